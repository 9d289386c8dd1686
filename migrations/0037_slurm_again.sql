-- Under Slurm, too, a task that makes no progress is run a second time beside the first. Conventions as in 0001.

-- Whether the process was requested beside another one that has the task.
ALTER TABLE slurm_elements ADD COLUMN beside INTEGER NOT NULL DEFAULT 0 CHECK (beside IN (0, 1));
DROP INDEX slurm_one_open;
-- Nothing is submitted twice: the database itself refuses it.
CREATE UNIQUE INDEX slurm_one_open ON slurm_elements (task_id, beside) WHERE outcome IS NULL;
