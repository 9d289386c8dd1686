-- What is deleted with time, and what stays of it.

-- How many days things are kept after their job has ended. `days` is NULL for ever. The farm's own rules have
-- an empty project; where there is no rule, the program's defaults hold.
CREATE TABLE retention (
    project TEXT NOT NULL CHECK (length(project) <= 200),
    kind    TEXT NOT NULL CHECK (kind IN ('images', 'profiles', 'scenes', 'logs', 'events', 'plans', 'jobs')),
    days    INTEGER CHECK (days BETWEEN 0 AND 36500),
    PRIMARY KEY (project, kind)
) STRICT, WITHOUT ROWID;

-- The last time that what is past its time was deleted.
CREATE TABLE last_prune (
    one  INTEGER PRIMARY KEY CHECK (one = 1),
    at   INTEGER NOT NULL,
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;

-- Jobs that were deleted. A row also lets the bookings and payments of its job be deleted, see the triggers.
CREATE TABLE deleted_jobs (
    id         BLOB PRIMARY KEY CHECK (length(id) = 16),
    name       TEXT NOT NULL,
    project    TEXT NOT NULL,
    deleted_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX deleted_jobs_by_age ON deleted_jobs (deleted_at);

-- Plans that are being deleted: rows exist only within a write.
CREATE TABLE deleted_plans (
    id BLOB PRIMARY KEY CHECK (length(id) = 16)
) STRICT, WITHOUT ROWID;

-- What deleted jobs cost, by project and quarter of an hour. Nights and months begin at full hours in all time
-- zones of today, so sums over them are exact.
CREATE TABLE past_payments (
    project TEXT NOT NULL,
    from_at INTEGER NOT NULL CHECK (from_at % 900000000 = 0),
    cost    INTEGER NOT NULL CHECK (cost >= 0),
    -- Node time, microseconds.
    used    INTEGER NOT NULL CHECK (used >= 0),
    PRIMARY KEY (project, from_at)
) STRICT, WITHOUT ROWID;

ALTER TABLE jobs ADD COLUMN images_deleted_at INTEGER;
ALTER TABLE jobs ADD COLUMN profiles_deleted_at INTEGER;
CREATE INDEX jobs_by_end ON jobs (finished_at) WHERE finished_at IS NOT NULL;

-- Since when nothing refers to an artefact. It is deleted if this is long ago.
ALTER TABLE artifacts ADD COLUMN unused_since INTEGER;
CREATE INDEX artifacts_unused ON artifacts (unused_since) WHERE unused_since IS NOT NULL;

-- A bundle outlives its file: its jobs refer to it.
PRAGMA defer_foreign_keys = ON;
CREATE TABLE bundles_before AS SELECT * FROM bundles;
DROP TABLE bundles;
CREATE TABLE bundles (
    id          BLOB PRIMARY KEY CHECK (length(id) = 16),
    hash        BLOB REFERENCES artifacts (hash),
    scene       TEXT NOT NULL CHECK (json_valid(scene)),
    created_at  INTEGER NOT NULL,
    uploaded_by TEXT
) STRICT, WITHOUT ROWID;
INSERT INTO bundles (id, hash, scene, created_at, uploaded_by)
SELECT id, hash, scene, created_at, uploaded_by FROM bundles_before;
DROP TABLE bundles_before;
CREATE INDEX bundles_by_hash ON bundles (hash) WHERE hash IS NOT NULL;

DROP TRIGGER plans_are_never_changed;
CREATE TRIGGER plans_are_never_changed BEFORE UPDATE ON plans
WHEN NOT EXISTS (SELECT 1 FROM deleted_plans WHERE id = OLD.parent_id)
BEGIN SELECT RAISE(ABORT, 'a plan never changes'); END;
DROP TRIGGER plans_are_never_deleted;
CREATE TRIGGER plans_are_never_deleted BEFORE DELETE ON plans
WHEN NOT EXISTS (SELECT 1 FROM deleted_plans WHERE id = OLD.id)
BEGIN SELECT RAISE(ABORT, 'a plan never changes'); END;
DROP TRIGGER bookings_are_never_deleted;
CREATE TRIGGER bookings_are_never_deleted BEFORE DELETE ON bookings
WHEN NOT EXISTS (SELECT 1 FROM deleted_jobs WHERE id = OLD.job_id)
 AND NOT EXISTS (SELECT 1 FROM deleted_plans WHERE id = OLD.plan_id)
BEGIN SELECT RAISE(ABORT, 'a booking never changes'); END;
DROP TRIGGER shared_cache_bookings_are_never_deleted;
CREATE TRIGGER shared_cache_bookings_are_never_deleted BEFORE DELETE ON shared_cache_bookings
WHEN NOT EXISTS (SELECT 1 FROM deleted_jobs WHERE id = OLD.job_id)
 AND NOT EXISTS (SELECT 1 FROM deleted_plans WHERE id = OLD.plan_id)
BEGIN SELECT RAISE(ABORT, 'a booking never changes'); END;
DROP TRIGGER ledger_is_never_deleted;
CREATE TRIGGER ledger_is_never_deleted BEFORE DELETE ON ledger
WHEN NOT EXISTS (SELECT 1 FROM deleted_jobs WHERE id = OLD.job_id)
BEGIN SELECT RAISE(ABORT, 'what was paid never changes'); END;

-- A row that is deleted is looked for in all tables that may refer to it.
CREATE INDEX results_by_lease ON results (lease_id);
CREATE INDEX ledger_by_job ON ledger (job_id);
CREATE INDEX node_learning_by_job ON node_learning (job_id);
CREATE INDEX live_forecasts_by_plan ON live_forecasts (plan_id);
CREATE INDEX plans_by_parent ON plans (parent_id) WHERE parent_id IS NOT NULL;

-- What something refers to.
CREATE VIEW used_artifacts AS
SELECT hash FROM result_artifacts
UNION ALL SELECT hash FROM bundles WHERE hash IS NOT NULL
UNION ALL SELECT preview_png FROM frames WHERE preview_png IS NOT NULL;
