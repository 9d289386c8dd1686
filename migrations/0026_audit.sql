-- Who did what. Conventions as in 0001.

-- A row is written in the transaction of the change. It holds names, not references, so it outlives what it names.
-- `role`, `token` and `peer` are absent for what was done on the service's own machine, beside the service.
CREATE TABLE audit (
    id      INTEGER PRIMARY KEY AUTOINCREMENT,
    at      INTEGER NOT NULL,
    actor   TEXT NOT NULL CHECK (length(actor) BETWEEN 1 AND 200),
    role    TEXT CHECK (role IN ('submitter', 'worker', 'operator', 'viewer')),
    token   BLOB CHECK (length(token) = 16),
    peer    TEXT,
    action  TEXT NOT NULL,
    target  TEXT NOT NULL,
    project TEXT,
    detail  TEXT CHECK (json_valid(detail))
) STRICT;
CREATE INDEX audit_by_time ON audit (at);
CREATE INDEX audit_of_actor ON audit (actor, id);
CREATE INDEX audit_of_project ON audit (project, id) WHERE project IS NOT NULL;
CREATE INDEX audit_of_target ON audit (target, id);
CREATE TRIGGER audit_is_never_rewritten BEFORE UPDATE ON audit
BEGIN SELECT RAISE(ABORT, 'what was done never changes'); END;
