//! Whether a result is one of the task that was handed out. What goes into a forecast or a plan has to make sense, so
//! it is refused here, with the place, rather than found out later.

use std::collections::BTreeSet;

use forelight_protocol::{
    AccuracyDoc, AllottedStats, CACHE_BYTES, CacheFillResult, CacheFillSpec, CacheMergeResult, CacheMode,
    CachePlanResult, CachePlanSpec, ImageError, LadderKind, LeftOut, NoiseCell, PreviewResult, PreviewSpec,
    ProcessCosts, ProfileResult, ProfileSpec, Quantiles, RenderResult, RenderSettings, RenderSpec, Spent,
    Stratum, TaskResult, TaskSpec,
};

use crate::error::{ApiError, ApiResult};

/// The largest number that the database and every JSON reader of ours can hold.
const LARGEST: u64 = i64::MAX as u64;

/// Checks a result against its task.
pub(super) fn check(spec: &TaskSpec, result: &TaskResult) -> ApiResult<()> {
    match (spec, result) {
        (TaskSpec::Preview(spec), TaskResult::Preview(result)) => preview(spec, result),
        (TaskSpec::Profile(spec), TaskResult::Profile(result)) => profile(spec, result),
        (TaskSpec::CachePlan(spec), TaskResult::CachePlan(result)) => cache_plan(spec, result),
        (TaskSpec::CacheFill(spec), TaskResult::CacheFill(result)) => cache_fill(spec, result),
        (TaskSpec::CacheMerge(_), TaskResult::CacheMerge(result)) => cache_merge(result),
        (TaskSpec::Render(spec), TaskResult::Render(result)) => render(spec, result),
        (spec, result) => wrong(
            "/result",
            format!("the task is a {}, the result is that of a {}", spec.kind(), result.kind()),
        ),
    }
}

fn wrong(pointer: impl Into<String>, reason: impl Into<String>) -> ApiResult<()> {
    Err(ApiError::invalid(pointer, reason))
}

fn preview(spec: &PreviewSpec, result: &PreviewResult) -> ApiResult<()> {
    const AT: &str = "/result/preview";
    strata(&format!("{AT}/strata"), &result.strata)?;
    prior_cost(&format!("{AT}/background_prior_cost"), result.background_prior_cost)?;
    if let Some(cost) = result.record_prior_cost {
        prior_cost(&format!("{AT}/record_prior_cost"), cost)?;
    }
    if result.frames.len() != spec.frames.len() {
        let reason = format!("{} frames; the task has {}", result.frames.len(), spec.frames.len());
        return wrong(format!("{AT}/frames"), reason);
    }
    for (i, (frame, &expected)) in result.frames.iter().zip(&spec.frames).enumerate() {
        if frame.frame != expected {
            return wrong(
                format!("{AT}/frames/{i}/frame"),
                format!("frame {}; the task has {expected} here", frame.frame),
            );
        }
        if frame.pixels.len() != result.strata.len() {
            let reason = format!("{} numbers for {} strata", frame.pixels.len(), result.strata.len());
            return wrong(format!("{AT}/frames/{i}/pixels"), reason);
        }
        let pixels: u64 =
            frame.pixels.iter().map(|&n| u64::from(n)).sum::<u64>() + u64::from(frame.background);
        if pixels != spec.settings.pixels() {
            let reason = format!("{pixels} pixels in all; the image has {}", spec.settings.pixels());
            return wrong(format!("{AT}/frames/{i}/pixels"), reason);
        }
        let (found, levels) = (frame.cache_records.len(), levels(&spec.settings));
        if found != levels {
            let reason = format!("records of {found} levels; the settings call for {levels}");
            return wrong(format!("{AT}/frames/{i}/cache_records"), reason);
        }
    }
    spent(&format!("{AT}/spent"), result.spent)
}

/// Levels of the irradiance cache that settings call for.
fn levels(settings: &RenderSettings) -> usize {
    match settings.cache {
        CacheMode::On => settings.ambient_bounces as usize,
        CacheMode::Off => 0,
    }
}

fn profile(spec: &ProfileSpec, result: &ProfileResult) -> ApiResult<()> {
    const AT: &str = "/result/profile";
    if result.frame != spec.frame {
        return wrong(
            format!("{AT}/frame"),
            format!("frame {}; the task is about {}", result.frame, spec.frame),
        );
    }
    strata(&format!("{AT}/strata"), &result.strata)?;
    if result.samples.is_empty() {
        return wrong(format!("{AT}/samples"), "no pixel was profiled");
    }
    let mut seen = BTreeSet::new();
    for (i, sample) in result.samples.iter().enumerate() {
        let at = format!("{AT}/samples/{i}");
        if u64::from(sample.pixel) >= spec.settings.pixels() {
            return wrong(at + "/pixel", format!("the image has {} pixels", spec.settings.pixels()));
        }
        if !seen.insert(sample.pixel) {
            return wrong(at + "/pixel", format!("pixel {} was given before", sample.pixel));
        }
        if sample.stratum as usize > result.strata.len() {
            return wrong(at + "/stratum", format!("there are {} strata", result.strata.len()));
        }
        if [sample.work, sample.cpu_nanos].iter().chain(&sample.rays).any(|&number| number > LARGEST) {
            return wrong(at, "a number is larger than 2⁶³ − 1");
        }
        let by_ray: u128 = sample.work_by_ray.iter().map(|&work| u128::from(work)).sum();
        if by_ray != 0 && by_ray != u128::from(sample.work) {
            let reason = format!("{by_ray} in all; the pixel's work is {}", sample.work);
            return wrong(at + "/work_by_ray", reason);
        }
    }
    let expected = if spec.cache.is_some() { result.samples.len() } else { 0 };
    if result.shared_samples.len() != expected {
        let reason =
            format!("{} samples; there are {expected} pixels to measure", result.shared_samples.len());
        return wrong(format!("{AT}/shared_samples"), reason);
    }
    for (i, sample) in result.shared_samples.iter().enumerate() {
        if [sample.work, sample.cpu_nanos].iter().chain(&sample.rays).any(|&number| number > LARGEST) {
            return wrong(format!("{AT}/shared_samples/{i}"), "a number is larger than 2⁶³ − 1");
        }
    }
    let levels = levels(&spec.settings);
    for (name, samples) in
        [("cache_samples", &result.cache_samples), ("shared_cache_samples", &result.shared_cache_samples)]
    {
        for (i, sample) in samples.iter().enumerate() {
            let at = format!("{AT}/{name}/{i}");
            if sample.level as usize >= levels {
                return wrong(at + "/level", format!("the settings call for {levels} levels"));
            }
            if [sample.work, sample.cpu_nanos].iter().chain(&sample.rays).any(|&number| number > LARGEST) {
                return wrong(at, "a number is larger than 2⁶³ − 1");
            }
        }
    }
    noise(&format!("{AT}/noise"), spec, &result.noise)?;
    effects(&format!("{AT}/effects"), &result.effects)?;
    left_out(&format!("{AT}/left_out"), &result.left_out)?;
    if result.renderer.as_ref().is_some_and(|name| !(1..=200).contains(&name.chars().count())) {
        return wrong(format!("{AT}/renderer"), "must have 1 to 200 characters");
    }
    let fixed = &result.fixed;
    for (name, cost) in
        [("load", fixed.load), ("build", fixed.build), ("plan", fixed.plan), ("write", fixed.write)]
    {
        spent(&format!("{AT}/fixed/{name}"), cost)?;
    }
    once(&format!("{AT}/once"), result.once)?;
    if let Some(document) = &result.ladders {
        ladders(&format!("{AT}/ladders"), spec, document)?;
    }
    if fixed.plan_rays.iter().any(|&number| number > LARGEST) {
        return wrong(format!("{AT}/fixed/plan_rays"), "a number is larger than 2⁶³ − 1");
    }
    spent(&format!("{AT}/spent"), result.spent)
}

fn cache_plan(spec: &CachePlanSpec, result: &CachePlanResult) -> ApiResult<()> {
    const AT: &str = "/result/cache_plan";
    let levels = levels(&spec.settings);
    let right = |at: String, found: usize| {
        if found == levels {
            return Ok(());
        }
        wrong(at, format!("records of {found} levels; the settings call for {levels}"))
    };
    right(format!("{AT}/records"), result.records.len())?;
    if result.cache.is_some() {
        cache_bytes(&format!("{AT}/bytes"), result.bytes)?;
    }
    if result.bytes > LARGEST {
        return wrong(format!("{AT}/bytes"), "a number is larger than 2⁶³ − 1");
    }
    if result.frames.len() != spec.frames.len() {
        let reason = format!("{} frames; the task has {}", result.frames.len(), spec.frames.len());
        return wrong(format!("{AT}/frames"), reason);
    }
    for (i, (frame, &expected)) in result.frames.iter().zip(&spec.frames).enumerate() {
        let at = format!("{AT}/frames/{i}");
        if frame.frame != expected {
            let reason = format!("frame {}; the task has {expected} here", frame.frame);
            return wrong(at + "/frame", reason);
        }
        right(format!("{at}/records"), frame.records.len())?;
        right(format!("{at}/own"), frame.own.len())?;
        if frame.own.iter().zip(&frame.records).any(|(own, all)| own > all) {
            return wrong(at + "/own", "more than all records of the frame");
        }
        if frame.dropped > LARGEST || frame.plan_rays.iter().any(|&number| number > LARGEST) {
            return wrong(at, "a number is larger than 2⁶³ − 1");
        }
        spent(&format!("{at}/plan"), frame.plan)?;
    }
    spent(&format!("{AT}/spent"), result.spent)
}

fn cache_fill(spec: &CacheFillSpec, result: &CacheFillResult) -> ApiResult<()> {
    const AT: &str = "/result/cache_fill";
    cache_bytes(&format!("{AT}/bytes"), result.bytes)?;
    if spec.parts == 1 && !result.full {
        return wrong(format!("{AT}/full"), "the only part of a cache fills all of it");
    }
    if result.filled > LARGEST {
        return wrong(format!("{AT}/filled"), "a number is larger than 2⁶³ − 1");
    }
    spent(&format!("{AT}/spent"), result.spent)
}

fn cache_merge(result: &CacheMergeResult) -> ApiResult<()> {
    cache_bytes("/result/cache_merge/bytes", result.bytes)?;
    spent("/result/cache_merge/spent", result.spent)
}

fn cache_bytes(pointer: &str, bytes: u64) -> ApiResult<()> {
    if bytes <= CACHE_BYTES {
        return Ok(());
    }
    wrong(pointer, format!("an irradiance cache has at most {CACHE_BYTES} bytes"))
}

/// Camera samples of a frame that was given its work.
fn samples_where_they_pay(spec: &RenderSpec, allotted: &AllottedStats) -> ApiResult<()> {
    const AT: &str = "/result/render/stats/allotted";
    if spec.work.is_none() {
        return wrong(AT, "the task has as many camera samples for every pixel");
    }
    let AllottedStats { least, most, mean, error, .. } = allotted;
    let (low, high) = (f64::from(*least), f64::from(*most));
    if *least == 0 || !(low..=high).contains(mean) {
        return wrong(
            format!("{AT}/mean"),
            "the mean lies between the least and the most, which are above 0",
        );
    }
    if !is_an_error(*error) {
        return wrong(format!("{AT}/error"), "errors are 0 or more");
    }
    Ok(())
}

fn render(spec: &RenderSpec, result: &RenderResult) -> ApiResult<()> {
    const AT: &str = "/result/render/stats";
    let stats = &result.stats;
    let settings = &spec.settings;
    if stats.frame != spec.frame {
        return wrong(
            format!("{AT}/frame"),
            format!("frame {}; the task is about {}", stats.frame, spec.frame),
        );
    }
    once(&format!("{AT}/once"), stats.once)?;
    stats.allotted.iter().try_for_each(|allotted| samples_where_they_pay(spec, allotted))?;
    let spp = stats.allotted.as_ref().map_or(settings.spp, |allotted| allotted.mean.round() as u32);
    for (name, actual, expected) in [
        ("width", stats.width, settings.width),
        ("height", stats.height, settings.height),
        ("spp", stats.spp, spp),
    ] {
        if actual != expected {
            return wrong(format!("{AT}/{name}"), format!("{actual}; the task has {expected}"));
        }
    }
    for (name, seconds) in [
        ("cpu_seconds", stats.cpu_seconds),
        ("wall_seconds", stats.wall_seconds),
        ("reused_cpu_seconds", stats.reused_cpu_seconds),
    ] {
        if !(0.0..=1e12).contains(&seconds) {
            return wrong(format!("{AT}/{name}"), "seconds are 0 or more");
        }
    }
    if u64::max(stats.work, stats.reused_work) > LARGEST || stats.rays.total() > LARGEST {
        return wrong(AT, "a number is larger than 2⁶³ − 1");
    }
    if stats.work_by_ray.is_some_and(|by_ray| by_ray.total() > stats.work) {
        return wrong(format!("{AT}/work_by_ray"), "more in all than the frame's whole work");
    }
    effects(&format!("{AT}/effects"), &stats.effects)?;
    left_out(&format!("{AT}/left_out"), &stats.left_out)?;
    if stats.cache_records.len() != levels(settings) {
        let (found, levels) = (stats.cache_records.len(), levels(settings));
        let reason = format!("records of {found} levels; the settings call for {levels}");
        return wrong(format!("{AT}/cache_records"), reason);
    }
    if stats.reused_pixels > settings.pixels() {
        return wrong(format!("{AT}/reused_pixels"), format!("the image has {} pixels", settings.pixels()));
    }
    if stats.reused_work > stats.work {
        return wrong(format!("{AT}/reused_work"), "more than the frame's whole work");
    }
    Ok(())
}

fn strata(pointer: &str, strata: &[Stratum]) -> ApiResult<()> {
    let mut seen = BTreeSet::new();
    for (i, stratum) in strata.iter().enumerate() {
        let (object, material) = stratum.identity();
        // The largest number stands for the background.
        for (name, number) in [("object", object), ("material", material)] {
            if number == u32::MAX {
                return wrong(format!("{pointer}/{i}/{name}"), format!("a scene has no {name} {number}"));
            }
        }
        if !seen.insert(stratum.identity()) {
            return wrong(
                format!("{pointer}/{i}"),
                format!("material {material} of object {object} was given before"),
            );
        }
        prior_cost(&format!("{pointer}/{i}/prior_cost"), stratum.prior_cost)?;
    }
    Ok(())
}

fn prior_cost(pointer: &str, cost: f64) -> ApiResult<()> {
    // Written so that a NaN, should one ever get here, is refused as well.
    if cost > 0.0 && cost <= Stratum::HIGHEST_PRIOR_COST {
        return Ok(());
    }
    wrong(pointer, format!("a prior cost is above 0 and at most {}", Stratum::HIGHEST_PRIOR_COST))
}

/// What says how noisy the image will be: numbers that can be added up, of pixels that the image has.
fn noise(pointer: &str, spec: &ProfileSpec, cells: &[NoiseCell]) -> ApiResult<()> {
    const DROPS: usize = 32;
    const HIGHEST: f32 = 1e30;
    let pixels: u64 = cells.iter().map(|cell| u64::from(cell.pixels)).sum();
    if !cells.is_empty() && pixels != spec.settings.pixels() {
        return wrong(pointer, format!("{pixels} pixels in all; the image has {}", spec.settings.pixels()));
    }
    for (i, cell) in cells.iter().enumerate() {
        if cell.samples.is_empty() {
            return wrong(format!("{pointer}/{i}/samples"), "none of the cell's pixels was sampled");
        }
        for (j, sample) in cell.samples.iter().enumerate() {
            let at = format!("{pointer}/{i}/samples/{j}");
            if !(0.0..=HIGHEST).contains(&sample.brightness) {
                return wrong(at + "/brightness", format!("it is 0 to {HIGHEST:e}"));
            }
            if sample.drops.is_empty() || sample.drops.len() > DROPS {
                return wrong(at + "/drops", format!("there are 1 to {DROPS}"));
            }
            if sample.drops.iter().any(|drop| !(0.0..=HIGHEST).contains(drop)) {
                return wrong(at + "/drops", format!("each is 0 to {HIGHEST:e}"));
            }
        }
    }
    Ok(())
}

/// Ladders are of the settings that were asked for, and priced by numbers that can be multiplied.
fn ladders(pointer: &str, spec: &ProfileSpec, document: &AccuracyDoc) -> ApiResult<()> {
    const HIGHEST: f64 = 1e30;
    if !spec.ladders {
        return wrong(pointer, "the task does not ask for them");
    }
    if document.settings != spec.settings {
        return wrong(format!("{pointer}/settings"), "they are not those of the task");
    }
    let ladder = |kind: LadderKind| forelight_quote::ladder(kind, &spec.settings).unwrap_or_default();
    let all = LadderKind::ALL.map(|kind| (kind, ladder(kind)));
    let mut seen = BTreeSet::new();
    for (i, rung) in document.rungs.iter().enumerate() {
        let at = format!("{pointer}/rungs/{i}");
        let place = all.iter().find(|(kind, _)| *kind == rung.ladder).and_then(|(kind, rungs)| {
            Some((*kind, rungs.iter().position(|settings| *settings == rung.settings)?))
        });
        if place.is_none_or(|place| !seen.insert(place)) {
            return wrong(
                at + "/settings",
                "a ladder around the task's settings has no such rung, or has it once",
            );
        }
        for (name, price) in [("work", rung.work), ("cpu_seconds", rung.cpu_seconds)] {
            let Quantiles { mean, p50, p80, p95 } = price;
            if ![mean, p50, p80, p95].iter().all(|number| (0.0..=HIGHEST).contains(number)) {
                return wrong(format!("{at}/{name}"), format!("each is 0 to {HIGHEST:e}"));
            }
        }
        if rung.error.is_some_and(|error| !is_an_error(error)) {
            return wrong(at + "/error", "errors are 0 or more");
        }
    }
    let reasons = document.missing.iter().map(|missing| missing.reason.len());
    if document.missing.len() > 100 || reasons.max().unwrap_or(0) > 4096 {
        return wrong(format!("{pointer}/missing"), "at most 100 entries, of at most 4096 bytes each");
    }
    // No rung is profiled by more pixels than the image has.
    let most = all.iter().map(|(_, rungs)| rungs.len() as u64).sum::<u64>() * spec.settings.pixels();
    if document.profiled.pixels > most {
        return wrong(format!("{pointer}/profiled/pixels"), format!("all rungs together have {most} pixels"));
    }
    if document.spent.work > LARGEST {
        return wrong(format!("{pointer}/spent/work"), "a number is larger than 2⁶³ − 1");
    }
    Ok(())
}

/// Whether an image can err so far.
fn is_an_error(ImageError { p05, p50, p80, p95 }: ImageError) -> bool {
    [p05, p50, p80, p95].iter().all(|error| (0.0..=1e12).contains(error))
}

/// Names of effects are shown to people, and kept with the job.
fn effects(pointer: &str, effects: &[String]) -> ApiResult<()> {
    if effects.len() <= 100 && effects.iter().all(|name| name.len() <= 100) {
        return Ok(());
    }
    wrong(pointer, "at most 100 names of at most 100 bytes each")
}

/// What was left out is shown to people, too.
fn left_out(pointer: &str, left_out: &[LeftOut]) -> ApiResult<()> {
    const LONGEST: usize = 4096;
    let fits = |left: &LeftOut| left.what.len() <= LONGEST && left.reason.len() <= LONGEST;
    if left_out.len() <= LeftOut::MOST && left_out.iter().all(fits) {
        return Ok(());
    }
    wrong(pointer, format!("at most {} entries, of at most {LONGEST} bytes each", LeftOut::MOST))
}

fn once(pointer: &str, costs: Option<ProcessCosts>) -> ApiResult<()> {
    let ProcessCosts { load, build } = costs.unwrap_or_default();
    spent(&format!("{pointer}/load"), load)?;
    spent(&format!("{pointer}/build"), build)
}

fn spent(pointer: &str, spent: Spent) -> ApiResult<()> {
    if u64::max(spent.work, spent.cpu_nanos) > LARGEST {
        return wrong(pointer, "a number is larger than 2⁶³ − 1");
    }
    Ok(())
}
