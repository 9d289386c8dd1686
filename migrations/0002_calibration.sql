-- What finished jobs teach about quotes. A quote is remembered with its own idea of how sure it is (spreads: standard deviations of the
-- logarithm), before past jobs corrected its quantiles; when the job is finished, in the same transaction, with how far it was off in
-- units of that (residuals). Jobs are compared with others of the same renderer, version included, and the same class of features.

CREATE TABLE quotes (
    job_id        BLOB PRIMARY KEY REFERENCES jobs (id),
    renderer      TEXT NOT NULL CHECK (length(renderer) BETWEEN 1 AND 200),
    feature_class TEXT NOT NULL CHECK (length(feature_class) BETWEEN 1 AND 200),
    -- When its residuals were written; none of a job that was not finished.
    learnt_at     INTEGER
) STRICT, WITHOUT ROWID;
CREATE INDEX quotes_learnt ON quotes (renderer, feature_class, learnt_at, job_id) WHERE learnt_at IS NOT NULL;

-- Frame -1 is all frames together. CPU seconds are those of a node of speed 1. A residual is NULL before the job is finished, of
-- what cost nothing, and of frames of a long job that are left out.
CREATE TABLE quote_spreads (
    job_id        BLOB NOT NULL REFERENCES quotes (job_id),
    frame         INTEGER NOT NULL CHECK (frame >= -1),
    work_mean     REAL NOT NULL,
    work_spread   REAL NOT NULL CHECK (work_spread > 0),
    cpu_mean      REAL NOT NULL,
    cpu_spread    REAL NOT NULL CHECK (cpu_spread > 0),
    work_residual REAL,
    cpu_residual  REAL,
    PRIMARY KEY (job_id, frame)
) STRICT, WITHOUT ROWID;
