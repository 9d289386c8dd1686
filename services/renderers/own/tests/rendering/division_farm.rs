//! The tasks of a divided frame, one after the other, as a farm hands them out.

use bytes::Bytes;
use forelight_preview::Choice;
use forelight_protocol::{
    ArtifactHash, BundleSource, CacheFillResult, CacheFillSpec, CacheMergeSpec, CachePlanSpec, DivideResult,
    DivideSpec, ErrorTarget, FinishedPart, JobId, PartPass, PartRange, Passes, PixelRange, ProfileResult,
    ProfileSpec, RenderPartResult, RenderPartSpec, RenderSettings, RenderSpec, SceneDigest, Spent,
    TaskResult, TaskSpec,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome, artifact_name};
use forelight_renderer_own::{OwnRenderer, TaskRunner};
use std::path::{Path, PathBuf};

/// A placeholder: the content comes with the task.
const FILE: ArtifactHash = ArtifactHash([7; 32]);

/// One frame of a bundle, and a node.
pub struct Farm {
    runner: TaskRunner,
    bundle: PathBuf,
    digest: SceneDigest,
    pub settings: RenderSettings,
    pub frame: u32,
    pub profile: Option<Bytes>,
    /// The complete cache that the shot's frames share.
    pub shared: Option<Bytes>,
    /// Largest work of the frame, if it is rendered in passes.
    pub work: Option<u64>,
    /// Error at which the frame is finished, if it is rendered in passes for one.
    pub error_target: Option<ErrorTarget>,
}

/// A frame that was rendered in passes, and put together.
pub struct InPasses {
    pub outcome: Outcome,
    /// Of each pass, its parts.
    pub passes: Vec<Vec<RenderPartResult>>,
    /// The picture after each pass.
    pub pictures: Vec<Bytes>,
    /// Work of the tasks that filled the frame's cache.
    pub filled: u64,
}

/// A frame that was divided, rendered and put together.
pub struct Divided {
    pub outcome: Outcome,
    pub divided: DivideResult,
    pub parts: Vec<RenderPartResult>,
    /// Work of the tasks that filled the frame's cache.
    pub filled: u64,
}

impl Farm {
    pub fn new(bundle: &Path, settings: RenderSettings, frame: u32) -> Self {
        let scene = forelight_scene::Scene::load(bundle, &forelight_scene::Limits::default()).unwrap();
        Self {
            runner: TaskRunner::new(OwnRenderer::new(Choice::Cpu)),
            bundle: bundle.to_owned(),
            digest: SceneDigest(scene.digest()),
            settings,
            frame,
            profile: None,
            shared: None,
            work: None,
            error_target: None,
        }
    }

    fn source(&self) -> BundleSource {
        BundleSource::Path(self.bundle.display().to_string())
    }

    fn assignment(&self, spec: TaskSpec) -> Assignment {
        Assignment { profile: self.profile.clone(), ..Assignment::new(spec, self.bundle.clone()) }
    }

    pub fn run(&self, assignment: Assignment) -> Result<Outcome, ExecuteError> {
        self.runner.execute(&assignment, &Control::default())
    }

    fn named(file: Option<&Bytes>) -> Option<ArtifactHash> {
        file.map(|_| FILE)
    }

    /// Profiles the frame.
    pub fn profile(&mut self) -> ProfileResult {
        let spec = ProfileSpec {
            ladders: false,
            error_target: self.error_target,
            denoise: false,
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frame: self.frame,
            samples: 100,
            phase_seed: 5,
            settings: self.settings.clone().into(),
            renderer: None,
            cache: None,
        };
        let outcome = self.run(self.assignment(TaskSpec::Profile(spec))).unwrap();
        self.profile = Some(outcome.artifacts[0].clone());
        let TaskResult::Profile(profiled) = outcome.result else { panic!() };
        profiled
    }

    /// Plans and fills a cache for these frames.
    pub fn share(&mut self, frames: &[u32]) {
        let spec = CachePlanSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frames: frames.to_vec(),
            settings: self.settings.clone(),
        };
        let planned = self.run(self.assignment(TaskSpec::CachePlan(spec))).unwrap().artifacts[0].clone();
        self.shared = Some(self.filled(planned, 1).0);
    }

    /// Fills one of several parts of a cache of the frame.
    pub fn fill(&self, cache: &Bytes, round: u32, (part, parts): (u32, u32)) -> (CacheFillResult, Bytes) {
        let spec = CacheFillSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frame: Some(self.frame),
            settings: self.settings.clone(),
            cache: FILE,
            round,
            part,
            parts,
        };
        let task = self.assignment(TaskSpec::CacheFill(spec));
        let outcome = self.run(Assignment { caches: vec![cache.clone()], ..task }).unwrap();
        let TaskResult::CacheFill(result) = outcome.result else { panic!() };
        (result, outcome.artifacts[0].clone())
    }

    /// Fills a cache round by round, in so many parts. Also returns the work.
    fn filled(&self, mut cache: Bytes, parts: u32) -> (Bytes, u64) {
        let mut work = 0;
        for round in 0.. {
            let filled = (0..parts).map(|part| self.fill(&cache, round, (part, parts)));
            let (results, mut files): (Vec<CacheFillResult>, Vec<Bytes>) = filled.unzip();
            work += results.iter().map(|result| result.spent.work).sum::<u64>();
            if parts == 1 {
                return (files.remove(0), work);
            }
            let spec = CacheMergeSpec {
                job_id: JobId::new(),
                bundle: self.source(),
                digest: self.digest,
                frame: Some(self.frame),
                round,
                parts: vec![FILE; files.len()],
            };
            let task = self.assignment(TaskSpec::CacheMerge(spec));
            let outcome = self.run(Assignment { caches: files, ..task }).unwrap();
            let TaskResult::CacheMerge(merged) = &outcome.result else { panic!() };
            cache = outcome.artifacts[0].clone();
            if merged.full {
                break;
            }
        }
        (cache, work)
    }

    fn render_spec(&self, own: Option<&Bytes>, parts: usize) -> TaskSpec {
        TaskSpec::Render(RenderSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frame: self.frame,
            settings: self.settings.clone().into(),
            renderer: None,
            work: self.work,
            error_target: self.error_target,
            denoise: false,
            profile: Self::named(self.profile.as_ref()),
            cache: Self::named(self.shared.as_ref()),
            frame_cache: Self::named(own),
            parts: vec![FILE; parts],
            shares: Vec::new(),
        })
    }

    /// Renders the frame in one piece.
    pub fn whole(&self) -> Outcome {
        let caches = self.shared.iter().cloned().collect();
        self.run(Assignment { caches, ..self.assignment(self.render_spec(None, 0)) }).unwrap()
    }

    /// Finds the parts, and plans the frame's own cache.
    pub fn divide_only(&self, parts: u32) -> (DivideResult, Option<Bytes>) {
        self.try_to_divide(parts).unwrap()
    }

    /// The same.
    pub fn try_to_divide(&self, parts: u32) -> Result<(DivideResult, Option<Bytes>), ExecuteError> {
        let (divided, files) = self.division(parts)?;
        let cache = divided.cache.map(|cache| named(&files, cache.hash));
        Ok((divided, cache))
    }

    /// The coarse picture of dividing the frame, as a PNG file.
    pub fn coarse(&self, parts: u32) -> Bytes {
        let (divided, files) = self.division(parts).unwrap();
        named(&files, divided.coarse_png.unwrap())
    }

    fn division(&self, parts: u32) -> Result<(DivideResult, Vec<Bytes>), ExecuteError> {
        self.division_after(parts, None, &[])
    }

    /// Divides the frame after a pass, whose files these are.
    fn division_after(
        &self,
        parts: u32,
        own: Option<&Bytes>,
        before: &[Bytes],
    ) -> Result<(DivideResult, Vec<Bytes>), ExecuteError> {
        let spec = DivideSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frame: self.frame,
            settings: self.settings.clone(),
            parts,
            profile: Self::named(self.profile.as_ref()),
            cache: Self::named(self.shared.as_ref()),
            frame_cache: Self::named(own),
            passes: self.work.map(|work| Passes {
                work,
                error_target: self.error_target,
                before: vec![FILE; before.len()],
            }),
        };
        let caches = self.shared.iter().chain(own).cloned().collect();
        let task = self.assignment(TaskSpec::Divide(spec));
        let outcome = self.run(Assignment { caches, parts: before.to_vec(), ..task })?;
        let TaskResult::Divide(divided) = outcome.result else { panic!() };
        Ok((divided, outcome.artifacts))
    }

    /// Finds the parts, and fills the frame's own cache. Returns that and the work of filling.
    pub fn divide(&self, parts: u32) -> (DivideResult, Option<Bytes>, u64) {
        let (divided, planned) = self.divide_only(parts);
        let (own, work) = self.filled_if_planned(&divided, planned);
        (divided, own, work)
    }

    /// The frame's own cache, filled, and the work of that.
    fn filled_if_planned(&self, divided: &DivideResult, planned: Option<Bytes>) -> (Option<Bytes>, u64) {
        match (planned, divided.cache) {
            (Some(planned), Some(found)) if !found.full => {
                let (cache, work) = self.filled(planned, 3);
                (Some(cache), work)
            }
            (cache, _) => (cache, 0),
        }
    }

    /// The task of a part.
    pub fn part(
        &self,
        range: Option<PartRange>,
        (part, parts): (u32, u32),
        own: Option<&Bytes>,
    ) -> Assignment {
        let spec = RenderPartSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest,
            frame: self.frame,
            settings: self.settings.clone().into(),
            renderer: None,
            part,
            parts,
            range,
            profile: Self::named(self.profile.as_ref()),
            cache: Self::named(self.shared.as_ref()),
            frame_cache: Self::named(own),
            pass: None,
        };
        let caches = self.shared.iter().chain(own).cloned().collect();
        Assignment { caches, ..self.assignment(TaskSpec::RenderPart(spec)) }
    }

    /// Renders one part.
    pub fn render_part(&self, assignment: Assignment) -> (RenderPartResult, Bytes) {
        let outcome = self.run(assignment).unwrap();
        let TaskResult::RenderPart(result) = outcome.result else { panic!() };
        let file = outcome.artifacts[0].clone();
        assert_eq!(result.finished.hash(), artifact_name(&file));
        (result, file)
    }

    /// Puts the frame together from the files of its parts.
    pub fn put_together(&self, own: Option<&Bytes>, parts: Vec<Bytes>) -> Outcome {
        let caches = self.shared.iter().chain(own).cloned().collect();
        let task = self.assignment(self.render_spec(own, parts.len()));
        self.run(Assignment { caches, parts, ..task }).unwrap()
    }

    /// Renders the frame in parts.
    pub fn divided(&self, parts: u32) -> Divided {
        let (divided, own, filled) = self.divide(parts);
        assert_eq!((divided.ends.len() as u32, divided.work.len() as u32), (parts, parts));
        let rendered = (0..)
            .zip(ranges(&divided))
            .map(|(part, range)| self.render_part(self.part(Some(range), (part, parts), own.as_ref())));
        let (parts, files) = rendered.unzip();
        Divided { outcome: self.put_together(own.as_ref(), files), divided, parts, filled }
    }
}

/// Unfinished pixels of a part of a frame, and their file.
type PassFile = (PixelRange, Bytes);

impl Farm {
    /// The task of a part of a pass. `last` are the parts of the pass before.
    pub fn pass_part(
        &self,
        pixels: PixelRange,
        (part, parts): (u32, u32),
        (own, samples, last): (Option<&Bytes>, &Bytes, &[PassFile]),
    ) -> Assignment {
        let overlaps = |(range, _): &&PassFile| range.from < pixels.to && pixels.from < range.to;
        let before: Vec<Bytes> = last.iter().filter(overlaps).map(|(_, file)| file.clone()).collect();
        let mut task = self.part(None, (part, parts), own);
        let TaskSpec::RenderPart(spec) = &mut task.spec else { panic!() };
        spec.pass = Some(PartPass { pixels, samples: FILE, before: vec![FILE; before.len()] });
        Assignment { samples: Some(samples.clone()), parts: before, ..task }
    }

    /// Renders the frame in passes, whose parts `render` renders, each as one or several pieces.
    pub fn in_passes(
        &self,
        parts: u32,
        render: &dyn Fn(Assignment) -> Vec<(RenderPartResult, Bytes)>,
    ) -> InPasses {
        let (mut divided, mut files) = self.division(parts).unwrap();
        let planned = divided.cache.map(|cache| named(&files, cache.hash));
        let (own, filled) = self.filled_if_planned(&divided, planned);
        let own = own.as_ref();
        let (mut passes, mut pictures, mut last) = (Vec::new(), Vec::new(), Vec::<PassFile>::new());
        while let Some(samples) = divided.samples {
            let samples = named(&files, samples);
            let mut results = Vec::new();
            let mut made = Vec::new();
            for (part, range) in (0..).zip(ranges(&divided)) {
                let PartRange::Pixels(pixels) = range else { panic!() };
                let task = self.pass_part(pixels, (part, parts), (own, &samples, &last));
                for (result, file) in render(task) {
                    results.push(result);
                    made.push((pixels, file));
                }
            }
            passes.push(results);
            last = made;
            let before: Vec<Bytes> = last.iter().map(|(_, file)| file.clone()).collect();
            (divided, files) = self.division_after(parts, own, &before).unwrap();
            pictures.push(named(&files, divided.coarse_png.unwrap()));
        }
        assert!(divided.ends.is_empty() && divided.work.is_empty(), "{divided:?}");
        let files = last.into_iter().map(|(_, file)| file).collect();
        InPasses { outcome: self.put_together(own, files), passes, pictures, filled }
    }
}

/// The file with this hash.
pub fn named(files: &[Bytes], hash: ArtifactHash) -> Bytes {
    files
        .iter()
        .find(|file| artifact_name(file) == hash)
        .expect("the result names a file that came with it")
        .clone()
}

/// The ranges of a frame's parts.
pub fn ranges(divided: &DivideResult) -> Vec<PartRange> {
    let mut from = 0;
    let range = |&to: &u32| PartRange::Pixels(PixelRange { from: std::mem::replace(&mut from, to), to });
    divided.ends.iter().map(range).collect()
}

/// Number of finished pixels of a part, and their cost.
pub fn pixels(part: &RenderPartResult) -> (u64, Spent) {
    let FinishedPart::Pixels(pixels) = part.finished else { panic!("{part:?}") };
    (u64::from(pixels.count), pixels.cost)
}

impl Execute for Farm {
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        self.runner.execute(assignment, control)
    }
}
