//! Execution of each kind of task: previews and profiles here, irradiance caches in `cache`, renders in
//! `render`, divided frames in `divide`, `part` and `whole`. What they are given is in `given`, what they say
//! of their progress in `progress`.

pub(crate) mod cache;
mod checkpoint;
mod divide;
mod given;
mod part;
mod pass;
mod progress;
pub(crate) mod render;
mod whole;

use self::given::own;
use self::progress::{Reporting, fraction};
use self::render::render;
use crate::accuracy::{AccuracyOptions, DenoiseBy, Pilot, predict};
use crate::adaptive::allotment::Allotment;
use crate::adaptive::error_target::ErrorAim;
use crate::answers::Progress;
use crate::error::{RenderError, ShotError};
use crate::frame::OwnFrame;
use crate::opening::OwnRenderer;
use crate::profile::{count_frames, profile_ready};
use crate::quote_options::QuoteOptions;
use crate::render::pictures::{encoding_cost, png, write_cost};
use crate::results::{preview_result, profile_result};
use crate::shared_cache::profile_shared;
use crate::shot::OwnShot;
use forelight_denoise::Denoiser;
use forelight_protocol::{
    AccuracyDoc, LadderKind, LogLevel, PreviewSpec, ProfileArtifacts, ProfileSpec, Spent, SpentOnForecast,
    TaskResult, TaskSpec,
};
use forelight_quote::{is_own, without_ladders};
use forelight_renderer::process::Sandbox;
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Files, OpenShots, Outcome, with_run};
use std::cell::Cell;
use std::sync::Arc;

/// Executes tasks. All workers of a process share one runner, and so its open shots.
pub struct TaskRunner {
    renderer: OwnRenderer,
    shots: OpenShots<OwnShot>,
    denoising: Option<Denoising>,
}

impl TaskRunner {
    /// A runner that opens bundles with `renderer`, and cannot remove noise.
    pub fn new(renderer: OwnRenderer) -> Self {
        Self { renderer, shots: OpenShots::default(), denoising: None }
    }

    /// With what removes noise on this machine, if anything does.
    #[must_use]
    pub fn with_denoising(self, denoising: Option<Denoising>) -> Self {
        Self { denoising, ..self }
    }

    /// What removes the noise of a task's image.
    fn denoising(&self) -> Result<&Denoising, ExecuteError> {
        let missing = "this worker has no Open Image Denoise; install it, and start the worker again";
        self.denoising.as_ref().ok_or_else(|| ExecuteError::Transient(missing.to_owned()))
    }
}

/// What removes noise on this machine.
#[derive(Debug)]
pub struct Denoising {
    /// The program.
    pub denoiser: Denoiser,
    /// CPU time that it takes for a pixel, nanoseconds.
    pub nanos_per_pixel: u64,
    /// In which it runs. `None`: with the rights of this process.
    pub sandbox: Option<Arc<Sandbox>>,
}

impl Execute for TaskRunner {
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        let loading = Cell::new(Spent::default());
        let load = || {
            let shot = self.renderer.open(&assignment.bundle)?;
            loading.set(shot.loading());
            Ok::<_, RenderError>(Arc::new(shot))
        };
        let no_scene = || ExecuteError::Permanent("the task has no scene".to_owned());
        let source = assignment.spec.bundle().ok_or_else(no_scene)?;
        let shot = self.shots.open(source, &assignment.bundle, load)?;
        let shot = &*shot;
        // A bundle on shared storage may have changed. The quote would be wrong, and frames would not match.
        let (submitted, found) = (assignment.spec.digest().ok_or_else(no_scene)?, shot.info().summary.digest);
        if found != submitted {
            return Err(ExecuteError::Permanent(format!(
                "the bundle has changed since the job was submitted (digest {submitted}, now {found}): submit the job again"
            )));
        }
        let scene = &shot.info().summary;
        control.log(
            LogLevel::Info,
            format!("scene {} with {} triangles in {} objects", scene.name, scene.triangles, scene.objects),
        );
        match &assignment.spec {
            TaskSpec::Preview(spec) => preview(shot, spec, control),
            TaskSpec::Profile(spec) => {
                let denoising = spec.denoise.then(|| self.denoising()).transpose()?;
                profile(shot, spec, denoising, assignment, control)
            }
            TaskSpec::CachePlan(spec) => cache::plan(shot, spec, control),
            TaskSpec::CacheFill(spec) => cache::fill(shot, spec, assignment, control),
            TaskSpec::CacheMerge(spec) => cache::merge(spec, assignment, control),
            TaskSpec::Divide(spec) => divide::divide(shot, spec, loading.get(), assignment, control),
            TaskSpec::RenderPart(spec) => part::render_part(shot, spec, loading.get(), assignment, control),
            TaskSpec::Render(spec) => {
                let denoising = spec.denoise.then(|| self.denoising()).transpose()?;
                render(shot, spec, denoising, assignment, control)
            }
            TaskSpec::Video(_) => Err(no_scene()),
        }
    }
}

fn preview(shot: &OwnShot, spec: &PreviewSpec, control: &Control) -> Result<Outcome, ExecuteError> {
    let settings = own(&spec.settings)?;
    let counted = count_frames(shot, &spec.frames, settings, &Reporting::all(control))?;
    let result = preview_result(shot.info(), &spec.frames, settings, &counted);
    control.log(LogLevel::Info, format!("previewed {} frames", result.frames.len()));
    Ok(Outcome { result: TaskResult::Preview(result), artifacts: Vec::new() })
}

fn profile(
    shot: &OwnShot,
    spec: &ProfileSpec,
    denoising: Option<&Denoising>,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let settings = own(&spec.settings)?;
    let options = QuoteOptions {
        samples: spec.samples,
        seed: spec.phase_seed,
        denoiser_nanos_per_pixel: denoising.map(|denoising| denoising.nanos_per_pixel),
        scans: true,
        ..QuoteOptions::default()
    };
    let share = if spec.ladders { WITHOUT_LADDERS } else { 1.0 };
    let ready = shot.frame(spec.frame, settings)?;
    // The noise of an image shows in its final colours.
    let fills = spec.error_target.is_some() && !ready.has_final_colours();
    let filled = if fills { fill(&ready, control)? } else { Spent::default() };
    let reporting = Reporting { control, from: if fills { FILLED } else { 0.0 }, to: share };
    let (mut profiled, seen) = profile_ready(&ready, &shot.info().strata, settings, &options, &reporting)?;
    let (encoding, file_bytes) = encoding_cost(&profiled)?;
    profiled.fixed.write = write_cost(encoding, profiled.preview);
    let mut files = Files::default();
    let artifacts = ProfileArtifacts {
        profile: files.add(profiled.profile.to_bytes()),
        preview_png: Some(files.add(png(&profiled.picture)?)),
    };
    let mut result = profile_result(shot.info(), settings, &profiled, artifacts);
    result.spent.cpu_nanos += encoding;
    if let Some(target) = spec.error_target {
        let pilot = Pilot::of(shot, &ready, settings.clone(), &profiled, &seen);
        let needed = Allotment::new(&pilot)?.samples_for_error(target.share(), ErrorAim::FIRST.into());
        result.samples_for_error = Some(needed);
        if fills {
            result.spent = result.spent.plus(filled).less(profiled.spent_on_deepest_records());
        }
    }
    result.file_bytes = file_bytes;
    if spec.cache.is_some() {
        let cache = given::only_cache(assignment)?;
        profile_shared(shot, &profiled, settings, &options, cache)
            .map_err(given::of_given_cache)?
            .add_to(&mut result);
    }
    if spec.ladders {
        let ladders = ladders(shot, spec, (!result.noise.is_empty(), denoising), assignment, control)?;
        let SpentOnForecast { work, cpu_seconds, .. } = ladders.spent;
        result.spent = result.spent.plus(Spent { work, cpu_nanos: (cpu_seconds * 1e9).round() as u64 });
        result.ladders = Some(Box::new(ladders));
    }
    Ok(Outcome { result: TaskResult::Profile(result), artifacts: files.contents })
}

/// Fills the irradiance cache of a frame, if it has one. Returns the cost, without that of the plan.
fn fill(ready: &OwnFrame<'_>, control: &Control) -> Result<Spent, ExecuteError> {
    let progress = |progress: Progress| control.set_progress(FILLED * fraction(progress, false));
    if !ready.fill(&progress, control.cancelled()) {
        return Err(ExecuteError::Cancelled);
    }
    Ok(ready.spent_on_cache().less(ready.fixed().plan))
}

/// Share of a profile task's progress at which its cache is filled, if it fills one.
const FILLED: f64 = 0.8;

/// Share of a profile task's progress before its ladders, which take longer.
const WITHOUT_LADDERS: f64 = 0.2;

/// The ladders that the frame's profile does not give by itself. If they fail, the profile is still valid.
fn ladders(
    shot: &OwnShot,
    spec: &ProfileSpec,
    (knows_error, denoising): (bool, Option<&Denoising>),
    assignment: &Assignment,
    control: &Control,
) -> Result<AccuracyDoc, ExecuteError> {
    // At resolutions that the profile can price, the error is that of the settings asked for.
    let settings = own(&spec.settings)?;
    let told = |kind: LadderKind| is_own(kind, settings) && (knows_error || kind == LadderKind::Resolution);
    // What a denoiser leaves follows from no profile.
    let is_wanted = |kind: &LadderKind| denoising.is_some() || !told(*kind);
    let wanted: Vec<LadderKind> = LadderKind::ALL.into_iter().filter(is_wanted).collect();
    let reporting = Reporting { control, from: WITHOUT_LADDERS, to: 1.0 };
    let predicted = |denoise: Option<DenoiseBy<'_>>| {
        let options = AccuracyOptions { samples: spec.samples, seed: spec.phase_seed, denoise };
        predict(shot, spec.frame, settings, &wanted, &options, &reporting)
    };
    let predicted = match denoising {
        None => predicted(None),
        Some(&Denoising { ref denoiser, nanos_per_pixel, ref sandbox }) => {
            with_run(assignment, control, sandbox.as_deref(), |run| {
                Ok(predicted(Some(DenoiseBy { denoiser, nanos_per_pixel, run })))
            })?
        }
    };
    match predicted {
        Ok(ladders) => {
            control.log(LogLevel::Info, format!("predicted ladders of {} qualities", ladders.rungs.len()));
            Ok(ladders)
        }
        Err(ShotError::Cancelled) => Err(ExecuteError::Cancelled),
        Err(error) => {
            control.log(LogLevel::Warn, format!("ladders of qualities cannot be predicted: {error}"));
            Ok(without_ladders(spec.frame, settings, &error.to_string()))
        }
    }
}

impl From<RenderError> for ExecuteError {
    fn from(error: RenderError) -> Self {
        if error.is_permanent() {
            Self::Permanent(error.to_string())
        } else {
            Self::Transient(error.to_string())
        }
    }
}

impl From<ShotError> for ExecuteError {
    fn from(error: ShotError) -> Self {
        match error {
            ShotError::Render(error) => error.into(),
            ShotError::Forecast(error) => Self::Permanent(error.to_string()),
            ShotError::Quote(error) => Self::Permanent(error.to_string()),
            ShotError::Cancelled => Self::Cancelled,
        }
    }
}
