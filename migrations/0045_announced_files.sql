-- Quotas count the files that open jobs are still to write. Conventions as in 0001.

-- Expected size of the files of one frame. 0: of a job from before this was counted.
ALTER TABLE jobs ADD COLUMN frame_bytes INTEGER NOT NULL DEFAULT 0 CHECK (frame_bytes >= 0);
