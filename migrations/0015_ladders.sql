-- Which ladders of qualities a job's quote has.
ALTER TABLE jobs ADD COLUMN ladders TEXT NOT NULL DEFAULT 'own' CHECK (ladders IN ('own', 'all'));
