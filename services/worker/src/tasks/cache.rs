//! The tasks that make the irradiance cache which the frames of a job share: plan, fill a part, put parts together.

use crate::agent::execute::{Assignment, Control, ExecuteError, Outcome};
use crate::renderer::{RenderError, Renderer};
use crate::shared_cache::{Filled, fill_part, plan_shared};
use crate::tasks::Files;
use bytes::Bytes;
use forelight_protocol::{
    CacheFillResult, CacheFillSpec, CacheMergeResult, CacheMergeSpec, CachePlanSpec, LogLevel, Spent,
    TaskResult,
};
use forelight_tracer::{Cache, CacheError, clocked};
use std::sync::atomic::{AtomicU64, Ordering};

/// Plans the cache of a shot, and what each frame makes of it.
pub(crate) fn plan(
    renderer: &dyn Renderer,
    spec: &CachePlanSpec,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let progress = |fraction| control.set_progress(fraction);
    let planned = plan_shared(renderer, &spec.frames, &spec.settings, &progress, control.cancelled())?;
    if control.is_cancelled() {
        return Err(ExecuteError::Cancelled);
    }
    let Some(planned) = planned else {
        return Err(ExecuteError::Permanent("these settings have no use for an irradiance cache".into()));
    };
    let mut files = Files::default();
    let result = planned.result(|bytes| files.add(bytes));
    control.log(
        LogLevel::Info,
        format!(
            "planned {} records for {} frames: {} bytes",
            sum(&result.records),
            spec.frames.len(),
            result.bytes
        ),
    );
    Ok(Outcome { result: TaskResult::CachePlan(result), artifacts: files.contents })
}

/// Fills a part of the cache of a shot.
pub(crate) fn fill(
    renderer: &dyn Renderer,
    spec: &CacheFillSpec,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let cache = only_cache(assignment)?;
    // Threads report in any order.
    let most = AtomicU64::new(0);
    let progress = |done: u64, all: u64| {
        let done = done.max(most.fetch_max(done, Ordering::Relaxed));
        let share = all.div_ceil(u64::from(spec.parts)).max(1);
        control.set_progress(done as f64 / share as f64);
    };
    let part = (spec.part, spec.parts);
    let filled = fill_part(renderer, cache, &spec.settings, part, &progress, control.cancelled());
    let Filled { cache, filled, spent } = filled.map_err(of_shared_cache)?.ok_or(ExecuteError::Cancelled)?;
    control.log(
        LogLevel::Info,
        format!("part {} of {}: {filled} records, {} operations", spec.part + 1, spec.parts, spent.work),
    );
    let (full, bytes) = (cache.is_complete(), cache.to_bytes());
    let mut files = Files::default();
    let size = bytes.len() as u64;
    let result = CacheFillResult { cache: files.add(bytes), bytes: size, filled, full, spent };
    Ok(Outcome { result: TaskResult::CacheFill(result), artifacts: files.contents })
}

/// Puts the parts of a round together, and smooths what is full. No light is traced.
pub(crate) fn merge(
    spec: &CacheMergeSpec,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let put_together = || {
        let mut whole: Option<Cache> = None;
        for (bytes, done) in assignment.caches.iter().zip(1..) {
            let part = Cache::from_bytes(bytes).map_err(unusable)?;
            match &mut whole {
                None => whole = Some(part),
                Some(whole) => whole.merge(&part).map_err(unusable)?,
            }
            if control.is_cancelled() {
                return Err(ExecuteError::Cancelled);
            }
            control.set_progress(f64::from(done) / spec.parts.len() as f64);
        }
        whole.ok_or_else(|| ExecuteError::Permanent("there are no parts to put together".into()))
    };
    let (whole, merging) = clocked(put_together);
    let whole = whole?;
    let before = whole.totals().fill.cpu_nanos;
    whole.smooth_full();
    let smoothing = whole.totals().fill.cpu_nanos - before;
    let ((full, bytes), writing) = clocked(|| (whole.is_complete(), whole.to_bytes()));
    let size = bytes.len() as u64;
    control.log(LogLevel::Info, format!("{} parts put together: {size} bytes", spec.parts.len()));
    let mut files = Files::default();
    let spent = Spent { work: 0, cpu_nanos: merging + smoothing + writing };
    let result = CacheMergeResult { cache: files.add(bytes), bytes: size, full, spent };
    Ok(Outcome { result: TaskResult::CacheMerge(result), artifacts: files.contents })
}

/// The one cache that a task was given.
pub(crate) fn only_cache(assignment: &Assignment) -> Result<Cache, ExecuteError> {
    Cache::from_bytes(only_file(assignment)?).map_err(unusable)
}

/// The same as a file.
pub(crate) fn only_file(assignment: &Assignment) -> Result<&Bytes, ExecuteError> {
    match assignment.caches.as_slice() {
        [bytes] => Ok(bytes),
        others => {
            Err(ExecuteError::Transient(format!("{} irradiance caches where one was expected", others.len())))
        }
    }
}

/// What goes wrong with a cache that is shared.
pub(crate) fn of_shared_cache(error: RenderError) -> ExecuteError {
    match error {
        RenderError::Cache(error) => unusable(error),
        other => other.into(),
    }
}

/// A file that is damaged is damaged for everyone: it came under its own hash. One that another version of the renderer made may be right
/// for another worker.
fn unusable(error: CacheError) -> ExecuteError {
    let text = format!("the shot's irradiance cache cannot be used: {error}");
    match error {
        CacheError::Length { .. } | CacheError::Damaged(_) => ExecuteError::Permanent(text),
        CacheError::Foreign | CacheError::OtherScene(_) | CacheError::OtherPlan => {
            ExecuteError::Transient(text)
        }
    }
}

fn sum(records: &[u32]) -> u64 {
    records.iter().copied().map(u64::from).sum()
}
