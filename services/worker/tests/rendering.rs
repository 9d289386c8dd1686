//! The tasks, done by our renderer on a room that is written here.

use forelight_forecast::Strategy;
use forelight_preview::Choice;
use forelight_protocol::{
    BundleSource, CacheMode, JobId, PreviewSpec, ProfileSpec, Quantiles, RenderSettings,
    RenderSettingsRequest, RenderSpec, RenderStats, SceneDigest, TaskResult, TaskSpec,
};
use forelight_worker::{
    Ambient, Assignment, Control, Execute, ExecuteError, Given, Library, Observer, Outcome, QuoteOptions,
    TaskRunner, quote, render_frame,
};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A floor, a mirror, and a pane; the camera moves to the right over three frames.
fn write_bundle(folder: &Path) {
    let scene = serde_json::json!({
        "version": 1,
        "name": "room",
        "geometry": ["room.obj"],
        "camera": { "origin": [0, 1, 4], "target": [0, 0.5, 0], "up": [0, 1, 0], "fov_deg": 50, "fov_axis": "x", "width": 32, "height": 24 },
        "lights": [{ "type": "quad", "corner": [-1, 3, -1], "edge_u": [2, 0, 0], "edge_v": [0, 0, 2], "radiance": [9, 9, 9] }],
        "animation": { "fps": 24, "frames": 3, "tracks": [{
            "target": "camera", "property": "origin", "interpolation": "linear",
            "keys": [{ "frame": 0, "value": [0, 1, 4] }, { "frame": 2, "value": [1, 1, 4] }],
        }] },
    });
    fs::write(folder.join("scene.json"), scene.to_string()).unwrap();
    let materials = "newmtl wood\nillum 1\nKd 0.6 0.4 0.2\nnewmtl mirror\nillum 3\nKs 0.9 0.9 0.9\nnewmtl pane\nillum 4\nNi 1.5\nTf 1 1 1\n";
    fs::write(folder.join("room.mtl"), materials).unwrap();
    let mut geometry = String::from("mtllib room.mtl\n");
    let quads = [
        ("floor", "wood", [[-3, 0, 3], [3, 0, 3], [3, 0, -3], [-3, 0, -3]]),
        ("wall", "mirror", [[-3, 0, -3], [0, 0, -3], [0, 2, -3], [-3, 2, -3]]),
        ("window", "pane", [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]),
    ];
    for (index, (object, material, corners)) in quads.iter().enumerate() {
        geometry += &format!("o {object}\nusemtl {material}\n");
        for [x, y, z] in corners {
            geometry += &format!("v {x} {y} {z}\n");
        }
        let first = 4 * index + 1;
        geometry += &format!("f {} {} {} {}\n", first, first + 1, first + 2, first + 3);
    }
    fs::write(folder.join("room.obj"), geometry).unwrap();
}

struct Rig {
    folder: tempfile::TempDir,
    runner: TaskRunner,
    settings: RenderSettings,
}

impl Rig {
    /// With an irradiance cache of so many levels, and a side wall for the floor to be lit by.
    fn cached(bounces: u32) -> Self {
        let mut rig = Self::new();
        let side = "o side\nusemtl wood\nv -3 0 3\nv -3 0 -3\nv -3 2 -3\nv -3 2 3\nf -4 -3 -2 -1\n";
        let path = rig.bundle().join("room.obj");
        fs::write(&path, fs::read_to_string(&path).unwrap() + side).unwrap();
        rig.settings.ambient_bounces = bounces;
        rig.settings.cache = CacheMode::On;
        rig.settings.cache_rays = 192;
        rig
    }

    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let bundle = folder.path().join("bundle");
        fs::create_dir(&bundle).unwrap();
        write_bundle(&bundle);
        let library =
            Library::new(&folder.path().join("bundles"), Box::new(Ambient::new(Choice::Cpu))).unwrap();
        let settings = RenderSettingsRequest { spp: Some(2), ambient_bounces: Some(1), ..Default::default() };
        Self { folder, runner: TaskRunner::new(Arc::new(library)), settings: settings.complete((32, 24)) }
    }

    /// Adds a track to the scene's animation.
    fn animate(&self, track: serde_json::Value) {
        let path = self.bundle().join("scene.json");
        let mut scene: serde_json::Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        scene["animation"]["tracks"].as_array_mut().unwrap().push(track);
        fs::write(&path, scene.to_string()).unwrap();
    }

    fn bundle(&self) -> std::path::PathBuf {
        self.folder.path().join("bundle")
    }

    fn source(&self) -> BundleSource {
        BundleSource::Path(self.bundle().display().to_string())
    }

    /// Of what the bundle holds now, if that is a scene.
    fn digest(&self) -> SceneDigest {
        let scene = forelight_scene::Scene::load(&self.bundle(), &forelight_scene::Limits::default());
        SceneDigest(scene.map_or([0; 32], |scene| scene.digest()))
    }

    fn run(&self, spec: TaskSpec, profile: Option<bytes::Bytes>) -> Result<Outcome, ExecuteError> {
        self.run_from(spec, profile, None, &Control::default())
    }

    fn run_from(
        &self,
        spec: TaskSpec,
        profile: Option<bytes::Bytes>,
        checkpoint: Option<bytes::Bytes>,
        control: &Control,
    ) -> Result<Outcome, ExecuteError> {
        self.runner.execute(
            &Assignment { spec, bundle: self.bundle(), profile, caches: Vec::new(), checkpoint },
            control,
        )
    }

    fn profile_spec(&self, frame: u32) -> TaskSpec {
        TaskSpec::Profile(ProfileSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest(),
            frame,
            samples: 100,
            phase_seed: 5,
            settings: self.settings.clone(),
            cache: None,
        })
    }

    fn render_spec(&self, frame: u32) -> TaskSpec {
        TaskSpec::Render(RenderSpec {
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest(),
            frame,
            settings: self.settings.clone(),
            profile: None,
            cache: None,
        })
    }
}

/// An observer that looks away.
struct Nobody;

impl Observer for Nobody {
    fn previewed(&self, _: usize, _: usize) {}
    fn profiled(&self, _: usize, _: usize) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}

#[test]
fn a_preview_counts_every_pixel_of_every_frame() {
    let rig = Rig::new();
    let spec = PreviewSpec {
        job_id: JobId::new(),
        bundle: rig.source(),
        digest: rig.digest(),
        frames: vec![0, 2],
        settings: rig.settings.clone(),
    };
    let TaskResult::Preview(result) = rig.run(TaskSpec::Preview(spec), None).unwrap().result else {
        panic!()
    };
    let names: Vec<&str> = result.strata.iter().map(|stratum| stratum.name.object.as_str()).collect();
    assert_eq!(names, ["floor", "wall", "window"]);
    let prior: Vec<f64> = result.strata.iter().map(|stratum| stratum.prior_cost).collect();
    assert_eq!(
        (&prior[..], result.background_prior_cost),
        (&[1.0, 2.0, 3.0][..], 0.1),
        "wood, mirror, glass, nothing"
    );
    assert_eq!(result.frames.iter().map(|frame| frame.frame).collect::<Vec<_>>(), [0, 2]);
    for frame in &result.frames {
        assert_eq!(frame.pixels.len(), result.strata.len());
        assert_eq!(frame.pixels.iter().sum::<u32>() + frame.background, 32 * 24);
    }
    assert_ne!(result.frames[0].pixels, result.frames[1].pixels, "the camera moved");
    assert!(result.spent.work > 0);
}

#[test]
fn a_profiled_pixel_is_a_finished_pixel() {
    let rig = Rig::new();
    let profiled = rig.run(rig.profile_spec(1), None).unwrap();
    let TaskResult::Profile(profile) = &profiled.result else { panic!() };
    assert_eq!(profile.samples.len(), 100);
    let mut pixels: Vec<u32> = profile.samples.iter().map(|sample| sample.pixel).collect();
    pixels.sort_unstable();
    pixels.dedup();
    assert_eq!(pixels.len(), 100, "each pixel once");
    assert!(profile.samples.iter().all(|s| s.stratum as usize <= profile.strata.len()));

    let artifact = |hash: forelight_protocol::ArtifactHash, outcome: &Outcome| {
        outcome.artifacts.iter().find(|a| *blake3::hash(a).as_bytes() == hash.0).unwrap().clone()
    };
    let bytes = artifact(profile.artifacts.profile, &profiled);
    let fresh = rig.run(rig.render_spec(1), None).unwrap();
    let reusing = rig.run(rig.render_spec(1), Some(bytes)).unwrap();
    let (TaskResult::Render(fresh_result), TaskResult::Render(reused_result)) =
        (&fresh.result, &reusing.result)
    else {
        panic!()
    };
    assert_eq!(fresh_result.artifacts.image_png, reused_result.artifacts.image_png);
    assert_eq!(fresh_result.artifacts.cost_map_png, reused_result.artifacts.cost_map_png);
    let (fresh, reused) = (&fresh_result.stats, &reused_result.stats);
    assert_eq!((fresh.work, fresh.rays), (reused.work, reused.rays));
    // The samples, and neighbours of some of them that were traced to see how long warm caches make them take.
    assert_eq!(fresh.reused_pixels, 0);
    assert!((101..=100 + 100 / 16 * 64).contains(&reused.reused_pixels), "{}", reused.reused_pixels);
    assert!(reused.reused_work > profile.samples.iter().map(|sample| sample.work).sum::<u64>());
    assert!(profile.spent.work >= reused.reused_work);
    for outcome in [&profiled, &reusing] {
        for hash in outcome.result.artifacts() {
            artifact(hash, outcome);
        }
    }
}

#[test]
fn a_frame_that_was_broken_off_goes_on_from_its_finished_tiles_to_the_same_bits() {
    let mut rig = Rig::new();
    rig.settings.spp = 64;
    let profiled = rig.run(rig.profile_spec(1), None).unwrap();
    let profile = profiled.artifacts.first().cloned();
    let undisturbed = rig.run(rig.render_spec(1), profile.clone()).unwrap();
    let control = Control::with_checkpoints(std::time::Duration::ZERO);
    let tiles = std::thread::scope(|scope| {
        let work = scope.spawn(|| rig.run_from(rig.render_spec(1), profile.clone(), None, &control));
        let tiles = loop {
            if let Some(tiles) = control.take_checkpoint() {
                break tiles;
            }
            assert!(!work.is_finished(), "it ended without a checkpoint");
            std::thread::yield_now();
        };
        control.cancel();
        let ended = work.join().unwrap();
        assert!(matches!(ended, Err(ExecuteError::Cancelled) | Ok(_)), "{ended:?}");
        // What was finished while it was stopped counts, too.
        control.take_checkpoint().unwrap_or(tiles)
    });
    let control = Control::default();
    let resumed = rig.run_from(rig.render_spec(1), profile.clone(), Some(tiles.clone()), &control).unwrap();
    let (TaskResult::Render(before), TaskResult::Render(after)) = (&undisturbed.result, &resumed.result)
    else {
        panic!()
    };
    assert_eq!(before.artifacts.image_png, after.artifacts.image_png);
    assert_eq!(before.artifacts.cost_map_png, after.artifacts.cost_map_png);
    assert_eq!((before.stats.work, before.stats.rays), (after.stats.work, after.stats.rays));
    assert!(after.stats.reused_pixels > before.stats.reused_pixels, "nothing was gone on from");
    assert!(control.unsent().iter().any(|line| line.text.starts_with("goes on from")));
    // What is told of the frame's finished pixels while it is rendered ends as all of them, whoever traced them.
    let told = control.pixels().unwrap();
    assert_eq!((told.done, told.all), (32 * 24, 32 * 24));
    assert!(told.work <= after.stats.work && told.work * 10 > after.stats.work * 9, "{told:?}");
    assert!(told.cpu_nanos > 0);
    // Tiles of another frame, and damaged ones, are no reason to fail.
    let mut damaged = tiles.to_vec();
    damaged[100] ^= 1;
    for (frame, tiles) in [(0, tiles), (1, damaged.into())] {
        let control = Control::default();
        let anyway = rig.run_from(rig.render_spec(frame), None, Some(tiles), &control).unwrap();
        let TaskResult::Render(anyway) = anyway.result else { panic!() };
        assert_eq!(anyway.stats.reused_pixels, 0);
        assert!(control.unsent().iter().any(|line| line.text.contains("cannot be used")));
    }
}

#[test]
fn a_frame_with_an_irradiance_cache_tells_of_its_finished_pixels_with_what_the_cache_took() {
    let mut rig = Rig::new();
    rig.settings.cache = CacheMode::On;
    rig.settings.cache_rays = 48;
    let control = Control::default();
    let rendered = rig.run_from(rig.render_spec(1), None, None, &control).unwrap();
    let TaskResult::Render(rendered) = rendered.result else { panic!() };
    let told = control.pixels().expect("it tells of finished pixels");
    assert_eq!((told.done, told.all), (32 * 24, 32 * 24));
    let cache = rendered.stats.cache.expect("it has a cache");
    assert!(told.work > cache.plan_work + cache.fill_work && cache.fill_work > 0, "{told:?} {cache:?}");
    assert!(told.work <= rendered.stats.work && told.work * 10 > rendered.stats.work * 9, "{told:?}");
}

#[test]
fn a_frames_time_holds_that_of_writing_its_files_and_the_profile_measures_it() {
    let rig = Rig::new();
    let profiled = rig.run(rig.profile_spec(1), None).unwrap();
    let TaskResult::Profile(profile) = &profiled.result else { panic!() };
    let write = profile.fixed.write;
    assert!(write.cpu_nanos > 10_000 && write.work == 0, "{write:?}");
    assert_eq!(profile.fixed.total().work, profile.fixed.load.work + profile.fixed.build.work);
    assert_eq!(
        profile.fixed.total().cpu_nanos,
        profile.fixed.load.cpu_nanos + profile.fixed.build.cpu_nanos + write.cpu_nanos
    );
    // With every pixel taken over, what is left of the frame's time is setting it up and writing it.
    let shot = Ambient::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let all = QuoteOptions { samples: 32 * 24, profile_frames: 1, seed: 1, ..QuoteOptions::default() };
    let quoted = quote(&shot, &[1], &rig.settings, &all, &Nobody).unwrap();
    let bytes = bytes::Bytes::from(quoted.profiled[0].profile.to_bytes());
    let TaskResult::Render(render) = rig.run(rig.render_spec(1), Some(bytes)).unwrap().result else {
        panic!()
    };
    assert_eq!(render.stats.reused_pixels, 32 * 24);
    let rest = render.stats.cpu_seconds - render.stats.reused_cpu_seconds;
    assert!(rest > 10e-6, "{rest} s");
    assert_eq!(render.stats.work, render.stats.reused_work, "writing is no work");
    assert_eq!(quoted.profiled[0].fixed.write.cpu_nanos, 0, "a quote made offline writes no files");
}

#[test]
fn a_profile_of_another_image_is_refused_for_good() {
    let rig = Rig::new();
    let profiled = rig.run(rig.profile_spec(0), None).unwrap();
    for bytes in [profiled.artifacts[0].clone(), bytes::Bytes::from_static(b"FLprof01 but no more")] {
        let error = rig.run(rig.render_spec(1), Some(bytes)).unwrap_err();
        assert!(
            matches!(&error, ExecuteError::Permanent(text) if text.starts_with("profile: ")),
            "{error:?}"
        );
    }
}

#[test]
fn a_bad_bundle_is_an_error_for_good_that_names_the_file() {
    let rig = Rig::new();
    fs::write(rig.bundle().join("room.obj"), "v 0 0 zero\n").unwrap();
    let error = rig.run(rig.render_spec(0), None).unwrap_err();
    assert!(matches!(&error, ExecuteError::Permanent(text) if text.contains("room.obj")), "{error:?}");
}

#[test]
fn a_bundle_that_changed_on_shared_storage_is_loaded_anew() {
    let rig = Rig::new();
    let png = |outcome: Outcome| match outcome.result {
        TaskResult::Render(result) => result.artifacts.image_png,
        other => panic!("{other:?}"),
    };
    let before = png(rig.run(rig.render_spec(0), None).unwrap());
    let materials = fs::read_to_string(rig.bundle().join("room.mtl")).unwrap();
    fs::write(rig.bundle().join("room.mtl"), materials.replace("0.6 0.4 0.2", "0.1 0.4 0.25")).unwrap();
    assert_ne!(before, png(rig.run(rig.render_spec(0), None).unwrap()));
}

#[test]
fn a_bundle_that_changed_after_the_job_was_submitted_is_an_error_for_good_of_every_task() {
    let rig = Rig::new();
    let preview = PreviewSpec {
        job_id: JobId::new(),
        bundle: rig.source(),
        digest: rig.digest(),
        frames: vec![0],
        settings: rig.settings.clone(),
    };
    let specs = [TaskSpec::Preview(preview), rig.profile_spec(0), rig.render_spec(0)];
    // Opened before it changes, and kept open.
    rig.run(specs[2].clone(), None).unwrap();
    let before = rig.digest();
    let materials = fs::read_to_string(rig.bundle().join("room.mtl")).unwrap();
    fs::write(rig.bundle().join("room.mtl"), materials.replace("0.6 0.4 0.2", "0.6 0.4 0.25")).unwrap();
    for spec in specs {
        let error = rig.run(spec, None).unwrap_err();
        let ExecuteError::Permanent(text) = &error else { panic!("{error:?}") };
        assert!(text.contains("has changed") && text.contains(&before.to_string()), "{text}");
    }
    rig.run(rig.render_spec(0), None).unwrap();
}

#[test]
fn a_cancelled_task_says_so() {
    let rig = Rig::new();
    let control = Control::default();
    control.cancel();
    for spec in [rig.render_spec(0), rig.profile_spec(0)] {
        let assignment =
            Assignment { spec, bundle: rig.bundle(), profile: None, caches: Vec::new(), checkpoint: None };
        assert_eq!(rig.runner.execute(&assignment, &control).unwrap_err(), ExecuteError::Cancelled);
    }
}

#[test]
fn a_quote_from_all_pixels_is_the_render_to_the_last_operation() {
    let rig = Rig::new();
    let shot = Ambient::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let options = QuoteOptions { samples: 32 * 24, profile_frames: 3, seed: 1, ..QuoteOptions::default() };
    let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
    let mut total = 0;
    for forecast in &quoted.document.frames {
        let cancel = AtomicBool::new(false);
        let rendered = render_frame(&shot, forecast.frame, &rig.settings, Given::default(), &|_| (), &cancel)
            .unwrap()
            .unwrap();
        let stats = rendered.stats;
        assert_eq!(forecast.work.mean, stats.work as f64, "frame {}", stats.frame);
        assert_eq!(forecast.work.p95, stats.work as f64);
        for (forecast, actual) in forecast.rays.to_array().iter().zip(stats.rays.to_array()) {
            assert_eq!(forecast.mean, actual as f64);
        }
        total += stats.work;
    }
    assert_eq!(quoted.document.total.work.mean, total as f64);
    assert_eq!(quoted.document.profiled.pixels, 3 * 32 * 24);
}

#[test]
fn every_strategy_quotes_a_shot_and_from_all_pixels_exactly() {
    let rig = Rig::new();
    let shot = Ambient::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let work = |strategy: Strategy, samples: u32| {
        let options = QuoteOptions { samples, profile_frames: 2, seed: 3, strategy, corrections: None };
        let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
        assert!(quoted.document.profiled.pixels <= 2 * u64::from(samples), "{strategy:?}");
        quoted.document
    };
    let all = work(Strategy::Snapshot, 32 * 24);
    for strategy in Strategy::ALL {
        let exact = work(strategy, 32 * 24);
        assert_eq!(exact.profiled.frames, all.profiled.frames, "{strategy:?}");
        for frame in &all.profiled.frames {
            let [one, other] = [&exact, &all].map(|document| document.frames[*frame as usize].work);
            assert_eq!([one.mean, one.p95], [other.mean, other.p95], "{strategy:?}, frame {frame}");
        }
        let few = work(strategy, 48).total.work;
        assert!(few.p95 > few.mean, "{strategy:?}: {few:?}");
        assert!((few.mean / all.total.work.mean - 1.0).abs() < 0.4, "{strategy:?}: {few:?}");
    }
}

#[test]
fn a_quote_depends_on_its_seed_and_not_on_the_threads() {
    let rig = Rig::new();
    let shot = Ambient::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let work = |seed: u64, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = QuoteOptions { samples: 64, profile_frames: 1, seed, ..QuoteOptions::default() };
        let quoted = pool.install(|| quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody)).unwrap();
        quoted.document.frames.iter().map(|frame| frame.work).collect::<Vec<_>>()
    };
    assert_eq!(work(1, 1), work(1, 3));
    assert_ne!(work(1, 1), work(2, 1));
}

#[test]
fn building_the_tree_is_in_a_frames_cost_only_where_something_moves() {
    let rig = Rig::new();
    let work = || {
        let shot = Ambient::new(Choice::Cpu).open(&rig.bundle()).unwrap();
        // Frame 0 of the moving shot has the geometry that it would have without the motion.
        let cancel = AtomicBool::new(false);
        render_frame(&shot, 0, &rig.settings, Given::default(), &|_| (), &cancel).unwrap().unwrap().stats.work
    };
    let without = work();
    rig.animate(serde_json::json!({
        "target": "object:window", "property": "translation", "interpolation": "linear",
        "keys": [{ "frame": 0, "value": [0, 0, 0] }, { "frame": 2, "value": [0, 1, 0] }],
    }));
    assert!(work() > without);
}

#[test]
fn a_frame_in_the_dark_is_forecast_from_one_in_the_dark() {
    // With a cache, of which a frame in the dark has no records, all three are profiled: two others would be worth more.
    for (rig, profile_frames) in [(Rig::new(), 2), (Rig::cached(1), 3)] {
        rig.animate(serde_json::json!({
            "target": "light:0", "property": "radiance", "interpolation": "step",
            "keys": [
                { "frame": 0, "value": [9, 9, 9] },
                { "frame": 1, "value": [0, 0, 0] },
                { "frame": 2, "value": [9, 9, 9] },
            ],
        }));
        let shot = Ambient::new(Choice::Cpu).open(&rig.bundle()).unwrap();
        // Half of all pixels: what is left of error is that of carrying.
        let options = QuoteOptions { samples: 384, profile_frames, seed: 2, ..QuoteOptions::default() };
        let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
        assert_eq!(quoted.counted.lights, [0, 1, 0]);
        let render = |frame| {
            let given = Given::default();
            let rendered = render_frame(&shot, frame, &rig.settings, given, &|_| (), &AtomicBool::new(false));
            rendered.unwrap().unwrap().stats
        };
        let stats: Vec<RenderStats> = (0..3).map(render).collect();
        assert!(4 * stats[1].work < stats[0].work, "{} of {}", stats[1].work, stats[0].work);
        assert!(
            stats[1].effects.iter().all(|effect| !["ambient", "irradiance cache"].contains(&&effect[..]))
        );
        for (forecast, stats) in quoted.document.frames.iter().zip(&stats) {
            let off = forecast.work.mean / stats.work as f64 - 1.0;
            assert!(off.abs() < 0.08, "frame {}: {off}", forecast.frame);
            assert_eq!(stats.cache_records.len(), forecast.cache_records.len());
        }
    }
}

#[test]
fn the_records_that_the_preview_counted_are_those_of_the_render() {
    for bounces in [1, 2] {
        let rig = Rig::cached(bounces);
        let shot = Ambient::new(Choice::Cpu).open(&rig.bundle()).unwrap();
        let options = QuoteOptions { samples: 64, profile_frames: 1, seed: 2, ..QuoteOptions::default() };
        let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
        for (forecast, counted) in quoted.document.frames.iter().zip(&quoted.counted.cache_records) {
            let cancel = AtomicBool::new(false);
            let frame = forecast.frame;
            let stats = render_frame(&shot, frame, &rig.settings, Given::default(), &|_| (), &cancel)
                .unwrap()
                .unwrap()
                .stats;
            assert_eq!(stats.cache_records.len(), bounces as usize);
            assert!(stats.cache_records.iter().all(|&count| count > 20), "{:?}", stats.cache_records);
            let known: Vec<u64> = counted.iter().map(|&count| u64::from(count)).collect();
            assert_eq!(stats.cache_records, known, "frame {frame}");
            for (forecast, &count) in forecast.cache_records.iter().zip(&known) {
                assert_eq!(*forecast, Quantiles::known(count as f64), "frame {frame}");
            }
            let cache = stats.cache.unwrap();
            assert!(
                cache.plan_work > 0 && cache.fill_work > 0 && stats.work > cache.plan_work + cache.fill_work
            );
            assert_eq!((cache.rejected, cache.reused_records), (0, 0));
            assert!(stats.effects.iter().any(|effect| effect == "irradiance cache"), "{:?}", stats.effects);
        }
        assert!(quoted.document.effects.iter().any(|effect| effect == "irradiance cache"));
        assert_ne!(quoted.counted.cache_records[0], quoted.counted.cache_records[2], "the camera moved");
    }
}

#[test]
fn a_profiled_cache_is_taken_over_with_its_plan_and_the_records_that_depend_on_no_others() {
    for bounces in [1, 2] {
        let rig = Rig::cached(bounces);
        let profiled = rig.run(rig.profile_spec(1), None).unwrap();
        let TaskResult::Profile(profile) = &profiled.result else { panic!() };
        let fixed = profile.fixed;
        assert!(fixed.plan.work > 0 && fixed.plan.cpu_nanos > 0 && fixed.plan_rays.iter().sum::<u64>() > 0);
        assert!(fixed.write.cpu_nanos > 10_000, "the files have their time though no pixel is kept");
        let of_level = |level: u32| profile.cache_samples.iter().filter(|s| s.level == level).count();
        for level in 0..bounces {
            assert_eq!(of_level(level), 37, "100 pixels go with 37 records");
        }
        // A deeper level has the fewest rays that there are, all of which its plan has traced.
        assert!(profile.cache_samples.iter().all(|s| s.work > 0 && (s.rays[5] > 0 || s.level > 0)));

        let bytes =
            profiled.artifacts.iter().find(|a| *blake3::hash(a).as_bytes() == profile.artifacts.profile.0);
        let fresh = rig.run(rig.render_spec(1), None).unwrap();
        let reusing = rig.run(rig.render_spec(1), bytes.cloned()).unwrap();
        let (TaskResult::Render(fresh), TaskResult::Render(reused)) = (&fresh.result, &reusing.result) else {
            panic!()
        };
        assert_eq!(fresh.artifacts.image_png, reused.artifacts.image_png);
        assert_eq!(fresh.artifacts.cost_map_png, reused.artifacts.cost_map_png);
        let (fresh, reused) = (&fresh.stats, &reused.stats);
        assert_eq!((fresh.work, fresh.rays), (reused.work, reused.rays));
        assert_eq!(fresh.cache_records, reused.cache_records);
        assert_eq!((fresh.reused_work, reused.reused_pixels), (0, 0));
        let cache = reused.cache.unwrap();
        assert_eq!(cache.reused_records, of_level(bounces - 1) as u64);
        let deepest = profile.cache_samples.iter().filter(|sample| sample.level == bounces - 1);
        assert_eq!(reused.reused_work, fixed.plan.work + deepest.map(|sample| sample.work).sum::<u64>());
        assert!(reused.reused_rays > fixed.plan_rays.iter().sum());
        assert!(profile.spent.work > reused.reused_work);
    }
}

#[test]
fn a_cache_of_another_image_is_refused_for_good() {
    let rig = Rig::cached(1);
    let profiled = rig.run(rig.profile_spec(0), None).unwrap();
    let bytes = profiled.artifacts[0].clone();
    let mut other = rig.render_spec(0);
    if let TaskSpec::Render(spec) = &mut other {
        spec.settings.cache_accuracy = 199;
    }
    for spec in [rig.render_spec(1), other] {
        let error = rig.run(spec, Some(bytes.clone())).unwrap_err();
        assert!(
            matches!(&error, ExecuteError::Permanent(text) if text.starts_with("profile: ")),
            "{error:?}"
        );
    }
    // A profile that is whole, but holds a cache that is not.
    let mut profile = forelight_tracer::Profile::from_bytes(&bytes).unwrap();
    profile.cache.as_mut().unwrap()[200] ^= 1;
    let error = rig.run(rig.render_spec(0), Some(profile.to_bytes().into())).unwrap_err();
    assert!(matches!(&error, ExecuteError::Permanent(text) if text.contains("cache")), "{error:?}");
}

/// Bounds are those of one deterministic run with room for a change of samples, not of many.
#[test]
fn with_a_cache_the_quote_of_the_kitchen_is_within_a_few_percent_of_its_render() {
    let kitchen = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenes/kitchen");
    let shot = Ambient::new(Choice::Cpu).open(&kitchen).unwrap();
    for bounces in [1, 2] {
        let settings = RenderSettingsRequest {
            spp: Some(4),
            ambient_bounces: Some(bounces),
            cache: Some(CacheMode::On),
            cache_rays: Some(192),
            ..Default::default()
        };
        let settings = settings.complete((48, 27));
        let options = QuoteOptions { samples: 256, profile_frames: 1, seed: 0, ..QuoteOptions::default() };
        let quoted = quote(&shot, &[0], &settings, &options, &Nobody).unwrap();
        let cancel = AtomicBool::new(false);
        let stats =
            render_frame(&shot, 0, &settings, Given::default(), &|_| (), &cancel).unwrap().unwrap().stats;
        let forecast = &quoted.document.frames[0];
        let error = forecast.work.mean / stats.work as f64 - 1.0;
        println!(
            "{bounces} bounces: {:?} records, work {:+.2} %, {:?}",
            stats.cache_records,
            error * 100.0,
            stats.cache
        );
        assert!(error.abs() < 0.06, "{error}");
        assert!(forecast.work.p95 > stats.work as f64 && forecast.work.p95 < 1.5 * stats.work as f64);
        let counts: Vec<f64> = stats.cache_records.iter().map(|&count| count as f64).collect();
        assert_eq!(forecast.cache_records.iter().map(|level| level.mean).collect::<Vec<_>>(), counts);
        for (name, (forecast, actual)) in forelight_protocol::Rays::NAMES
            .iter()
            .zip(forecast.rays.to_array().iter().zip(stats.rays.to_array()))
        {
            let error = forecast.mean / (actual as f64).max(1.0) - 1.0;
            println!("  {name}: {actual}, {:+.2} %", error * 100.0);
        }
    }
}
