-- Finds the newest events of which people are told, among the many that every task writes. Conventions as in 0001.

CREATE INDEX events_told ON events (id) WHERE kind NOT IN ('task_leased', 'task_submitted', 'task_progress',
    'task_done', 'task_late', 'task_stalled', 'lease_released', 'lease_lost');
