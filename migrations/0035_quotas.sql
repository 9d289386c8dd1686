-- How much a project, or whoever has a token of a name, may take. Conventions as in 0001.

-- NULL: there is no limit.
CREATE TABLE quotas (
    kind          TEXT NOT NULL CHECK (kind IN ('project', 'token')),
    name          TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 200),
    storage_bytes INTEGER CHECK (storage_bytes >= 0),
    open_jobs     INTEGER CHECK (open_jobs >= 0),
    updated_at    INTEGER NOT NULL,
    PRIMARY KEY (kind, name)
) STRICT, WITHOUT ROWID;

-- Name of the token with which a job was submitted. NULL for jobs of the time before this.
ALTER TABLE jobs ADD COLUMN submitted_by TEXT;
CREATE INDEX jobs_by_submitter ON jobs (submitted_by) WHERE submitted_by IS NOT NULL;
