-- Videos of finished frames. Conventions as in 0001.

-- The video that is asked for: `{}` or `{"frames_per_second": 24}`. NULL: none.
ALTER TABLE jobs ADD COLUMN video TEXT CHECK (json_valid(video));

-- The kinds of tasks are in a constraint of the table, so it is made again under its name, as in 0032. From now on the program
-- knows the kinds.
PRAGMA defer_foreign_keys = ON;
CREATE TABLE tasks_before AS SELECT * FROM tasks;
DROP TABLE tasks;

-- `round` and `part` are those of an irradiance cache; `part` is also that of a frame. A cache is of one frame or, without a
-- frame, shared by all. A `video` is of all frames.
-- `booked_part` is the part of the frame whose booking the task has: 0 of a whole frame. The `render` task of a divided frame
-- has none until its parts are done. Then it has that of part 0, to put the frame together, and the parts have none.
-- `renderer` is what a node must have: a renderer, or `(ffmpeg)`, see `nodes.renderers`.
CREATE TABLE tasks (
    id            BLOB PRIMARY KEY CHECK (length(id) = 16),
    job_id        BLOB NOT NULL REFERENCES jobs (id),
    kind          TEXT NOT NULL,
    frame         INTEGER CHECK (frame >= 0),
    round         INTEGER CHECK (round >= 0),
    part          INTEGER CHECK (part >= 0),
    booked_part   INTEGER CHECK (booked_part >= 0),
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
    booked_rate   INTEGER CHECK (booked_rate >= 0),
    renderer      TEXT,
    again         INTEGER NOT NULL DEFAULT 0 CHECK (again IN (0, 1)),
    CHECK (kind NOT IN ('profile', 'divide', 'render_part', 'render') OR frame IS NOT NULL),
    CHECK (kind NOT IN ('preview', 'cache_plan', 'video') OR frame IS NULL),
    CHECK ((kind IN ('cache_fill', 'cache_merge')) = (round IS NOT NULL)),
    CHECK ((kind IN ('cache_fill', 'render_part')) = (part IS NOT NULL)),
    CHECK (booked_part IS NULL OR kind IN ('render_part', 'render')),
    CHECK ((booked_node IS NULL) = (booked_at IS NULL))
) STRICT;
INSERT INTO tasks (id, job_id, kind, frame, round, part, booked_part, state, spec, fence, failures, expiries, progress, error, due_at,
                   priority, booked_node, booked_at, node_id, started_at, finished_at, held, limits, not_before, pixels_share,
                   pixels_work, pixels_cpu, booked_rate, renderer, again)
SELECT id, job_id, kind, frame, round, part, booked_part, state, spec, fence, failures, expiries, progress, error, due_at,
       priority, booked_node, booked_at, node_id, started_at, finished_at, held, limits, not_before, pixels_share,
       pixels_work, pixels_cpu, booked_rate, renderer, again
FROM tasks_before;
DROP TABLE tasks_before;

-- A job has each task once: creating them twice, as after a restart, does nothing.
CREATE UNIQUE INDEX tasks_once ON tasks (job_id, kind, ifnull(frame, -1), ifnull(round, -1), ifnull(part, -1));
-- What plans do not book; what they book: frames and their parts, and parts of shared caches.
CREATE INDEX tasks_ready_quotes ON tasks (priority DESC, due_at, job_id, frame)
    WHERE state = 'ready' AND kind NOT IN ('cache_fill', 'render_part', 'render');
CREATE INDEX tasks_ready_booked ON tasks (booked_node, booked_at, job_id, frame, part)
    WHERE state = 'ready' AND kind IN ('cache_fill', 'render_part', 'render');
CREATE INDEX tasks_ready_any ON tasks (due_at, priority DESC, job_id, frame, part)
    WHERE state = 'ready' AND kind IN ('cache_fill', 'render_part', 'render');
CREATE INDEX tasks_ready_rates ON tasks (job_id, booked_rate DESC, frame, part) WHERE state = 'ready' AND booked_rate IS NOT NULL;
CREATE INDEX tasks_ready_starts ON tasks (job_id, booked_at, frame, part) WHERE state = 'ready' AND booked_rate IS NOT NULL;
CREATE INDEX tasks_by_state ON tasks (state);
CREATE INDEX tasks_by_node ON tasks (node_id) WHERE state = 'leased';
CREATE INDEX tasks_held ON tasks (job_id) WHERE held = 1;
CREATE INDEX tasks_backing_off ON tasks (not_before) WHERE state = 'ready' AND not_before > 0;
CREATE INDEX tasks_again ON tasks (due_at, priority DESC, job_id, frame) WHERE state = 'leased' AND again = 1;
CREATE UNIQUE INDEX tasks_of_frames ON tasks (job_id, frame) WHERE kind = 'render';
-- From a booking to its task.
CREATE UNIQUE INDEX tasks_of_bookings ON tasks (job_id, frame, booked_part) WHERE booked_part IS NOT NULL;
-- From a divided frame to its parts.
CREATE INDEX tasks_of_parts ON tasks (job_id, frame, part) WHERE kind = 'render_part';
CREATE TRIGGER tasks_begin_held AFTER INSERT ON tasks
WHEN EXISTS (SELECT 1 FROM budgets b JOIN jobs j ON j.project = b.project WHERE j.id = NEW.job_id AND b.action IN ('drain', 'stop'))
BEGIN UPDATE tasks SET held = 1 WHERE id = NEW.id; END;
