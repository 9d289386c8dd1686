-- Jobs whose images have their noise removed. Conventions as in 0001.

ALTER TABLE jobs ADD COLUMN denoise INTEGER NOT NULL DEFAULT 0 CHECK (denoise IN (0, 1));
