-- Tokens that are listed, expire, are rotated and revoked; nodes that are removed. Conventions as in 0001.

-- `first` marks the tokens that the service writes into its folder when it starts. A token of the time before
-- this has a random id.
ALTER TABLE tokens ADD COLUMN id BLOB CHECK (length(id) = 16);
UPDATE tokens SET id = randomblob(16);
CREATE UNIQUE INDEX tokens_by_id ON tokens (id);
CREATE INDEX tokens_by_age ON tokens (created_at, id);
ALTER TABLE tokens ADD COLUMN expires_at INTEGER;
ALTER TABLE tokens ADD COLUMN last_used_at INTEGER;
ALTER TABLE tokens ADD COLUMN first INTEGER NOT NULL DEFAULT 0 CHECK (first IN (0, 1));
UPDATE tokens SET first = 1 WHERE name = 'first ' || role;

-- Rights that ended (`is_over`) or now end at another time, by the hash of the token or of the session's secret.
-- The service ends the requests and streams that live by them. Triggers write this, so that no way for a right
-- to end can be forgotten.
CREATE TABLE ended_rights (
    id      INTEGER PRIMARY KEY AUTOINCREMENT,
    hash    BLOB NOT NULL CHECK (length(hash) = 32),
    is_over INTEGER NOT NULL CHECK (is_over IN (0, 1))
) STRICT;
CREATE TRIGGER tokens_end AFTER DELETE ON tokens
BEGIN
    INSERT INTO ended_rights (hash, is_over) VALUES (OLD.hash, 1);
END;
CREATE TRIGGER tokens_end_at_another_time AFTER UPDATE OF expires_at ON tokens
BEGIN
    INSERT INTO ended_rights (hash, is_over)
    SELECT OLD.hash, 0 UNION ALL SELECT secret_hash, 0 FROM sessions WHERE token_hash = OLD.hash;
END;
CREATE TRIGGER sessions_end AFTER DELETE ON sessions
BEGIN
    INSERT INTO ended_rights (hash, is_over) VALUES (OLD.secret_hash, 1);
END;

-- A node that was removed keeps its row, which leases, bookings and the ledger refer to. A machine that registers
-- under its name brings it back.
ALTER TABLE nodes ADD COLUMN removed_at INTEGER;
