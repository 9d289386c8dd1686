//! Checks that a result fits its task. Forecasts and plans depend on it, so nonsense is refused here.

mod division;
mod fields;
mod profile;
mod shot;

use forelight_protocol::{
    AllottedStats, CacheFillResult, CacheFillSpec, CacheMergeResult, CachePlanResult, CachePlanSpec,
    Capabilities, DenoisedStats, JobSettings, PreviewResult, PreviewSpec, RenderResult, RenderSpec,
    TaskResult, TaskSpec, VIDEO_BYTES, VideoResult, VideoSpec,
};

use self::fields::{
    cache_bytes, effects, frame, frame_count, image_error, left_out, once, prior_cost, record_levels, spent,
    storable, strata, wrong,
};
use crate::error::ApiResult;

pub(super) fn check(spec: &TaskSpec, result: &TaskResult) -> ApiResult<()> {
    match (spec, result) {
        (TaskSpec::Preview(spec), TaskResult::Preview(result)) => preview(spec, result),
        (TaskSpec::Profile(spec), TaskResult::Profile(result)) => match &spec.settings {
            JobSettings::Own(settings) => profile::check(spec, settings, result),
            JobSettings::Shot(settings) => profile::check_shot(spec, settings, result),
        },
        (TaskSpec::Profile(spec), TaskResult::Measured(result)) => shot::measured(spec, result),
        (TaskSpec::CachePlan(spec), TaskResult::CachePlan(result)) => cache_plan(spec, result),
        (TaskSpec::CacheFill(spec), TaskResult::CacheFill(result)) => cache_fill(spec, result),
        (TaskSpec::CacheMerge(_), TaskResult::CacheMerge(result)) => cache_merge(result),
        (TaskSpec::Divide(spec), TaskResult::Divide(result)) => division::divide(spec, result),
        (TaskSpec::RenderPart(spec), TaskResult::RenderPart(result)) => division::render_part(spec, result),
        (TaskSpec::Render(spec), TaskResult::Render(result)) => render(spec, result),
        (TaskSpec::Video(spec), TaskResult::Video(result)) => video(spec, result),
        (spec, result) => wrong(
            "/result",
            format!("this is the result of a {} task; the task is a {} task", result.kind(), spec.kind()),
        ),
    }
}

fn preview(spec: &PreviewSpec, result: &PreviewResult) -> ApiResult<()> {
    const AT: &str = "/result/preview";
    strata(&format!("{AT}/strata"), &result.strata)?;
    prior_cost(&format!("{AT}/background_prior_cost"), result.background_prior_cost)?;
    if let Some(cost) = result.record_prior_cost {
        prior_cost(&format!("{AT}/record_prior_cost"), cost)?;
    }
    shot::described(spec, result.described.as_deref())?;
    let image = match (&spec.settings, &result.described) {
        (JobSettings::Own(settings), _) => settings.pixels(),
        (JobSettings::Shot(_), described) => {
            described.as_ref().and_then(|described| described.settings.pixels()).unwrap_or(0)
        }
    };
    frame_count(&format!("{AT}/frames"), result.frames.len(), spec.frames.len())?;
    for (i, (seen, &expected)) in result.frames.iter().zip(&spec.frames).enumerate() {
        let at = format!("{AT}/frames/{i}");
        frame(&format!("{at}/frame"), seen.frame, expected)?;
        if seen.pixels.len() != result.strata.len() {
            let reason =
                format!("there are {} numbers for {} strata", seen.pixels.len(), result.strata.len());
            return wrong(at + "/pixels", reason);
        }
        let pixels: u64 = seen.pixels.iter().map(|&n| u64::from(n)).sum::<u64>() + u64::from(seen.background);
        if pixels != image {
            let reason = format!("the strata have {pixels} pixels; the image has {image}");
            return wrong(at + "/pixels", reason);
        }
        job_record_levels(&format!("{at}/cache_records"), &spec.settings, seen.cache_records.len())?;
    }
    spent(&format!("{AT}/spent"), result.spent)
}

fn job_record_levels(pointer: &str, settings: &JobSettings, found: usize) -> ApiResult<()> {
    match settings {
        JobSettings::Own(settings) => record_levels(pointer, settings, found),
        JobSettings::Shot(_) if found == 0 => Ok(()),
        JobSettings::Shot(_) => wrong(pointer, "another renderer's frames have no irradiance cache"),
    }
}

fn cache_plan(spec: &CachePlanSpec, result: &CachePlanResult) -> ApiResult<()> {
    const AT: &str = "/result/cache_plan";
    record_levels(&format!("{AT}/records"), &spec.settings, result.records.len())?;
    if result.cache.is_some() {
        cache_bytes(&format!("{AT}/bytes"), result.bytes)?;
    }
    storable(&format!("{AT}/bytes"), [result.bytes])?;
    frame_count(&format!("{AT}/frames"), result.frames.len(), spec.frames.len())?;
    for (i, (planned, &expected)) in result.frames.iter().zip(&spec.frames).enumerate() {
        let at = format!("{AT}/frames/{i}");
        frame(&format!("{at}/frame"), planned.frame, expected)?;
        record_levels(&format!("{at}/records"), &spec.settings, planned.records.len())?;
        record_levels(&format!("{at}/own"), &spec.settings, planned.own.len())?;
        if planned.own.iter().zip(&planned.records).any(|(own, all)| own > all) {
            return wrong(at + "/own", "a level has more own records than records");
        }
        storable(&at, planned.plan_rays.into_iter().chain([planned.dropped]))?;
        spent(&format!("{at}/plan"), planned.plan)?;
    }
    spent(&format!("{AT}/spent"), result.spent)
}

fn cache_fill(spec: &CacheFillSpec, result: &CacheFillResult) -> ApiResult<()> {
    const AT: &str = "/result/cache_fill";
    cache_bytes(&format!("{AT}/bytes"), result.bytes)?;
    if spec.parts == 1 && !result.full {
        return wrong(
            format!("{AT}/full"),
            "the cache has one part, so it is full after this; the result says that it is not",
        );
    }
    storable(&format!("{AT}/filled"), [result.filled])?;
    spent(&format!("{AT}/spent"), result.spent)
}

fn cache_merge(result: &CacheMergeResult) -> ApiResult<()> {
    cache_bytes("/result/cache_merge/bytes", result.bytes)?;
    spent("/result/cache_merge/spent", result.spent)
}

fn video(spec: &VideoSpec, result: &VideoResult) -> ApiResult<()> {
    const AT: &str = "/result/video";
    let VideoResult { file, spent: cost, peak_memory_bytes } = result;
    frame_count(&format!("{AT}/file/frames"), file.frames as usize, spec.pictures.len())?;
    if !(1..=VIDEO_BYTES).contains(&file.bytes) {
        let reason = format!("{} bytes; a video has 1 to {VIDEO_BYTES}", file.bytes);
        return wrong(format!("{AT}/file/bytes"), reason);
    }
    storable(&format!("{AT}/peak_memory_bytes"), [*peak_memory_bytes])?;
    spent(&format!("{AT}/spent"), *cost)
}

fn samples_where_they_pay(spec: &RenderSpec, allotted: &AllottedStats) -> ApiResult<()> {
    const AT: &str = "/result/render/stats/allotted";
    if spec.work.is_none() {
        return wrong(AT, "the task takes the same number of camera samples in every pixel; leave this out");
    }
    let AllottedStats { least, most, mean, error, .. } = allotted;
    let (low, high) = (f64::from(*least), f64::from(*most));
    if *least == 0 || !(low..=high).contains(mean) {
        return wrong(
            format!("{AT}/mean"),
            "the mean is not between the least and the most number of samples, or the least is 0",
        );
    }
    image_error(&format!("{AT}/error"), *error)?;
    match spec.error_target {
        Some(target) if !target.is_met(error, *most) => {
            let reason = format!(
                "the error is {:.6} of the mean; the task asks for {:.6}: this worker may be too old for error targets",
                error.at(target.confidence),
                target.share()
            );
            wrong(format!("{AT}/error"), reason)
        }
        _ => Ok(()),
    }
}

/// What is said of removing the noise of an image of so many pixels.
fn denoised(pointer: &str, spec: &RenderSpec, stats: Option<&DenoisedStats>, pixels: u64) -> ApiResult<()> {
    let stats = match (spec.denoise, stats) {
        (false, None) => return Ok(()),
        (false, Some(_)) => return wrong(pointer, "the task leaves the noise in its image"),
        (true, None) => {
            return wrong(
                pointer,
                "the task removes the noise of its image: say how, and what is left of it",
            );
        }
        (true, Some(stats)) => stats,
    };
    if !(1..=Capabilities::LONGEST_VERSION).contains(&stats.by.chars().count()) {
        return wrong(format!("{pointer}/by"), "the denoiser and its version: 1 to 50 characters");
    }
    image_error(&format!("{pointer}/error"), stats.error)?;
    image_error(&format!("{pointer}/noisy"), stats.noisy)?;
    if stats.measured_pixels > pixels {
        let reason = format!("{} pixels; the image has {pixels}", stats.measured_pixels);
        return wrong(format!("{pointer}/measured_pixels"), reason);
    }
    seconds(
        pointer,
        [
            ("denoiser_cpu_seconds", stats.denoiser_cpu_seconds),
            ("features_cpu_seconds", stats.features_cpu_seconds),
            ("measuring_cpu_seconds", stats.measuring_cpu_seconds),
        ],
    )
}

/// Times in seconds, by name.
fn seconds<const N: usize>(pointer: &str, times: [(&str, f64); N]) -> ApiResult<()> {
    match times.iter().find(|(_, seconds)| !(0.0..=1e12).contains(seconds)) {
        Some((name, _)) => wrong(format!("{pointer}/{name}"), "seconds are 0 to 1e12"),
        None => Ok(()),
    }
}

fn render(spec: &RenderSpec, result: &RenderResult) -> ApiResult<()> {
    const AT: &str = "/result/render/stats";
    let stats = &result.stats;
    let settings = &spec.settings;
    let Some(((width, height), samples)) = settings.size().zip(settings.samples()) else {
        return wrong(AT, "the task's settings are not complete, so nothing can be rendered");
    };
    let pixels = u64::from(width) * u64::from(height);
    frame(&format!("{AT}/frame"), stats.frame, spec.frame)?;
    once(&format!("{AT}/once"), stats.once)?;
    if spec.work.is_some() && stats.allotted.is_none() {
        return wrong(format!("{AT}/allotted"), "the task's camera samples differ by pixel: say how");
    }
    denoised(&format!("{AT}/denoised"), spec, stats.denoised.as_ref(), pixels)?;
    stats.allotted.iter().try_for_each(|allotted| samples_where_they_pay(spec, allotted))?;
    let spp = stats.allotted.as_ref().map_or(samples, |allotted| allotted.mean.round() as u32);
    for (name, actual, expected) in
        [("width", stats.width, width), ("height", stats.height, height), ("spp", stats.spp, spp)]
    {
        if actual != expected {
            return wrong(
                format!("{AT}/{name}"),
                format!("the result has {actual}; the task has {expected}"),
            );
        }
    }
    seconds(
        AT,
        [
            ("cpu_seconds", stats.cpu_seconds),
            ("wall_seconds", stats.wall_seconds),
            ("reused_cpu_seconds", stats.reused_cpu_seconds),
        ],
    )?;
    storable(AT, [stats.work, stats.reused_work, stats.rays.total()])?;
    if stats.work_by_ray.is_some_and(|by_ray| by_ray.total() > stats.work) {
        return wrong(format!("{AT}/work_by_ray"), "the sum is more than the frame's work");
    }
    effects(&format!("{AT}/effects"), &stats.effects)?;
    left_out(&format!("{AT}/left_out"), &stats.left_out)?;
    job_record_levels(&format!("{AT}/cache_records"), settings, stats.cache_records.len())?;
    if stats.reused_pixels > pixels {
        let reason = format!("{} pixels; the image has {pixels}", stats.reused_pixels);
        return wrong(format!("{AT}/reused_pixels"), reason);
    }
    if stats.reused_work > stats.work {
        return wrong(format!("{AT}/reused_work"), "this is more than the frame's work");
    }
    Ok(())
}
