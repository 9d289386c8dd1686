-- From a frame to its task, one step for each. Conventions as in 0001.

-- `tasks_once` does not do for that: a job has tasks of no frame, so it holds an expression in place of the frame, and joins to it go
-- through all of a job's tasks for each of its frames.
CREATE UNIQUE INDEX tasks_of_frames ON tasks (job_id, frame) WHERE kind = 'render';

-- Jobs whose newest estimate does not know of every finished frame: the sweep looks for them.
CREATE INDEX live_forecasts_behind ON live_forecasts (updated_at) WHERE frames_since > 0;
