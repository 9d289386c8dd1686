-- Where artefacts rest, if that was ever said: one row. A farm that is started with another place would promise files that are not there.
CREATE TABLE artifact_place (
    one   INTEGER PRIMARY KEY CHECK (one = 1),
    place TEXT NOT NULL CHECK (length(place) BETWEEN 1 AND 600)
) STRICT;

-- What was handed to Slurm. An array is written before it is submitted, and its id travels in the comment of the Slurm job: whatever dies
-- in between, the next start finds out there whether it was submitted. Times are limits as they were asked for.
CREATE TABLE slurm_arrays (
    id            BLOB PRIMARY KEY CHECK (length(id) = 16),
    job_id        BLOB NOT NULL REFERENCES jobs (id),
    slurm_id      INTEGER CHECK (slurm_id > 0),
    limit_minutes INTEGER NOT NULL CHECK (limit_minutes >= 1),
    begin_at      INTEGER,
    deadline_at   INTEGER,
    reservation   TEXT,
    reserved_to   INTEGER,
    created_at    INTEGER NOT NULL,
    CHECK ((reservation IS NULL) = (reserved_to IS NULL))
) STRICT;
CREATE INDEX slurm_arrays_of_job ON slurm_arrays (job_id);

-- Its elements: one task each. `outcome` is how Slurm said that it ended; NULL while it has not.
CREATE TABLE slurm_elements (
    array_id BLOB NOT NULL REFERENCES slurm_arrays (id),
    position INTEGER NOT NULL CHECK (position >= 0),
    task_id  BLOB NOT NULL REFERENCES tasks (id),
    outcome  TEXT,
    ended_at INTEGER,
    PRIMARY KEY (array_id, position),
    CHECK ((outcome IS NULL) = (ended_at IS NULL))
) STRICT, WITHOUT ROWID;
-- Nothing is submitted twice: the database itself refuses it.
CREATE UNIQUE INDEX slurm_one_open ON slurm_elements (task_id) WHERE outcome IS NULL;
CREATE INDEX slurm_elements_of_task ON slurm_elements (task_id, ended_at);
