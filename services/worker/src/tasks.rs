//! The three kinds of tasks, done by a renderer.

use crate::execute::{Assignment, Control, Execute, ExecuteError, Outcome};
use crate::library::Library;
use crate::render::render_frame;
use crate::renderer::{RenderError, Renderer, StratumInfo};
use crate::shot::{Observer, ShotError, count_frames, profile_frame};
use bytes::Bytes;
use forelight_protocol::{
    ArtifactHash, FrameStrata, PreviewResult, PreviewSpec, ProfileArtifacts, ProfileResult, ProfileSample,
    ProfileSpec, RenderArtifacts, RenderResult, RenderSpec, StratumName, TaskResult, TaskSpec,
};
use forelight_tracer::Profile;
use image::{ImageFormat, RgbImage};
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

/// Does tasks with the bundles of a library.
#[derive(Debug, Clone)]
pub struct TaskRunner {
    library: Arc<Library>,
}

impl TaskRunner {
    /// A runner that opens bundles through `library`.
    pub fn new(library: Arc<Library>) -> Self {
        Self { library }
    }
}

impl Execute for TaskRunner {
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        let renderer = self.library.open(&assignment.bundle)?;
        let renderer = &*renderer;
        match &assignment.spec {
            TaskSpec::Preview(spec) => preview(renderer, spec, control),
            TaskSpec::Profile(spec) => profile(renderer, spec, control),
            TaskSpec::Render(spec) => render(renderer, spec, assignment.profile.as_ref(), control),
        }
    }
}

fn preview(renderer: &dyn Renderer, spec: &PreviewSpec, control: &Control) -> Result<Outcome, ExecuteError> {
    let counted = count_frames(renderer, &spec.frames, &spec.settings, &Reporting(control))?;
    let infos = &renderer.info().strata;
    let seen = |stratum: usize| counted.counts.iter().any(|counts| counts[stratum] > 0);
    let names = Names::new(infos, (0..infos.len()).filter(|&s| seen(s)));
    let frames = spec.frames.iter().zip(&counted.counts).map(|(&frame, counts)| {
        let (known, background) = counts.split_at(infos.len());
        let mut pixels = vec![0; names.list.len()];
        for (stratum, &count) in known.iter().enumerate().filter(|(_, count)| **count > 0) {
            pixels[names.index(infos, stratum)] += count;
        }
        FrameStrata { frame, pixels, background: background.iter().sum(), preview_png: None }
    });
    let frames = frames.collect();
    let result = PreviewResult { strata: names.list, frames, backend: counted.backend, spent: counted.spent };
    Ok(Outcome { result: TaskResult::Preview(result), artifacts: Vec::new() })
}

fn profile(renderer: &dyn Renderer, spec: &ProfileSpec, control: &Control) -> Result<Outcome, ExecuteError> {
    let profiled = profile_frame(
        renderer,
        spec.frame,
        &spec.settings,
        spec.samples,
        spec.phase_seed,
        &Reporting(control),
    )?;
    let infos = &renderer.info().strata;
    let shown = profiled.observations.iter().map(|o| o.stratum as usize).filter(|&s| s < infos.len());
    let names = Names::new(infos, shown);
    let background = names.list.len();
    let sample = |(&(pixel, _), observation): (&(u32, _), &forelight_forecast::Observation)| {
        let stratum = observation.stratum as usize;
        let stratum = if stratum < infos.len() { names.index(infos, stratum) } else { background };
        let cost = observation.cost;
        ProfileSample {
            pixel,
            stratum: stratum as u32,
            work: cost.work,
            cpu_nanos: cost.cpu_nanos,
            rays: cost.rays,
        }
    };
    let samples = profiled.profile.pixels.iter().zip(&profiled.observations).map(sample).collect();
    let mut files = Files::default();
    let artifacts = ProfileArtifacts {
        profile: files.add(profiled.profile.to_bytes()),
        preview_png: Some(files.add(png(&profiled.picture)?)),
    };
    let result = ProfileResult {
        frame: spec.frame,
        samples,
        fixed: profiled.fixed,
        spent: profiled.spent(),
        strata: names.list,
        artifacts,
    };
    Ok(Outcome { result: TaskResult::Profile(result), artifacts: files.contents })
}

fn render(
    renderer: &dyn Renderer,
    spec: &RenderSpec,
    profile: Option<&Bytes>,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let reuse = profile.map(|bytes| Profile::from_bytes(bytes)).transpose().map_err(RenderError::from)?;
    let progress = |done: u64, all: u64| control.set_progress(done as f64 / all.max(1) as f64);
    let rendered =
        render_frame(renderer, spec.frame, &spec.settings, reuse.as_ref(), &progress, control.cancelled())?
            .ok_or(ExecuteError::Cancelled)?;
    let seen = renderer.frame(spec.frame, &spec.settings)?.preview()?;
    let mut files = Files::default();
    let artifacts = RenderArtifacts {
        image_exr: files.add(exr(&rendered)?),
        image_png: files.add(png(&rendered.image.picture())?),
        cost_map_png: files.add(png(&rendered.image.cost_map())?),
        preview_png: Some(files.add(png(&forelight_preview::picture(&seen.preview, &rendered.frame))?)),
    };
    let result = RenderResult { stats: rendered.stats, artifacts };
    Ok(Outcome { result: TaskResult::Render(result), artifacts: files.contents })
}

/// Names of strata, each once: two pairs of equal names (a bundle may have that) are one stratum to the outside.
struct Names {
    list: Vec<StratumName>,
    index: BTreeMap<StratumName, usize>,
}

impl Names {
    fn new(infos: &[StratumInfo], strata: impl Iterator<Item = usize>) -> Self {
        let mut strata: Vec<usize> = strata.collect();
        strata.sort_unstable();
        let mut names = Self { list: Vec::new(), index: BTreeMap::new() };
        for stratum in strata {
            let name = &infos[stratum].name;
            if !names.index.contains_key(name) {
                names.index.insert(name.clone(), names.list.len());
                names.list.push(name.clone());
            }
        }
        names
    }

    /// Index of a stratum's name; it must be one of those that the list was made from.
    fn index(&self, infos: &[StratumInfo], stratum: usize) -> usize {
        self.index[&infos[stratum].name]
    }
}

/// Files to be uploaded, named by their hash.
#[derive(Default)]
struct Files {
    contents: Vec<Bytes>,
}

impl Files {
    fn add(&mut self, content: Vec<u8>) -> ArtifactHash {
        let hash = ArtifactHash(*blake3::hash(&content).as_bytes());
        self.contents.push(content.into());
        hash
    }
}

/// A picture as a PNG file.
pub fn png(picture: &RgbImage) -> Result<Vec<u8>, ExecuteError> {
    let mut bytes = Vec::new();
    picture
        .write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)
        .map_err(|error| ExecuteError::Transient(format!("cannot encode a picture: {error}")))?;
    Ok(bytes)
}

/// The image as an OpenEXR file; the writer wants a real one.
fn exr(rendered: &crate::render::Rendered) -> Result<Vec<u8>, ExecuteError> {
    let failed =
        |error: &dyn std::fmt::Display| ExecuteError::Transient(format!("cannot write the image: {error}"));
    let file = tempfile::Builder::new().suffix(".exr").tempfile().map_err(|e| failed(&e))?;
    rendered.image.write_exr(file.path(), &rendered.frame).map_err(|e| failed(&e))?;
    std::fs::read(file.path()).map_err(|e| failed(&e))
}

/// Progress of the steps of a quote, as the lease's progress.
struct Reporting<'a>(&'a Control);

impl Observer for Reporting<'_> {
    fn previewed(&self, done: usize, all: usize) {
        self.0.set_progress(done as f64 / all.max(1) as f64);
    }

    fn profiled(&self, done: usize, all: usize) {
        self.0.set_progress(done as f64 / all.max(1) as f64);
    }

    fn is_cancelled(&self) -> bool {
        self.0.is_cancelled()
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
            ShotError::Cancelled => Self::Cancelled,
        }
    }
}
