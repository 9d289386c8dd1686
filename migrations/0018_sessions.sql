-- People who have signed in with a browser. Conventions as in 0001.

-- One-time codes: each begins one session, with the rights of the token that asked for it. Only hashes are kept.
CREATE TABLE session_codes (
    hash       BLOB PRIMARY KEY CHECK (length(hash) = 32),
    token_hash BLOB NOT NULL REFERENCES tokens (hash) ON DELETE CASCADE,
    expires_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX session_codes_of_token ON session_codes (token_hash);

-- A session has the role of its token, and ends with it. `secret_hash` is the hash of what the browser keeps.
CREATE TABLE sessions (
    id           BLOB PRIMARY KEY CHECK (length(id) = 16),
    secret_hash  BLOB NOT NULL UNIQUE CHECK (length(secret_hash) = 32),
    token_hash   BLOB NOT NULL REFERENCES tokens (hash) ON DELETE CASCADE,
    created_at   INTEGER NOT NULL,
    expires_at   INTEGER NOT NULL,
    last_used_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX sessions_of_token ON sessions (token_hash);
CREATE INDEX sessions_by_end ON sessions (expires_at);
