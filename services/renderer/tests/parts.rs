//! A frame of a renderer that divides by samples, on several nodes. Its image is a list of its samples.

use bytes::Bytes;
use forelight_protocol::{
    ArtifactHash, BundleSource, FinishedPart, JobId, JobSettings, PartRange, PixelRange, RenderPartSpec,
    RenderSpec, RendererRequest, SampleRange, SampleShare, ShotSettings, TaskResult, TaskSpec,
};
use forelight_quote::division::sample_ranges;
use forelight_renderer::door::{
    Artefact, Capabilities, Common, Cost, Description, FixedCosts, FrameCounts, Frames, Measured, Part,
    Rendered, Renderer, RendererError, RendererId, Run, Settings, Shot, TakenOver,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome, Renderers, scene_digest};
use image::RgbImage;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const SAMPLES: u32 = 16;
/// Starting the program, and one sample, nanoseconds.
const START: u64 = 1_000_000;
const SAMPLE: u64 = 40_000;

struct Lister(RendererId);

struct ListedShot {
    id: RendererId,
    description: Description,
}

fn samples(offset: u32, count: u32) -> String {
    (offset..offset + count).map(|sample| format!("{sample} ")).collect()
}

fn cost(samples: u32) -> Cost {
    Cost { cpu_nanos: START + u64::from(samples) * SAMPLE, peak_memory_bytes: 5, ..Cost::default() }
}

impl Renderer for Lister {
    fn id(&self) -> &RendererId {
        &self.0
    }

    fn settings_schema(&self) -> serde_json::Value {
        serde_json::json!({})
    }

    fn capabilities(&self) -> Capabilities {
        Capabilities::new()
    }

    fn open(&self, _: &Path, _: &Run<'_>) -> Result<Box<dyn Shot>, RendererError> {
        let common = Common { width: 4, height: 2, samples: SAMPLES, seed: 0 };
        let description = Description {
            frames: Frames { first: 0, last: 0, step: 1 },
            frames_per_second: 24.0,
            cameras: Vec::new(),
            layers: Vec::new(),
            objects: None,
            materials: None,
            settings: Settings { common, own: Default::default() },
            assets: Vec::new(),
            notes: Vec::new(),
            opening: Cost::default(),
        };
        Ok(Box::new(ListedShot { id: self.0.clone(), description }))
    }
}

impl Shot for ListedShot {
    fn description(&self) -> &Description {
        &self.description
    }

    fn capabilities(&self, _: &Settings) -> Capabilities {
        Capabilities::new()
    }

    fn preview(&self, _: &[i32], _: &Settings, _: &Run<'_>) -> Result<Vec<FrameCounts>, RendererError> {
        Ok(Vec::new())
    }

    fn measure(
        &self,
        frame: i32,
        settings: &Settings,
        part: &Part,
        run: &Run<'_>,
    ) -> Result<Measured, RendererError> {
        part.check(&settings.common)?;
        let &Part::Samples { offset, count } = part else { panic!("{part:?}") };
        let path = run.scratch.join("samples");
        fs::write(&path, samples(offset, count)).unwrap();
        let (renderer, settings, part) = (self.id.clone(), settings.clone(), part.clone());
        // With another seed, a render takes over nothing.
        let artefact = Artefact { renderer, frame, part, path, settings };
        Ok(Measured {
            cost: cost(count),
            fixed: FixedCosts::from([("start".to_owned(), START)]),
            pieces: Vec::new(),
            strata: Vec::new(),
            blocks: None,
            ids: None,
            artefact: Some(artefact).filter(|artefact| artefact.settings.common.seed == 0),
            stopping: None,
        })
    }

    fn render(
        &self,
        _: i32,
        _: &Settings,
        taken_over: &[Artefact],
        run: &Run<'_>,
    ) -> Result<Rendered, RendererError> {
        let mut image = String::new();
        for artefact in taken_over {
            image += &fs::read_to_string(&artefact.path).unwrap();
        }
        let first = image.split_whitespace().count() as u32;
        let path = run.scratch.join("image");
        fs::write(&path, image + &samples(first, SAMPLES - first)).unwrap();
        Ok(Rendered {
            files: vec![path],
            picture: Some(RgbImage::new(4, 2)),
            ids: None,
            cost: cost(SAMPLES - first),
            fixed: FixedCosts::new(),
            strata: Vec::new(),
            blocks: None,
            taken_over: TakenOver::default(),
        })
    }
}

struct NoOwn;

impl Execute for NoOwn {
    fn execute(&self, assignment: &Assignment, _: &Control) -> Result<Outcome, ExecuteError> {
        panic!("{assignment:?}")
    }
}

struct Rig {
    renderers: Renderers,
    scene: PathBuf,
    _folder: tempfile::TempDir,
}

impl Rig {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("scene.list");
        fs::write(&scene, "a scene").unwrap();
        let id = RendererId { name: "lister".to_owned(), version: "1".to_owned() };
        let renderers = Renderers::new(Arc::new(NoOwn), vec![Box::new(Lister(id))], None);
        Self { renderers, scene, _folder: folder }
    }

    fn run(&self, spec: TaskSpec, shares: Vec<Bytes>) -> Result<Outcome, ExecuteError> {
        let task = Assignment { shares, ..Assignment::new(spec, self.scene.clone()) };
        self.renderers.execute(&task, &Control::default())
    }

    fn part(&self, range: Option<PartRange>, seed: u32) -> Result<(SampleShare, Bytes), ExecuteError> {
        let spec = RenderPartSpec {
            job_id: JobId::new(),
            bundle: BundleSource::Path(self.scene.display().to_string()),
            digest: scene_digest(&self.scene).unwrap(),
            frame: 0,
            settings: JobSettings::Shot(ShotSettings { seed: Some(seed), ..ShotSettings::default() }),
            renderer: Some(RendererRequest { name: "lister".to_owned(), version: None }),
            part: 0,
            parts: 3,
            range,
            profile: None,
            cache: None,
            frame_cache: None,
            pass: None,
        };
        let outcome = self.run(TaskSpec::RenderPart(spec), Vec::new())?;
        let TaskResult::RenderPart(result) = outcome.result else { panic!() };
        let FinishedPart::Samples(share) = result.finished else { panic!("{result:?}") };
        assert_eq!(share.cpu_nanos, u64::from(share.count) * SAMPLE);
        assert_eq!((result.spent.cpu_nanos, result.peak_memory_bytes), (START + share.cpu_nanos, 5));
        assert_eq!(share.hash, ArtifactHash(*blake3::hash(&outcome.artifacts[0]).as_bytes()));
        Ok((share, outcome.artifacts[0].clone()))
    }

    /// The list of samples, and the CPU time of what was rendered and taken over.
    fn render(&self, shares: Vec<(SampleShare, Bytes)>) -> (Bytes, u64) {
        let (shares, files): (Vec<SampleShare>, Vec<Bytes>) = shares.into_iter().unzip();
        let spec = RenderSpec {
            error_target: None,
            denoise: false,
            job_id: JobId::new(),
            bundle: BundleSource::Path(self.scene.display().to_string()),
            digest: scene_digest(&self.scene).unwrap(),
            frame: 0,
            settings: JobSettings::Shot(ShotSettings::default()),
            renderer: Some(RendererRequest { name: "lister".to_owned(), version: None }),
            work: None,
            profile: None,
            cache: None,
            frame_cache: None,
            parts: Vec::new(),
            shares,
        };
        let outcome = self.run(TaskSpec::Render(spec), files).unwrap();
        let TaskResult::Render(result) = &outcome.result else { panic!() };
        (outcome.artifacts[0].clone(), (result.stats.cpu_seconds * 1e9).round() as u64)
    }
}

fn range(range: SampleRange) -> Option<PartRange> {
    Some(PartRange::Samples(range))
}

#[test]
fn shares_of_the_samples_from_several_nodes_are_the_image_of_one() {
    let rig = Rig::new();
    let (whole, cost) = rig.render(Vec::new());
    assert_eq!((whole.as_ref(), cost), (samples(0, SAMPLES).as_bytes(), START + 16 * SAMPLE));
    // A profile has finished two samples.
    for profiled in [0, 2] {
        let finished =
            (profiled > 0).then(|| rig.part(range(SampleRange { offset: 0, count: profiled }), 0).unwrap());
        let mut shares: Vec<(SampleShare, Bytes)> = finished.into_iter().collect();
        let known: Vec<SampleShare> = shares.iter().map(|(share, _)| *share).collect();
        for part in sample_ranges(SAMPLES, &known, 3) {
            shares.push(rig.part(range(part), 0).unwrap());
        }
        assert_eq!(rig.render(shares), (whole.clone(), cost), "{profiled} profiled samples");
    }
}

#[test]
fn a_frame_that_cannot_be_divided_says_so() {
    let rig = Rig::new();
    let failed = |range, seed| rig.part(range, seed).unwrap_err();
    let all = range(SampleRange { offset: 0, count: 16 });
    for (range, seed, reason) in [
        (Some(PartRange::Pixels(PixelRange { from: 0, to: 8 })), 0, "its parts are shares of the samples"),
        (all, 1, "a render cannot take over samples"),
        (range(SampleRange { offset: 9, count: 9 }), 0, "samples 9 to 18 of 16"),
    ] {
        let error = failed(range, seed);
        assert!(matches!(&error, ExecuteError::Permanent(text) if text.contains(reason)), "{error:?}");
    }
    let error = failed(None, 0);
    assert!(matches!(&error, ExecuteError::Transient(text) if text.contains("not divided yet")), "{error:?}");
}
