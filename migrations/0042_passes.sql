-- Divided frames that are rendered in passes, and parts that are divided again. Conventions as in 0001.

-- A part renders its pixels of each pass in turn. What it did in earlier passes: work (or CPU time in microseconds, as in
-- `pixels_work`), CPU seconds on a node of speed 1, and measured CPU time in nanoseconds.
ALTER TABLE tasks ADD COLUMN earlier_work REAL NOT NULL DEFAULT 0 CHECK (earlier_work >= 0);
ALTER TABLE tasks ADD COLUMN earlier_cpu REAL NOT NULL DEFAULT 0 CHECK (earlier_cpu >= 0);
ALTER TABLE tasks ADD COLUMN earlier_nanos INTEGER NOT NULL DEFAULT 0 CHECK (earlier_nanos >= 0);

-- Share of the frame's forecast cost that a part has. NULL: that of every part is the same. It is set once a part of the frame
-- is divided again.
ALTER TABLE tasks ADD COLUMN share REAL CHECK (share BETWEEN 0 AND 1);

-- Into how many parts the worker is to divide the pixels that it has not begun. NULL: it is not.
ALTER TABLE leases ADD COLUMN divide_rest INTEGER CHECK (divide_rest BETWEEN 2 AND 512);
