-- What the farm remembers. Conventions:
--   ids          16 bytes, UUID version 7 (sorts by age)
--   …_at         microseconds since 1970-01-01T00:00:00Z
--   money        micro-units
--   JSON columns hold the wire types of the protocol crate
-- Every table is STRICT; tables of short rows go WITHOUT ROWID, so that the key is the table; what must hold whatever the code does is said here as a constraint.

-- Bearer tokens. Only the BLAKE3 hash of a token is kept: whoever reads the database cannot use it.
CREATE TABLE tokens (
    hash       BLOB PRIMARY KEY CHECK (length(hash) = 32),
    name       TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 200),
    role       TEXT NOT NULL CHECK (role IN ('submitter', 'worker', 'operator', 'viewer')),
    created_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- Files by content. A row is written only after the file is on disk, so a row means that the file is there.
CREATE TABLE artifacts (
    hash       BLOB PRIMARY KEY CHECK (length(hash) = 32),
    size       INTEGER NOT NULL CHECK (size >= 0),
    created_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE bundles (
    id         BLOB PRIMARY KEY CHECK (length(id) = 16),
    hash       BLOB NOT NULL REFERENCES artifacts (hash),
    scene      TEXT NOT NULL CHECK (json_valid(scene)),
    created_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX bundles_by_hash ON bundles (hash);

CREATE TABLE nodes (
    id             BLOB PRIMARY KEY CHECK (length(id) = 16),
    name           TEXT NOT NULL UNIQUE CHECK (length(name) BETWEEN 1 AND 100),
    speed          REAL NOT NULL CHECK (speed > 0),
    price_per_hour INTEGER NOT NULL CHECK (price_per_hour >= 0),
    cores          INTEGER NOT NULL CHECK (cores >= 1),
    -- What was set by hand goes before what the node says of itself, each time that it registers.
    speed_set      REAL CHECK (speed_set > 0),
    price_set      INTEGER CHECK (price_set >= 0),
    drain          INTEGER NOT NULL DEFAULT 0 CHECK (drain IN (0, 1)),
    created_at     INTEGER NOT NULL,
    last_seen_at   INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- Plans and their bookings never change: a new plan names its parent.
CREATE TABLE plans (
    id         BLOB PRIMARY KEY CHECK (length(id) = 16),
    parent_id  BLOB REFERENCES plans (id),
    reason     TEXT NOT NULL CHECK (reason IN ('job_forecast')),
    verdicts   TEXT NOT NULL CHECK (json_valid(verdicts)),
    created_at INTEGER NOT NULL
) STRICT;

CREATE TABLE jobs (
    id             BLOB PRIMARY KEY CHECK (length(id) = 16),
    name           TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 200),
    project        TEXT NOT NULL CHECK (length(project) BETWEEN 1 AND 200),
    state          TEXT NOT NULL CHECK (state IN ('previewing', 'profiling', 'booked', 'rendering', 'done', 'failed', 'cancelled')),
    bundle_id      BLOB REFERENCES bundles (id),
    bundle_path    TEXT,
    bundle_source  TEXT NOT NULL CHECK (json_valid(bundle_source)),
    scene          TEXT NOT NULL CHECK (json_valid(scene)),
    frames         TEXT NOT NULL,
    frames_total   INTEGER NOT NULL CHECK (frames_total >= 1),
    settings       TEXT NOT NULL CHECK (json_valid(settings)),
    samples        INTEGER NOT NULL CHECK (samples >= 1),
    profile_frames INTEGER NOT NULL CHECK (profile_frames >= 1),
    deadline_at    INTEGER,
    budget         INTEGER CHECK (budget >= 0),
    confidence     TEXT NOT NULL CHECK (confidence IN ('p50', 'p80', 'p95')),
    priority       INTEGER NOT NULL,
    forecast       TEXT CHECK (json_valid(forecast)),
    plan_id        BLOB REFERENCES plans (id),
    verdict        TEXT CHECK (json_valid(verdict)),
    error          TEXT,
    created_at     INTEGER NOT NULL,
    finished_at    INTEGER,
    CHECK ((bundle_id IS NULL) <> (bundle_path IS NULL)),
    CHECK ((finished_at IS NOT NULL) = (state IN ('done', 'failed', 'cancelled'))),
    CHECK ((error IS NOT NULL) = (state = 'failed')),
    CHECK (state NOT IN ('booked', 'rendering', 'done') OR (forecast IS NOT NULL AND plan_id IS NOT NULL))
) STRICT;
CREATE INDEX jobs_by_state ON jobs (state, id);
CREATE INDEX jobs_by_project ON jobs (project, id);
CREATE INDEX jobs_by_bundle ON jobs (bundle_id);
CREATE INDEX jobs_by_plan ON jobs (plan_id);

CREATE TABLE bookings (
    id       BLOB PRIMARY KEY CHECK (length(id) = 16),
    plan_id  BLOB NOT NULL REFERENCES plans (id),
    job_id   BLOB NOT NULL REFERENCES jobs (id),
    frame    INTEGER NOT NULL CHECK (frame >= 0),
    node_id  BLOB NOT NULL REFERENCES nodes (id),
    start_at INTEGER NOT NULL,
    end_at   INTEGER NOT NULL,
    CHECK (start_at < end_at),
    UNIQUE (plan_id, job_id, frame)
) STRICT, WITHOUT ROWID;
CREATE INDEX bookings_by_node ON bookings (node_id, start_at);
CREATE INDEX bookings_by_job ON bookings (job_id, frame);

CREATE TRIGGER plans_are_never_changed BEFORE UPDATE ON plans
BEGIN SELECT RAISE(ABORT, 'a plan never changes'); END;
CREATE TRIGGER plans_are_never_deleted BEFORE DELETE ON plans
BEGIN SELECT RAISE(ABORT, 'a plan never changes'); END;
CREATE TRIGGER bookings_are_never_changed BEFORE UPDATE ON bookings
BEGIN SELECT RAISE(ABORT, 'a booking never changes'); END;
CREATE TRIGGER bookings_are_never_deleted BEFORE DELETE ON bookings
BEGIN SELECT RAISE(ABORT, 'a booking never changes'); END;

-- The work of a job. `fence` counts the hand-outs: it is the fencing token of the newest lease.
-- `due_at` and `priority` are the job's, `booked_…` the plan's: the claim must find its task by index alone.
CREATE TABLE tasks (
    id            BLOB PRIMARY KEY CHECK (length(id) = 16),
    job_id        BLOB NOT NULL REFERENCES jobs (id),
    kind          TEXT NOT NULL CHECK (kind IN ('preview', 'profile', 'render')),
    frame         INTEGER CHECK (frame >= 0),
    state         TEXT NOT NULL CHECK (state IN ('ready', 'leased', 'done', 'failed', 'cancelled')),
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
    CHECK ((kind = 'preview') = (frame IS NULL)),
    CHECK ((booked_node IS NULL) = (booked_at IS NULL))
) STRICT;
-- A job has each task once: creating them twice, as after a restart, does nothing.
CREATE UNIQUE INDEX tasks_once ON tasks (job_id, kind, ifnull(frame, -1));
CREATE INDEX tasks_ready_quotes ON tasks (priority DESC, due_at, job_id, frame) WHERE state = 'ready' AND kind <> 'render';
CREATE INDEX tasks_ready_booked ON tasks (booked_node, booked_at, job_id, frame) WHERE state = 'ready' AND kind = 'render';
CREATE INDEX tasks_ready_any ON tasks (due_at, priority DESC, job_id, frame) WHERE state = 'ready' AND kind = 'render';
CREATE INDEX tasks_by_state ON tasks (state);
CREATE INDEX tasks_by_node ON tasks (node_id) WHERE state = 'leased';

CREATE TABLE leases (
    id         BLOB PRIMARY KEY CHECK (length(id) = 16),
    task_id    BLOB NOT NULL REFERENCES tasks (id),
    node_id    BLOB NOT NULL REFERENCES nodes (id),
    fence      INTEGER NOT NULL CHECK (fence >= 1),
    node_speed REAL NOT NULL CHECK (node_speed > 0),
    state      TEXT NOT NULL CHECK (state IN ('active', 'committed', 'failed', 'expired', 'released', 'revoked')),
    granted_at INTEGER NOT NULL,
    expires_at INTEGER NOT NULL,
    ended_at   INTEGER,
    CHECK ((ended_at IS NULL) = (state = 'active')),
    UNIQUE (task_id, fence)
) STRICT, WITHOUT ROWID;
-- The one thing that must never happen is that two workers hold a task: the database itself refuses it.
CREATE UNIQUE INDEX leases_one_active ON leases (task_id) WHERE state = 'active';
CREATE INDEX leases_expiring ON leases (expires_at) WHERE state = 'active';
CREATE INDEX leases_of_node ON leases (node_id) WHERE state = 'active';

-- Committed results: one a task, for good.
CREATE TABLE results (
    task_id      BLOB PRIMARY KEY REFERENCES tasks (id),
    lease_id     BLOB NOT NULL REFERENCES leases (id),
    body         TEXT NOT NULL CHECK (json_valid(body)),
    body_hash    BLOB NOT NULL CHECK (length(body_hash) = 32),
    committed_at INTEGER NOT NULL
) STRICT;
CREATE TABLE result_artifacts (
    task_id BLOB NOT NULL REFERENCES results (task_id),
    hash    BLOB NOT NULL REFERENCES artifacts (hash),
    PRIMARY KEY (task_id, hash)
) STRICT, WITHOUT ROWID;
CREATE INDEX result_artifacts_by_hash ON result_artifacts (hash);

-- A job's frames: what was forecast and what it took. CPU seconds are those of a node of speed 1.
CREATE TABLE frames (
    job_id      BLOB NOT NULL REFERENCES jobs (id),
    frame       INTEGER NOT NULL CHECK (frame >= 0),
    forecast    TEXT CHECK (json_valid(forecast)),
    work_mean   REAL, work_p50 REAL, work_p80 REAL, work_p95 REAL,
    cpu_mean    REAL, cpu_p50 REAL, cpu_p80 REAL, cpu_p95 REAL,
    preview_png BLOB REFERENCES artifacts (hash),
    artifacts   TEXT CHECK (json_valid(artifacts)),
    actual      TEXT CHECK (json_valid(actual)),
    actual_work REAL,
    actual_cpu  REAL,
    finished_at INTEGER,
    PRIMARY KEY (job_id, frame),
    CHECK ((forecast IS NULL) = (work_mean IS NULL)),
    CHECK ((actual IS NULL) = (finished_at IS NULL))
) STRICT;
CREATE INDEX frames_track_record ON frames (finished_at, job_id, frame) WHERE finished_at IS NOT NULL AND forecast IS NOT NULL;
CREATE INDEX frames_by_preview ON frames (preview_png) WHERE preview_png IS NOT NULL;

-- What happened, in one order. AUTOINCREMENT: an id is never used again, so "everything after n" never misses one.
CREATE TABLE events (
    id     INTEGER PRIMARY KEY AUTOINCREMENT,
    at     INTEGER NOT NULL,
    kind   TEXT NOT NULL,
    job_id BLOB,
    body   TEXT NOT NULL CHECK (json_valid(body))
) STRICT;
CREATE INDEX events_of_job ON events (job_id, id) WHERE job_id IS NOT NULL;
CREATE INDEX events_progress ON events (at) WHERE kind = 'task_progress';

-- Answers to creating requests, written in the transaction that creates: a repeated request finds its answer.
CREATE TABLE idempotency (
    principal    BLOB NOT NULL CHECK (length(principal) = 32),
    key          TEXT NOT NULL CHECK (length(key) BETWEEN 1 AND 255),
    request_hash BLOB NOT NULL CHECK (length(request_hash) = 32),
    status       INTEGER NOT NULL,
    body         TEXT NOT NULL,
    created_at   INTEGER NOT NULL,
    PRIMARY KEY (principal, key)
) STRICT;
CREATE INDEX idempotency_by_age ON idempotency (created_at);
