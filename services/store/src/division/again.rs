//! Parts that take longer than forecast are divided again, so that idle nodes help.
//!
//! The worker hears of it with its next renewal. It finishes the pixels that it has begun, divides the others
//! into parts of equal forecast cost, and reports both. So nothing is rendered twice, and a worker that does
//! not know of this only goes on. In a pass, the worker's file has the samples so far of all pixels, and the
//! others continue from it.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{
    Event, EventKind, LeaseId, MOST_PARTS, Node, NodeId, PartPass, PartRange, PixelRange, RenderPartResult,
    RenderPartSpec, RestOfPart, TaskSpec, Timestamp,
};
use forelight_quote::JobForecast;
use forelight_quote::division::{overhead_seconds, parts_of_rest};

use crate::columns::{Id, Json, corrupt};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::append;
use crate::leases::{LeaseRow, read_in};
use crate::nodes::listing::without_capabilities;
use crate::plans::replans;
use crate::policy::availability::{Opening, opening};
use crate::policy::overdue::AttemptTimes;
use crate::policy::versions::is_there;
use crate::tasks::Common;
use crate::writing::run;

impl Store {
    /// Has the rest of late parts divided, as far as nodes are idle and the pieces are worth it.
    pub(crate) async fn divide_late_parts(&self, now: Timestamp) -> Result<()> {
        let late = sqlx::query!(
            r#"SELECT l.id, l.granted_at, l.counts_from, l.progress_at, l.progress, t.job_id, t.frame AS "frame!: u32",
                      t.renderer, j.forecast AS "forecast!: Json<JobForecast>",
                      f.parts + (SELECT ifnull(sum(o.divide_rest - 1), 0) FROM tasks p JOIN leases o ON o.task_id = p.id
                                 AND o.state = 'active' WHERE p.job_id = t.job_id AND p.frame = t.frame)
                      AS "parts!: i64"
               FROM leases l JOIN tasks t ON t.id = l.task_id JOIN jobs j ON j.id = t.job_id
               JOIN frames f ON f.job_id = t.job_id AND f.frame = t.frame
               WHERE l.state = 'active' AND l.lateness = 'late' AND l.divide_rest IS NULL AND t.kind = 'render_part'
                     AND t.again = 0 AND t.held = 0 AND coalesce(json_extract(t.spec, '$.render_part.range.pixels.to'),
                                  json_extract(t.spec, '$.render_part.pass.pixels.to')) IS NOT NULL
                     AND j.forecast IS NOT NULL
               ORDER BY l.granted_at, l.id"#
        )
        .fetch_all(self.readers())
        .await?;
        if late.is_empty() {
            return Ok(());
        }
        let mut idle = self.idle_nodes(now).await?;
        // Of each frame, the parts that were asked for now.
        let mut asked: BTreeMap<(Id, u32), u32> = BTreeMap::new();
        for row in late {
            let since =
                AttemptTimes::new(row.granted_at, row.counts_from, row.progress_at).attempt(0.0, None).since;
            let elapsed = now.micros_since(since).max(0) as f64 * 1e-6;
            let rest = if row.progress > 0.0 { elapsed * (1.0 - row.progress) / row.progress } else { 0.0 };
            let asked = asked.entry((row.job_id, row.frame)).or_default();
            let all = u32::try_from(row.parts).unwrap_or(MOST_PARTS).saturating_add(*asked);
            let most = MOST_PARTS.saturating_sub(all).saturating_add(1);
            let helpers = idle.with(row.renderer.as_deref());
            let parts = parts_of_rest(rest, overhead_seconds(&row.forecast.0), helpers).min(most);
            if parts > 1 {
                *asked += parts - 1;
                idle.promised += i64::from(parts - 1);
                self.divide_late_part(row.id.into(), parts, now).await?;
            }
        }
        Ok(())
    }

    async fn divide_late_part(&self, lease: LeaseId, parts: u32, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        let changed = run!(
            write,
            "UPDATE leases SET divide_rest = ? WHERE id = ? AND state = 'active'",
            parts,
            lease.0
        );
        if changed == 1 {
            let row = read_in(&mut write, lease).await?;
            let message = format!(
                "it takes longer than forecast; the rest is divided into {parts} parts for idle nodes"
            );
            append(&mut write, Event { message: Some(message), ..row.event(EventKind::TaskLate, now) });
        }
        self.commit(write).await
    }

    /// The nodes that would take a task now.
    async fn idle_nodes(&self, now: Timestamp) -> Result<IdleNodes> {
        let mut connection = self.readers().acquire().await?;
        let nodes = without_capabilities(&mut connection).await?;
        let is_idle = |node: &&Node| {
            node.task_id.is_none()
                && node.takes_tasks()
                && is_there(node, now)
                && matches!(opening(node, now), Opening::Awake(_))
        };
        let idle: BTreeSet<NodeId> = nodes.iter().filter(is_idle).map(|node| node.id).collect();
        let renderers = sqlx::query!(
            r#"SELECT n.id, r.value || '' AS "renderer!: String" FROM nodes n, json_each(n.renderers) r
               WHERE n.removed_at IS NULL"#
        );
        let renderers = renderers.fetch_all(&mut *connection).await?;
        let renderers = renderers.into_iter().map(|row| (NodeId::from(row.id), row.renderer));
        // Tasks that wait for a node, and parts that workers have been told to make.
        let promised = sqlx::query_scalar!(
            r#"SELECT (SELECT count(*) FROM tasks WHERE state = 'ready' AND held = 0)
                      + (SELECT ifnull(sum(divide_rest - 1), 0) FROM leases WHERE state = 'active') AS "promised!: i64""#
        );
        let promised = promised.fetch_one(&mut *connection).await?;
        Ok(IdleNodes {
            renderers: renderers.filter(|(node, _)| idle.contains(node)).collect(),
            all: idle,
            promised,
        })
    }
}

/// Nodes that would take a task now.
struct IdleNodes {
    all: BTreeSet<NodeId>,
    renderers: Vec<(NodeId, String)>,
    /// Number of tasks that they will be given.
    promised: i64,
}

impl IdleNodes {
    /// Number of those that have a renderer, and nothing else to do.
    fn with(&self, renderer: Option<&str>) -> u32 {
        let found = match renderer {
            None => self.all.len(),
            Some(renderer) => self.renderers.iter().filter(|(_, has)| has == renderer).count(),
        };
        u32::try_from(found as i64 - self.promised).unwrap_or(0)
    }
}

/// Makes parts of what a worker has left of a part.
pub(super) async fn divide_rest(
    write: &mut Write,
    row: &LeaseRow,
    frame: u32,
    (result, rest): (&RenderPartResult, &RestOfPart),
) -> Result<()> {
    let own = sqlx::query!("SELECT spec, share FROM tasks WHERE id = ?", row.task_id.0);
    let own = own.fetch_one(write.connection().await?).await?;
    let TaskSpec::RenderPart(spec) = own.spec.0 else {
        return Err(corrupt("spec", "not that of a render_part task"));
    };
    let (Some(PartRange::Pixels(range)), [first, ..]) = (spec.assigned_range(), rest.ends.as_slice()) else {
        return Err(corrupt("spec", "not that of a part of pixels"));
    };
    let asked = row.divide_rest.unwrap_or(0);
    if rest.ends.len() > asked as usize + 1 {
        let reason = format!("the worker was asked to leave its rest in {asked} parts");
        return Err(StoreError::Conflict(reason));
    }
    let parts = sqlx::query_scalar!(
        r#"SELECT parts AS "parts: u32" FROM frames WHERE job_id = ? AND frame = ?"#,
        row.job_id.0,
        frame
    );
    let parts = parts.fetch_one(write.connection().await?).await?;
    let more = u32::try_from(rest.ends.len() - 1).unwrap_or(u32::MAX);
    let all = parts.saturating_add(more);
    run!(
        write,
        "UPDATE tasks SET share = ifnull(share, 1.0 / ?), spec = json_set(spec, '$.render_part.parts', ?) \
         WHERE job_id = ? AND frame = ? AND kind = 'render_part'",
        parts,
        all,
        row.job_id.0,
        frame
    );
    run!(write, "UPDATE frames SET parts = ? WHERE job_id = ? AND frame = ?", all, row.job_id.0, frame);
    let whole = own.share.unwrap_or(1.0 / f64::from(parts.max(1)));
    // A share decides how long a piece may take. So none is without one, whatever work the worker forecasts.
    let by_work = rest.work.iter().skip(1).all(|&work| work > 0);
    let starts = std::iter::once(&range.from).chain(&rest.ends);
    let pixels = starts.zip(&rest.ends).map(|(from, to)| u64::from(to.saturating_sub(*from)));
    let sizes: Vec<u64> = if by_work { rest.work.clone() } else { pixels.collect() };
    let all_sizes = sizes.iter().fold(0.0, |sum, &size| sum + size as f64).max(1.0);
    let share_of = |piece: usize| whole * sizes[piece] as f64 / all_sizes;
    let piece_of = |from, to, part, before| {
        let pixels = PixelRange { from, to };
        match &spec.pass {
            None => {
                RenderPartSpec { part, parts: all, range: Some(PartRange::Pixels(pixels)), ..spec.clone() }
            }
            Some(pass) => {
                let pass = PartPass { pixels, before, ..pass.clone() };
                RenderPartSpec { part, parts: all, pass: Some(pass), ..spec.clone() }
            }
        }
    };
    let before = spec.pass.iter().flat_map(|pass| pass.before.clone()).collect();
    let finished = piece_of(range.from, *first, spec.part, before);
    run!(
        write,
        "UPDATE tasks SET spec = ?, share = ? WHERE id = ?",
        Json(&TaskSpec::RenderPart(finished)),
        share_of(0),
        row.task_id.0
    );
    let common = Common::read(write.connection().await?, row.job_id).await?;
    for ((ends, piece), part) in rest.ends.windows(2).zip(1..).zip(parts..all) {
        let spec = piece_of(ends[0], ends[1], part, vec![result.finished.hash()]);
        common.one_more_part(write, spec).await?;
        run!(
            write,
            "UPDATE tasks SET share = ? WHERE job_id = ? AND frame = ? AND kind = 'render_part' AND part = ?",
            share_of(piece),
            row.job_id.0,
            frame,
            part
        );
    }
    replans::want(write, &format!("a part of frame {frame} was divided again")).await
}
