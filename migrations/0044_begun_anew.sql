-- What happened before a task begins anew is not held against it, and does not come back. Conventions as in 0001.

-- Leases up to this fence do not count: what they finished of the task is not gone on with. Pixels of a refused
-- result must not come back by their checkpoint.
ALTER TABLE tasks ADD COLUMN begun_anew INTEGER NOT NULL DEFAULT 0 CHECK (begun_anew >= 0);

-- Whether the task began anew after this attempt of Slurm.
ALTER TABLE slurm_elements ADD COLUMN is_past INTEGER NOT NULL DEFAULT 0 CHECK (is_past IN (0, 1));
