//! Tasks of irradiance caches: plan, fill a part, merge parts.

use crate::shared_cache::{Filled, fill_part, plan_shared};
use crate::shot::OwnShot;
use crate::tasks::given::{of_given_cache, only_cache, unusable};
use forelight_protocol::{
    CacheFillResult, CacheFillSpec, CacheMergeResult, CacheMergeSpec, CachePlanSpec, LogLevel, Spent,
    TaskResult,
};
use forelight_renderer::{Assignment, Control, ExecuteError, Files, Outcome};
use forelight_tracer::{Cache, clocked};
use std::sync::atomic::{AtomicU64, Ordering};

pub(crate) fn plan(shot: &OwnShot, spec: &CachePlanSpec, control: &Control) -> Result<Outcome, ExecuteError> {
    let progress = |fraction| control.set_progress(fraction);
    let planned = plan_shared(shot, &spec.frames, &spec.settings, &progress, control.cancelled())?;
    if control.is_cancelled() {
        return Err(ExecuteError::Cancelled);
    }
    let Some(planned) = planned else {
        return Err(ExecuteError::Permanent("these settings need no irradiance cache".into()));
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

pub(crate) fn fill(
    shot: &OwnShot,
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
    let filled = fill_part(shot, cache, &spec.settings, part, &progress, control.cancelled());
    let Filled { cache, filled, spent } = filled.map_err(of_given_cache)?.ok_or(ExecuteError::Cancelled)?;
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

/// Merges the parts of a round and smooths full levels. Traces no light.
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
        whole.ok_or_else(|| ExecuteError::Permanent("the task names no cache parts to merge".into()))
    };
    let (whole, merging) = clocked(put_together);
    let whole = whole?;
    let before = whole.totals().fill.cpu_nanos;
    whole.smooth_full();
    let smoothing = whole.totals().fill.cpu_nanos - before;
    let ((full, bytes), writing) = clocked(|| (whole.is_complete(), whole.to_bytes()));
    let size = bytes.len() as u64;
    control.log(LogLevel::Info, format!("merged {} parts: {size} bytes", spec.parts.len()));
    let mut files = Files::default();
    let spent = Spent { work: 0, cpu_nanos: merging + smoothing + writing };
    let result = CacheMergeResult { cache: files.add(bytes), bytes: size, full, spent };
    Ok(Outcome { result: TaskResult::CacheMerge(result), artifacts: files.contents })
}

fn sum(records: &[u32]) -> u64 {
    records.iter().copied().map(u64::from).sum()
}
