-- Which frames that are booked elsewhere an idle node may take. Conventions as in 0001.

-- What the plan pays for an hour of a core of speed 1 of the task's work on the node where it is booked, in thousandths of a micro-unit. NULL: the task
-- is for whoever is idle, because it is booked nowhere, or because its job has neither a deadline nor a budget.
ALTER TABLE tasks ADD COLUMN booked_rate INTEGER CHECK (booked_rate >= 0);
-- By what an idle node looks for: what is booked dearest, and what should have begun first. Tasks for everybody are in neither.
CREATE INDEX tasks_ready_rates ON tasks (job_id, booked_rate DESC, frame, part) WHERE state = 'ready' AND booked_rate IS NOT NULL;
CREATE INDEX tasks_ready_starts ON tasks (job_id, booked_at, frame, part) WHERE state = 'ready' AND booked_rate IS NOT NULL;

-- A part of the forecast, beside it: a claim must not read all of that.
ALTER TABLE jobs ADD COLUMN work_by_class TEXT CHECK (json_valid(work_by_class));
UPDATE jobs SET work_by_class = json_extract(forecast, '$.work_by_class') WHERE forecast IS NOT NULL;

-- Why the node got none of the frames that there are, when it last asked; NULL if there were none for it to pass over.
ALTER TABLE nodes ADD COLUMN idle_reason TEXT;
