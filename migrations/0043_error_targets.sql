-- Jobs whose images are rendered until their error is small enough. Conventions as in 0001.

-- The largest error of each image, and how sure that must be. NULL: none is asked for.
ALTER TABLE jobs ADD COLUMN error_target TEXT CHECK (json_valid(error_target));
