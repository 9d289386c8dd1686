-- Plans that are mended when something happens; terms and calendars of nodes; shares of projects. Conventions as in 0001.

-- Why a plan was made: a job got its forecast, or something happened. SQLite cannot widen the check of a column, so a new one takes its place.
ALTER TABLE plans ADD COLUMN why TEXT NOT NULL DEFAULT 'job_forecast' CHECK (why IN ('job_forecast', 'events'));
ALTER TABLE plans DROP COLUMN reason;
ALTER TABLE plans RENAME COLUMN why TO reason;
ALTER TABLE plans ADD COLUMN causes TEXT NOT NULL DEFAULT '[]' CHECK (json_valid(causes));

-- What happened since the newest plan that has taken it into account: one row. It is written in the transaction in which the thing happens, so that
-- no death of the service can lose a plan that is due. `causes` holds lines for people, those of the first happenings, at most 20.
CREATE TABLE replans (
    one     INTEGER PRIMARY KEY CHECK (one = 1),
    wanted  INTEGER NOT NULL CHECK (wanted >= planned),
    planned INTEGER NOT NULL CHECK (planned >= 0),
    causes  TEXT NOT NULL CHECK (json_valid(causes))
) STRICT;
INSERT INTO replans (one, wanted, planned, causes) VALUES (1, 0, 0, '[]');

-- `factor`: what the plan multiplies the forecast by, after what the job's finished frames took. `outlook`: why it waits, and what is left of
-- its promise.
ALTER TABLE jobs ADD COLUMN weight INTEGER NOT NULL DEFAULT 1 CHECK (weight BETWEEN 1 AND 1000);
ALTER TABLE jobs ADD COLUMN factor REAL NOT NULL DEFAULT 1 CHECK (factor > 0);
ALTER TABLE jobs ADD COLUMN outlook TEXT NOT NULL DEFAULT '{}' CHECK (json_valid(outlook));

-- When a node is awake: as its worker says, and as was set by hand, which goes before it. On which terms it is had.
ALTER TABLE nodes ADD COLUMN schedule TEXT CHECK (json_valid(schedule));
ALTER TABLE nodes ADD COLUMN schedule_set TEXT CHECK (json_valid(schedule_set));
ALTER TABLE nodes ADD COLUMN terms TEXT NOT NULL DEFAULT '{}' CHECK (json_valid(terms));

-- Shares of the farm, relative to each other; a project that is not named here has one.
CREATE TABLE projects (
    name       TEXT PRIMARY KEY CHECK (length(name) BETWEEN 1 AND 200),
    share      INTEGER NOT NULL CHECK (share BETWEEN 1 AND 1000000),
    updated_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
