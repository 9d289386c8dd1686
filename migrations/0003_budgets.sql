-- What projects may spend, what they spent, and what was said of the nights to come. Conventions as in 0001.

-- A project has one budget of each kind. `action` is what is in force for the period that began at `period_at`.
CREATE TABLE budgets (
    project    TEXT NOT NULL CHECK (length(project) BETWEEN 1 AND 200),
    period     TEXT NOT NULL CHECK (period IN ('night', 'month', 'total')),
    amount     INTEGER NOT NULL CHECK (amount >= 0),
    zone       TEXT NOT NULL CHECK (length(zone) BETWEEN 1 AND 100),
    thresholds TEXT NOT NULL CHECK (json_valid(thresholds)),
    action     TEXT CHECK (action IN ('warn', 'drain', 'stop')),
    period_at  INTEGER,
    updated_at INTEGER NOT NULL,
    PRIMARY KEY (project, period),
    CHECK (action IS NULL OR period_at IS NOT NULL)
) STRICT, WITHOUT ROWID;

-- What was paid for: a row for each lease, at the price that its node had when it was granted. While the lease is active, neither end nor cost is
-- known. Triggers write it, so that no way for a lease to end can be forgotten.
CREATE TABLE ledger (
    lease_id       BLOB PRIMARY KEY REFERENCES leases (id),
    project        TEXT NOT NULL,
    job_id         BLOB NOT NULL REFERENCES jobs (id),
    node_id        BLOB NOT NULL REFERENCES nodes (id),
    price_per_hour INTEGER NOT NULL CHECK (price_per_hour >= 0),
    from_at        INTEGER NOT NULL,
    until_at       INTEGER,
    CHECK (until_at IS NULL OR until_at >= from_at)
) STRICT, WITHOUT ROWID;
CREATE INDEX ledger_by_project ON ledger (project, from_at);
CREATE INDEX ledger_by_time ON ledger (from_at);
CREATE INDEX ledger_running ON ledger (project) WHERE until_at IS NULL;

INSERT INTO ledger (lease_id, project, job_id, node_id, price_per_hour, from_at, until_at)
SELECT l.id, j.project, j.id, l.node_id, coalesce(n.price_set, n.price_per_hour), l.granted_at, max(l.ended_at, l.granted_at)
FROM leases l JOIN tasks t ON t.id = l.task_id JOIN jobs j ON j.id = t.job_id JOIN nodes n ON n.id = l.node_id;

CREATE TRIGGER ledger_begins AFTER INSERT ON leases
BEGIN
    INSERT INTO ledger (lease_id, project, job_id, node_id, price_per_hour, from_at, until_at)
    SELECT NEW.id, j.project, j.id, n.id, coalesce(n.price_set, n.price_per_hour), NEW.granted_at, max(NEW.ended_at, NEW.granted_at)
    FROM tasks t JOIN jobs j ON j.id = t.job_id JOIN nodes n ON n.id = NEW.node_id WHERE t.id = NEW.task_id;
END;
CREATE TRIGGER ledger_ends AFTER UPDATE OF ended_at ON leases WHEN OLD.ended_at IS NULL AND NEW.ended_at IS NOT NULL
BEGIN
    UPDATE ledger SET until_at = max(NEW.ended_at, from_at) WHERE lease_id = NEW.id;
END;
CREATE TRIGGER ledger_is_never_rewritten BEFORE UPDATE ON ledger WHEN OLD.until_at IS NOT NULL
BEGIN SELECT RAISE(ABORT, 'what was paid never changes'); END;
CREATE TRIGGER ledger_is_never_deleted BEFORE DELETE ON ledger
BEGIN SELECT RAISE(ABORT, 'what was paid never changes'); END;

-- A task is held back while a budget of its project says that nothing new is started.
ALTER TABLE tasks ADD COLUMN held INTEGER NOT NULL DEFAULT 0 CHECK (held IN (0, 1));
CREATE INDEX tasks_held ON tasks (job_id) WHERE held = 1;
CREATE TRIGGER tasks_begin_held AFTER INSERT ON tasks
WHEN EXISTS (SELECT 1 FROM budgets b JOIN jobs j ON j.project = b.project WHERE j.id = NEW.job_id AND b.action IN ('drain', 'stop'))
BEGIN UPDATE tasks SET held = 1 WHERE id = NEW.id; END;

-- What was said of a night, before it began: one row for each, however often it is asked for. `made_at` is when it was said last.
CREATE TABLE budget_forecasts (
    date     TEXT NOT NULL CHECK (date GLOB '[0-9][0-9][0-9][0-9]-[0-1][0-9]-[0-3][0-9]'),
    zone     TEXT NOT NULL CHECK (length(zone) BETWEEN 1 AND 100),
    begin_at INTEGER NOT NULL,
    end_at   INTEGER NOT NULL,
    made_at  INTEGER NOT NULL,
    body     TEXT NOT NULL CHECK (json_valid(body)),
    PRIMARY KEY (date, zone),
    CHECK (begin_at < end_at)
) STRICT;
CREATE INDEX budget_forecasts_by_night ON budget_forecasts (begin_at);
