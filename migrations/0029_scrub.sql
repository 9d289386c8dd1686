-- Whether artefacts are still what they were. Conventions as in 0001.

-- Artefacts whose content is missing or has changed, as it was found last. The row goes when the content is back.
CREATE TABLE damaged_artifacts (
    hash     BLOB PRIMARY KEY REFERENCES artifacts (hash) ON DELETE CASCADE,
    reason   TEXT NOT NULL,
    found_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- How far the scrub has come: one row. It goes through artefacts in the order of their hashes, again and again.
CREATE TABLE scrub (
    one      INTEGER PRIMARY KEY CHECK (one = 1),
    after    BLOB CHECK (length(after) = 32),
    begun_at INTEGER,
    rounds   INTEGER NOT NULL DEFAULT 0 CHECK (rounds >= 0)
) STRICT;
INSERT INTO scrub (one) VALUES (1);
