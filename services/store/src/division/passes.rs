//! Divided frames that are rendered in passes: the nodes share the pixels of each pass.
//!
//! ```text
//! divide ──► parts (ready), with the samples of the first pass
//! last part of a pass ──► divide (ready), with the pixels so far in its specification
//!                     ──► parts (ready), with the samples of the next pass and the pixels so far
//!                     ──► the frame's render task (ready), if the image has all its samples
//! ```
//!
//! So `divide` and the parts are the same tasks in every pass. Pixels of the last pass are kept until the
//! next one is over.

use forelight_protocol::{
    ArtifactHash, DivideResult, FinishedPart, JobId, PartPass, Passes, PixelRange, RenderPartSpec,
    TaskResult, TaskSpec,
};

use crate::columns::{Id, Json, corrupt};
use crate::database::Write;
use crate::error::Result;
use crate::leases::LeaseRow;
use crate::tasks;
use crate::writing::run;

/// Lets a frame's `divide` task begin again after a pass, whose parts have made these files.
pub(super) async fn divide_again(
    write: &mut Write,
    job: JobId,
    frame: u32,
    passes: Passes,
    finished: &[FinishedPart],
) -> Result<()> {
    let before = finished.iter().map(FinishedPart::hash).collect();
    divide_anew(write, (job, frame), &Passes { before, ..passes }, "ready").await?;
    write.made_work = true;
    Ok(())
}

/// Lets a frame's `divide` task begin again: before the first pass, or after the one whose files `passes` names. Its
/// irradiance cache, if it is full, stays. There are as many parts as the frame has now.
pub(super) async fn divide_anew(
    write: &mut Write,
    (job, frame): (JobId, u32),
    passes: &Passes,
    state: &'static str,
) -> Result<()> {
    let tasks = sqlx::query_scalar!(
        r#"UPDATE tasks SET spec = json_set(
           iif(json_array_length(?1, '$.before') > 0, json_remove(spec, '$.divide.profile'), spec),
           '$.divide.passes', json(?1),
           '$.divide.parts', (SELECT f.parts FROM frames f WHERE f.job_id = ?2 AND f.frame = ?3),
           '$.divide.frame_cache',
           json_extract((SELECT r.spec FROM tasks r WHERE r.job_id = ?2 AND r.frame = ?3 AND r.kind = 'render'),
           '$.render.frame_cache'))
           WHERE job_id = ?2 AND frame = ?3 AND kind = 'divide' RETURNING id AS "id!: Id""#,
        Json(passes),
        job.0,
        frame
    )
    .fetch_all(write.connection().await?)
    .await?;
    // A cache that came with the profile has no other owner than the division.
    run!(
        write,
        "INSERT OR IGNORE INTO result_artifacts (task_id, hash) SELECT p.id, a.hash \
         FROM tasks d JOIN tasks p ON p.job_id = d.job_id AND p.frame = d.frame AND p.kind = 'profile' \
         JOIN results r ON r.task_id = p.id \
         JOIN artifacts a ON a.hash = unhex(json_extract(d.spec, '$.divide.frame_cache')) \
         WHERE d.job_id = ? AND d.frame = ? AND d.kind = 'divide'",
        job.0,
        frame
    );
    for task in tasks {
        tasks::forget_result(write, task).await?;
        tasks::begin_again(write, task, state).await?;
    }
    Ok(())
}

/// Keeps what a frame will probably take, to tell how far it is.
pub(super) async fn expect_work(write: &mut Write, (job, frame): (JobId, u32), work: u64) -> Result<()> {
    let work = i64::try_from(work).unwrap_or(i64::MAX);
    run!(
        write,
        "UPDATE tasks SET spec = json_set(spec, '$.render.work', ?) \
         WHERE job_id = ? AND kind = 'render' AND frame = ?",
        work,
        job.0,
        frame
    );
    Ok(())
}

/// Gives the parts of a frame their pixels of the next pass.
pub(super) async fn next_pass(
    write: &mut Write,
    row: &LeaseRow,
    frame: u32,
    (result, samples): (&DivideResult, ArtifactHash),
) -> Result<()> {
    let last = parts_of_last_pass(write, row.job_id, frame).await?;
    for part in last.iter().filter(|part| part.made.is_some()) {
        end_pass(write, row, part).await?;
    }
    // Pieces of late parts had shares of their own in the last pass.
    run!(
        write,
        "UPDATE tasks SET share = NULL WHERE job_id = ? AND frame = ? AND kind = 'render_part'",
        row.job_id.0,
        frame
    );
    let mut from = 0;
    for (part, &to) in last.iter().zip(&result.ends) {
        let pixels = PixelRange { from, to };
        let overlaps = |(range, hash): (PixelRange, ArtifactHash)| {
            (range.from < pixels.to && pixels.from < range.to).then_some(hash)
        };
        let before = last.iter().filter_map(|part| overlaps(part.made?)).collect();
        run!(
            write,
            "UPDATE tasks SET spec = json_set(spec, '$.render_part.pass', json(?)) WHERE id = ?",
            Json(&PartPass { pixels, samples, before }),
            part.task
        );
        from = to;
    }
    Ok(())
}

/// A part of a frame, in the order of parts.
struct Part {
    task: Id,
    /// The pixels of its last pass, and their file.
    made: Option<(PixelRange, ArtifactHash)>,
}

async fn parts_of_last_pass(write: &mut Write, job: JobId, frame: u32) -> Result<Vec<Part>> {
    let rows = sqlx::query!(
        r#"SELECT t.id, t.spec, r.body AS "body?: Json<TaskResult>" FROM tasks t LEFT JOIN results r ON r.task_id = t.id
           WHERE t.job_id = ? AND t.kind = 'render_part' AND t.frame = ? ORDER BY t.part"#,
        job.0,
        frame
    )
    .fetch_all(write.connection().await?)
    .await?;
    rows.into_iter()
        .map(|row| {
            let made = match (row.spec.0, row.body.map(|it| it.0)) {
                (_, None) => None,
                (
                    TaskSpec::RenderPart(RenderPartSpec { pass: Some(pass), .. }),
                    Some(TaskResult::RenderPart(result)),
                ) => Some((pass.pixels, result.finished.hash())),
                _ => return Err(corrupt("spec", "not that of a part of a pass")),
            };
            Ok(Part { task: row.id, made })
        })
        .collect()
}

/// Lets a part begin again. What it did is counted, and its file stays with the `divide` task until the next
/// pass is over.
async fn end_pass(write: &mut Write, row: &LeaseRow, part: &Part) -> Result<()> {
    run!(
        write,
        "INSERT OR IGNORE INTO result_artifacts (task_id, hash) SELECT ?, hash FROM result_artifacts WHERE task_id = ?",
        row.task_id.0,
        part.task
    );
    run!(
        write,
        "UPDATE tasks SET earlier_work = earlier_work + ifnull(pixels_work, 0), \
         earlier_cpu = earlier_cpu + ifnull(pixels_cpu, 0), earlier_nanos = earlier_nanos + \
         (SELECT ifnull(json_extract(r.body, '$.render_part.finished.pixels.cost.cpu_nanos'), 0) \
          FROM results r WHERE r.task_id = tasks.id) WHERE id = ?",
        part.task
    );
    tasks::forget_result(write, part.task).await?;
    tasks::begin_again(write, part.task, "waiting").await
}

/// Forgets what the parts of a frame did in earlier passes.
pub(super) async fn forget_earlier(write: &mut Write, job: JobId, frame: u32) -> Result<()> {
    run!(
        write,
        "UPDATE tasks SET earlier_work = 0, earlier_cpu = 0, earlier_nanos = 0 \
         WHERE job_id = ? AND frame = ? AND kind = 'render_part'",
        job.0,
        frame
    );
    Ok(())
}
