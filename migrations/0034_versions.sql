-- Which version of our own renderer renders a job, and why frames may come from more than one. Conventions as in
-- 0001. NULL: no node has said which version it has, or the job is of another renderer.
ALTER TABLE jobs ADD COLUMN rendered_by TEXT CHECK (json_valid(rendered_by));
