-- Workers that join by themselves, take orders and say what they do; tasks that fail. Conventions as in 0001.

-- The token of a node speaks for that node alone; one without a node speaks for all.
ALTER TABLE tokens ADD COLUMN node_id BLOB REFERENCES nodes (id);
CREATE INDEX tokens_of_node ON tokens (node_id) WHERE node_id IS NOT NULL;

-- One-time tokens: each lets one machine join the farm, once. Only hashes are kept, also of the token that the machine made for
-- itself: a machine that did not hear the answer asks again with the same one, and is told from a second machine by that.
CREATE TABLE join_tokens (
    hash       BLOB PRIMARY KEY CHECK (length(hash) = 32),
    name       TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 200),
    created_at INTEGER NOT NULL,
    expires_at INTEGER NOT NULL,
    used_at    INTEGER,
    used_for   BLOB CHECK (length(used_for) = 32),
    node_id    BLOB REFERENCES nodes (id),
    CHECK (((used_at IS NULL) = (used_for IS NULL)) AND ((used_at IS NULL) = (node_id IS NULL)))
) STRICT, WITHOUT ROWID;

-- `pause` is the operator's order, `paused` what the worker last said. A node that was set aside has a reason, and gets no work until
-- an operator brings it back; failures before `trusted_since` are forgiven.
ALTER TABLE nodes ADD COLUMN pause INTEGER NOT NULL DEFAULT 0 CHECK (pause IN (0, 1));
ALTER TABLE nodes ADD COLUMN paused INTEGER NOT NULL DEFAULT 0 CHECK (paused IN (0, 1));
ALTER TABLE nodes ADD COLUMN set_aside TEXT;
ALTER TABLE nodes ADD COLUMN trusted_since INTEGER NOT NULL DEFAULT 0;
ALTER TABLE nodes ADD COLUMN capabilities TEXT NOT NULL DEFAULT '{}' CHECK (json_valid(capabilities));

-- What a task of the job may use at most.
ALTER TABLE jobs ADD COLUMN limits TEXT NOT NULL DEFAULT '{}' CHECK (json_valid(limits));
ALTER TABLE tasks ADD COLUMN limits TEXT NOT NULL DEFAULT '{}' CHECK (json_valid(limits));

-- A task that failed is not handed out again before `not_before`.
ALTER TABLE tasks ADD COLUMN not_before INTEGER NOT NULL DEFAULT 0;
CREATE INDEX tasks_backing_off ON tasks (not_before) WHERE state = 'ready' AND not_before > 0;

-- Whether a failure says something about the node: not if anyone would have failed, or if the job's own limit was met.
ALTER TABLE leases ADD COLUMN blameless INTEGER NOT NULL DEFAULT 0 CHECK (blameless IN (0, 1));
CREATE INDEX leases_failed_on_node ON leases (node_id, ended_at) WHERE state = 'failed' AND NOT blameless;

-- What workers had to say, by attempt. Lines are numbered by the worker, so that one that is sent twice is kept once.
CREATE TABLE task_logs (
    task_id BLOB NOT NULL REFERENCES tasks (id),
    fence   INTEGER NOT NULL CHECK (fence >= 1),
    number  INTEGER NOT NULL CHECK (number >= 0),
    at      INTEGER NOT NULL,
    level   TEXT NOT NULL CHECK (level IN ('info', 'warn', 'error')),
    line    TEXT NOT NULL,
    PRIMARY KEY (task_id, fence, number)
) STRICT, WITHOUT ROWID;
CREATE INDEX task_logs_by_age ON task_logs (at);

-- Whether a job has frames left is asked with every frame that is delivered.
CREATE INDEX frames_open ON frames (job_id) WHERE actual IS NULL;
