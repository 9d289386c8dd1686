-- What lists and charts of large farms ask for. Conventions as in 0001.

-- Open jobs by risk: those that will miss deadline or budget first, then by deadline.
ALTER TABLE jobs ADD COLUMN due_at INTEGER NOT NULL GENERATED ALWAYS AS (coalesce(deadline_at, 9223372036854775807)) VIRTUAL;
ALTER TABLE jobs ADD COLUMN at_risk INTEGER NOT NULL
    GENERATED ALWAYS AS (coalesce(json_extract(outlook, '$.promise.kept') = 0, 0)
                         OR coalesce(json_extract(verdict, '$.verdict') <> 'on_time', 0)) VIRTUAL;
CREATE INDEX jobs_open ON jobs (at_risk DESC, due_at, id) WHERE stage IN ('previewing', 'profiling', 'booked', 'rendering');

-- How the end of all bookings varies in the scenarios of the newest plan: one row.
CREATE TABLE farm_outlook (
    one  INTEGER PRIMARY KEY CHECK (one = 1),
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;

-- What a node did between two instants.
CREATE INDEX ledger_by_node ON ledger (node_id, from_at);
