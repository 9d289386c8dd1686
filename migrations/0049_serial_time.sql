-- How long tasks keep a node beyond their CPU time divided by its cores. Conventions as in 0001.

-- What plans use for a frame of the job, in microseconds: on nodes of one core, and of several.
ALTER TABLE jobs ADD COLUMN serial_one_core INTEGER NOT NULL DEFAULT 0 CHECK (serial_one_core >= 0);
ALTER TABLE jobs ADD COLUMN serial_many_cores INTEGER NOT NULL DEFAULT 0 CHECK (serial_many_cores >= 0);

-- Finished frames of a job on nodes of one core (0) or of several (1). In microseconds: CPU time at speed 1, CPU time
-- on their nodes divided by the nodes' cores, and the time of their leases.
CREATE TABLE node_use (
    job_id     BLOB NOT NULL REFERENCES jobs (id),
    many_cores INTEGER NOT NULL CHECK (many_cores IN (0, 1)),
    renderer   TEXT NOT NULL,
    frames     INTEGER NOT NULL CHECK (frames >= 1),
    cpu        INTEGER NOT NULL CHECK (cpu >= 0),
    shared     INTEGER NOT NULL CHECK (shared >= 0),
    used       INTEGER NOT NULL CHECK (used >= 0),
    PRIMARY KEY (job_id, many_cores)
) STRICT, WITHOUT ROWID;
CREATE INDEX node_use_of_renderer ON node_use (renderer, job_id);
