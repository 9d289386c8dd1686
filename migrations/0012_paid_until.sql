-- Leases are given one more term when the service starts again. Whether their workers are alive is not known then: a lease that is
-- never renewed after that is paid for until it would have run out, and not for the time that the service was down.
ALTER TABLE leases ADD COLUMN paid_until INTEGER;
