-- The dashboard counts nodes by the version of their workers. The other capabilities are long and are not read
-- for that.
ALTER TABLE nodes ADD COLUMN version TEXT AS (json_extract(capabilities, '$.version')) VIRTUAL;
CREATE INDEX nodes_by_version ON nodes (version) WHERE removed_at IS NULL;
