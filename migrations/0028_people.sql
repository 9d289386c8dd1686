-- People who sign in by OpenID Connect. Conventions as in 0001.

-- Each has one token, which begins his sessions, and which a new sign-in replaces. Nobody knows its secret.
-- `subject` is the provider's address and his id there.
ALTER TABLE tokens ADD COLUMN subject TEXT;
CREATE UNIQUE INDEX tokens_by_subject ON tokens (subject) WHERE subject IS NOT NULL;
