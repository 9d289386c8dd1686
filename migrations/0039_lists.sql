-- What lists of many jobs and sums of many payments ask for. Conventions as in 0001.

-- Jobs by the cost of their bookings, dearest first; jobs without any last.
ALTER TABLE jobs ADD COLUMN by_cost INTEGER NOT NULL
    GENERATED ALWAYS AS (-coalesce(json_extract(verdict, '$.cost'), -1)) VIRTUAL;

-- An index for each order. Each has what a list is filtered by, because the rows of jobs are long.
CREATE INDEX jobs_newest ON jobs (id, name, project, state);
CREATE INDEX jobs_by_risk ON jobs (at_risk DESC, due_at, id, name, project, state);
CREATE INDEX jobs_by_deadline ON jobs (due_at, id, name, project, state);
CREATE INDEX jobs_by_name ON jobs (name, id, project, state);
CREATE INDEX jobs_by_cost ON jobs (by_cost, id, name, project, state);

-- What ended leases cost since an instant: a sum over this index alone.
CREATE INDEX ledger_ended ON ledger (until_at, project, from_at, price_per_hour) WHERE until_at IS NOT NULL;
