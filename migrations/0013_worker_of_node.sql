-- The process that registered the node last: another one of the same name takes the node over, and what the earlier one asks for is refused.
ALTER TABLE nodes ADD COLUMN worker BLOB;
