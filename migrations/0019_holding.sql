-- Jobs whose quote is looked at before nodes are booked; terms that change; frames that are left out. Conventions as in 0001.

-- `stage` is how far a job is. `state` is what people see of it: a job whose quote is complete, and for which nothing is booked, is
-- quoted. SQLite cannot widen the check of a column, and to make this table again would look at every row that refers to a job.
ALTER TABLE jobs RENAME COLUMN state TO stage;
-- Whether the job waits to be accepted, and when its quote was complete.
ALTER TABLE jobs ADD COLUMN hold INTEGER NOT NULL DEFAULT 0 CHECK (hold IN (0, 1));
ALTER TABLE jobs ADD COLUMN quoted_at INTEGER;
ALTER TABLE jobs ADD COLUMN state TEXT NOT NULL
    GENERATED ALWAYS AS (CASE WHEN stage = 'profiling' AND quoted_at IS NOT NULL THEN 'quoted' ELSE stage END) VIRTUAL;
DROP INDEX jobs_by_state;
CREATE INDEX jobs_by_state ON jobs (state, id);

-- How often deadline, budget or confidence were changed, and which of these the newest plan of the job was made for.
ALTER TABLE jobs ADD COLUMN terms INTEGER NOT NULL DEFAULT 0 CHECK (terms >= 0);
ALTER TABLE jobs ADD COLUMN terms_planned INTEGER NOT NULL DEFAULT 0 CHECK (terms_planned >= 0);

-- A frame that a person took out of its job: the job is done without it.
ALTER TABLE frames ADD COLUMN dropped INTEGER NOT NULL DEFAULT 0 CHECK (dropped IN (0, 1));
DROP INDEX frames_open;
CREATE INDEX frames_open ON frames (job_id) WHERE actual IS NULL AND dropped = 0;
