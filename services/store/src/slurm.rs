//! Job arrays in Slurm, and the task of each of their elements.
//!
//! The life of a task here, beside its life in [`crate::leases`]:
//!
//! ```text
//! ready, no open element ──announce──► array without Slurm's id
//!       ▲                                │ sbatch          │ sbatch refuses
//!       │                                ▼                 │
//!       │                              array with Slurm's id
//!       │                                │ Slurm ends it   │
//!       │                                ▼                 │
//!       └──────task not over───────────element ended       │
//!       └──────────────────────────────────────────────────┘
//! ```
//!
//! A task that makes no progress is announced once more, beside the element whose process has it.
//!
//! An element says only that a process was requested; leases alone say who works on a task. So an element
//! that runs twice, is lost or comes late is harmless: its process asks for the lease of exactly its task,
//! and gets it or not.

use forelight_protocol::{Event, EventKind, JobId, Money, NodeId, TaskId, TaskKind, Timestamp, Verdict};
use uuid::Uuid;

use crate::columns::Time;
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::events::{append, event, node_event};
use crate::jobs::ending;
use crate::nodes;
use crate::writing::run;

/// A task that waits to be submitted to Slurm.
#[derive(Clone, PartialEq, Debug)]
pub struct Waiting {
    /// The task.
    pub task: TaskId,
    /// Its job.
    pub job: JobId,
    /// The job's name.
    pub job_name: String,
    /// The kind of task.
    pub kind: TaskKind,
    /// Its frame; `None` for tasks without one, such as previews.
    pub frame: Option<u32>,
    /// Where and when the plan has booked it.
    pub booked: Option<BookedTime>,
    /// CPU seconds on a node of speed 1, 95 % quantile; `None` before the forecast.
    pub cpu_p95: Option<f64>,
    /// How long it keeps a node beyond its CPU time, in microseconds.
    pub serial: i64,
    /// The job's deadline, if the plan keeps it.
    pub deadline: Option<Timestamp>,
    /// Outcomes by Slurm of elements that ended before the task was done, oldest first.
    pub lost: Vec<String>,
    /// When the last of these ended.
    pub lost_at: Option<Timestamp>,
    /// The node on which it makes no progress, if this is a second attempt beside that one.
    pub beside: Option<String>,
}

/// Where and when a plan has booked a frame.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct BookedTime {
    /// The node's name.
    pub node: String,
    /// From when.
    pub start: Timestamp,
    /// Until when.
    pub end: Timestamp,
}

/// A job array to submit.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NewArray {
    /// The job of all its tasks.
    pub job: JobId,
    /// The tasks, by position.
    pub tasks: Vec<TaskId>,
    /// Minutes after which Slurm ends an element.
    pub limit_minutes: u32,
    /// Earliest start.
    pub begin: Option<Timestamp>,
    /// Latest end: Slurm gives the array up if it cannot end by then.
    pub deadline: Option<Timestamp>,
    /// Its reservation, and when that ends.
    pub reservation: Option<(String, Timestamp)>,
}

/// An array with elements that have not ended.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenArray {
    /// Its id, which the Slurm job's comment holds.
    pub id: Uuid,
    /// The array as submitted.
    pub array: NewArray,
    /// Slurm's job id; `None` until it is known.
    pub slurm_id: Option<u32>,
    /// When it was announced.
    pub announced: Timestamp,
    /// Its open elements.
    pub elements: Vec<OpenElement>,
}

/// An element that has not ended.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenElement {
    /// Its place in the array.
    pub position: u32,
    /// Its task.
    pub task: TaskId,
    /// The state of its task.
    pub state: Holding,
}

/// The state of a task, as far as it matters to Slurm.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Holding {
    /// It waits for a process.
    Ready,
    /// A process holds it.
    Leased,
    /// Its result is there.
    Done,
    /// It is no longer wanted: it failed, or its job was cancelled.
    Withdrawn,
}

/// A machine as Slurm knows it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SeenNode {
    /// Its name.
    pub name: String,
    /// Its cores.
    pub cores: u32,
}

macro_rules! of_task {
    ($row:expr, $kind:expr, $now:expr) => {
        Event {
            job_id: Some($row.job_id.into()),
            task_id: Some($row.id.into()),
            task_kind: Some($row.kind.0),
            frame: $row.frame,
            ..event($kind, $now)
        }
    };
}

impl Store {
    /// The ready tasks that are in no open array, and those that are to be run a second time beside an
    /// attempt that makes no progress. What was lost before a task's last result, or before it began anew, does
    /// not count. By deadline, priority, age of the job, and booked time. Videos are left to workers that have
    /// ffmpeg: Slurm does not know which of its machines have it.
    pub async fn waiting_for_slurm(&self) -> Result<Vec<Waiting>> {
        let rows = sqlx::query!(
            r#"SELECT t.id, t.job_id, t.kind, t.frame, j.name AS job, j.deadline_at, j.verdict, n.name AS "node?",
                      coalesce(b.start_at, s.start_at) AS "start_at?: Time", coalesce(b.end_at, s.end_at) AS "end_at?: Time",
                      CASE t.kind WHEN 'cache_fill' THEN json_extract(j.forecast, '$.cache.shared_cache.cpu_seconds.p95')
                                                         / json_extract(t.spec, '$.cache_fill.parts')
                           WHEN 'render_part' THEN f.cpu_p95 * ifnull(t.share, 1.0 / f.parts)
                           WHEN 'render' THEN iif(f.parts = 1, f.cpu_p95, NULL) ELSE f.cpu_p95 END AS "cpu_p95?: f64",
                      max(j.serial_one_core, j.serial_many_cores) AS "serial!: i64",
                      (SELECT group_concat(e.outcome, char(10) ORDER BY e.ended_at, e.array_id) FROM slurm_elements e
                       JOIN slurm_arrays a ON a.id = e.array_id WHERE e.task_id = t.id AND e.is_past = 0 AND a.created_at >= ifnull((SELECT
                       max(l.ended_at) FROM leases l WHERE l.task_id = t.id AND l.state = 'committed'), 0))
                       AS "lost?: String",
                      (SELECT max(e.ended_at) FROM slurm_elements e JOIN slurm_arrays a ON a.id = e.array_id
                       WHERE e.task_id = t.id AND e.is_past = 0 AND a.created_at >= ifnull((SELECT max(l.ended_at) FROM leases l
                       WHERE l.task_id = t.id AND l.state = 'committed'), 0)) AS "lost_at?: Time",
                      iif(t.state = 'leased', (SELECT h.name FROM nodes h WHERE h.id = t.node_id), NULL) AS "beside?: String"
               FROM tasks t JOIN jobs j ON j.id = t.job_id
               LEFT JOIN frames f ON f.job_id = t.job_id AND f.frame = t.frame
               LEFT JOIN bookings b ON b.plan_id = j.plan_id AND b.job_id = j.id AND b.frame = t.frame AND b.part = t.booked_part
               LEFT JOIN shared_cache_bookings s
                    ON s.plan_id = j.plan_id AND s.job_id = j.id AND t.kind = 'cache_fill' AND t.frame IS NULL AND s.part = t.part
               LEFT JOIN nodes n ON n.id = coalesce(b.node_id, s.node_id)
               WHERE (t.state = 'ready' OR t.state = 'leased' AND t.again = 1) AND t.held = 0 AND t.kind <> 'video'
                     AND NOT EXISTS (SELECT 1 FROM slurm_elements e WHERE e.task_id = t.id AND e.outcome IS NULL
                                     AND e.beside >= (t.state = 'leased'))
               ORDER BY t.due_at, t.priority DESC, t.job_id, coalesce(b.start_at, s.start_at), t.kind, t.frame, t.part"#
        )
        .fetch_all(self.readers())
        .await?;
        Ok(rows
            .into_iter()
            .map(|row| {
                let verdict = row.verdict.map(|it| it.0.verdict);
                let is_held = matches!(verdict, Some(Verdict::OnTime | Verdict::OverBudget));
                // A second attempt has no booking: it begins at once, on any other node.
                let booking = row.node.zip(row.start_at.zip(row.end_at)).filter(|_| row.beside.is_none());
                let booked = booking.map(|(node, (start, end))| BookedTime {
                    node,
                    start: start.into(),
                    end: end.into(),
                });
                Waiting {
                    task: row.id.into(),
                    job: row.job_id.into(),
                    job_name: row.job,
                    kind: row.kind.0,
                    frame: row.frame,
                    booked,
                    cpu_p95: row.cpu_p95,
                    serial: row.serial,
                    deadline: row.deadline_at.filter(|_| is_held && row.beside.is_none()).map(Into::into),
                    lost: row.lost.map_or(Vec::new(), |lost| lost.lines().map(str::to_owned).collect()),
                    lost_at: row.lost_at.map(Into::into),
                    beside: row.beside,
                }
            })
            .collect())
    }

    /// Records that an array is about to be submitted, and returns its id. A [`StoreError::Conflict`] if one
    /// of its tasks is not ready or in an open array already.
    pub async fn announce_slurm_array(&self, new: &NewArray, now: Timestamp) -> Result<Uuid> {
        let mut write = self.write().await?;
        let array = Uuid::now_v7();
        run!(
            write,
            "INSERT INTO slurm_arrays (id, job_id, limit_minutes, begin_at, deadline_at, reservation, \
             reserved_to, created_at) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            array,
            new.job.0,
            new.limit_minutes,
            new.begin.map(Timestamp::micros),
            new.deadline.map(Timestamp::micros),
            new.reservation.as_ref().map(|(name, _)| name),
            new.reservation.as_ref().map(|(_, until)| until.micros()),
            now.micros()
        );
        for (task, position) in new.tasks.iter().zip(0_i64..) {
            let written = run!(
                write,
                "INSERT INTO slurm_elements (array_id, position, task_id, beside) \
                 SELECT ?1, ?2, t.id, t.state = 'leased' FROM tasks t \
                 WHERE t.id = ?3 AND (t.state = 'ready' OR t.state = 'leased' AND t.again = 1) AND t.held = 0 \
                 AND NOT EXISTS (SELECT 1 FROM slurm_elements e \
                 WHERE e.task_id = ?3 AND e.outcome IS NULL AND e.beside >= (t.state = 'leased'))",
                array,
                position,
                task.0
            );
            if written != 1 {
                return Err(StoreError::Conflict(format!(
                    "task {task} is not ready, or already in a Slurm array"
                )));
            }
        }
        self.commit(write).await?;
        Ok(array)
    }

    /// Records Slurm's job id of an array.
    pub async fn slurm_array_submitted(&self, array: Uuid, slurm_id: u32, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        run!(write, "UPDATE slurm_arrays SET slurm_id = ? WHERE id = ?", slurm_id, array);
        let elements = sqlx::query!(
            "SELECT e.position, t.id, t.job_id, t.kind, t.frame FROM slurm_elements e \
             JOIN tasks t ON t.id = e.task_id WHERE e.array_id = ? ORDER BY e.position",
            array
        )
        .fetch_all(write.connection().await?)
        .await?;
        for row in elements {
            let message = Some(format!("Slurm job {slurm_id}_{}", row.position));
            append(&mut write, Event { message, ..of_task!(row, EventKind::TaskSubmitted, now) });
        }
        self.commit(write).await
    }

    /// Deletes an array that Slurm refused. Its tasks wait again.
    pub async fn slurm_array_refused(&self, array: Uuid) -> Result<()> {
        let mut write = self.write().await?;
        run!(write, "DELETE FROM slurm_elements WHERE array_id = ?", array);
        run!(write, "DELETE FROM slurm_arrays WHERE id = ?", array);
        self.commit(write).await
    }

    /// Records that the array's reservation has ended.
    pub async fn slurm_reservation_ended(&self, array: Uuid) -> Result<()> {
        let mut write = self.write().await?;
        run!(write, "UPDATE slurm_arrays SET reservation = NULL, reserved_to = NULL WHERE id = ?", array);
        self.commit(write).await
    }

    /// The arrays with open elements, and those whose reservation still exists.
    pub async fn open_slurm_arrays(&self) -> Result<Vec<OpenArray>> {
        let mut transaction = self.read().await?;
        let rows = sqlx::query!(
            "SELECT * FROM slurm_arrays a WHERE a.reservation IS NOT NULL OR EXISTS (SELECT 1 \
             FROM slurm_elements e WHERE e.array_id = a.id AND e.outcome IS NULL) ORDER BY a.id"
        )
        .fetch_all(&mut *transaction)
        .await?;
        let mut arrays = Vec::with_capacity(rows.len());
        for row in rows {
            let array = row.id.0;
            let elements = sqlx::query!(
                r#"SELECT e.position, e.task_id, e.outcome,
                          CASE WHEN t.state = 'leased' AND t.again = 1 AND e.beside = 1 THEN 'ready'
                               WHEN t.state = 'ready' AND t.held = 1 THEN 'held' ELSE t.state END AS "state!: String"
                   FROM slurm_elements e JOIN tasks t ON t.id = e.task_id WHERE e.array_id = ? ORDER BY e.position"#,
                array
            )
            .fetch_all(&mut *transaction)
            .await?;
            let mut tasks = Vec::with_capacity(elements.len());
            let mut open = Vec::new();
            for element in elements {
                let task = TaskId::from(element.task_id);
                tasks.push(task);
                if element.outcome.is_none() {
                    let state = match element.state.as_str() {
                        "ready" => Holding::Ready,
                        "leased" => Holding::Leased,
                        "done" => Holding::Done,
                        _ => Holding::Withdrawn,
                    };
                    open.push(OpenElement { position: element.position, task, state });
                }
            }
            arrays.push(OpenArray {
                id: array,
                slurm_id: row.slurm_id,
                announced: row.created_at.into(),
                elements: open,
                array: NewArray {
                    job: row.job_id.into(),
                    tasks,
                    limit_minutes: row.limit_minutes,
                    begin: row.begin_at.map(Into::into),
                    deadline: row.deadline_at.map(Into::into),
                    reservation: row.reservation.zip(row.reserved_to.map(Into::into)),
                },
            });
        }
        Ok(arrays)
    }

    /// Records how an element ended. If its task is not over, that is an event, and the task waits again. A task that is
    /// held lost nothing.
    pub async fn slurm_element_ended(
        &self,
        array: Uuid,
        position: u32,
        outcome: &str,
        now: Timestamp,
    ) -> Result<()> {
        let mut write = self.write().await?;
        let ended = run!(
            write,
            "UPDATE slurm_elements SET outcome = ?, ended_at = ?, is_past = EXISTS (SELECT 1 FROM tasks t \
             WHERE t.id = task_id AND t.state = 'ready' AND t.held = 1) WHERE array_id = ? AND position = ? \
             AND outcome IS NULL",
            outcome,
            now.micros(),
            array,
            position
        );
        if ended == 1 {
            let row = sqlx::query!(
                r#"SELECT t.id, t.job_id, t.kind, t.frame, a.slurm_id, t.state = 'ready' AND t.held = 0 AND NOT EXISTS
                          (SELECT 1 FROM leases l WHERE l.task_id = t.id AND l.state = 'committed'
                           AND l.ended_at >= a.created_at) AS "is_lost!: bool" FROM slurm_elements e
                   JOIN tasks t ON t.id = e.task_id JOIN slurm_arrays a ON a.id = e.array_id
                   WHERE e.array_id = ? AND e.position = ?"#,
                array,
                position
            )
            .fetch_one(write.connection().await?)
            .await?;
            // A task that is ready again after a pass has its result.
            if row.is_lost {
                let number = row
                    .slurm_id
                    .map_or("never submitted".to_owned(), |slurm| format!("job {slurm}_{position}"));
                let message = Some(format!("Slurm ended it: {outcome} ({number})"));
                append(&mut write, Event { message, ..of_task!(row, EventKind::SubmissionLost, now) });
            }
        }
        self.commit(write).await
    }

    /// Fails the job of a task that Slurm cannot complete. Does nothing if the task is over or with a worker.
    pub async fn fail_unrunnable(&self, task: TaskId, reason: &str, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        let row = sqlx::query!(
            "UPDATE tasks SET state = 'failed', error = ?, finished_at = ? WHERE id = ? \
             AND state = 'ready' RETURNING id, job_id, kind, frame",
            reason,
            now.micros(),
            task.0
        )
        .fetch_optional(write.connection().await?)
        .await?;
        if let Some(row) = row {
            let of = (row.kind.0, row.frame);
            ending::fail_for_task(&mut write, row.job_id.into(), of, reason, now).await?;
        }
        self.commit(write).await
    }

    /// Records the machines that exist now. New ones become nodes of speed 1 at this price, until measured.
    pub async fn see_nodes(&self, seen: &[SeenNode], price_per_hour: Money, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        for node in seen {
            let touched = run!(
                write,
                "UPDATE nodes SET last_seen_at = max(last_seen_at, ?) WHERE name = ?",
                now.micros(),
                node.name
            );
            if touched == 1 {
                continue;
            }
            let new = NodeId::new();
            run!(
                write,
                "INSERT INTO nodes (id, name, speed, price_per_hour, cores, created_at, last_seen_at) \
                 VALUES (?, ?, 1, ?, ?, ?5, ?5)",
                new.0,
                node.name,
                price_per_hour.micro_units(),
                node.cores,
                now.micros()
            );
            let new = nodes::read(write.connection().await?, new).await?;
            node_event(&mut write, EventKind::NodeRegistered, &new, node.name.clone(), now);
        }
        self.commit(write).await
    }

    /// The names of nodes that get no more tasks: drained, paused, or set aside.
    pub async fn closed_nodes(&self) -> Result<Vec<String>> {
        Ok(sqlx::query_scalar!(
            "SELECT name FROM nodes WHERE drain OR pause OR set_aside IS NOT NULL ORDER BY name"
        )
        .fetch_all(self.readers())
        .await?)
    }

    /// The lowest speed of a live node that takes tasks, all its cores together; `None` without such a node.
    pub async fn slowest_node(&self, seen_since: Timestamp) -> Result<Option<f64>> {
        Ok(sqlx::query_scalar!(
            r#"SELECT min(coalesce(speed_set, speed) * cores) AS "least?: f64" FROM nodes
               WHERE NOT (drain OR pause OR set_aside IS NOT NULL) AND removed_at IS NULL
               AND last_seen_at >= ?"#,
            seen_since.micros()
        )
        .fetch_one(self.readers())
        .await?)
    }

    /// Writes an event with the state of the engine.
    pub async fn tell_of_engine(&self, message: &str, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        append(&mut write, Event { message: Some(message.to_owned()), ..event(EventKind::EngineState, now) });
        self.commit(write).await
    }
}
