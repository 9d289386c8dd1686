//! The tasks of a divided frame, one after the other. Each part is rendered by a node that has not opened the
//! scene before.

use anyhow::{Result, anyhow, bail};
use bytes::Bytes;
use forelight_kept::Folder;
use forelight_preview::Choice;
use forelight_protocol::{
    ArtifactHash, BundleSource, CacheFillSpec, DivideSpec, FinishedPart, JobId, PartRange, PixelRange,
    RenderPartSpec, RenderSettings, RenderSpec, RenderStats, SceneDigest, Spent, TaskResult, TaskSpec,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome, artifact_name};
use forelight_renderer_own::{OwnRenderer, TaskRunner};
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A placeholder: contents come with the tasks.
const FILE: ArtifactHash = ArtifactHash([0; 32]);

/// A frame that was rendered in parts.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct InParts {
    pub parts: u32,
    /// Work of the longest part over the mean of the parts.
    pub longest: f64,
    /// Work of all tasks of the frame.
    pub work: u64,
    /// CPU time of all tasks, with pictures left out.
    pub cpu_seconds: f64,
    /// CPU time that a part spends beside its pixels, the mean over the parts.
    pub overhead_nanos: u64,
    #[serde(skip)]
    picture: ArtifactHash,
}

impl InParts {
    /// Whether this is its picture, as PNG.
    pub fn has_image(&self, png: &[u8]) -> bool {
        self.picture == artifact_name(png)
    }
}

pub struct Tasks {
    bundle: PathBuf,
    digest: SceneDigest,
    frame: u32,
    settings: RenderSettings,
    kept: Option<Folder>,
}

impl Tasks {
    /// `kept` is where nodes keep scenes and trees.
    pub fn new(
        bundle: &Path,
        digest: SceneDigest,
        frame: u32,
        settings: &RenderSettings,
        kept: Option<Folder>,
    ) -> Self {
        Self { bundle: bundle.to_owned(), digest, frame, settings: settings.clone(), kept }
    }

    fn source(&self) -> BundleSource {
        BundleSource::Path(self.bundle.display().to_string())
    }

    /// Executes a task on a node that starts with it.
    fn run(&self, assignment: Assignment, interrupt: &Interrupt) -> Result<Outcome> {
        if interrupt.is_set() {
            return Err(Interrupted.into());
        }
        let renderer = OwnRenderer::new(Choice::Cpu);
        let renderer = match &self.kept {
            Some(folder) => renderer.keeping(folder.clone()),
            None => renderer,
        };
        TaskRunner::new(renderer).execute(&assignment, &Control::default()).map_err(|error| match error {
            ExecuteError::Cancelled => Interrupted.into(),
            error => anyhow!("frame {}: {error}", self.frame),
        })
    }

    /// Renders the frame in parts. `whole` is the same frame in one piece.
    pub fn render(&self, parts: u32, whole: &RenderStats, interrupt: &Interrupt) -> Result<InParts> {
        let (ends, cache, mut all) = self.divide(parts, interrupt)?;
        let (mut files, mut costs, mut beside, mut from) = (Vec::new(), Vec::new(), 0, 0);
        for (part, to) in (0..).zip(ends) {
            let range = PartRange::Pixels(PixelRange { from: std::mem::replace(&mut from, to), to });
            let task = self.part(range, (part, parts), cache.as_ref());
            let outcome = self.run(task, interrupt)?;
            let TaskResult::RenderPart(result) = outcome.result else { bail!("a part has another result") };
            let FinishedPart::Pixels(pixels) = result.finished else { bail!("a part has no pixels") };
            beside += result.spent.cpu_nanos - pixels.cost.cpu_nanos;
            all = all.plus(result.spent);
            costs.push(result.spent.work);
            files.extend(outcome.artifacts);
        }
        let stats = self.put_together(files, cache, interrupt)?;
        let (stats, picture) = stats;
        anyhow::ensure!(
            (stats.work, &stats.rays) == (whole.work, &whole.rays),
            "the work in parts differs from that in one piece"
        );
        let mean = costs.iter().sum::<u64>() as f64 / f64::from(parts);
        Ok(InParts {
            parts,
            longest: costs.iter().max().map_or(0.0, |&most| most as f64 / mean),
            work: all.work,
            cpu_seconds: all.cpu_nanos as f64 * 1e-9,
            overhead_nanos: beside / u64::from(parts),
            picture,
        })
    }

    /// Where parts end, the frame's irradiance cache, filled, and the cost of both.
    fn divide(&self, parts: u32, interrupt: &Interrupt) -> Result<(Vec<u32>, Option<Bytes>, Spent)> {
        let spec = DivideSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frame: self.frame,
            settings: self.settings.clone(),
            parts,
            profile: None,
            cache: None,
            frame_cache: None,
            passes: None,
        };
        let outcome = self.run(self.task(TaskSpec::Divide(spec)), interrupt)?;
        let TaskResult::Divide(divided) = outcome.result else { bail!("a division has another result") };
        let planned = divided.cache.map(|cache| cache.hash);
        let is_planned = |file: &Bytes| Some(artifact_name(file)) == planned;
        let mut cache = outcome.artifacts.into_iter().find(is_planned);
        let mut spent = divided.spent;
        if let (Some(planned), Some(found)) = (&cache, divided.cache)
            && !found.full
        {
            let spec = CacheFillSpec {
                job_id: JobId::new(),
                bundle: self.source(),
                digest: self.digest,
                frame: Some(self.frame),
                settings: self.settings.clone(),
                cache: FILE,
                round: 0,
                part: 0,
                parts: 1,
            };
            let task = Assignment { caches: vec![planned.clone()], ..self.task(TaskSpec::CacheFill(spec)) };
            let filled = self.run(task, interrupt)?;
            let TaskResult::CacheFill(result) = filled.result else { bail!("a fill has another result") };
            spent = spent.plus(result.spent);
            cache = filled.artifacts.into_iter().next();
        }
        Ok((divided.ends, cache, spent))
    }

    fn part(&self, range: PartRange, (part, parts): (u32, u32), cache: Option<&Bytes>) -> Assignment {
        let spec = RenderPartSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frame: self.frame,
            settings: self.settings.clone().into(),
            renderer: None,
            part,
            parts,
            range: Some(range),
            profile: None,
            cache: None,
            frame_cache: cache.map(|_| FILE),
            pass: None,
        };
        let caches = cache.into_iter().cloned().collect();
        Assignment { caches, ..self.task(TaskSpec::RenderPart(spec)) }
    }

    /// Statistics of the frame, and its picture.
    fn put_together(
        &self,
        parts: Vec<Bytes>,
        cache: Option<Bytes>,
        interrupt: &Interrupt,
    ) -> Result<(RenderStats, ArtifactHash)> {
        let spec = RenderSpec {
            error_target: None,
            denoise: false,
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frame: self.frame,
            settings: self.settings.clone().into(),
            renderer: None,
            work: None,
            profile: None,
            cache: None,
            frame_cache: cache.as_ref().map(|_| FILE),
            parts: vec![FILE; parts.len()],
            shares: Vec::new(),
        };
        let caches = cache.into_iter().collect();
        let task = Assignment { caches, parts, ..self.task(TaskSpec::Render(spec)) };
        let TaskResult::Render(result) = self.run(task, interrupt)?.result else {
            bail!("a render has another result")
        };
        Ok((result.stats, result.artifacts.image_png))
    }

    fn task(&self, spec: TaskSpec) -> Assignment {
        Assignment::new(spec, self.bundle.clone())
    }
}
