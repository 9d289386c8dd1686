//! Tasks of the farm for a renderer behind the door: previews, profiles, renders, and parts of frames.

use crate::door::{
    Artefact, BlockCosts, Capability, Cost, Limits, Part, Rendered, Renderer, RendererError, RendererId, Run,
    Settings, Shot, TakenOver,
};
use crate::execute::{Assignment, Control, Execute, ExecuteError, Outcome};
use crate::files::Files;
use crate::open_shots::OpenShots;
use crate::process::Sandbox;
use crate::quoting::{
    Measurement, PixelChoice, PixelProfile, measure_frame, own_number, preview_result, profile_pixels,
};
use bytes::Bytes;
use forelight_forecast::Strategy;
use forelight_kept::TemporaryFolder;
use forelight_pictures::{cost_map, tone_map};
use forelight_protocol::{
    ArtifactHash, FinishedPart, LogLevel, PartRange, PreviewSpec, ProfileSpec, Rays, RenderArtifacts,
    RenderPartResult, RenderPartSpec, RenderResult, RenderSpec, RenderStats, SampleRange, SampleShare,
    SceneDigest, SceneSummary, Spent, TaskLimit, TaskResult, TaskSpec,
};
use forelight_scene::{open_no_link, open_regular};
use image::{DynamicImage, ImageFormat, ImageReader, Rgb, RgbImage};
use std::fs;
use std::io::{BufReader, Read as _};
use std::path::Path;
use std::sync::Arc;

/// Executes tasks with one renderer. All workers of a process share it, and so its open scenes.
struct ShotRunner {
    renderer: Box<dyn Renderer>,
    shots: OpenShots<OpenShot>,
    sandbox: Option<Arc<Sandbox>>,
}

/// An open scene.
struct OpenShot {
    shot: Box<dyn Shot>,
    /// Hash of the scene's file.
    digest: SceneDigest,
}

/// What surrounds one task.
struct Task<'a> {
    open: &'a OpenShot,
    renderer: &'a RendererId,
    settings: Settings,
    run: Run<'a>,
    assignment: &'a Assignment,
}

impl ShotRunner {
    fn new(renderer: Box<dyn Renderer>, sandbox: Option<Arc<Sandbox>>) -> Self {
        Self { renderer, shots: OpenShots::default(), sandbox }
    }

    fn renderer(&self) -> &RendererId {
        self.renderer.id()
    }

    fn open(&self, path: &Path, run: &Run<'_>) -> Result<Arc<OpenShot>, RendererError> {
        // The file is hashed first: if it changes while it is read, its next opening finds another hash.
        let digest = scene_digest(path)?;
        // Others wait until it is open, and are not to wait for a pause.
        let shot = self.renderer.open(path, &Run { pause: None, ..*run })?;
        Ok(Arc::new(OpenShot { shot, digest }))
    }
}

impl Execute for ShotRunner {
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        with_run(assignment, control, self.sandbox.as_deref(), |run| {
            self.execute_in(run, assignment, control)
        })
    }
}

impl ShotRunner {
    fn execute_in(
        &self,
        run: &Run<'_>,
        assignment: &Assignment,
        control: &Control,
    ) -> Result<Outcome, ExecuteError> {
        let failed = |error| failure(error, assignment);
        let no_scene = || ExecuteError::Permanent("the task has no scene".to_owned());
        let source = assignment.spec.bundle().ok_or_else(no_scene)?;
        let load = || self.open(&assignment.bundle, run);
        let open = self.shots.open(source, &assignment.bundle, load).map_err(failed)?;
        let submitted = assignment.spec.digest().ok_or_else(no_scene)?;
        if open.digest != submitted {
            return Err(ExecuteError::Permanent(format!(
                "the scene has changed since the job was submitted (digest {submitted}, now {}): submit the job again",
                open.digest
            )));
        }
        let settings = settings(&*open.shot, &assignment.spec)?;
        let task = Task { open: &open, renderer: self.renderer.id(), settings, run: *run, assignment };
        match &assignment.spec {
            TaskSpec::Preview(spec) => task.preview(spec, control),
            TaskSpec::Profile(spec) => task.measure(spec),
            TaskSpec::Render(spec) => task.render(spec),
            TaskSpec::RenderPart(spec) => task.render_part(spec),
            TaskSpec::Divide(_) => {
                let reason = format!("{} divides frames by samples, not by pixels", self.renderer.id());
                Err(RendererError::Unsupported(reason))
            }
            TaskSpec::Video(_) => Err(RendererError::Unsupported("a renderer encodes no videos".to_owned())),
            TaskSpec::CachePlan(_) | TaskSpec::CacheFill(_) | TaskSpec::CacheMerge(_) => {
                let reason = format!("{} has no irradiance cache to share", self.renderer.id());
                Err(RendererError::Unsupported(reason))
            }
        }
        .map_err(failed)
    }
}

/// The scene's settings, changed by the job's. The shot checks them.
fn settings(shot: &dyn Shot, spec: &TaskSpec) -> Result<Settings, ExecuteError> {
    let job = match spec {
        TaskSpec::Preview(PreviewSpec { settings, .. })
        | TaskSpec::Profile(ProfileSpec { settings, .. })
        | TaskSpec::RenderPart(RenderPartSpec { settings, .. })
        | TaskSpec::Render(RenderSpec { settings, .. }) => settings.shot(),
        _ => None,
    };
    let for_own = || ExecuteError::Permanent("the task is for forelight's own renderer".to_owned());
    Ok(shot.description().settings.changed_by(job.ok_or_else(for_own)?))
}

impl Task<'_> {
    fn preview(&self, spec: &PreviewSpec, control: &Control) -> Result<Outcome, RendererError> {
        let name = scene_name(&self.assignment.bundle);
        let of = (name.as_str(), self.open.digest);
        let result =
            preview_result(self.renderer, &*self.open.shot, of, &spec.frames, &self.settings, &self.run)?;
        if let Some(described) = &result.described {
            let SceneSummary { objects, triangles, .. } = described.scene;
            let text = format!("{}: {objects} objects with {triangles} triangles", described.renderer);
            control.log(LogLevel::Info, text);
            described.notes.iter().for_each(|note| control.log(LogLevel::Warn, note.clone()));
        }
        Ok(Outcome { result: TaskResult::Preview(result), artifacts: Vec::new() })
    }

    fn measure(&self, spec: &ProfileSpec) -> Result<Outcome, RendererError> {
        if self.open.shot.capabilities(&self.settings).contains(&Capability::MeasurePixels) {
            return self.profile(spec);
        }
        let frame = (spec.frame, u32::try_from(spec.phase_seed).unwrap_or(0));
        let measured = measure_frame(self.renderer, &*self.open.shot, frame, &self.settings, &self.run)?;
        let Measurement { mut result, artefacts, ids, .. } = measured;
        let mut files = Files::default();
        for (share, artefact) in result.shares.iter_mut().zip(&artefacts) {
            share.hash = Some(files.add(read_written(&artefact.path)?));
        }
        result.preview_png = add_picture(&mut files, ids.as_ref())?;
        Ok(Outcome { result: TaskResult::Measured(result), artifacts: files.contents })
    }

    /// Profiles single pixels.
    fn profile(&self, spec: &ProfileSpec) -> Result<Outcome, RendererError> {
        let ProfileSpec { frame, samples, phase_seed: seed, .. } = *spec;
        let choice = PixelChoice { samples, seed, strategy: Strategy::Snapshot };
        let shot = &*self.open.shot;
        let profiled = profile_pixels(self.renderer, shot, frame, &self.settings, choice, &self.run)?;
        let PixelProfile { mut result, artefact, ids, .. } = profiled;
        let mut files = Files::default();
        result.artifacts.profile = files.add(read_written(&artefact.path)?);
        result.artifacts.preview_png = add_picture(&mut files, ids.as_ref())?;
        Ok(Outcome { result: TaskResult::Profile(result), artifacts: files.contents })
    }

    /// Renders a share of a frame's samples.
    fn render_part(&self, spec: &RenderPartSpec) -> Result<Outcome, RendererError> {
        let unsupported = |reason: &str| {
            Err(RendererError::Unsupported(format!("{} cannot divide this frame: {reason}", self.renderer)))
        };
        let SampleRange { offset, count } = match spec.range {
            Some(PartRange::Samples(range)) => range,
            Some(PartRange::Pixels(_)) => return unsupported("its parts are shares of the samples"),
            None => return Err(RendererError::Failed("the frame is not divided yet".to_owned())),
        };
        let part = Part::Samples { offset, count };
        let frame = own_number(spec.frame)?;
        let measured = self.open.shot.measure(frame, &self.settings, &part, &self.run)?;
        let cpu_nanos = measured.sample_nanos();
        let Some(artefact) = measured.artefact else {
            return unsupported("at its settings, a render cannot take over samples");
        };
        let mut files = Files::default();
        let share = SampleShare { offset, count, cpu_nanos, hash: files.add(read_written(&artefact.path)?) };
        let result = RenderPartResult {
            finished: FinishedPart::Samples(share),
            rest: None,
            spent: Spent::uncounted(measured.cost.cpu_nanos),
            peak_memory_bytes: measured.cost.peak_memory_bytes,
        };
        Ok(Outcome { result: TaskResult::RenderPart(result), artifacts: files.contents })
    }

    fn render(&self, spec: &RenderSpec) -> Result<Outcome, RendererError> {
        let number = own_number(spec.frame)?;
        let taken_over = self.taken_over(spec, number)?;
        let rendered = self.open.shot.render(number, &self.settings, &taken_over, &self.run)?;
        let Rendered { files, picture, ids, cost, blocks, taken_over, .. } = rendered;
        let image =
            files.first().ok_or_else(|| RendererError::Answer("the render has no file".to_owned()))?;
        let mut kept = Files::default();
        let artifacts = RenderArtifacts {
            image_exr: kept.add(read_written(image)?),
            image_png: kept.add(png(&picture.map_or_else(|| picture_of(image), Ok)?)?),
            cost_map_png: kept.add(png(&self.cost_map(blocks.as_ref()))?),
            preview_png: add_picture(&mut kept, ids.as_ref())?,
        };
        let stats = self.stats(spec, &cost, taken_over);
        Ok(Outcome {
            result: TaskResult::Render(RenderResult { stats, artifacts }),
            artifacts: kept.contents,
        })
    }

    /// The shares and pixels that the task names, as files.
    fn taken_over(&self, spec: &RenderSpec, frame: i32) -> Result<Vec<Artefact>, RendererError> {
        let artefact = |name: String, bytes: &Bytes, part: Part| {
            let path = self.run.scratch.join(name);
            fs::write(&path, bytes).map_err(RendererError::io(&path))?;
            let (renderer, settings) = (self.renderer.clone(), self.settings.clone());
            Ok(Artefact { renderer, frame, settings, part, path })
        };
        let shares = spec.shares.iter().zip(&self.assignment.shares).map(|(share, bytes)| {
            let part = Part::Samples { offset: share.offset, count: share.count };
            artefact(format!("taken-over-{}.exr", share.offset), bytes, part)
        });
        let pixels = self.assignment.profile.iter();
        // The file says which pixels it holds.
        let pixels =
            pixels.map(|bytes| artefact("taken-over-pixels".to_owned(), bytes, Part::Pixels(Vec::new())));
        shares.chain(pixels).collect()
    }

    /// The cost of each pixel as a colour, block by block. One colour if the renderer does not know.
    fn cost_map(&self, blocks: Option<&BlockCosts>) -> RgbImage {
        let (width, height) = (self.settings.common.width, self.settings.common.height);
        let costs = blocks.map_or_else(Vec::new, |blocks| blocks.of_pixels(width, height));
        let costs: Vec<u64> = costs.into_iter().map(|nanos| nanos as u64).collect();
        cost_map(width, height, &costs)
    }

    /// The cost of the whole frame: of this render, and of what it took over.
    fn stats(&self, spec: &RenderSpec, cost: &Cost, taken_over: TakenOver) -> RenderStats {
        let of_shares: u64 = spec.shares.iter().map(|share| share.cpu_nanos).sum();
        let reused = Spent::uncounted(of_shares + taken_over.cpu_nanos);
        let whole = Spent::uncounted(cost.cpu_nanos).plus(reused);
        RenderStats {
            frame: spec.frame,
            width: self.settings.common.width,
            height: self.settings.common.height,
            spp: self.settings.common.samples,
            allotted: None,
            denoised: None,
            effects: Vec::new(),
            left_out: Vec::new(),
            rays: Rays::default(),
            cache_records: Vec::new(),
            cache: None,
            cache_choice: None,
            work: whole.work,
            work_by_class: None,
            work_by_ray: None,
            cpu_seconds: whole.cpu_nanos as f64 * 1e-9,
            once: None,
            wall_seconds: cost.wall_nanos as f64 * 1e-9,
            peak_rss_bytes: cost.peak_memory_bytes,
            reused_pixels: taken_over.pixels,
            reused_rays: 0,
            reused_work: reused.work,
            reused_cpu_seconds: reused.cpu_nanos as f64 * 1e-9,
        }
    }
}

/// Reads a file that a renderer has written. A scene could make a link to one that only the worker may read.
///
/// # Errors
/// If the file cannot be read, or is a link.
pub fn read_written(path: &Path) -> Result<Vec<u8>, RendererError> {
    let mut bytes = Vec::new();
    let read = open_no_link(path).and_then(|mut file| file.read_to_end(&mut bytes));
    read.map_err(RendererError::io(path))?;
    Ok(bytes)
}

/// The picture in an image file of a common format.
fn picture_of(path: &Path) -> Result<RgbImage, RendererError> {
    let unreadable = |reason: String| RendererError::Answer(format!("{}: {reason}", path.display()));
    let file = open_no_link(path).map_err(|error| unreadable(error.to_string()))?;
    let mut reader = ImageReader::new(BufReader::new(file));
    if let Ok(format) = ImageFormat::from_path(path) {
        reader.set_format(format);
    }
    let image = reader.decode().map_err(|error| unreadable(error.to_string()))?;
    if !matches!(image, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        return Ok(image.to_rgb8());
    }
    // Linear values.
    let linear = image.to_rgb32f();
    Ok(RgbImage::from_fn(linear.width(), linear.height(), |x, y| Rgb(tone_map(linear.get_pixel(x, y).0))))
}

fn png(picture: &RgbImage) -> Result<Vec<u8>, RendererError> {
    let failed = |error| RendererError::Answer(format!("cannot encode a picture: {error}"));
    forelight_pictures::png(picture).map_err(failed)
}

/// Adds a picture to the files of a result, if there is one.
fn add_picture(files: &mut Files, picture: Option<&RgbImage>) -> Result<Option<ArtifactHash>, RendererError> {
    picture.map(|picture| Ok(files.add(png(picture)?))).transpose()
}

/// BLAKE3 hash of a scene's file.
///
/// # Errors
/// If the file cannot be read.
pub fn scene_digest(path: &Path) -> Result<SceneDigest, RendererError> {
    let file = open_regular(path).map_err(RendererError::io(path))?;
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file).map_err(RendererError::io(path))?;
    Ok(SceneDigest(*hasher.finalize().as_bytes()))
}

/// Name of a scene: that of its file, without the ending.
pub fn scene_name(path: &Path) -> String {
    path.file_stem().map_or_else(|| "scene".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// Runs foreign programs for a task: in a folder of its own, with the task's limits, progress and log.
///
/// # Errors
/// Those of `work`, and if there is no place for the folder.
pub fn with_run<T>(
    assignment: &Assignment,
    control: &Control,
    sandbox: Option<&Sandbox>,
    work: impl FnOnce(&Run<'_>) -> Result<T, ExecuteError>,
) -> Result<T, ExecuteError> {
    let folder = sandbox.map_or_else(std::env::temp_dir, |sandbox| sandbox.folder().to_owned());
    let no_place = |error| failure(RendererError::io("temporary folder")(error), assignment);
    let scratch = TemporaryFolder::new_in(&folder).map_err(no_place)?;
    // Only who has stopped the program may stand still.
    let progress = |share: f64| control.note_progress(share);
    let log = |line: &str| control.log(LogLevel::Info, line);
    let limits = Limits {
        memory_bytes: assignment.limits.memory_bytes,
        // The worker holds tasks to their time, and leaves pauses out.
        time: None,
        threads: assignment.threads,
        ..Limits::default()
    };
    work(&Run {
        cancelled: control.cancelled(),
        pause: Some(control),
        progress: &progress,
        log: &log,
        scratch: scratch.path(),
        limits,
        sandbox,
    })
}

/// The error of a task. It names the frame, and which limit was exceeded.
pub fn failure(error: RendererError, assignment: &Assignment) -> ExecuteError {
    let frame = assignment.spec.frame().map_or(String::new(), |frame| format!("frame {frame}: "));
    let text = format!("{frame}{error}");
    match error {
        RendererError::Cancelled => ExecuteError::Cancelled,
        RendererError::OutOfMemory(_) if assignment.limits.memory_bytes.is_some() => {
            ExecuteError::Limit(TaskLimit::Memory, text)
        }
        RendererError::TimeLimit(_) => ExecuteError::Limit(TaskLimit::WallTime, text),
        error if error.is_permanent() => ExecuteError::Permanent(text),
        _ => ExecuteError::Transient(text),
    }
}

/// Executes a task with the renderer that it names.
pub struct Renderers {
    /// Forelight's own renderer.
    own: Arc<dyn Execute>,
    others: Vec<ShotRunner>,
    /// Encodes videos. `None` if this machine cannot.
    video: Option<Box<dyn Execute>>,
}

impl Renderers {
    /// Our own renderer, and others that were found on this machine. The programs of the others run in the
    /// sandbox, if there is one.
    pub fn new(own: Arc<dyn Execute>, others: Vec<Box<dyn Renderer>>, sandbox: Option<Arc<Sandbox>>) -> Self {
        let runner = |renderer| ShotRunner::new(renderer, sandbox.clone());
        Self { own, others: others.into_iter().map(runner).collect(), video: None }
    }

    /// With what encodes videos on this machine, if anything does.
    #[must_use]
    pub fn with_video(self, video: Option<Box<dyn Execute>>) -> Self {
        Self { video, ..self }
    }

    /// Names and versions of the others.
    pub fn ids(&self) -> Vec<RendererId> {
        self.others.iter().map(|other| other.renderer().clone()).collect()
    }
}

impl Execute for Renderers {
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        if let TaskSpec::Video(_) = assignment.spec {
            let missing = || ExecuteError::Transient("this worker has no ffmpeg; start it again".to_owned());
            return self.video.as_ref().ok_or_else(missing)?.execute(assignment, control);
        }
        let Some(asked) = assignment.spec.renderer() else { return self.own.execute(assignment, control) };
        match self.others.iter().find(|other| asked.allows(other.renderer())) {
            Some(other) => other.execute(assignment, control),
            // The service would not have sent the task, so the renderer is gone since this worker started.
            None => Err(ExecuteError::Transient(format!("this worker has no {asked}; start it again"))),
        }
    }
}
