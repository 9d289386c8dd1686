//! Checks of results of other renderers.

use forelight_protocol::{Described, FixedPart, MeasuredFrame, PreviewSpec, ProfileSpec};

use super::fields::{frame, spent, storable, wrong};
use crate::error::ApiResult;
use crate::resources::checks::check_name;

/// Most measured costs of a frame.
const MOST_COSTS: usize = 1000;
/// Most shares of a frame's samples.
const MOST_SHARES: usize = 100;
/// Most parts of the fixed costs, and characters of a name.
const MOST_FIXED: usize = 20;
const LONGEST_FIXED: usize = 50;
/// Most notes about a scene, and characters of each.
const MOST_NOTES: usize = 100;
const LONGEST_NOTE: usize = 1000;

/// What a renderer found in the scene: there must be something exactly if another renderer was asked.
pub(super) fn described(spec: &PreviewSpec, found: Option<&Described>) -> ApiResult<()> {
    const AT: &str = "/result/preview/described";
    let (asked, found) = match (&spec.renderer, found) {
        (None, None) => return Ok(()),
        (None, Some(_)) => return wrong(AT, "the task is for forelight's own renderer: leave this out"),
        (Some(asked), None) => return wrong(AT, format!("{asked} has to say what is in the scene")),
        (Some(asked), Some(found)) => (asked, found),
    };
    if let Err((field, reason)) = found.renderer.check() {
        return wrong(format!("{AT}/renderer/{field}"), reason);
    }
    if !asked.allows(&found.renderer) {
        return wrong(
            format!("{AT}/renderer"),
            format!("this is {}; the task is for {asked}", found.renderer),
        );
    }
    if found.scene.digest != spec.digest {
        return wrong(format!("{AT}/scene/digest"), "the task is about another version of the scene");
    }
    for (name, value) in [
        ("width", found.settings.width),
        ("height", found.settings.height),
        ("samples", found.settings.samples),
    ] {
        if !value.is_some_and(|value| (1..=65_536).contains(&value)) {
            return wrong(format!("{AT}/settings/{name}"), "it is 1 to 65536, and never absent here");
        }
    }
    if found.notes.len() > MOST_NOTES || found.notes.iter().any(|note| note.chars().count() > LONGEST_NOTE) {
        let reason = format!("at most {MOST_NOTES} notes of {LONGEST_NOTE} characters each");
        return wrong(format!("{AT}/notes"), reason);
    }
    storable(AT, [found.scene.objects, found.scene.materials, found.scene.triangles])
}

/// A frame at few samples.
pub(super) fn measured(spec: &ProfileSpec, result: &MeasuredFrame) -> ApiResult<()> {
    const AT: &str = "/result/measured";
    let Some(asked) = &spec.renderer else {
        return wrong(AT, "the task is for forelight's own renderer");
    };
    frame(&format!("{AT}/frame"), result.frame, spec.frame)?;
    if !asked.allows(&result.renderer) {
        return wrong(
            format!("{AT}/renderer"),
            format!("this is {}; the task is for {asked}", result.renderer),
        );
    }
    let mut amounts: Vec<u32> = result.costs.iter().map(|cost| cost.amount).collect();
    amounts.sort_unstable();
    amounts.dedup();
    if amounts.len() < 2 || result.costs.len() > MOST_COSTS {
        let reason = format!("costs of two different amounts at least, and at most {MOST_COSTS} costs");
        return wrong(format!("{AT}/costs"), reason);
    }
    storable(&format!("{AT}/costs"), result.costs.iter().map(|cost| cost.cpu_nanos))?;
    fixed_parts(&format!("{AT}/fixed"), &result.fixed)?;
    storable(&format!("{AT}/strata"), result.strata.iter().map(|time| time.nanos))?;
    shares(spec, result)?;
    storable(&format!("{AT}/peak_memory_bytes"), [result.peak_memory_bytes])?;
    spent(&format!("{AT}/spent"), result.spent)
}

fn fixed_parts(pointer: &str, parts: &[FixedPart]) -> ApiResult<()> {
    if parts.len() > MOST_FIXED {
        return wrong(pointer, format!("{} parts; there are at most {MOST_FIXED}", parts.len()));
    }
    for (i, part) in parts.iter().enumerate() {
        check_name(&format!("{pointer}/{i}/name"), &part.name, LONGEST_FIXED)?;
    }
    storable(pointer, parts.iter().map(|part| part.cpu_nanos))
}

/// Shares of the samples: one after the other, from the first sample on, not more than the frame has.
fn shares(spec: &ProfileSpec, result: &MeasuredFrame) -> ApiResult<()> {
    const AT: &str = "/result/measured/shares";
    if result.shares.len() > MOST_SHARES {
        return wrong(AT, format!("{} shares; there are at most {MOST_SHARES}", result.shares.len()));
    }
    let all = spec.settings.samples().unwrap_or(0);
    let mut end = 0u32;
    for (i, share) in result.shares.iter().enumerate() {
        let next = share.offset.checked_add(share.count);
        match next.filter(|&next| share.offset == end && share.count > 0 && next <= all) {
            Some(next) => end = next,
            None => {
                let reason =
                    format!("shares follow each other from sample 0 on; the frame has {all} samples");
                return wrong(format!("{AT}/{i}"), reason);
            }
        }
    }
    storable(AT, result.shares.iter().map(|share| share.cpu_nanos))
}
