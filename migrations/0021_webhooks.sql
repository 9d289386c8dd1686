-- Webhooks: addresses that are told of events, and what they were told. Conventions as in 0001.

-- `secret` signs what is sent, so it is kept as it is. `seen` is the last event that was looked at for it.
CREATE TABLE webhooks (
    id         BLOB PRIMARY KEY CHECK (length(id) = 16),
    url        TEXT NOT NULL CHECK (length(url) BETWEEN 1 AND 2000),
    secret     TEXT NOT NULL,
    kinds      TEXT NOT NULL CHECK (json_valid(kinds)),
    project    TEXT,
    template   TEXT CHECK (json_valid(template)),
    seen       INTEGER NOT NULL,
    created_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- What is to be sent, and what was: an event is sent to a webhook until it answers, or for a day. Events of one job are sent in
-- order: the first of a job that is pending holds back the others. `event_id` 0 is a test.
CREATE TABLE deliveries (
    id         BLOB PRIMARY KEY CHECK (length(id) = 16),
    webhook_id BLOB NOT NULL REFERENCES webhooks (id) ON DELETE CASCADE,
    event_id   INTEGER NOT NULL CHECK (event_id >= 0),
    job_id     BLOB,
    kind       TEXT NOT NULL,
    body       TEXT NOT NULL,
    state      TEXT NOT NULL CHECK (state IN ('pending', 'delivered', 'given_up')),
    attempts   INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    next_at    INTEGER NOT NULL,
    status     INTEGER,
    error      TEXT,
    created_at INTEGER NOT NULL,
    ended_at   INTEGER,
    CHECK ((state = 'pending') = (ended_at IS NULL))
) STRICT;
CREATE UNIQUE INDEX deliveries_once ON deliveries (webhook_id, event_id) WHERE event_id > 0;
CREATE INDEX deliveries_of_webhook ON deliveries (webhook_id, id);
CREATE INDEX deliveries_pending ON deliveries (webhook_id, job_id, id) WHERE state = 'pending';
CREATE INDEX deliveries_by_age ON deliveries (ended_at) WHERE ended_at IS NOT NULL;
