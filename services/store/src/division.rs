//! Frames that are divided into parts, which several nodes render at the same time.
//!
//! ```text
//! plan books parts ──► divide (ready), parts (waiting), the frame's render task (waiting)
//! divide ──► parts (ready), with their pixels in their specification
//!        ──► parts of the frame's irradiance cache (ready), if it has one that is not full
//! merge, full ──► parts (ready), with the cache's name in their specification
//! last part ──► the frame's render task (ready), with the finished parts in its specification
//! ```
//!
//! A renderer that divides a frame by its samples needs no `divide` task: its parts are ready at once. With a
//! shared cache, `divide` waits for it. As in [`crate::shared_cache`], every arrow is part of the transaction
//! that commits the result before it.
//!
//! A frame is divided only while no worker has had it. Once it is, it stays so, but for parts that take
//! longer than forecast: see [`again`]. A frame whose samples go where they help is divided anew before each
//! pass over its pixels: see [`passes`].

pub(crate) mod again;
mod passes;

use std::collections::BTreeMap;

use forelight_protocol::{
    ArtifactHash, DivideResult, FinishedPart, FrameCache, JobId, JobSettings, LeaseId, PartRange, Passes,
    PixelRange, RenderPartResult, RenderSpec, TaskKind, TaskResult, TaskSpec, Timestamp,
};
use forelight_quote::division::sample_ranges;

use crate::columns::{Id, Json, corrupt};
use crate::database::Write;
use crate::error::{Result, StoreError};
use crate::leases::{LeaseRow, take_back};
use crate::policy::rebooking::NewBooking;
use crate::tasks::{self, Common, PartAsked};
use crate::writing::{later, run};

/// Divides the frames that the plan books in parts, and that no worker has had yet.
pub(crate) async fn divide_as_planned(write: &mut Write, job: JobId, planned: &[NewBooking]) -> Result<()> {
    let in_parts = planned.iter().filter(|booking| booking.frame.parts > 1);
    let parts: BTreeMap<u32, u32> =
        in_parts.map(|booking| (booking.frame.frame, booking.frame.parts)).collect();
    if parts.is_empty() {
        return Ok(());
    }
    let common = Common::read(write.connection().await?, job).await?;
    for (frame, parts) in parts {
        let whole = sqlx::query!(
            "SELECT t.id, t.spec, t.state FROM tasks t JOIN frames f ON f.job_id = t.job_id AND f.frame = t.frame \
             WHERE t.job_id = ? AND t.kind = 'render' AND t.frame = ? AND f.parts = 1 AND t.fence = 0 \
             AND t.state IN ('waiting', 'ready')",
            job.0,
            frame
        )
        .fetch_optional(write.connection().await?)
        .await?;
        let Some(whole) = whole else { continue };
        let TaskSpec::Render(spec) = whole.spec.0 else {
            return Err(corrupt("spec", "not that of a render task"));
        };
        run!(
            write,
            "UPDATE tasks SET state = 'waiting', booked_part = NULL, booked_node = NULL, booked_at = NULL, \
             booked_rate = NULL WHERE id = ?",
            whole.id
        );
        run!(write, "UPDATE frames SET parts = ? WHERE job_id = ? AND frame = ?", parts, job.0, frame);
        begin(write, &common, &spec, parts, whole.state == "waiting").await?;
    }
    Ok(())
}

/// Makes the tasks of a frame's parts. With `waits`, they wait for the job's shared cache.
async fn begin(
    write: &mut Write,
    common: &Common,
    whole: &RenderSpec,
    parts: u32,
    waits: bool,
) -> Result<()> {
    let RenderSpec { frame, profile, cache, .. } = *whole;
    let asked = |part, range| PartAsked { frame, part, parts, range, profile, cache };
    // In passes, the profile's pixels are rendered as all others, and the division has read its cache.
    let in_parts =
        |asked: PartAsked| PartAsked { profile: profile.filter(|_| whole.work.is_none()), ..asked };
    match &common.settings {
        JobSettings::Own(_) => {
            common.divide(write, asked(0, None), whole.passes(), waits).await?;
            for part in 0..parts {
                common.render_part(write, in_parts(asked(part, None))).await?;
            }
        }
        JobSettings::Shot(settings) => {
            let samples = settings.samples.unwrap_or(1);
            for (part, range) in (0..).zip(sample_ranges(samples, &whole.shares, parts)) {
                common.render_part(write, asked(part, Some(PartRange::Samples(range)))).await?;
            }
        }
    }
    Ok(())
}

/// Continues after a frame was divided.
pub(crate) async fn divided(write: &mut Write, row: &LeaseRow, result: &DivideResult) -> Result<()> {
    let frame = frame_of(row)?;
    if result.ends.is_empty() {
        let finished = finished_parts(write, row.job_id, frame).await?;
        return put_together(write, row, frame, &finished).await;
    }
    if let Some(work) = result.expected_work {
        passes::expect_work(write, (row.job_id, frame), work).await?;
    }
    match result.samples {
        Some(samples) => passes::next_pass(write, row, frame, (result, samples)).await?,
        None => set_ranges(write, row.job_id, frame, result).await?,
    }
    match result.cache {
        Some(FrameCache { hash, full: false, .. }) => {
            let common = Common::read(write.connection().await?, row.job_id).await?;
            let parts = u32::try_from(result.ends.len()).unwrap_or(u32::MAX);
            for part in 0..parts {
                common.cache_fill(write, (hash, Some(frame)), 0, (part, parts), None).await?;
            }
            Ok(())
        }
        Some(FrameCache { hash, .. }) => begin_parts(write, row.job_id, frame, Some(hash)).await,
        None => begin_parts(write, row.job_id, frame, None).await,
    }
}

/// Gives the parts of a frame their pixels.
async fn set_ranges(write: &mut Write, job: JobId, frame: u32, result: &DivideResult) -> Result<()> {
    let mut from = 0;
    for (part, &to) in (0u32..).zip(&result.ends) {
        let range = PartRange::Pixels(PixelRange { from, to });
        run!(
            write,
            "UPDATE tasks SET spec = json_set(spec, '$.render_part.range', json(?)) \
             WHERE job_id = ? AND kind = 'render_part' AND frame = ? AND part = ?",
            Json(&range),
            job.0,
            frame,
            part
        );
        from = to;
    }
    Ok(())
}

/// Makes the parts of a divided frame ready. Its own irradiance cache, if it has one, is full.
pub(crate) async fn begin_parts(
    write: &mut Write,
    job: JobId,
    frame: u32,
    cache: Option<ArtifactHash>,
) -> Result<()> {
    let cache = cache.map(|cache| cache.to_string());
    run!(
        write,
        "UPDATE tasks SET state = 'ready', spec = iif(?1 IS NULL, spec, json_set(spec, '$.render_part.frame_cache', ?1)) \
         WHERE job_id = ?2 AND kind = 'render_part' AND frame = ?3 AND state = 'waiting'",
        cache,
        job.0,
        frame
    );
    run!(
        write,
        "UPDATE tasks SET spec = json_set(spec, '$.render.frame_cache', ?1) \
         WHERE ?1 IS NOT NULL AND job_id = ?2 AND kind = 'render' AND frame = ?3",
        cache,
        job.0,
        frame
    );
    write.made_work = true;
    Ok(())
}

/// Continues after a part was rendered: after the last one, the frame is put together.
pub(crate) async fn part_rendered(
    write: &mut Write,
    row: &LeaseRow,
    result: &RenderPartResult,
) -> Result<()> {
    let frame = frame_of(row)?;
    let (work, cpu_nanos) = match &result.finished {
        FinishedPart::Pixels(pixels) => (Some(pixels.cost.work as f64), pixels.cost.cpu_nanos),
        FinishedPart::Samples(share) => (None, share.cpu_nanos),
    };
    let cpu_at_speed_one = cpu_nanos as f64 * 1e-9 * row.node_speed;
    run!(
        write,
        "UPDATE tasks SET pixels_share = 1, pixels_work = ?, pixels_cpu = ? WHERE id = ?",
        // Renderers that count no work have CPU time in microseconds instead.
        work.unwrap_or(cpu_at_speed_one * 1e6),
        cpu_at_speed_one,
        row.task_id.0
    );
    if let Some(rest) = &result.rest {
        again::divide_rest(write, row, frame, (result, rest)).await?;
    }
    add_up(write, row.job_id, frame).await?;
    let is_any_left = sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM tasks WHERE job_id = ? AND kind = 'render_part' AND frame = ? AND state <> 'done')
           AS "is_any_left!: bool""#,
        row.job_id.0,
        frame
    );
    if is_any_left.fetch_one(write.connection().await?).await? {
        return Ok(());
    }
    let finished = finished_parts(write, row.job_id, frame).await?;
    match passes_of(write, row.job_id, frame).await? {
        Some(passes) => passes::divide_again(write, row.job_id, frame, passes, &finished).await,
        None => put_together(write, row, frame, &finished).await,
    }
}

/// What the parts of a frame have made, in their order.
async fn finished_parts(write: &mut Write, job: JobId, frame: u32) -> Result<Vec<FinishedPart>> {
    let results = sqlx::query_scalar!(
        "SELECT r.body FROM tasks t JOIN results r ON r.task_id = t.id \
         WHERE t.job_id = ? AND t.kind = 'render_part' AND t.frame = ? ORDER BY t.part",
        job.0,
        frame
    )
    .fetch_all(write.connection().await?)
    .await?;
    let made = |result: Json<TaskResult>| match result.0 {
        TaskResult::RenderPart(result) => Ok(result.finished),
        other => Err(corrupt("body", format!("a {} result of a render_part task", other.kind()))),
    };
    results.into_iter().map(made).collect()
}

/// How a frame is rendered in passes, before the first. `None` for frames that are not.
async fn passes_of(write: &mut Write, job: JobId, frame: u32) -> Result<Option<Passes>> {
    let spec = sqlx::query_scalar!(
        "SELECT spec FROM tasks WHERE job_id = ? AND kind = 'render' AND frame = ?",
        job.0,
        frame
    )
    .fetch_optional(write.connection().await?)
    .await?;
    Ok(match spec.map(|spec| spec.0) {
        Some(TaskSpec::Render(spec)) => spec.passes(),
        _ => None,
    })
}

/// Makes the frame's render task ready, with its finished parts. The node that did the last one has the scene
/// open, so it does this next; any other node may do it too.
async fn put_together(
    write: &mut Write,
    row: &LeaseRow,
    frame: u32,
    finished: &[FinishedPart],
) -> Result<()> {
    let job = row.job_id;
    let task = sqlx::query!(
        "SELECT id, spec FROM tasks WHERE job_id = ? AND kind = 'render' AND frame = ?",
        job.0,
        frame
    )
    .fetch_optional(write.connection().await?)
    .await?
    .ok_or(StoreError::NotFound("task"))?;
    let TaskSpec::Render(mut spec) = task.spec.0 else {
        return Err(corrupt("spec", "not that of a render task"));
    };
    let first = finished.iter().filter_map(|part| match part {
        FinishedPart::Samples(share) => Some(share.offset),
        FinishedPart::Pixels(_) => None,
    });
    // Of an earlier attempt at the frame, only what its profile has finished counts.
    let first = first.min().unwrap_or(u32::MAX);
    spec.shares.retain(|share| share.offset < first);
    spec.parts.clear();
    for part in finished {
        match part {
            FinishedPart::Pixels(pixels) => spec.parts.push(pixels.hash),
            FinishedPart::Samples(share) => spec.shares.push(*share),
        }
    }
    run!(
        write,
        "UPDATE tasks SET booked_part = NULL WHERE job_id = ? AND kind = 'render_part' AND frame = ?",
        job.0,
        frame
    );
    run!(
        write,
        "UPDATE tasks SET state = 'ready', booked_part = 0, booked_node = ?, booked_at = 0, spec = ? WHERE id = ?",
        row.node_id.0,
        Json(&TaskSpec::Render(spec)),
        task.id
    );
    write.made_work = true;
    Ok(())
}

/// Writes to the frame's render task how far its parts are. Each has its share of the
/// forecast cost; in passes, the work of the whole frame is known, or expected by the image so far.
pub(crate) async fn add_up(write: &mut Write, job: JobId, frame: u32) -> Result<()> {
    run!(
        write,
        "UPDATE tasks SET (progress, pixels_share, pixels_work, pixels_cpu) = \
         (SELECT iif(whole IS NULL, progress, min(work / whole, 1.0)), \
                 iif(whole IS NULL, min(share, 1.0), min(work / whole, 1.0)), work, cpu FROM \
          (SELECT total(ifnull(p.share, 1.0) * CASE p.state WHEN 'done' THEN 1.0 WHEN 'leased' THEN p.progress ELSE 0.0 END) \
                  / total(ifnull(p.share, 1.0)) AS progress, \
                  total(ifnull(p.share, 1.0) * ifnull(p.pixels_share, 0.0)) / total(ifnull(p.share, 1.0)) AS share, \
                  total(p.pixels_work) + total(p.earlier_work) AS work, \
                  total(p.pixels_cpu) + total(p.earlier_cpu) AS cpu, \
                  max(json_extract(tasks.spec, '$.render.work'), 1.0) AS whole \
           FROM tasks p WHERE p.job_id = ?1 AND p.kind = 'render_part' AND p.frame = ?2)) \
         WHERE job_id = ?1 AND kind = 'render' AND frame = ?2 AND state = 'waiting'",
        job.0,
        frame
    );
    Ok(())
}

/// CPU time of a divided frame's parts: as measured, and converted to a node of speed 1, in seconds.
pub(crate) async fn cpu_of_parts(write: &mut Write, job: JobId, frame: u32) -> Result<(f64, f64)> {
    let row = sqlx::query!(
        r#"SELECT total(t.pixels_cpu) + total(t.earlier_cpu) AS "at_speed_one!: f64",
                  total(coalesce(json_extract(r.body, '$.render_part.finished.pixels.cost.cpu_nanos'),
                                 json_extract(r.body, '$.render_part.finished.samples.cpu_nanos')))
                  + total(t.earlier_nanos) AS "nanos!: f64"
           FROM tasks t INDEXED BY tasks_of_parts JOIN results r ON r.task_id = t.id
           WHERE t.job_id = ? AND t.frame = ? AND t.kind = 'render_part'"#,
        job.0,
        frame
    )
    .fetch_one(write.connection().await?)
    .await?;
    Ok((row.nanos * 1e-9, row.at_speed_one))
}

/// Forgets the pixels of a finished frame's parts, and its coarse picture: its image has them. What its
/// irradiance cache was planned as stays.
pub(crate) fn forget_parts(write: &mut Write, job: JobId, frame: u32) {
    later!(
        write,
        "DELETE FROM result_artifacts WHERE task_id IN \
         (SELECT id FROM tasks WHERE job_id = ? AND frame = ? AND kind = 'render_part')",
        job.0,
        frame
    );
    later!(
        write,
        "DELETE FROM result_artifacts WHERE (task_id, hash) IN \
         (SELECT a.task_id, a.hash FROM tasks t JOIN results r ON r.task_id = t.id \
          JOIN result_artifacts a ON a.task_id = t.id \
          WHERE t.job_id = ? AND t.frame = ? AND t.kind = 'divide' \
          AND a.hash <> unhex(ifnull(json_extract(r.body, '$.divide.cache.hash'), '')))",
        job.0,
        frame
    );
}

/// Lets the parts of a frame begin again, if it is divided. What comes before them stays, as far as it is
/// done; `state` is that of its division otherwise. Returns whether the frame is divided.
pub(crate) async fn begin_again(
    write: &mut Write,
    job: JobId,
    frame: u32,
    state: &'static str,
    now: Timestamp,
) -> Result<bool> {
    take_parts_back(write, job, frame, now).await?;
    let tasks = tasks_of(write, job, frame).await?;
    let is_left = |kind, task: &PartTask| task.kind == kind && task.state != "done";
    let fills = |task: &PartTask| {
        [TaskKind::CacheFill, TaskKind::CacheMerge].into_iter().any(|kind| is_left(kind, task))
    };
    let is_filled = !tasks.iter().any(fills);
    let passes = passes_of(write, job, frame).await?;
    for task in tasks.iter().filter(|task| fills(task)) {
        tasks::begin_again(write, task.id, "ready").await?;
    }
    let mut is_prepared = is_filled;
    for task in tasks.iter().filter(|task| task.kind == TaskKind::Divide) {
        match &passes {
            // All passes begin again.
            Some(passes) if is_filled => {
                passes::divide_anew(write, (job, frame), passes, state).await?;
                is_prepared = false;
            }
            _ if task.state != "done" => {
                tasks::begin_again(write, task.id, state).await?;
                is_prepared = false;
            }
            _ => {}
        }
    }
    for task in tasks.iter().filter(|task| task.kind == TaskKind::RenderPart) {
        tasks::forget_result(write, task.id).await?;
        tasks::begin_again(write, task.id, if is_prepared { "ready" } else { "waiting" }).await?;
    }
    passes::forget_earlier(write, job, frame).await?;
    let is_divided = !tasks.is_empty();
    if is_divided {
        run!(
            write,
            "UPDATE tasks SET booked_part = NULL WHERE job_id = ? AND frame = ? AND kind = 'render'",
            job.0,
            frame
        );
        run!(
            write,
            "UPDATE tasks SET booked_part = part WHERE job_id = ? AND frame = ? AND kind = 'render_part'",
            job.0,
            frame
        );
    }
    Ok(is_divided)
}

/// Cancels the tasks of a frame's parts, if it is divided, and forgets their pixels.
pub(crate) async fn cancel_parts(write: &mut Write, job: JobId, frame: u32, now: Timestamp) -> Result<()> {
    take_parts_back(write, job, frame, now).await?;
    forget_parts(write, job, frame);
    run!(
        write,
        "UPDATE tasks SET state = 'cancelled', finished_at = ? WHERE job_id = ? AND frame = ? \
         AND kind IN ('divide', 'cache_fill', 'cache_merge', 'render_part') AND state IN ('waiting', 'ready')",
        now.micros(),
        job.0,
        frame
    );
    Ok(())
}

/// Takes the tasks of a frame's parts back from all workers that have them.
async fn take_parts_back(write: &mut Write, job: JobId, frame: u32, now: Timestamp) -> Result<()> {
    let held = sqlx::query_scalar!(
        "SELECT l.id FROM tasks t JOIN leases l ON l.task_id = t.id AND l.state = 'active' \
         WHERE t.job_id = ? AND t.frame = ? AND t.state = 'leased' \
         AND t.kind IN ('divide', 'cache_fill', 'cache_merge', 'render_part') ORDER BY l.id",
        job.0,
        frame
    )
    .fetch_all(write.connection().await?)
    .await?;
    take_back(write, held.into_iter().map(LeaseId::from), now).await
}

/// A task of a divided frame, besides its render task.
struct PartTask {
    id: Id,
    kind: TaskKind,
    state: String,
}

async fn tasks_of(write: &mut Write, job: JobId, frame: u32) -> Result<Vec<PartTask>> {
    let rows = sqlx::query!(
        "SELECT id, kind, state FROM tasks WHERE job_id = ? AND frame = ? \
         AND kind IN ('divide', 'cache_fill', 'cache_merge', 'render_part') ORDER BY kind, round, part",
        job.0,
        frame
    )
    .fetch_all(write.connection().await?)
    .await?;
    Ok(rows.into_iter().map(|row| PartTask { id: row.id, kind: row.kind.0, state: row.state }).collect())
}

fn frame_of(row: &LeaseRow) -> Result<u32> {
    row.frame.ok_or_else(|| corrupt("frame", format!("a {} task has none", row.kind)))
}
