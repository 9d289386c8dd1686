-- Renderers other than our own: the one that a job asks for, the same for its tasks as one text such as `cycles 5.0.1`, and
-- every text that each node answers to. NULL is our own renderer, which every node has.
ALTER TABLE jobs ADD COLUMN renderer TEXT CHECK (renderer IS NULL OR json_valid(renderer));
ALTER TABLE tasks ADD COLUMN renderer TEXT;
ALTER TABLE nodes ADD COLUMN renderers TEXT NOT NULL DEFAULT '[]' CHECK (json_valid(renderers));
