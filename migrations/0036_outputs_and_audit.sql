-- Images that cannot be written give way to others, and the audit has a retention. Conventions as in 0001.

-- When an image was last tried in vain. Those that were never tried come first, then those that waited longest.
ALTER TABLE frames ADD COLUMN output_tried_at INTEGER;
DROP INDEX frames_output_due;
CREATE INDEX frames_output_due ON frames (output_tried_at, job_id, frame) WHERE output_due = 1;

-- `kind` may be `audit`. The program knows the kinds.
CREATE TABLE retention_of_all (
    project TEXT NOT NULL CHECK (length(project) <= 200),
    kind    TEXT NOT NULL CHECK (length(kind) BETWEEN 1 AND 50),
    days    INTEGER CHECK (days BETWEEN 0 AND 36500),
    PRIMARY KEY (project, kind)
) STRICT, WITHOUT ROWID;
INSERT INTO retention_of_all (project, kind, days) SELECT project, kind, days FROM retention;
DROP TABLE retention;
ALTER TABLE retention_of_all RENAME TO retention;
