//! Execution of each kind of task: previews and profiles here, the shared cache in `cache`, renders in
//! `render`.

pub(crate) mod cache;
mod checkpoint;
pub(crate) mod render;

use self::render::render;
use crate::accuracy::{AccuracyObserver, AccuracyOptions, predict};
use crate::answers::ShotInfo;
use crate::error::RenderError;
use crate::open_shots::OpenShots;
use crate::opening::OwnRenderer;
use crate::opening::uncovered_gathers;
use crate::profile::noise::noise_strata;
use crate::profile::{
    CountedFrames, Observer, ProfiledFrame, ShotError, count_frames, forecast_strata, profile_frame,
    record_prior_cost,
};
use crate::quote::QuoteOptions;
use crate::render::pictures::{encoding_nanos, png, write_cost};
use crate::shared_cache::{cache_sample, profile_shared};
use crate::shot::OwnShot;
use bytes::Bytes;
use forelight_forecast::Observation;
use forelight_forecast::accuracy::PixelNoise;
use forelight_protocol::{
    AccuracyDoc, ArtifactHash, FrameStrata, LadderKind, LogLevel, NoiseCell, NoiseSample, PreviewResult,
    PreviewSpec, ProfileArtifacts, ProfileResult, ProfileSample, ProfileSpec, RenderSettings, Spent,
    SpentOnForecast, Stratum, TaskResult, TaskSpec,
};
use forelight_quote::{is_own, without_ladders};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome};
use forelight_tracer::Pixel;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Executes tasks with the bundles of a library.
#[derive(Debug, Clone)]
pub struct TaskRunner {
    shots: Arc<OpenShots>,
}

impl TaskRunner {
    /// A runner that opens bundles with `renderer`.
    pub fn new(renderer: OwnRenderer) -> Self {
        Self { shots: Arc::new(OpenShots::new(renderer)) }
    }
}

impl Execute for TaskRunner {
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        let shot = self.shots.open(assignment.spec.bundle(), &assignment.bundle)?;
        let shot = &*shot;
        // A bundle on shared storage may have changed. The quote would be wrong, and frames would not match.
        let (submitted, found) = (assignment.spec.digest(), shot.info().summary.digest);
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
            TaskSpec::Profile(spec) => profile(shot, spec, assignment, control),
            TaskSpec::CachePlan(spec) => cache::plan(shot, spec, control),
            TaskSpec::CacheFill(spec) => cache::fill(shot, spec, assignment, control),
            TaskSpec::CacheMerge(spec) => cache::merge(spec, assignment, control),
            TaskSpec::Render(spec) => render(shot, spec, assignment, control),
        }
    }
}

fn preview(shot: &OwnShot, spec: &PreviewSpec, control: &Control) -> Result<Outcome, ExecuteError> {
    let counted = count_frames(shot, &spec.frames, &spec.settings, &Reporting::all(control))?;
    let result = preview_result(shot.info(), &spec.frames, &spec.settings, &counted);
    control.log(LogLevel::Info, format!("previewed {} frames", result.frames.len()));
    Ok(Outcome { result: TaskResult::Preview(result), artifacts: Vec::new() })
}

/// Counts of frames as protocol data, with the strata that any of them shows.
pub fn preview_result(
    info: &ShotInfo,
    frames: &[u32],
    settings: &RenderSettings,
    counted: &CountedFrames,
) -> PreviewResult {
    let background = info.strata.len();
    let seen = |stratum: usize| counted.counts.iter().any(|counts| counts[stratum] > 0);
    let shown = Shown::new(info, settings, (0..background).filter(|&stratum| seen(stratum)));
    let frames = frames.iter().enumerate().map(|(at, &frame)| FrameStrata {
        frame,
        pixels: shown.strata.iter().map(|&stratum| counted.counts[at][stratum]).collect(),
        background: counted.counts[at][background],
        cache_records: counted.cache_records[at].clone(),
        cache_plan: counted.cache_plans[at],
        lights: counted.lights[at],
        shining: counted.shining[at],
        triangles: counted.triangles[at],
        preview_png: None,
    });
    PreviewResult {
        frames: frames.collect(),
        background_prior_cost: shown.background_prior_cost,
        record_prior_cost: record_prior_cost(settings),
        strata: shown.list,
        backend: counted.backend,
        spent: counted.spent,
    }
}

fn profile(
    shot: &OwnShot,
    spec: &ProfileSpec,
    assignment: &Assignment,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let options = QuoteOptions { samples: spec.samples, seed: spec.phase_seed, ..QuoteOptions::default() };
    let share = if spec.ladders { WITHOUT_LADDERS } else { 1.0 };
    let reporting = Reporting { control, from: 0.0, to: share };
    let mut profiled = profile_frame(shot, spec.frame, &spec.settings, &options, &reporting)?;
    let encoding = encoding_nanos(&profiled)?;
    profiled.fixed.write = write_cost(encoding, profiled.preview);
    let mut files = Files::default();
    let artifacts = ProfileArtifacts {
        profile: files.add(profiled.profile.to_bytes()),
        preview_png: Some(files.add(png(&profiled.picture)?)),
    };
    let mut result = profile_result(shot.info(), &spec.settings, &profiled, artifacts);
    result.spent.cpu_nanos += encoding;
    if spec.cache.is_some() {
        let cache = cache::only_cache(assignment)?;
        profile_shared(shot, &profiled, &spec.settings, &options, cache)
            .map_err(cache::of_shared_cache)?
            .add_to(&mut result);
    }
    if spec.ladders {
        let ladders = ladders(shot, spec, !result.noise.is_empty(), control)?;
        let SpentOnForecast { work, cpu_seconds, .. } = ladders.spent;
        result.spent = result.spent.plus(Spent { work, cpu_nanos: (cpu_seconds * 1e9).round() as u64 });
        result.ladders = Some(Box::new(ladders));
    }
    Ok(Outcome { result: TaskResult::Profile(result), artifacts: files.contents })
}

/// Share of a profile task's progress before its ladders, which take longer.
const WITHOUT_LADDERS: f64 = 0.2;

/// The ladders that the frame's profile does not give by itself. If they fail, the profile is still valid.
fn ladders(
    shot: &OwnShot,
    spec: &ProfileSpec,
    knows_error: bool,
    control: &Control,
) -> Result<AccuracyDoc, ExecuteError> {
    // At resolutions that the profile can price, the error is that of the settings asked for.
    let told =
        |kind: LadderKind| is_own(kind, &spec.settings) && (knows_error || kind == LadderKind::Resolution);
    let wanted: Vec<LadderKind> = LadderKind::ALL.into_iter().filter(|kind| !told(*kind)).collect();
    let options = AccuracyOptions { samples: spec.samples, seed: spec.phase_seed };
    let reporting = Reporting { control, from: WITHOUT_LADDERS, to: 1.0 };
    match predict(shot, spec.frame, &spec.settings, &wanted, &options, &reporting) {
        Ok(ladders) => {
            control.log(LogLevel::Info, format!("predicted ladders of {} qualities", ladders.rungs.len()));
            Ok(ladders)
        }
        Err(ShotError::Cancelled) => Err(ExecuteError::Cancelled),
        Err(error) => {
            control.log(LogLevel::Warn, format!("ladders of qualities cannot be predicted: {error}"));
            Ok(without_ladders(spec.frame, &spec.settings, &error.to_string()))
        }
    }
}

/// A profiled frame as protocol data, with the strata that were sampled.
pub fn profile_result(
    info: &ShotInfo,
    settings: &RenderSettings,
    profiled: &ProfiledFrame,
    artifacts: ProfileArtifacts,
) -> ProfileResult {
    let sampled = profiled.shown.iter().map(|&stratum| stratum as usize);
    let shown = Shown::new(info, settings, sampled.filter(|&stratum| stratum < info.strata.len()));
    let sample = |((&(index, pixel), observation), &stratum): ((&(u32, Pixel), &Observation), &u32)| {
        let cost = observation.cost;
        ProfileSample {
            pixel: index,
            stratum: shown.place(stratum as usize),
            work: cost.work,
            extra_work: pixel.extra_work,
            work_by_ray: pixel.work_by_ray,
            cpu_nanos: cost.cpu_nanos,
            rays: cost.rays,
        }
    };
    // Pixels after the observed ones were traced for their time only.
    let samples =
        profiled.traced.iter().zip(&profiled.observations).zip(&profiled.shown).map(sample).collect();
    ProfileResult {
        frame: profiled.frame,
        samples,
        uncovered: uncovered_gathers(settings),
        shared_samples: Vec::new(),
        cache_samples: profiled.records.iter().map(cache_sample).collect(),
        shared_cache_samples: Vec::new(),
        noise: noise_cells(info, settings, profiled),
        effects: profiled.effects.clone(),
        left_out: profiled.left_out.clone(),
        renderer: Some(info.renderer.clone()),
        work_by_class: profiled.work_by_class,
        fixed: profiled.fixed,
        once: Some(profiled.once),
        ladders: None,
        spent: profiled.spent(),
        strata: shown.list,
        artifacts,
    }
}

/// Noise of the profiled pixels, as protocol data.
fn noise_cells(info: &ShotInfo, settings: &RenderSettings, profiled: &ProfiledFrame) -> Vec<NoiseCell> {
    let Some(noise) = profiled.noise.as_ref().filter(|noise| noise.is_known()) else { return Vec::new() };
    let strata = noise_strata(&info.strata, settings);
    // The strata are the frame's own, so they match.
    let cells = noise.cells(&strata, &noise.counts).unwrap_or_default();
    // Seven digits are enough for an estimate from few pixels.
    let sample = |sample: PixelNoise| NoiseSample {
        brightness: sample.brightness as f32,
        drops: sample.drops.into_iter().map(|drop| drop as f32).collect(),
    };
    cells
        .into_iter()
        .map(|cell| NoiseCell {
            // At most the pixels of an image.
            pixels: u32::try_from(cell.pixels).unwrap_or(u32::MAX),
            samples: cell.samples.into_iter().map(sample).collect(),
        })
        .collect()
}

/// The strata in a result, in the order of the shot. Estimates add up in this order, for the same bits.
struct Shown {
    strata: Vec<usize>,
    list: Vec<Stratum>,
    background_prior_cost: f64,
}

impl Shown {
    fn new(info: &ShotInfo, settings: &RenderSettings, strata: impl Iterator<Item = usize>) -> Self {
        let strata: Vec<usize> = strata.collect::<BTreeSet<usize>>().into_iter().collect();
        let all = forecast_strata(&info.strata, settings);
        let wire = |&stratum: &usize| Stratum {
            name: info.strata[stratum].name.clone(),
            object: all[stratum].object,
            material: all[stratum].material,
            prior_cost: all[stratum].prior_cost,
        };
        let list = strata.iter().map(wire).collect();
        Self { strata, list, background_prior_cost: all[info.strata.len()].prior_cost }
    }

    /// Index of a stratum in the list. The background, or any other stratum, comes after the last.
    fn place(&self, stratum: usize) -> u32 {
        self.strata.binary_search(&stratum).unwrap_or(self.strata.len()) as u32
    }
}

/// Name of an artefact with this content.
pub(crate) fn artifact_name(content: &[u8]) -> ArtifactHash {
    ArtifactHash(*blake3::hash(content).as_bytes())
}

#[derive(Default)]
pub(crate) struct Files {
    pub(crate) contents: Vec<Bytes>,
}

impl Files {
    pub(crate) fn add(&mut self, content: Vec<u8>) -> ArtifactHash {
        let hash = artifact_name(&content);
        self.contents.push(content.into());
        hash
    }
}

/// Reports the steps of a quote as progress of the task.
struct Reporting<'a> {
    control: &'a Control,
    /// The range of the task's progress that this covers, 0 to 1.
    from: f64,
    to: f64,
}

impl<'a> Reporting<'a> {
    fn all(control: &'a Control) -> Self {
        Self { control, from: 0.0, to: 1.0 }
    }

    fn report(&self, done: usize, all: usize) {
        let part = done as f64 / all.max(1) as f64;
        self.control.set_progress(self.from + part * (self.to - self.from));
    }
}

impl Observer for Reporting<'_> {
    fn previewed(&self, done: usize, all: usize) {
        self.report(done, all);
    }

    fn profiled(&self, done: usize, all: usize) {
        self.report(done, all);
    }

    fn is_cancelled(&self) -> bool {
        self.control.is_cancelled()
    }
}

impl AccuracyObserver for Reporting<'_> {
    fn predicted(&self, done: usize, all: usize) {
        self.report(done, all);
    }

    fn cancel(&self) -> &AtomicBool {
        self.control.cancelled()
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
