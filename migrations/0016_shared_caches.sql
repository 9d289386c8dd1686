-- The irradiance cache that the frames of a job share is called a shared cache. A seed is only that of random numbers.

DROP INDEX seed_bookings_by_job;
DROP TRIGGER seed_bookings_are_never_changed;
DROP TRIGGER seed_bookings_are_never_deleted;
ALTER TABLE seed_bookings RENAME TO shared_cache_bookings;
CREATE INDEX shared_cache_bookings_by_job ON shared_cache_bookings (job_id);
CREATE TRIGGER shared_cache_bookings_are_never_changed BEFORE UPDATE ON shared_cache_bookings
BEGIN SELECT RAISE(ABORT, 'a booking never changes'); END;
CREATE TRIGGER shared_cache_bookings_are_never_deleted BEFORE DELETE ON shared_cache_bookings
BEGIN SELECT RAISE(ABORT, 'a booking never changes'); END;

-- In the quotes that jobs keep, `cache.seed` becomes `cache.shared_cache`.
UPDATE jobs
SET forecast = json_set(json_remove(forecast, '$.cache.seed'), '$.cache.shared_cache', json_extract(forecast, '$.cache.seed'))
WHERE json_type(forecast, '$.cache.seed') IS NOT NULL;
