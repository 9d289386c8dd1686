-- Whom tokens belong to, and which projects they reach. Conventions as in 0001.

-- A token belongs to a person or to a service. `projects` holds a role for each project that it reaches; without
-- it, `role` holds for all projects. With it, `role` is the highest of them.
ALTER TABLE tokens ADD COLUMN kind TEXT NOT NULL DEFAULT 'person' CHECK (kind IN ('person', 'service'));
UPDATE tokens SET kind = 'service' WHERE role = 'worker' OR first = 1;
ALTER TABLE tokens ADD COLUMN projects TEXT CHECK (json_valid(projects));
CREATE TRIGGER tokens_reach_other_projects AFTER UPDATE OF projects ON tokens
BEGIN
    INSERT INTO ended_rights (hash, is_over)
    SELECT OLD.hash, 1 UNION ALL SELECT secret_hash, 1 FROM sessions WHERE token_hash = OLD.hash;
END;

-- Projects exist before jobs are booked on them. Those of today do.
INSERT INTO projects (name, share, updated_at)
SELECT project, 1, 0 FROM (SELECT project FROM jobs UNION SELECT project FROM budgets UNION SELECT 'default')
WHERE project NOT IN (SELECT name FROM projects);

-- By whom a bundle was uploaded: who reaches some projects only, sees his own bundles and those of their jobs.
ALTER TABLE bundles ADD COLUMN uploaded_by TEXT;
