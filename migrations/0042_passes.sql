-- Divided frames that are rendered in passes. Conventions as in 0001.

-- A part renders its pixels of each pass in turn. What it did in earlier passes: work (or CPU time in microseconds, as in
-- `pixels_work`), CPU seconds on a node of speed 1, and measured CPU time in nanoseconds.
ALTER TABLE tasks ADD COLUMN earlier_work REAL NOT NULL DEFAULT 0 CHECK (earlier_work >= 0);
ALTER TABLE tasks ADD COLUMN earlier_cpu REAL NOT NULL DEFAULT 0 CHECK (earlier_cpu >= 0);
ALTER TABLE tasks ADD COLUMN earlier_nanos INTEGER NOT NULL DEFAULT 0 CHECK (earlier_nanos >= 0);
