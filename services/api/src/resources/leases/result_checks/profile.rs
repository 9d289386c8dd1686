//! Checks that a profile fits its task.

use std::collections::BTreeSet;

use forelight_protocol::{
    AccuracyDoc, ErrorTarget, LadderKind, NoiseCell, ProfileResult, ProfileSpec, Quantiles, RenderSettings,
    RendererId, SamplesForError, ShotSettings,
};

use super::fields::{effects, frame, image_error, left_out, levels, once, spent, storable, strata, wrong};
use crate::error::ApiResult;

const AT: &str = "/result/profile";

pub(super) fn check(spec: &ProfileSpec, settings: &RenderSettings, result: &ProfileResult) -> ApiResult<()> {
    frame(&format!("{AT}/frame"), result.frame, spec.frame)?;
    strata(&format!("{AT}/strata"), &result.strata)?;
    samples(settings.pixels(), result)?;
    shared_samples(spec, result)?;
    cache_samples(settings, result)?;
    noise(&format!("{AT}/noise"), settings, &result.noise)?;
    effects(&format!("{AT}/effects"), &result.effects)?;
    left_out(&format!("{AT}/left_out"), &result.left_out)?;
    if result.renderer.as_ref().is_some_and(|name| !(1..=200).contains(&name.chars().count())) {
        return wrong(format!("{AT}/renderer"), "a renderer's name has 1 to 200 characters");
    }
    if result.file_bytes.is_some_and(|bytes| bytes > 1 << 40) {
        return wrong(format!("{AT}/file_bytes"), "the files of a frame have at most 2⁴⁰ bytes");
    }
    let fixed = &result.fixed;
    for (name, cost) in [
        ("load", fixed.load),
        ("build", fixed.build),
        ("plan", fixed.plan),
        ("write", fixed.write),
        ("denoise", fixed.denoise),
    ] {
        spent(&format!("{AT}/fixed/{name}"), cost)?;
    }
    once(&format!("{AT}/once"), result.once)?;
    samples_for_error(spec, result)?;
    if let Some(document) = &result.ladders {
        ladders(&format!("{AT}/ladders"), (spec, settings), document)?;
    }
    storable(&format!("{AT}/fixed/plan_rays"), fixed.plan_rays)?;
    spent(&format!("{AT}/spent"), result.spent)
}

/// The same for pixels of another renderer, whose profiles have nothing else.
pub(super) fn check_shot(
    spec: &ProfileSpec,
    settings: &ShotSettings,
    result: &ProfileResult,
) -> ApiResult<()> {
    let Some(asked) = &spec.renderer else { return wrong(AT, "the task names no renderer") };
    frame(&format!("{AT}/frame"), result.frame, spec.frame)?;
    strata(&format!("{AT}/strata"), &result.strata)?;
    samples(settings.pixels().unwrap_or(0), result)?;
    let found = result.renderer.as_deref().unwrap_or_default();
    let (name, version) = found.split_once(' ').unwrap_or((found, ""));
    let id = RendererId { name: name.to_owned(), version: version.to_owned() };
    if id.check().is_err() || !asked.allows(&id) {
        return wrong(format!("{AT}/renderer"), format!("this is `{found}`; the task is for {asked}"));
    }
    for (name, is_there) in [
        ("uncovered", result.uncovered.is_some()),
        ("shared_samples", !result.shared_samples.is_empty()),
        ("cache_samples", !result.cache_samples.is_empty()),
        ("shared_cache_samples", !result.shared_cache_samples.is_empty()),
        ("noise", !result.noise.is_empty()),
        ("effects", !result.effects.is_empty()),
        ("left_out", !result.left_out.is_empty()),
        ("work_by_class", result.work_by_class.is_some()),
        ("once", result.once.is_some()),
        ("ladders", result.ladders.is_some()),
        ("samples_for_error", result.samples_for_error.is_some()),
    ] {
        if is_there {
            return wrong(format!("{AT}/{name}"), "only forelight's own renderer has this; leave it out");
        }
    }
    spent(&format!("{AT}/fixed/build"), result.fixed.build)?;
    spent(&format!("{AT}/spent"), result.spent)
}

/// Checks the profiled pixels: each lies in the image, appears once, and has numbers that can be stored.
fn samples(pixels: u64, result: &ProfileResult) -> ApiResult<()> {
    if result.samples.is_empty() {
        return wrong(format!("{AT}/samples"), "a profile has 1 pixel or more");
    }
    let mut seen = BTreeSet::new();
    for (i, sample) in result.samples.iter().enumerate() {
        let at = format!("{AT}/samples/{i}");
        if u64::from(sample.pixel) >= pixels {
            let reason = format!("there is no pixel {}; the image has {pixels}", sample.pixel);
            return wrong(at + "/pixel", reason);
        }
        if !seen.insert(sample.pixel) {
            return wrong(at + "/pixel", format!("pixel {} is in the list twice", sample.pixel));
        }
        if sample.stratum as usize > result.strata.len() {
            let reason =
                format!("there is no stratum {}; the profile has {}", sample.stratum, result.strata.len());
            return wrong(at + "/stratum", reason);
        }
        storable(&at, [sample.work, sample.cpu_nanos].into_iter().chain(sample.rays))?;
        let by_ray: u128 = sample.work_by_ray.iter().map(|&work| u128::from(work)).sum();
        if by_ray != 0 && by_ray != u128::from(sample.work) {
            let reason = format!("the sum is {by_ray}; the pixel's work is {}", sample.work);
            return wrong(at + "/work_by_ray", reason);
        }
    }
    Ok(())
}

fn samples_for_error(spec: &ProfileSpec, result: &ProfileResult) -> ApiResult<()> {
    let at = format!("{AT}/samples_for_error");
    match (spec.error_target, result.samples_for_error) {
        (None, None) => Ok(()),
        (None, Some(_)) => wrong(at, "the task has no error target; leave this out"),
        (Some(_), None) => wrong(at, "the task has an error target: say how many samples reach it"),
        (Some(_), Some(SamplesForError { p50, p80, p95 })) => {
            if 1.0 <= p50 && p50 <= p80 && p80 <= p95 && p95 <= f64::from(ErrorTarget::MOST_SAMPLES) {
                return Ok(());
            }
            wrong(at, format!("the quantiles do not ascend from 1 to {}", ErrorTarget::MOST_SAMPLES))
        }
    }
}

fn shared_samples(spec: &ProfileSpec, result: &ProfileResult) -> ApiResult<()> {
    let at = format!("{AT}/shared_samples");
    let expected = if spec.cache.is_some() { result.samples.len() } else { 0 };
    if result.shared_samples.len() != expected {
        let reason = format!(
            "there are {} pixels with the shared cache; the task calls for {expected}",
            result.shared_samples.len()
        );
        return wrong(at, reason);
    }
    for (i, sample) in result.shared_samples.iter().enumerate() {
        storable(&format!("{at}/{i}"), [sample.work, sample.cpu_nanos].into_iter().chain(sample.rays))?;
    }
    Ok(())
}

/// Checks sampled records of irradiance caches: their levels must exist.
fn cache_samples(settings: &RenderSettings, result: &ProfileResult) -> ApiResult<()> {
    let levels = levels(settings);
    for (name, samples) in
        [("cache_samples", &result.cache_samples), ("shared_cache_samples", &result.shared_cache_samples)]
    {
        for (i, sample) in samples.iter().enumerate() {
            let at = format!("{AT}/{name}/{i}");
            if sample.level as usize >= levels {
                let reason =
                    format!("there is no cache level {}; the settings call for {levels}", sample.level);
                return wrong(at + "/level", reason);
            }
            storable(&at, [sample.work, sample.cpu_nanos].into_iter().chain(sample.rays))?;
        }
    }
    Ok(())
}

/// Checks the noise cells: their numbers can be summed, and their pixels lie in the image.
fn noise(pointer: &str, settings: &RenderSettings, cells: &[NoiseCell]) -> ApiResult<()> {
    const DROPS: usize = 32;
    const HIGHEST: f32 = 1e30;
    let pixels: u64 = cells.iter().map(|cell| u64::from(cell.pixels)).sum();
    if !cells.is_empty() && pixels != settings.pixels() {
        let reason = format!("the cells have {pixels} pixels; the image has {}", settings.pixels());
        return wrong(pointer, reason);
    }
    for (i, cell) in cells.iter().enumerate() {
        if cell.samples.is_empty() {
            return wrong(format!("{pointer}/{i}/samples"), "a cell has 1 sampled pixel or more");
        }
        for (j, sample) in cell.samples.iter().enumerate() {
            let at = format!("{pointer}/{i}/samples/{j}");
            if !(0.0..=HIGHEST).contains(&sample.brightness) {
                return wrong(at + "/brightness", format!("a brightness is 0 to {HIGHEST:e}"));
            }
            if sample.drops.is_empty() || sample.drops.len() > DROPS {
                return wrong(at + "/drops", format!("a pixel has 1 to {DROPS} drops of variance"));
            }
            if sample.drops.iter().any(|drop| !(0.0..=HIGHEST).contains(drop)) {
                return wrong(at + "/drops", format!("a drop of variance is 0 to {HIGHEST:e}"));
            }
        }
    }
    Ok(())
}

/// Checks ladders: they belong to the requested settings, and their prices can be multiplied.
fn ladders(
    pointer: &str,
    (spec, settings): (&ProfileSpec, &RenderSettings),
    document: &AccuracyDoc,
) -> ApiResult<()> {
    const HIGHEST: f64 = 1e30;
    if !spec.ladders {
        return wrong(pointer, "the task does not ask for ladders; leave them out");
    }
    if document.settings != *settings {
        return wrong(format!("{pointer}/settings"), "these are not the settings of the task");
    }
    let all = LadderKind::ALL.map(|kind| (kind, forelight_quote::ladder(kind, settings).unwrap_or_default()));
    let mut seen = BTreeSet::new();
    for (i, rung) in document.rungs.iter().enumerate() {
        let at = format!("{pointer}/rungs/{i}");
        let place = all.iter().find(|(kind, _)| *kind == rung.ladder).and_then(|(kind, rungs)| {
            Some((*kind, rungs.iter().position(|settings| *settings == rung.settings)?))
        });
        if place.is_none_or(|place| !seen.insert(place)) {
            let reason = "a ladder around the task's settings has no rung of these settings, or it is in the list twice";
            return wrong(at + "/settings", reason);
        }
        for (name, price) in [("work", rung.work), ("cpu_seconds", rung.cpu_seconds)] {
            let Quantiles { mean, p50, p80, p95 } = price;
            if ![mean, p50, p80, p95].iter().all(|number| (0.0..=HIGHEST).contains(number)) {
                return wrong(format!("{at}/{name}"), format!("each number is 0 to {HIGHEST:e}"));
            }
        }
        rung.error.map_or(Ok(()), |error| image_error(&format!("{at}/error"), error))?;
        match rung.denoised_error {
            Some(_) if !spec.denoise => {
                return wrong(at + "/denoised_error", "the task does not ask for denoising; leave it out");
            }
            Some(error) => image_error(&format!("{at}/denoised_error"), error)?,
            None => {}
        }
    }
    let reasons = document.missing.iter().map(|missing| missing.reason.len());
    if document.missing.len() > 100 || reasons.max().unwrap_or(0) > 4096 {
        let reason = "there are at most 100 entries, each of at most 4096 bytes";
        return wrong(format!("{pointer}/missing"), reason);
    }
    // No rung profiles more pixels than the image has.
    let most = all.iter().map(|(_, rungs)| rungs.len() as u64).sum::<u64>() * settings.pixels();
    if document.profiled.pixels > most {
        return wrong(format!("{pointer}/profiled/pixels"), format!("all rungs together have {most} pixels"));
    }
    storable(&format!("{pointer}/spent/work"), [document.spent.work])
}
