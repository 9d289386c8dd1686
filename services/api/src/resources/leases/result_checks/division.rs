//! Results of divided frames.

use forelight_protocol::{
    DivideResult, DivideSpec, FinishedPart, MOST_PARTS, PartPixels, PartRange, RenderPartResult,
    RenderPartSpec, RestOfPart, SampleShare,
};

use super::fields::{cache_bytes, spent, storable, wrong};
use crate::error::ApiResult;

/// The parts cover the frame once, in their order.
pub(super) fn divide(spec: &DivideSpec, result: &DivideResult) -> ApiResult<()> {
    const AT: &str = "/result/divide";
    let is_over =
        spec.passes.as_ref().is_some_and(|passes| !passes.before.is_empty()) && result.ends.is_empty();
    if result.samples.is_some() != (spec.passes.is_some() && !is_over) {
        let reason =
            "there are samples for a pass exactly if the frame is rendered in passes, and one is left";
        return wrong(format!("{AT}/samples"), reason);
    }
    let parts = if is_over { 0 } else { spec.parts as usize };
    for (name, found) in [("ends", result.ends.len()), ("work", result.work.len())] {
        if found != parts {
            return wrong(format!("{AT}/{name}"), format!("there are {found} numbers for {parts} parts"));
        }
    }
    if !result.ends.is_sorted() {
        return wrong(format!("{AT}/ends"), "a part ends before the one that it follows");
    }
    let (last, pixels) = (result.ends.last().copied().map(u64::from), spec.settings.pixels());
    if last != Some(pixels) && !is_over {
        let reason = format!("the last part ends at pixel {}; the image has {pixels}", last.unwrap_or(0));
        return wrong(format!("{AT}/ends"), reason);
    }
    storable(&format!("{AT}/work"), result.work.iter().copied())?;
    if let Some(cache) = &result.cache {
        if spec.frame_cache.is_some() && !cache.full {
            return wrong(format!("{AT}/cache/full"), "the frame's irradiance cache was full before");
        }
        cache_bytes(&format!("{AT}/cache/bytes"), cache.bytes)?;
    }
    spent(&format!("{AT}/spent"), result.spent)
}

/// The part has what its task asks for.
pub(super) fn render_part(spec: &RenderPartSpec, result: &RenderPartResult) -> ApiResult<()> {
    const AT: &str = "/result/render_part";
    match (spec.assigned_range(), &result.finished) {
        (Some(PartRange::Pixels(range)), FinishedPart::Pixels(PartPixels { count, cost, .. })) => {
            let most = range.to.saturating_sub(range.from);
            if *count > most {
                let reason = format!("there are {count} pixels; the part has {most}");
                return wrong(format!("{AT}/finished/pixels/count"), reason);
            }
            spent(&format!("{AT}/finished/pixels/cost"), *cost)?;
        }
        (Some(PartRange::Samples(range)), FinishedPart::Samples(share)) => {
            let &SampleShare { offset, count, cpu_nanos, .. } = share;
            if (offset, count) != (range.offset, range.count) {
                let reason = format!(
                    "these are samples {offset} to {}; the part has {} to {}",
                    u64::from(offset) + u64::from(count),
                    range.offset,
                    range.offset + range.count
                );
                return wrong(format!("{AT}/finished/samples"), reason);
            }
            storable(&format!("{AT}/finished/samples/cpu_nanos"), [cpu_nanos])?;
        }
        _ => return wrong(format!("{AT}/finished"), "the part is divided in another way"),
    }
    if let Some(left) = &result.rest {
        rest(spec, &result.finished, left)?;
    }
    storable(&format!("{AT}/peak_memory_bytes"), [result.peak_memory_bytes])?;
    spent(&format!("{AT}/spent"), result.spent)
}

/// The pieces cover the part once.
fn rest(spec: &RenderPartSpec, finished: &FinishedPart, rest: &RestOfPart) -> ApiResult<()> {
    const AT: &str = "/result/render_part/rest";
    let RestOfPart { ends, work } = rest;
    let (Some(PartRange::Pixels(range)), FinishedPart::Pixels(_)) = (spec.assigned_range(), finished) else {
        return wrong(AT.to_owned(), "only a part of a frame's pixels can be divided again");
    };
    if !(2..=MOST_PARTS as usize).contains(&ends.len()) || work.len() != ends.len() {
        let (ends, work) = (ends.len(), work.len());
        return wrong(
            format!("{AT}/ends"),
            format!("there are {ends} ends and {work} numbers of work; 2 to {MOST_PARTS} are possible"),
        );
    }
    if !ends.is_sorted() || ends[0] < range.from || ends.last() != Some(&range.to) {
        let reason = format!("they must ascend from {} or more to {}", range.from, range.to);
        return wrong(format!("{AT}/ends"), reason);
    }
    storable(&format!("{AT}/work"), work.iter().copied())
}
