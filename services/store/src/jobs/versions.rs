//! Keeps a job with one version of our own renderer: see [`crate::policy::versions`].

use forelight_protocol::{
    Event, EventKind, JobId, Needs, Node, RenderedBy, RendererRequest, Timestamp, WITH_DENOISER,
};

use crate::columns::Json;
use crate::database::Write;
use crate::error::Result;
use crate::events::{append, event};
use crate::living::{self, Occasion};
use crate::plans::replans;
use crate::policy::versions::{is_left, version_to_use, words};
use crate::writing::run;
use crate::{division, nodes};

/// Chooses the version that renders a job of our own renderer, when it is previewed.
pub(crate) async fn choose(write: &mut Write, job: JobId, now: Timestamp) -> Result<()> {
    let denoise = sqlx::query_scalar!("SELECT denoise FROM jobs WHERE id = ?", job.0);
    let denoise = denoise.fetch_one(write.connection().await?).await?;
    let nodes = nodes::list(write.connection().await?, None, u32::MAX).await?;
    // A job that must wait for a denoiser has a version all the same, and another one when a node has both.
    let version = version_to_use(&nodes, denoise, now).or_else(|| version_to_use(&nodes, false, now));
    let Some(version) = version else { return Ok(()) };
    run!(
        write,
        "UPDATE jobs SET rendered_by = ? WHERE id = ?",
        Json(&RenderedBy { version, mixed: None }),
        job.0
    );
    Ok(())
}

/// Gives jobs another version if no node has theirs any more. Silence counts from the start of the service.
pub(crate) async fn replace_lost(write: &mut Write, up_since: Timestamp, now: Timestamp) -> Result<()> {
    // Jobs are read only if a version has no node that was heard of lately, which is rare. A job that must wait for a
    // denoiser gets no other version by it.
    let suspects = sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM jobs j
               WHERE j.state IN ('previewing', 'profiling', 'quoted', 'booked', 'rendering') AND j.rendered_by IS NOT NULL
               AND (NOT j.denoise OR EXISTS (SELECT 1 FROM nodes n, json_each(n.renderers) r
                   WHERE r.value = 'forelight' || ?1 AND n.removed_at IS NULL AND NOT n.drain AND n.set_aside IS NULL
                   AND n.last_seen_at >= ?2))
               AND NOT EXISTS (SELECT 1 FROM nodes n, json_each(n.renderers) r
                   WHERE r.value = 'forelight ' || (j.rendered_by ->> 'version') || iif(j.denoise, ?1, '')
                   AND n.removed_at IS NULL AND NOT n.drain AND n.set_aside IS NULL AND n.last_seen_at >= ?2)) AS "some!: bool""#,
        WITH_DENOISER,
        now.plus_micros(-nodes::LOST).micros()
    )
    .fetch_one(write.connection().await?)
    .await?;
    if !suspects {
        return Ok(());
    }
    let nodes = nodes::list(write.connection().await?, None, u32::MAX).await?;
    let heard = |node: Node| Node { last_seen_at: node.last_seen_at.max(up_since), ..node };
    let nodes: Vec<Node> = nodes.into_iter().map(heard).collect();
    let jobs = sqlx::query!(
        r#"SELECT j.id, j.name, j.denoise, j.rendered_by AS "rendered_by!",
                  EXISTS (SELECT 1 FROM tasks t
                  WHERE t.job_id = j.id AND t.state = 'done' AND t.kind <> 'preview') AS "has_begun!: bool"
           FROM jobs j WHERE j.state IN ('previewing', 'profiling', 'quoted', 'booked', 'rendering')
           AND j.rendered_by IS NOT NULL ORDER BY j.id"#
    )
    .fetch_all(write.connection().await?)
    .await?;
    for row in jobs {
        let before = row.rendered_by.0;
        if is_left(&nodes, &before.version, row.denoise, now) {
            continue;
        }
        let Some(version) = version_to_use(&nodes, row.denoise, now) else { continue };
        let job = (JobId::from(row.id), row.name.as_str());
        let why = format!("no node has {} any more", Needs::own(&before.version, row.denoise));
        replace(write, job, (before, row.has_begun), (&version, &why), now).await?;
    }
    Ok(())
}

/// A process that was started for exactly one task does it with the version that its node has. So it is under Slurm,
/// where machines usually share one program. The job goes on with that version, and says so, once.
pub(crate) async fn note_other(write: &mut Write, job: JobId, node: &Node, now: Timestamp) -> Result<()> {
    let Some(version) = node.own_version() else { return Ok(()) };
    let row = sqlx::query!(
        r#"SELECT j.name, j.rendered_by AS "rendered_by!", EXISTS (SELECT 1 FROM tasks t
                  WHERE t.job_id = j.id AND t.state = 'done' AND t.kind <> 'preview') AS "has_begun!: bool"
           FROM jobs j WHERE j.id = ? AND j.rendered_by ->> 'version' <> ? AND j.rendered_by ->> 'mixed' IS NULL"#,
        job.0,
        version
    )
    .fetch_optional(write.connection().await?)
    .await?;
    let Some(row) = row else { return Ok(()) };
    let new = RendererRequest::own(version);
    let why = format!("a process was started for one of its tasks on {}, which has {new}", node.name);
    replace(write, (job, &row.name), (row.rendered_by.0, row.has_begun), (version, &why), now).await
}

/// Has a job rendered by another version from now on, and says so.
async fn replace(
    write: &mut Write,
    (job, name): (JobId, &str),
    (before, has_begun): (RenderedBy, bool),
    (version, why): (&str, &str),
    now: Timestamp,
) -> Result<()> {
    let of = |version: &str| [false, true].map(|denoise| Needs::own(version, denoise).to_string());
    let ([old, old_denoised], [new, new_denoised]) = (of(&before.version), of(version));
    let mixed = if has_begun { Some(words(&old, &new, why, now)) } else { before.mixed };
    let after = RenderedBy { version: version.to_owned(), mixed };
    run!(write, "UPDATE jobs SET rendered_by = ? WHERE id = ?", Json(&after), job.0);
    for (new, old) in [(&new, &old), (&new_denoised, &old_denoised)] {
        run!(write, "UPDATE tasks SET renderer = ? WHERE job_id = ? AND renderer = ?", new, job.0, old);
    }
    if has_begun {
        render_parts_again(write, job, now).await?;
    }
    let message = after.mixed.unwrap_or_else(|| format!("{why}; {new} renders it"));
    let changed = Event { job_id: Some(job), ..event(EventKind::JobChanged, now) };
    append(write, Event { message: Some(message), ..changed });
    replans::want(write, &format!("job {name} is rendered by {new}")).await?;
    write.made_work = true;
    Ok(())
}

/// Renders the parts and passes of divided frames again that another version has rendered, or is rendering. A
/// frame of which all parts are there only has to be put together, and stays.
async fn render_parts_again(write: &mut Write, job: JobId, now: Timestamp) -> Result<()> {
    let frames = sqlx::query_scalar!(
        r#"SELECT DISTINCT p.frame AS "frame!: u32" FROM tasks p
           JOIN tasks r ON r.job_id = p.job_id AND r.frame = p.frame AND r.kind = 'render' AND r.state = 'waiting'
           WHERE p.job_id = ? AND (p.kind = 'render_part' AND p.state IN ('leased', 'done')
                 OR p.kind = 'divide' AND json_array_length(p.spec, '$.divide.passes.before') > 0) ORDER BY p.frame"#,
        job.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    if frames.is_empty() {
        return Ok(());
    }
    for frame in frames {
        division::begin_again(write, job, frame, "ready", now).await?;
    }
    living::update(write, job, Occasion::Booked, now).await
}
