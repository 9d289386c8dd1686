//! Adds the samples of one pass to the pixels of one part of a frame.

use super::checkpoint::Checkpoints;
use super::given;
use super::part::{Made, left_to_others};
use super::progress::fraction;
use crate::answers::{Progress, Step};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use forelight_protocol::{FinishedPixels, LogLevel, PixelRange, Spent};
use forelight_renderer::{Assignment, Control, ExecuteError};
use forelight_tracer::{Advanced, Passes, SampleCounts, Totals, Unfinished, clocked};
use std::sync::atomic::{AtomicU64, Ordering};

/// What an earlier worker added is not traced again. When the rest is to be left to others, no further pixels
/// are begun: the file has the samples so far of all pixels, so that others continue each of them.
pub(super) fn pass(
    ready: &OwnFrame<'_>,
    (range, part): (PixelRange, &[u32]),
    on_cache: Spent,
    assignment: &Assignment,
    control: &Control,
) -> Result<Made, ExecuteError> {
    let samples = assignment.samples.as_ref().map(|bytes| SampleCounts::from_bytes(bytes));
    let no_samples = || ExecuteError::Transient("the numbers of samples were expected".to_owned());
    let samples = samples.ok_or_else(no_samples)?.map_err(RenderError::from)?;
    let mut passes = ready.begin_pixels(part);
    given::take_over(&mut passes, ready, assignment, control)?;
    let before = passes.totals();
    let checkpoint = assignment.checkpoint.as_ref().map(|bytes| ready.unfinished(bytes));
    let checkpoint = checkpoint.and_then(|found| match found {
        Ok(found) => Some(found),
        Err(why) => {
            control.log(LogLevel::Warn, format!("an earlier worker's samples cannot be used: {why}"));
            None
        }
    });
    let kept = checkpoint.clone().unwrap_or_else(|| ready.so_far(&ready.begin_pixels(&[])));
    passes.take_over(checkpoint.map(Ok::<_, ExecuteError>), Some(&samples))?;
    let fills = !ready.has_final_colours();
    let progress = |progress: Progress| control.set_progress(fraction(progress, fills));
    if !ready.fill(&progress, control.cancelled()) {
        return Err(ExecuteError::Cancelled);
    }
    control.spent_before_pixels(ready.spent_on_cache_here(on_cache));
    let all = part.len() as u64;
    let found = passes.totals().minus(&before);
    control.finished_pixels(FinishedPixels { done: 0, all, work: found.work, cpu_nanos: found.cpu_nanos });
    let checkpoints = Checkpoints::new(control, Some(kept), Unfinished::bytes_of(all));
    let so_far = AtomicU64::new(0);
    let advanced = |advanced: &Advanced<'_>| {
        let Totals { pixels: done, work, cpu_nanos, .. } = advanced.cost;
        control.finished_pixels(FinishedPixels { done, all, work, cpu_nanos });
        checkpoints.add(|file| advanced.add_to(file));
        let done = so_far.fetch_add(done, Ordering::Relaxed) + done;
        progress(Progress { step: Step::Tracing, done, all });
    };
    let enough = || control.is_cancelled() || control.rest_in_parts().is_some();
    ready.advance(&mut passes, &samples, &enough, &advanced)?;
    if control.is_cancelled() {
        return Err(ExecuteError::Cancelled);
    }
    let Totals { work, cpu_nanos, .. } = passes.totals().minus(&before);
    let asked = control.rest_in_parts();
    let left = asked.and_then(|parts| unfinished(&passes, &samples, part).map(|done| (done, parts)));
    let rest = left.map(|(done, parts)| {
        // A part has at most as many pixels as an image.
        let first = range.from + done as u32;
        let (pieces, cpu_nanos) = clocked(|| ready.divide_pass(&passes, &samples, first..range.to, parts));
        (left_to_others(first, work, &pieces, control), Spent { work: 0, cpu_nanos })
    });
    let (file, writing) = clocked(|| ready.so_far(&passes).to_bytes());
    let count = left.map_or(all, |(done, _)| done as u64);
    Ok(Made { file, count, cost: Spent { work, cpu_nanos }, writing, rest })
}

/// How many pixels of the part come before the first that has not all samples of the pass. `None` if all have.
fn unfinished(passes: &Passes, wanted: &SampleCounts, part: &[u32]) -> Option<usize> {
    let (wanted, so_far) = (wanted.as_slice(), passes.so_far());
    part.iter().position(|&pixel| so_far[pixel as usize].samples < u32::from(wanted[pixel as usize]))
}
