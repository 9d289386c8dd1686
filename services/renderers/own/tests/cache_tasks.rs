//! Tasks of the shared cache, and what happens if it cannot be used.

use bytes::Bytes;
use forelight_preview::Choice;
use forelight_protocol::{
    ArtifactHash, BundleSource, CacheFillSpec, CacheMergeSpec, CacheMode, CachePlanSpec, JobId,
    RenderSettings, RenderSettingsRequest, RenderSpec, SceneDigest, TaskResult, TaskSpec,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome};
use forelight_renderer_own::{OwnRenderer, TaskRunner};
use forelight_tracer::Cache;
use std::path::{Path, PathBuf};

struct Rig {
    runner: TaskRunner,
    settings: RenderSettings,
    digest: SceneDigest,
    _folder: tempfile::TempDir,
}

fn corridor() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../deploy/scenes/corridor")
}

/// A placeholder: the content comes with the task.
const CACHE: ArtifactHash = ArtifactHash([7; 32]);

impl Rig {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();

        let scene = forelight_scene::Scene::load(&corridor(), &Default::default()).unwrap();
        let settings = RenderSettingsRequest {
            spp: Some(1),
            ambient_bounces: Some(2),
            cache: Some(CacheMode::On),
            cache_rays: Some(48),
            ..Default::default()
        };
        Self {
            runner: TaskRunner::new(OwnRenderer::new(Choice::Cpu)),
            settings: settings.complete((32, 18)),
            digest: SceneDigest(scene.digest()),
            _folder: folder,
        }
    }

    fn bundle(&self) -> BundleSource {
        BundleSource::Path(corridor().display().to_string())
    }

    fn run(&self, spec: TaskSpec, caches: Vec<Bytes>) -> Result<Outcome, ExecuteError> {
        self.run_under(spec, caches, &Control::default())
    }

    fn run_under(
        &self,
        spec: TaskSpec,
        caches: Vec<Bytes>,
        control: &Control,
    ) -> Result<Outcome, ExecuteError> {
        let assignment = Assignment { caches, ..Assignment::new(spec, corridor()) };
        self.runner.execute(&assignment, control)
    }

    fn plan(&self, settings: &RenderSettings) -> TaskSpec {
        TaskSpec::CachePlan(CachePlanSpec {
            job_id: JobId::new(),
            bundle: self.bundle(),
            digest: self.digest,
            frames: vec![0, 24],
            settings: settings.clone(),
        })
    }

    fn fill(&self, round: u32, part: u32, parts: u32) -> TaskSpec {
        TaskSpec::CacheFill(CacheFillSpec {
            job_id: JobId::new(),
            bundle: self.bundle(),
            digest: self.digest,
            frame: None,
            settings: self.settings.clone(),
            cache: CACHE,
            round,
            part,
            parts,
        })
    }

    fn merge(&self, parts: usize) -> TaskSpec {
        TaskSpec::CacheMerge(CacheMergeSpec {
            job_id: JobId::new(),
            bundle: self.bundle(),
            digest: self.digest,
            frame: None,
            round: 0,
            parts: vec![CACHE; parts],
        })
    }

    fn render(&self) -> TaskSpec {
        TaskSpec::Render(RenderSpec {
            error_target: None,
            denoise: false,
            job_id: JobId::new(),
            bundle: self.bundle(),
            digest: self.digest,
            frame: 24,
            settings: self.settings.clone().into(),
            renderer: None,
            frame_cache: None,
            parts: Vec::new(),
            shares: Vec::new(),
            work: None,
            profile: None,
            cache: Some(CACHE),
        })
    }

    fn planned(&self, settings: &RenderSettings) -> Bytes {
        file(&self.run(self.plan(settings), Vec::new()).unwrap())
    }
}

/// The only artefact of a task.
fn file(outcome: &Outcome) -> Bytes {
    let [file] = outcome.artifacts.as_slice() else { panic!("{} artefacts", outcome.artifacts.len()) };
    assert_eq!(outcome.result.artifacts(), [ArtifactHash(*blake3::hash(file).as_bytes())]);
    file.clone()
}

#[test]
fn parts_that_are_filled_and_put_together_round_by_round_are_the_cache_that_one_task_fills() {
    let rig = Rig::new();
    let outcome = rig.run(rig.plan(&rig.settings), Vec::new()).unwrap();
    let planned = file(&outcome);
    let TaskResult::CachePlan(plan) = &outcome.result else { panic!() };
    assert_eq!((plan.records.len(), plan.frames.len(), plan.bytes), (2, 2, planned.len() as u64));
    assert!(plan.frames.iter().all(|frame| frame.own.iter().all(|&own| own == 0)), "{plan:?}");
    assert!(plan.spent.work > 0);

    let outcome = rig.run(rig.fill(0, 0, 1), vec![planned.clone()]).unwrap();
    let whole = file(&outcome);
    let TaskResult::CacheFill(filled) = outcome.result else { panic!() };
    let all: u64 = plan.records.iter().copied().map(u64::from).sum();
    assert_eq!((filled.full, filled.filled), (true, all));

    let (mut merged, mut work, mut records) = (planned, 0, 0);
    for round in 0..2 {
        let mut parts = Vec::new();
        for part in 0..3 {
            let outcome = rig.run(rig.fill(round, part, 3), vec![merged.clone()]).unwrap();
            let TaskResult::CacheFill(filled) = &outcome.result else { panic!() };
            assert!(!filled.full);
            work += filled.spent.work;
            records += filled.filled;
            parts.push(file(&outcome));
        }
        // In any order.
        parts.rotate_left(round as usize);
        let outcome = rig.run(rig.merge(3), parts).unwrap();
        merged = file(&outcome);
        let TaskResult::CacheMerge(result) = outcome.result else { panic!() };
        assert_eq!((result.full, result.spent.work), (round == 1, 0));
    }
    assert_eq!((work, records), (filled.spent.work, all), "every record was gathered once, by one");
    let without_times = |bytes: &Bytes| Cache::from_bytes(bytes).unwrap().without_times().to_bytes();
    assert!(without_times(&merged) == without_times(&whole));
    // The PNG image. The EXR image also holds the times of its pixels.
    let image = |cache| rig.run(rig.render(), vec![cache]).unwrap().artifacts[1].clone();
    assert!(image(merged) == image(whole));
}

#[test]
fn a_cache_that_is_damaged_fails_for_good_and_one_of_another_kind_is_not_added_to() {
    let rig = Rig::new();
    let planned = rig.planned(&rig.settings);
    let other = rig.planned(&RenderSettings { seed: 9, ..rig.settings.clone() });
    let truncated = planned.slice(..planned.len() - 10);
    let mut damaged = planned.to_vec();
    damaged[500] ^= 1;
    let damaged = Bytes::from(damaged);
    for spec in [rig.fill(0, 0, 2), rig.render(), rig.merge(1)] {
        for (bytes, why) in [(&truncated, "truncated"), (&damaged, "damaged")] {
            let error = rig.run(spec.clone(), vec![bytes.clone()]).unwrap_err();
            let ExecuteError::Permanent(text) = &error else { panic!("{error:?}") };
            assert!(
                text.starts_with("the irradiance cache cannot be used: ") && text.contains(why),
                "{text}"
            );
        }
        if matches!(spec, TaskSpec::Render(_)) {
            continue;
        }
        for bytes in [Bytes::from_static(b"PK\x03\x04 some zip file"), Bytes::new()] {
            let error = rig.run(spec.clone(), vec![bytes]).unwrap_err();
            let ExecuteError::Transient(text) = &error else { panic!("{error:?}") };
            assert!(text.contains("not an irradiance cache of this version"), "{text}");
        }
    }
    let error = rig.run(rig.fill(0, 0, 2), vec![other.clone()]).unwrap_err();
    assert!(matches!(&error, ExecuteError::Transient(text) if text.contains("(seed 9, not 0)")), "{error:?}");
    let error = rig.run(rig.merge(2), vec![planned, other]).unwrap_err();
    assert!(matches!(&error, ExecuteError::Transient(text) if text.contains("different plans")), "{error:?}");
}

/// As when workers were updated after the cache was made.
#[test]
fn a_frame_whose_shared_cache_is_of_another_kind_makes_its_own() {
    let rig = Rig::new();
    let TaskSpec::Render(spec) = rig.render() else { panic!() };
    let alone = rig
        .run(TaskSpec::Render(RenderSpec { error_target: None, cache: None, ..spec }), Vec::new())
        .unwrap();
    let other = rig.planned(&RenderSettings { seed: 9, ..rig.settings.clone() });
    for bytes in [Bytes::from_static(b"FLcach05 and so on"), other] {
        let control = Control::default();
        let made = rig.run_under(rig.render(), vec![bytes], &control).unwrap();
        let (TaskResult::Render(alone), TaskResult::Render(made)) = (&alone.result, &made.result) else {
            panic!("{alone:?} {made:?}")
        };
        assert_eq!(alone.artifacts.image_png, made.artifacts.image_png);
        assert_eq!((alone.stats.work, &alone.stats.cache), (made.stats.work, &made.stats.cache));
        let said = |text: &str| text.starts_with("the frame builds its own irradiance cache");
        assert!(control.unsent().iter().any(|line| said(&line.text)), "{:?}", control.unsent());
    }
}

#[test]
fn settings_without_a_use_for_a_cache_are_refused_and_orders_to_stop_are_followed() {
    let rig = Rig::new();
    let off = RenderSettings { cache: CacheMode::Off, ..rig.settings.clone() };
    let error = rig.run(rig.plan(&off), Vec::new()).unwrap_err();
    assert!(
        matches!(&error, ExecuteError::Permanent(text) if text.contains("need no irradiance cache")),
        "{error:?}"
    );
    let planned = rig.planned(&rig.settings);
    let control = Control::default();
    control.cancel();
    for (spec, caches) in [
        (rig.plan(&rig.settings), Vec::new()),
        (rig.fill(0, 0, 1), vec![planned.clone()]),
        (rig.merge(1), vec![planned]),
    ] {
        assert_eq!(rig.run_under(spec, caches, &control).unwrap_err(), ExecuteError::Cancelled);
    }
}
