-- Finds the tasks of a job that failed and are tried again. Conventions as in 0001.

CREATE INDEX tasks_failing ON tasks (job_id) WHERE state IN ('waiting', 'ready', 'leased') AND (failures > 0 OR expiries > 1);
