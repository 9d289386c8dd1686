//! Claims: which task a node is given next.

pub(crate) mod asking;
pub(crate) mod work_stealing;

use std::collections::BTreeMap;
use std::time::Duration;

use forelight_protocol::{
    ByClass, Event, EventKind, JobId, JobState, Lease, LeaseId, Node, NodeId, TaskId, TaskKind, Timestamp,
};
use sqlx::{FromRow, SqliteConnection};

use self::asking::{Asking, Offer, OfferedTask, next_stalled_task, next_task, task_columns};
use crate::columns::{Json, Word};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{append, event, job_state};
use crate::idempotency::{Answered, IdempotencyKey, RecordedAnswer, earlier_answer, record};
use crate::jobs::versions::note_other;
use crate::leases::sweeping::sweep;
use crate::leases::touch;
use crate::nodes::{self, NodeRow, sleep_of};
use crate::policy::availability::{Opening, forecast_seconds_within, opening};
use crate::writing::{ask, later};

impl Store {
    /// Hands the node its next task, if there is one and the node is not draining. Sweeps first, so that the
    /// task of a lost worker can be handed out at once. The node counts as heard of.
    pub async fn claim(
        &self,
        node: NodeId,
        ttl: Duration,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Option<Answered<Lease>>> {
        self.hand_out(node, None, ttl, key, now).await
    }

    /// Hands the node exactly this task, whatever is planned for the node. `None` while another worker holds
    /// it; a [`StoreError::Conflict`] once it is over.
    pub async fn claim_task(
        &self,
        node: NodeId,
        task: TaskId,
        ttl: Duration,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Option<Answered<Lease>>> {
        self.hand_out(node, Some(task), ttl, key, now).await
    }

    /// Answers a claim while no task may be handed out: with the lease that the same request got before, or
    /// `None`. The node counts as heard of. A task that is over is a [`StoreError::Conflict`], as in
    /// [`Store::claim_task`].
    pub async fn claim_nothing_new(
        &self,
        node: NodeId,
        wanted: Option<TaskId>,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Option<Answered<Lease>>> {
        let mut write = self.write().await?;
        let asker = asker(&mut write, node, key, now).await?;
        if let Some(answer) = asker.answered {
            return Ok(Some(Answered::Repeated(answer)));
        }
        if let Some(task) = wanted {
            this_task(write.connection().await?, (task, node), now).await?;
        }
        touch(&mut write, node, now);
        self.commit(write).await?;
        Ok(None)
    }

    async fn hand_out(
        &self,
        node: NodeId,
        wanted: Option<TaskId>,
        ttl: Duration,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Option<Answered<Lease>>> {
        let mut write = self.write().await?;
        let asker = asker(&mut write, node, key, now).await?;
        if let Some(answer) = asker.answered {
            return Ok(Some(Answered::Repeated(answer)));
        }
        let mut node = asker.node;
        if asker.some_ran_out {
            sweep(&mut write, now).await?;
            node = nodes::read(write.connection().await?, node.id).await?;
        }
        let offered = match wanted {
            Some(task) => this_task(write.connection().await?, (task, node.id), now).await?.into(),
            None => offer(write.connection().await?, &node, self.up_since(), now).await?,
        };
        touch(&mut write, node.id, now);
        if offered.idle_reason != node.idle_reason {
            later!(write, "UPDATE nodes SET idle_reason = ? WHERE id = ?", offered.idle_reason, node.id.0);
        }
        let Some(task) = offered.task else {
            self.commit(write).await?;
            return Ok(None);
        };
        if wanted.is_some() {
            note_other(&mut write, task.job_id.into(), &node, now).await?;
        }
        let lease = lease(&mut write, &node, task, ttl, now);
        record(&mut write, key, 200, &lease, now);
        self.commit(write).await?;
        Ok(Some(Answered::Fresh(lease)))
    }

    /// Whether a claim could find a task for the node, or exactly this task. Waiting claims ask this, because
    /// it needs no write lock.
    pub async fn may_have_work(&self, node: NodeId, wanted: Option<TaskId>, now: Timestamp) -> Result<bool> {
        let mut connection = self.readers().acquire().await?;
        let some_ran_out = sqlx::query_scalar!(
            r#"SELECT EXISTS (SELECT 1 FROM leases WHERE state = 'active' AND expires_at <= ?)
               AS "some_ran_out!: bool""#,
            now.micros()
        );
        if some_ran_out.fetch_one(&mut *connection).await? {
            return Ok(true);
        }
        match wanted {
            Some(task) => match this_task(&mut connection, (task, node), now).await {
                Ok(task) => Ok(task.is_some()),
                // The claim gets an answer, although no task.
                Err(StoreError::Conflict(_)) => Ok(true),
                Err(error) => Err(error),
            },
            None => {
                let node = nodes::read(&mut connection, node).await?;
                Ok(offer(&mut connection, &node, self.up_since(), now).await?.task.is_some())
            }
        }
    }

    /// When the node wakes up; `None` if it is awake.
    pub async fn sleeps_until(&self, node: NodeId, now: Timestamp) -> Result<Option<Timestamp>> {
        let mut connection = self.readers().acquire().await?;
        let has_calendar = sqlx::query_scalar!(
            r#"SELECT coalesce(schedule_set, schedule) IS NOT NULL OR terms <> '{}'
               AS "has_calendar!: bool" FROM nodes WHERE id = ?"#,
            node.0
        )
        .fetch_optional(&mut *connection)
        .await?;
        sleep_of(&mut connection, node, has_calendar.unwrap_or(false), now).await
    }
}

/// Leases the task to the node, and starts its job if it is the first.
fn lease(write: &mut Write, node: &Node, task: OfferedTask, ttl: Duration, now: Timestamp) -> Lease {
    let (task_id, job_id) = (TaskId::from(task.id), JobId::from(task.job_id));
    let (spec, work) = (task.spec.0, task.work_by_class.map(|it| it.0));
    let (kind, fence) = (spec.kind(), task.fence + 1);
    later!(
        write,
        // A frame that is put together is as far as its parts.
        "UPDATE tasks SET state = 'leased', fence = ?, again = 0, node_id = ?, started_at = ?, \
         progress = iif(kind = 'render' AND (SELECT f.parts FROM frames f \
         WHERE f.job_id = tasks.job_id AND f.frame = tasks.frame) > 1, progress, 0), \
         pixels_share = iif(kind = 'render' AND (SELECT f.parts FROM frames f \
         WHERE f.job_id = tasks.job_id AND f.frame = tasks.frame) > 1, pixels_share, NULL) WHERE id = ?",
        fence,
        node.id.0,
        now.micros(),
        task_id.0
    );
    let ttl_micros = i64::try_from(ttl.as_micros()).unwrap_or(i64::MAX);
    let lease = Lease {
        lease_id: LeaseId::new(),
        task_id,
        job_id,
        fence: fence.unsigned_abs(),
        expires_at: now.plus_micros(ttl_micros),
        ttl_ms: u64::try_from(ttl.as_millis()).unwrap_or(u64::MAX),
        spec,
        limits: task.limits.0,
    };
    let speed = node.speed_for(work.as_ref());
    later!(
        write,
        "INSERT INTO leases (id, task_id, node_id, fence, node_speed, state, granted_at, expires_at, beside, p95) \
         VALUES (?, ?, ?, ?, ?, 'active', ?, ?, \
         coalesce((SELECT 1 - o.beside FROM leases o WHERE o.task_id = ? AND o.state = 'active'), 0), \
         (SELECT CAST(min(f.cpu_p95 * ifnull((SELECT share FROM tasks WHERE id = ?), 1.0 / f.parts) * j.factor / ? * 1000000, \
                          1e18) AS INTEGER) + iif(? > 1, j.serial_many_cores, j.serial_one_core) FROM frames f JOIN jobs j ON j.id = f.job_id \
         WHERE f.job_id = ? AND f.frame = ? AND f.cpu_p95 >= 0 AND (? = 'render_part' OR f.parts = 1)))",
        lease.lease_id.0,
        task_id.0,
        node.id.0,
        fence,
        speed,
        now.micros(),
        lease.expires_at.micros(),
        task_id.0,
        task_id.0,
        speed * f64::from(node.cores),
        node.cores,
        job_id.0,
        // Frames and their parts have a forecast of their own. How long it takes to put a frame together has
        // none.
        lease.spec.frame().filter(|_| matches!(kind, TaskKind::RenderPart | TaskKind::Render)),
        kind.name()
    );
    if lease.spec.kind().is_booked() && task.job_state.0 == JobState::Booked {
        later!(write, "UPDATE jobs SET stage = 'rendering' WHERE id = ?", job_id.0);
        job_state(write, job_id, JobState::Rendering, None, now);
    }
    let beside = "a second attempt, beside one that makes no progress; the first result counts";
    let leased = Event {
        message: task.is_again.then(|| beside.to_owned()),
        job_id: Some(job_id),
        task_id: Some(task_id),
        task_kind: Some(lease.spec.kind()),
        frame: lease.spec.frame(),
        part: lease.spec.part(),
        node_id: Some(node.id),
        ..event(EventKind::TaskLeased, now)
    };
    append(write, leased);
    lease
}

/// What a claim reads before it looks for a task. One query answers all three, because the last two are
/// nearly always negative.
#[derive(FromRow)]
struct Asker {
    #[sqlx(flatten, try_from = "NodeRow")]
    node: Node,
    /// Whether the request with this key was answered before.
    was_answered: bool,
    #[sqlx(skip)]
    answered: Option<RecordedAnswer>,
    some_ran_out: bool,
}

async fn asker(
    write: &mut Write,
    node: NodeId,
    key: Option<&IdempotencyKey>,
    now: Timestamp,
) -> Result<Asker> {
    let asker: Option<Asker> = ask!(
        write,
        "SELECT n.*, (SELECT l.task_id FROM leases l WHERE l.node_id = n.id AND l.state = 'active' \
                      ORDER BY l.granted_at DESC, l.id LIMIT 1) AS task_id, \
         EXISTS (SELECT 1 FROM idempotency WHERE principal = ? AND key = ?) AS was_answered, \
         EXISTS (SELECT 1 FROM leases WHERE state = 'active' AND expires_at <= ?) AS some_ran_out \
         FROM nodes n WHERE n.id = ? AND n.removed_at IS NULL",
        key.map(|key| &key.principal[..]),
        key.map(|key| &key.key),
        now.micros(),
        node.0
    )
    .first_row()
    .await?;
    let mut asker = asker.ok_or(StoreError::NotFound("node"))?;
    if asker.was_answered {
        asker.answered = earlier_answer(write, key).await?;
    }
    Ok(asker)
}

/// The task that the node should do next, if it may have one.
///
/// 0. A task that makes no progress on another node, to run it a second time: see
///    [`crate::policy::overdue`]. There is hardly ever one.
/// 1. Previews and profiles of any job, and plans and merges of irradiance caches. They are short, and every
///    quote and booking waits for them. Videos too: on a busy farm they would otherwise never be made. By
///    priority, then deadline, then age of the job.
/// 2. The node's own bookings, by planned start: frames, and parts of irradiance caches.
/// 3. Any other frames and parts, by the job's deadline, then priority, then age of the job, then frame, as
///    far as the plan allows it: see [`work_stealing`].
///
/// Each of them is one step into an index of its own. The index is named because SQLite would otherwise
/// sort all ready tasks. A later step runs only if the earlier ones found nothing. Booked jobs are examined
/// one by one only if the first task of the last kind is not free for every node.
///
/// A failed task is skipped while it waits, and for longer on the nodes on which it failed. Such tasks are
/// few, so these steps are few.
///
/// Before the node's window ends, frames are skipped that would run past its end in more than one case of
/// twenty.
async fn offer(
    connection: &mut SqliteConnection,
    node: &Node,
    up_since: Timestamp,
    now: Timestamp,
) -> Result<Offer> {
    let until = match opening(node, now) {
        Opening::Awake(until) if node.takes_tasks() => until,
        Opening::Awake(_) | Opening::Asleep(_) => return Ok(Offer::default()),
    };
    let at_most = match until {
        Some(until) => Some(at_most(connection, node, until.micros_since(now)).await?),
        None => None,
    };
    let asking = Asking { node, now, up_since, at_most };
    let Some(first) = asking.first(connection, NEXT, |query| query).await? else {
        return Ok(Offer::default());
    };
    if first.is_booked_elsewhere {
        return work_stealing::offer(connection, &asking).await;
    }
    Ok(Some(first).into())
}

/// A task by its id, if it is ready, or is to be run a second time and the node has not tried it; `None`
/// while it is leased, or waits after a failure. A [`StoreError::Conflict`] if it is over, or is a video and
/// the node has no ffmpeg.
async fn this_task(
    connection: &mut SqliteConnection,
    (task, node): (TaskId, NodeId),
    now: Timestamp,
) -> Result<Option<OfferedTask>> {
    let row = sqlx::query!(
        r#"SELECT id, job_id, spec, limits, fence, not_before,
                  (SELECT j.state FROM jobs j WHERE j.id = tasks.job_id) AS "job_state!: Word<JobState>",
                  (SELECT j.work_by_class FROM jobs j WHERE j.id = tasks.job_id) AS "work_by_class?: Json<ByClass>",
                  CASE WHEN state <> 'ready' OR NOT held THEN state
                  WHEN (SELECT j.paused FROM jobs j WHERE j.id = tasks.job_id) THEN 'held back: its job is paused'
                  ELSE 'held back by a budget' END AS "state!: String",
                  again = 1 AND held = 0 AND NOT EXISTS (SELECT 1 FROM leases f WHERE f.task_id = tasks.id
                  AND f.node_id = ?2 AND f.state IN ('active', 'failed')) AS "may_again!: bool",
                  kind = 'video' AND NOT EXISTS (SELECT 1 FROM nodes n, json_each(n.renderers) p
                  WHERE n.id = ?2 AND p.value = tasks.renderer) AS "lacks_ffmpeg!: bool"
           FROM tasks WHERE id = ?1"#,
        task.0,
        node.0
    )
    .fetch_optional(connection)
    .await?
    .ok_or(StoreError::NotFound("task"))?;
    if row.lacks_ffmpeg {
        return Err(StoreError::Conflict("the task is a video, and this node has no ffmpeg".to_owned()));
    }
    let is_again = row.state == "leased" && row.may_again;
    match row.state.as_str() {
        state if state == "ready" || is_again => {
            Ok((Timestamp::from(row.not_before) <= now).then_some(OfferedTask {
                id: row.id,
                job_id: row.job_id,
                spec: row.spec,
                limits: row.limits,
                fence: row.fence,
                job_state: row.job_state,
                work_by_class: row.work_by_class,
                is_again,
                is_booked_elsewhere: false,
            }))
        }
        "leased" | "waiting" => Ok(None),
        over => Err(StoreError::Conflict(format!("the task is {over}"))),
    }
}

/// JSON object by job: forecast CPU seconds that the node does in so many microseconds. As in plans, it is
/// for the job's classes of work and corrected by finished frames.
async fn at_most(connection: &mut SqliteConnection, node: &Node, micros: i64) -> Result<String> {
    let rows = sqlx::query!(
        "SELECT hex(id) AS \"name!: String\", work_by_class, factor, \
         iif(?, serial_many_cores, serial_one_core) AS \"serial!: i64\" FROM jobs \
         WHERE state IN ('booked', 'rendering')",
        node.cores > 1
    )
    .fetch_all(connection)
    .await?;
    let limits: BTreeMap<String, f64> = rows
        .into_iter()
        .map(|row| {
            let work = row.work_by_class.map(|it| it.0);
            // At least half of the window counts. Otherwise, serial time that was learnt too high would keep
            // frames from the node for ever.
            let shared = micros.saturating_sub(row.serial).max(micros / 2);
            (row.name, forecast_seconds_within(shared, node, work.as_ref(), row.factor))
        })
        .collect();
    Ok(serde_json::to_string(&limits)?)
}

/// The next task of the node by the steps of [`offer`], and whether it is booked elsewhere.
pub(crate) const NEXT: &str = concat!(
    "SELECT ",
    task_columns!(),
    ", again = 1 AND state = 'leased' AS is_again, state = 'ready' AND kind IN ('cache_fill', 'render_part', 'render') \
     AND booked_rate IS NOT NULL AND booked_node IS NOT ?1 AS is_booked_elsewhere FROM tasks WHERE id = coalesce((",
    next_stalled_task!(),
    "), (",
    next_task!(
        "tasks_ready_quotes",
        "kind NOT IN ('cache_fill', 'render_part', 'render')",
        "priority DESC, due_at, job_id, frame"
    ),
    "), (",
    next_task!(
        "tasks_ready_booked",
        "kind IN ('cache_fill', 'render_part', 'render') AND booked_node = ?1",
        "booked_at, job_id, frame, part"
    ),
    "), (",
    next_task!(
        "tasks_ready_any",
        "kind IN ('cache_fill', 'render_part', 'render')",
        "due_at, priority DESC, job_id, frame, part"
    ),
    "))"
);
