-- The estimate of a job lives: what it will have cost, as its frames are finished. Conventions as in 0001.

-- When a frame is on the shot's own clock; NULL of jobs that were booked before there was one.
ALTER TABLE frames ADD COLUMN clock REAL;

-- How much of a frame its worker has finished, and what that took; CPU seconds are those of a node of speed 1.
ALTER TABLE tasks ADD COLUMN pixels_share REAL CHECK (pixels_share BETWEEN 0 AND 1);
ALTER TABLE tasks ADD COLUMN pixels_work REAL;
ALTER TABLE tasks ADD COLUMN pixels_cpu REAL;

-- The newest estimate of each booked job, and what it is held against: what plan `plan_id` was made for. That was to take `booked_cpu`
-- in all, `booked_rest` of it for what was left then, which was the part `booked_share` of what was quoted.
-- `frames_since` were finished since it was made.
CREATE TABLE live_forecasts (
    job_id        BLOB PRIMARY KEY REFERENCES jobs (id),
    plan_id       BLOB NOT NULL REFERENCES plans (id),
    booked_cpu    REAL NOT NULL,
    booked_rest   REAL NOT NULL,
    booked_share  REAL NOT NULL,
    frames_done   INTEGER NOT NULL CHECK (frames_done >= 0),
    frames_since  INTEGER NOT NULL DEFAULT 0 CHECK (frames_since >= 0),
    cost_is_off   INTEGER NOT NULL CHECK (cost_is_off IN (0, 1)),
    finish_is_off INTEGER NOT NULL CHECK (finish_is_off IN (0, 1)),
    body          TEXT NOT NULL CHECK (json_valid(body)),
    updated_at    INTEGER NOT NULL
) STRICT;

-- What it was before, thinned: see `forelight-store`, `live`.
CREATE TABLE forecast_history (
    job_id BLOB NOT NULL REFERENCES live_forecasts (job_id),
    point  INTEGER NOT NULL CHECK (point >= 0),
    body   TEXT NOT NULL CHECK (json_valid(body)),
    PRIMARY KEY (job_id, point)
) STRICT, WITHOUT ROWID;
