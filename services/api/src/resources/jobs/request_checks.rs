//! Checks of a job request. Each error names its field.

use forelight_protocol::{
    BadSetting, BundleSource, CacheMode, CacheSharing, Division, ErrorTarget, JobRequest, JobSettings,
    Ladders, MOST_PARTS, Money, OWN_RENDERER, PartCount, RenderSettings, RenderSettingsRequest, SceneSummary,
    Timestamp,
};
use forelight_store::tokens::Principal;
use forelight_store::{NewJob, StoreError};

use crate::bundle_inspection;
use crate::error::{ApiError, ApiResult};
use crate::resources::checks::{HIGHEST_SUM, check_name, within};
use crate::resources::videos::check_length;
use crate::state::App;

/// Latest deadline: ten years from now, in microseconds. It catches a wrong digit in the year.
const LATEST_DEADLINE: i64 = 3653 * 86_400_000_000;

pub(crate) async fn checked(app: &App, caller: &Principal, mut request: JobRequest) -> ApiResult<NewJob> {
    check_name("/name", &request.name, 200)?;
    check_name("/project", &request.project, 200)?;
    within("/samples", i64::from(request.samples), 16..=1_000_000)?;
    if let Some(frames) = request.profile_frames {
        within("/profile_frames", i64::from(frames), 1..=1000)?;
    }
    check_priority(request.priority)?;
    within("/weight", i64::from(request.weight), 1..=1000)?;
    if let Some(bytes) = request.limits.memory_bytes {
        within("/limits/memory_bytes", i64::try_from(bytes).unwrap_or(i64::MAX), 1 << 20..=1 << 50)?;
    }
    if let Some(millis) = request.limits.wall_ms {
        within("/limits/wall_ms", i64::try_from(millis).unwrap_or(i64::MAX), 1..=31 * 86_400_000)?;
    }
    if let Some(limit) = request.within {
        let amounts = [limit.cpu_micros, limit.money.map(Money::micro_units)];
        match amounts {
            [Some(micros), None] => within("/within/cpu_micros", micros, 1..=i64::MAX)?,
            [None, Some(money)] => within("/within/money", money, 1..=HIGHEST_SUM.micro_units())?,
            _ => return Err(ApiError::invalid("/within", "give exactly one of `cpu_micros` and `money`")),
        }
    }
    if let Some(target) = request.error_target {
        within("/error_target/ppm", i64::from(target.ppm), 1..=i64::from(ErrorTarget::MOST_PPM))?;
        if request.within.is_some() {
            let reason = "either a limit or an error sets the camera samples: leave out this or `within`";
            return Err(ApiError::invalid("/error_target", reason));
        }
    }
    check_terms(app, request.deadline, request.budget)?;
    let frames = request.frames.count();
    if frames > app.limits.frames {
        return Err(ApiError::invalid(
            "/frames",
            format!("{frames} frames; a job has at most {}", app.limits.frames),
        ));
    }
    check_delivery(app, caller, &request)?;
    if request.video.is_some() {
        check_length(frames, "/video")?;
    }
    if let Some(renderer) = &request.renderer {
        renderer
            .check()
            .map_err(|(field, reason)| ApiError::invalid(format!("/renderer/{field}"), reason))?;
        if renderer.name == OWN_RENDERER {
            let reason = "forelight's own renderer is used where none is named: leave out `renderer`";
            return Err(ApiError::invalid("/renderer/name", reason));
        }
        return other_renderer(app, caller, request).await;
    }
    check_settings(&request.settings)?;
    if request.cache == CacheSharing::Shared && request.settings.complete((1, 1)).cache == CacheMode::Off {
        let reason = "a cache cannot be shared where there is none: set `settings.cache` to `on`";
        return Err(ApiError::invalid("/cache", reason));
    }
    check_chosen_samples(&request)?;
    let (source, scene) = find_bundle(app, caller, &mut request).await?;
    if bundle_inspection::is_unknown(&scene) {
        let reason = "only another renderer can open this scene: name it in `renderer`";
        return Err(ApiError::invalid("/bundle", reason));
    }
    if request.frames.last() >= scene.frames {
        let reason = format!(
            "frame {} is asked for, the scene has frames 0 to {}",
            request.frames.last(),
            scene.frames.saturating_sub(1)
        );
        return Err(ApiError::invalid("/frames", reason));
    }
    let settings = request.settings.complete((scene.width, scene.height));
    check_size(app, &settings)?;
    Ok(NewJob { request, scene, source, settings: settings.into() })
}

/// Checks what cannot be combined with camera samples that are chosen for a limit or an error.
fn check_chosen_samples(request: &JobRequest) -> ApiResult<()> {
    let chosen_by = match (request.within, request.error_target) {
        (Some(_), _) => "within",
        (None, Some(_)) => "error_target",
        (None, None) => return Ok(()),
    };
    if request.cache == CacheSharing::Shared {
        let reason = format!(
            "frames whose camera samples differ make their own caches: leave out `cache` or `{chosen_by}`"
        );
        return Err(ApiError::invalid("/cache", reason));
    }
    if request.denoise {
        let reason = format!(
            "an image whose camera samples differ by pixel keeps its noise: leave out `denoise` or `{chosen_by}`"
        );
        return Err(ApiError::invalid("/denoise", reason));
    }
    if request.ladders == Ladders::All {
        let reason = format!(
            "camera samples are chosen here, not by what they cost: leave out `ladders` or `{chosen_by}`"
        );
        return Err(ApiError::invalid("/ladders", reason));
    }
    if request.error_target.is_some() && request.settings.spp.is_some_and(|spp| spp < LEAST_SPP_FOR_NOISE) {
        let reason = format!(
            "a profile shows the noise of an image from {LEAST_SPP_FOR_NOISE} camera samples on: leave this out"
        );
        return Err(ApiError::invalid("/settings/spp", reason));
    }
    Ok(())
}

/// Fewest camera samples of a profiled pixel that show how the image's error falls: two doublings.
const LEAST_SPP_FOR_NOISE: u32 = 4;

/// Where images go, and whether frames are divided, is checked for every renderer.
fn check_delivery(app: &App, caller: &Principal, request: &JobRequest) -> ApiResult<()> {
    if request.output.is_some() && app.output_root.is_none() {
        let reason =
            "the service has no output root: leave this out, or start the service with --output-root";
        return Err(ApiError::invalid("/output", reason));
    }
    if request
        .output
        .as_ref()
        .is_some_and(|output| !caller.reaches_all() && !output.is_of_project(&request.project))
    {
        let reason = "begin the pattern with {project}/, and name the project by letters, digits, `-`, `_`, `.` and \
                      spaces: this token reaches some projects only, and images must not replace those of others";
        return Err(ApiError::invalid("/output", reason));
    }
    if let Division::Into(PartCount(parts)) = request.division
        && !(2..=MOST_PARTS).contains(&parts)
    {
        return Err(ApiError::invalid(
            "/division/into",
            format!("{parts} parts; 2 to {MOST_PARTS} are possible"),
        ));
    }
    Ok(())
}

pub(super) fn check_priority(priority: i32) -> ApiResult<()> {
    within("/priority", i64::from(priority), -1000..=1000)
}

/// Checks a deadline and a budget.
pub(super) fn check_terms(app: &App, deadline: Option<Timestamp>, budget: Option<Money>) -> ApiResult<()> {
    if let Some(budget) = budget {
        within("/budget", budget.micro_units(), 0..=HIGHEST_SUM.micro_units())?;
    }
    let Some(deadline) = deadline else { return Ok(()) };
    let wrong = |reason: &str| ApiError::invalid("/deadline", format!("the deadline {deadline} {reason}"));
    match deadline.micros_since(app.now()) {
        ..=0 => Err(wrong("has passed")),
        LATEST_DEADLINE.. => Err(wrong("is more than ten years away")),
        _ => Ok(()),
    }
}

/// Checks a job of a renderer other than our own. Its scene is not opened here: the job's first task does
/// that.
async fn other_renderer(app: &App, caller: &Principal, mut request: JobRequest) -> ApiResult<NewJob> {
    let settings = request.settings.of_shot().map_err(bad_setting)?;
    if let Some(pixels) = settings.pixels().filter(|&pixels| pixels > app.limits.pixels) {
        let reason = format!("{pixels} pixels; an image has at most {}", app.limits.pixels);
        return Err(ApiError::invalid("/settings/width", reason));
    }
    let only_own = "only forelight's own renderer can do this: leave it out";
    for (field, is_given) in [
        ("/cache", request.cache == CacheSharing::Shared),
        ("/within", request.within.is_some()),
        ("/error_target", request.error_target.is_some()),
        ("/ladders", request.ladders == Ladders::All),
        ("/denoise", request.denoise),
    ] {
        if is_given {
            return Err(ApiError::invalid(field, only_own));
        }
    }
    let (source, scene) = match (&request.bundle.id, &request.bundle.path) {
        (Some(_), None) => {
            let (source, scene) = find_bundle(app, caller, &mut request).await?;
            if !bundle_inspection::is_unknown(&scene) {
                let reason = "forelight's own renderer renders this bundle: leave out `renderer`";
                return Err(ApiError::invalid("/bundle/id", reason));
            }
            (source, scene)
        }
        (None, Some(path)) => {
            let canonical = bundle_inspection::resolve(app, path).await?;
            let Some(text) = canonical.to_str().map(str::to_owned) else {
                return Err(ApiError::invalid("/bundle/path", "the path of a scene is UTF-8"));
            };
            let scene =
                bundle_inspection::unopened(canonical).await.map_err(|error| error.at("/bundle/path"))?;
            request.bundle.path = Some(text.clone());
            (BundleSource::Path(text), scene)
        }
        _ => return Err(ApiError::invalid("/bundle", "give exactly one of `id` and `path`")),
    };
    Ok(NewJob { request, scene, source, settings: JobSettings::Shot(settings) })
}

/// Checks everything that does not depend on the scene. The camera's size is checked once it is known.
fn check_settings(settings: &RenderSettingsRequest) -> ApiResult<()> {
    if !settings.own.is_empty() {
        let reason = "these are settings of another renderer: name it in `renderer`, or leave them out";
        return Err(ApiError::invalid("/settings/own", reason));
    }
    settings.complete((1, 1)).check().map_err(bad_setting)
}

fn bad_setting(BadSetting { name, reason }: BadSetting) -> ApiError {
    ApiError::invalid(format!("/settings/{name}"), reason)
}

fn check_size(app: &App, settings: &RenderSettings) -> ApiResult<()> {
    if settings.pixels() > app.limits.pixels {
        let reason = format!(
            "{} × {} pixels; an image has at most {} pixels",
            settings.width, settings.height, app.limits.pixels
        );
        return Err(ApiError::invalid("/settings/width", reason));
    }
    settings.check().map_err(bad_setting)
}

/// Finds the bundle and inspects it. A path is replaced by its canonical form.
async fn find_bundle(
    app: &App,
    caller: &Principal,
    request: &mut JobRequest,
) -> ApiResult<(BundleSource, SceneSummary)> {
    match (&request.bundle.id, &request.bundle.path) {
        (Some(id), None) if !app.store.sees_bundle(caller, *id).await? => {
            Err(ApiError::invalid("/bundle/id", "there is no such bundle"))
        }
        (Some(id), None) => match app.store.bundle(*id).await {
            Ok(bundle) => Ok((BundleSource::Artifact(bundle.hash), bundle.scene)),
            Err(StoreError::NotFound(_)) => Err(ApiError::invalid("/bundle/id", "there is no such bundle")),
            Err(error) => Err(error.into()),
        },
        (None, Some(path)) => {
            let canonical = bundle_inspection::resolve(app, path).await?;
            let Some(text) = canonical.to_str().map(str::to_owned) else {
                return Err(ApiError::invalid("/bundle/path", "the path of a bundle is UTF-8"));
            };
            let scene = bundle_inspection::inspect(app, canonical, path)
                .await
                .map_err(|error| error.at("/bundle/path"))?;
            request.bundle.path = Some(text.clone());
            Ok((BundleSource::Path(text), scene))
        }
        _ => Err(ApiError::invalid("/bundle", "give exactly one of `id` and `path`")),
    }
}
