-- Irradiance caches that the frames of a job share: tasks that make them, frames that wait for them. Conventions as in 0001.

-- Whether the frames are to share one, if they have any.
ALTER TABLE jobs ADD COLUMN cache TEXT NOT NULL DEFAULT 'auto' CHECK (cache IN ('auto', 'shared', 'private'));

-- New kinds of tasks, and a state of tasks that wait for others, are in constraints of the table, which SQLite does not change in place: the
-- table is made again under its name. Rows that refer to tasks find them again before the transaction ends.
PRAGMA defer_foreign_keys = ON;
CREATE TABLE tasks_before AS SELECT * FROM tasks;
DROP TABLE tasks;

-- `round` and `part` are those of an irradiance cache: each round fills one of its levels, in parts.
-- A task that waits becomes ready in the transaction that commits what it waits for.
CREATE TABLE tasks (
    id            BLOB PRIMARY KEY CHECK (length(id) = 16),
    job_id        BLOB NOT NULL REFERENCES jobs (id),
    kind          TEXT NOT NULL CHECK (kind IN ('preview', 'profile', 'cache_plan', 'cache_fill', 'cache_merge', 'render')),
    frame         INTEGER CHECK (frame >= 0),
    round         INTEGER CHECK (round >= 0),
    part          INTEGER CHECK (part >= 0),
    state         TEXT NOT NULL CHECK (state IN ('waiting', 'ready', 'leased', 'done', 'failed', 'cancelled')),
    spec          TEXT NOT NULL CHECK (json_valid(spec)),
    fence         INTEGER NOT NULL DEFAULT 0 CHECK (fence >= 0),
    failures      INTEGER NOT NULL DEFAULT 0 CHECK (failures >= 0),
    expiries      INTEGER NOT NULL DEFAULT 0 CHECK (expiries >= 0),
    progress      REAL NOT NULL DEFAULT 0 CHECK (progress BETWEEN 0 AND 1),
    error         TEXT,
    due_at        INTEGER NOT NULL,
    priority      INTEGER NOT NULL,
    booked_node   BLOB REFERENCES nodes (id),
    booked_at     INTEGER,
    node_id       BLOB REFERENCES nodes (id),
    started_at    INTEGER,
    finished_at   INTEGER,
    held          INTEGER NOT NULL DEFAULT 0 CHECK (held IN (0, 1)),
    limits        TEXT NOT NULL DEFAULT '{}' CHECK (json_valid(limits)),
    not_before    INTEGER NOT NULL DEFAULT 0,
    pixels_share  REAL CHECK (pixels_share BETWEEN 0 AND 1),
    pixels_work   REAL,
    pixels_cpu    REAL,
    CHECK ((kind IN ('profile', 'render')) = (frame IS NOT NULL)),
    CHECK ((kind IN ('cache_fill', 'cache_merge')) = (round IS NOT NULL)),
    CHECK ((kind = 'cache_fill') = (part IS NOT NULL)),
    CHECK ((booked_node IS NULL) = (booked_at IS NULL))
) STRICT;
INSERT INTO tasks (id, job_id, kind, frame, state, spec, fence, failures, expiries, progress, error, due_at, priority, booked_node, booked_at,
                   node_id, started_at, finished_at, held, limits, not_before, pixels_share, pixels_work, pixels_cpu)
SELECT id, job_id, kind, frame, state, spec, fence, failures, expiries, progress, error, due_at, priority, booked_node, booked_at,
       node_id, started_at, finished_at, held, limits, not_before, pixels_share, pixels_work, pixels_cpu
FROM tasks_before;
DROP TABLE tasks_before;

-- A job has each task once: creating them twice, as after a restart, does nothing.
CREATE UNIQUE INDEX tasks_once ON tasks (job_id, kind, ifnull(frame, -1), ifnull(round, -1), ifnull(part, -1));
-- What others wait for and takes little; what is booked: frames, and parts of the caches that they share.
CREATE INDEX tasks_ready_quotes ON tasks (priority DESC, due_at, job_id, frame) WHERE state = 'ready' AND kind NOT IN ('cache_fill', 'render');
CREATE INDEX tasks_ready_booked ON tasks (booked_node, booked_at, job_id, frame, part) WHERE state = 'ready' AND kind IN ('cache_fill', 'render');
CREATE INDEX tasks_ready_any ON tasks (due_at, priority DESC, job_id, frame, part) WHERE state = 'ready' AND kind IN ('cache_fill', 'render');
CREATE INDEX tasks_by_state ON tasks (state);
CREATE INDEX tasks_by_node ON tasks (node_id) WHERE state = 'leased';
CREATE INDEX tasks_held ON tasks (job_id) WHERE held = 1;
CREATE INDEX tasks_backing_off ON tasks (not_before) WHERE state = 'ready' AND not_before > 0;
CREATE TRIGGER tasks_begin_held AFTER INSERT ON tasks
WHEN EXISTS (SELECT 1 FROM budgets b JOIN jobs j ON j.project = b.project WHERE j.id = NEW.job_id AND b.action IN ('drain', 'stop'))
BEGIN UPDATE tasks SET held = 1 WHERE id = NEW.id; END;

-- What a plan books for the cache that a job's frames share.
CREATE TABLE seed_bookings (
    plan_id  BLOB NOT NULL REFERENCES plans (id),
    job_id   BLOB NOT NULL REFERENCES jobs (id),
    part     INTEGER NOT NULL CHECK (part >= 0),
    node_id  BLOB NOT NULL REFERENCES nodes (id),
    start_at INTEGER NOT NULL,
    end_at   INTEGER NOT NULL,
    PRIMARY KEY (plan_id, job_id, part),
    CHECK (start_at < end_at)
) STRICT, WITHOUT ROWID;
CREATE INDEX seed_bookings_by_job ON seed_bookings (job_id);
CREATE TRIGGER seed_bookings_are_never_changed BEFORE UPDATE ON seed_bookings
BEGIN SELECT RAISE(ABORT, 'a booking never changes'); END;
CREATE TRIGGER seed_bookings_are_never_deleted BEFORE DELETE ON seed_bookings
BEGIN SELECT RAISE(ABORT, 'a booking never changes'); END;
