-- Whether more frames are profiled than the first, as many as pay; `profile_frames` are the first then.
ALTER TABLE jobs ADD COLUMN profiles_more INTEGER NOT NULL DEFAULT 0 CHECK (profiles_more IN (0, 1));
