-- Jobs that an operator took out of the track record, with the reason. Nothing is learnt from them.
CREATE TABLE left_out_jobs (
    job_id BLOB PRIMARY KEY REFERENCES jobs (id),
    reason TEXT NOT NULL CHECK (length(reason) BETWEEN 1 AND 500),
    at     INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
