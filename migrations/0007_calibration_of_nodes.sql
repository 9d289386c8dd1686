-- What finished frames teach about how fast nodes are, beyond what their calibrations say. Of each job's frames on a node that profiled none
-- of them: the sum of the logarithms of what they took over what they were forecast to take there, in millionths.
CREATE TABLE node_learning (
    node_id        BLOB NOT NULL REFERENCES nodes (id),
    job_id         BLOB NOT NULL REFERENCES jobs (id),
    frames         INTEGER NOT NULL CHECK (frames >= 1),
    log_millionths INTEGER NOT NULL,
    PRIMARY KEY (node_id, job_id)
) STRICT, WITHOUT ROWID;

-- The sum of the jobs' means of these, each rounded towards zero, and the number of jobs: whole numbers, which come to the same in whatever
-- order frames are finished.
ALTER TABLE nodes ADD COLUMN learned_millionths INTEGER NOT NULL DEFAULT 0;
ALTER TABLE nodes ADD COLUMN learned_jobs INTEGER NOT NULL DEFAULT 0 CHECK (learned_jobs >= 0);

-- What a job's frames may take, from which their camera samples are chosen; NULL where these are given.
ALTER TABLE jobs ADD COLUMN within TEXT CHECK (json_valid(within));
