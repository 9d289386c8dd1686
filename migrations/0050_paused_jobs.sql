-- Jobs that a person paused. Conventions as in 0001.

ALTER TABLE jobs ADD COLUMN paused INTEGER NOT NULL DEFAULT 0 CHECK (paused IN (0, 1));

-- The jobs whose tasks are not handed out.
CREATE VIEW held_jobs AS
SELECT j.id AS job_id FROM jobs j
WHERE j.paused = 1
   OR EXISTS (SELECT 1 FROM budgets b WHERE b.project = j.project AND b.action IN ('drain', 'stop'));

DROP TRIGGER tasks_begin_held;
CREATE TRIGGER tasks_begin_held AFTER INSERT ON tasks
WHEN EXISTS (SELECT 1 FROM held_jobs WHERE job_id = NEW.job_id)
BEGIN UPDATE tasks SET held = 1 WHERE id = NEW.id; END;

-- A job that is over is not paused: its video is made, and its frames can be rendered again.
CREATE TRIGGER jobs_end_paused AFTER UPDATE OF stage ON jobs
WHEN NEW.paused = 1 AND NEW.stage IN ('done', 'failed', 'cancelled')
BEGIN
    UPDATE jobs SET paused = 0 WHERE id = NEW.id;
    UPDATE tasks SET held = EXISTS (SELECT 1 FROM held_jobs WHERE job_id = NEW.id) WHERE job_id = NEW.id AND held = 1;
END;

-- A pause may last for days. Claims do not look at what is held.
DROP INDEX tasks_ready_quotes;
DROP INDEX tasks_ready_booked;
DROP INDEX tasks_ready_any;
DROP INDEX tasks_ready_rates;
DROP INDEX tasks_ready_starts;
CREATE INDEX tasks_ready_quotes ON tasks (priority DESC, due_at, job_id, frame)
    WHERE state = 'ready' AND held = 0 AND kind NOT IN ('cache_fill', 'render_part', 'render');
CREATE INDEX tasks_ready_booked ON tasks (booked_node, booked_at, job_id, frame, part)
    WHERE state = 'ready' AND held = 0 AND kind IN ('cache_fill', 'render_part', 'render');
CREATE INDEX tasks_ready_any ON tasks (due_at, priority DESC, job_id, frame, part)
    WHERE state = 'ready' AND held = 0 AND kind IN ('cache_fill', 'render_part', 'render');
CREATE INDEX tasks_ready_rates ON tasks (job_id, booked_rate DESC, frame, part)
    WHERE state = 'ready' AND held = 0 AND booked_rate IS NOT NULL;
CREATE INDEX tasks_ready_starts ON tasks (job_id, booked_at, frame, part)
    WHERE state = 'ready' AND held = 0 AND booked_rate IS NOT NULL;
