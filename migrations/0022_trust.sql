-- What the farm knows of a lease besides its end: how it goes on, how it failed, and whose fault that was.

-- A task that makes no progress is run again beside its first attempt: at most two leases of a task are
-- active.
ALTER TABLE leases ADD COLUMN beside INTEGER NOT NULL DEFAULT 0 CHECK (beside IN (0, 1));
DROP INDEX leases_one_active;
CREATE UNIQUE INDEX leases_one_active ON leases (task_id, beside) WHERE state = 'active';

-- The worker's progress, and when it last grew. NULL: not yet.
ALTER TABLE leases ADD COLUMN progress REAL NOT NULL DEFAULT 0 CHECK (progress BETWEEN 0 AND 1);
ALTER TABLE leases ADD COLUMN progress_at INTEGER;
-- From when its time counts, if not from its begin: pauses, and the time in which the service was down, do
-- not.
ALTER TABLE leases ADD COLUMN counts_from INTEGER;
-- How long the task takes on this node in 19 of 20 cases, in microseconds. NULL if nothing was forecast.
ALTER TABLE leases ADD COLUMN p95 INTEGER CHECK (p95 >= 0);
-- 'late' beyond its P95, 'stalled' once the task is run again elsewhere.
ALTER TABLE leases ADD COLUMN lateness TEXT CHECK (lateness IN ('late', 'stalled'));

-- What a failed lease was said to fail of, and what the farm holds against its node. NULL: nothing.
ALTER TABLE leases ADD COLUMN failure TEXT CHECK (failure IN ('unknown', 'node', 'input', 'task'));
ALTER TABLE leases ADD COLUMN permanent INTEGER NOT NULL DEFAULT 0 CHECK (permanent IN (0, 1));
-- Whether no other node could do the task when it failed: this one gets it again without a delay.
ALTER TABLE leases ADD COLUMN alone INTEGER NOT NULL DEFAULT 0 CHECK (alone IN (0, 1));
ALTER TABLE leases ADD COLUMN fault TEXT CHECK (fault IN ('refused', 'stalled', 'unshared'));
UPDATE leases SET failure = CASE blameless WHEN 1 THEN 'task' ELSE 'unknown' END WHERE state = 'failed';
DROP INDEX leases_failed_on_node;
ALTER TABLE leases DROP COLUMN blameless;
CREATE INDEX leases_at_fault ON leases (node_id, ended_at) WHERE fault IS NOT NULL;

-- Whether a leased task should be run a second time beside the first.
ALTER TABLE tasks ADD COLUMN again INTEGER NOT NULL DEFAULT 0 CHECK (again IN (0, 1));
CREATE INDEX tasks_again ON tasks (due_at, priority DESC, job_id, frame) WHERE state = 'leased' AND again = 1;
