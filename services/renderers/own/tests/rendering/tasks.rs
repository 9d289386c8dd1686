//! Tasks: previews, profiles and renders, interrupted, cancelled, and with changed bundles.

use crate::room::{Nobody, Rig};
use forelight_preview::Choice;
use forelight_protocol::{
    CacheMode, JobId, LadderKind, PreviewSpec, ProfileResult, ProfileSpec, RenderSpec, TaskResult, TaskSpec,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome};
use forelight_renderer_own::{OwnRenderer, QuoteOptions, quote};
use std::fs;

#[test]
fn a_preview_counts_every_pixel_of_every_frame() {
    let rig = Rig::new();
    let spec = PreviewSpec {
        job_id: JobId::new(),
        bundle: rig.source(),
        digest: rig.digest(),
        frames: vec![0, 2],
        settings: rig.settings.clone().into(),
        renderer: None,
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
    // The samples, and neighbours that were traced for their time.
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
fn a_profile_says_how_many_bytes_the_files_of_its_frame_will_have() {
    let mut rig = Rig::new();
    (rig.settings.width, rig.settings.height) = (160, 120);
    let profiled = rig.run(rig.profile_spec(1), None).unwrap();
    let TaskResult::Profile(profile) = &profiled.result else { panic!() };
    let rendered = rig.run(rig.render_spec(1), None).unwrap();
    // The preview is a file of the profile.
    let preview = profiled.artifacts.last().unwrap().len();
    let files = rendered.artifacts.iter().map(bytes::Bytes::len).sum::<usize>() + preview;
    let error = profile.file_bytes.unwrap() as f64 / files as f64 - 1.0;
    println!("{:?} bytes forecast, {files} made: {:+.1} %", profile.file_bytes, 100.0 * error);
    // An order of magnitude: images of plain rooms are compressed better than the stand-in for them.
    assert!((-0.5..1.0).contains(&error), "{error}");
}

#[test]
fn a_profile_that_is_asked_for_ladders_lays_them_out_beside_the_same_pixels() {
    // Each by a worker that has not seen the scene before.
    let profile = |ladders| {
        let rig = Rig::new();
        let TaskSpec::Profile(asked) = rig.profile_spec(1) else { panic!() };
        let spec = TaskSpec::Profile(ProfileSpec { ladders, ..asked });
        let TaskResult::Profile(result) = rig.run(spec, None).unwrap().result else { panic!() };
        (rig.settings, result)
    };
    let ((settings, plain), (_, laid_out)) = (profile(false), profile(true));
    assert!(plain.ladders.is_none());
    let ladders = laid_out.ladders.as_ref().unwrap();
    assert_eq!((&ladders.settings, &ladders.profiled.frames[..]), (&settings, &[1][..]));
    for kind in LadderKind::ALL {
        let rungs = ladders.rungs.iter().filter(|rung| rung.ladder == kind);
        let found: Vec<_> = rungs.map(|rung| rung.settings.clone()).collect();
        // Ladders that the profile gives by itself are not predicted again, except for the rung asked for.
        let all = forelight_quote::ladder(kind, &settings).unwrap();
        let expected = if forelight_quote::is_own(kind, &settings) { vec![settings.clone()] } else { all };
        assert_eq!(found, expected, "{kind:?}");
    }
    // Their cost counts for the task, not for its pixels.
    assert_eq!(laid_out.spent.work, plain.spent.work + ladders.spent.work);
    assert_eq!(laid_out.work_on_pixels(), plain.work_on_pixels());
    let works =
        |result: &ProfileResult| result.samples.iter().map(|sample| sample.work).collect::<Vec<u64>>();
    assert_eq!(works(&laid_out), works(&plain));
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
        // Pixels that were finished while it was stopped count too.
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
    assert!(after.stats.reused_pixels > before.stats.reused_pixels, "the checkpoint was not used");
    assert!(control.unsent().iter().any(|line| line.text.starts_with("continuing from")));
    // Reported pixels add up to all pixels, whichever worker traced them.
    let told = control.pixels().unwrap();
    assert_eq!((told.done, told.all), (32 * 24, 32 * 24));
    assert!(told.work <= after.stats.work && told.work * 10 > after.stats.work * 9, "{told:?}");
    assert!(told.cpu_nanos > 0);
    // Tiles of another frame and damaged tiles do not fail the task.
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
    // With every pixel taken over, what remains is set-up and writing.
    let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let all = QuoteOptions { samples: 32 * 24, profile_frames: Some(1), seed: 1, ..QuoteOptions::default() };
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
fn a_profile_that_is_of_no_use_is_left_and_the_image_is_what_it_would_be() {
    let rig = Rig::new();
    let profiled = rig.run(rig.profile_spec(0), None).unwrap();
    let fresh = rig.run(rig.render_spec(1), None).unwrap();
    // From another frame, and from an obsolete version.
    for bytes in [profiled.artifacts[0].clone(), bytes::Bytes::from_static(b"FLprof01 but no more")] {
        rig.makes_the_same(&fresh, rig.render_spec(1), bytes);
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
        settings: rig.settings.clone().into(),
        renderer: None,
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
        let assignment = Assignment::new(spec, rig.bundle());
        assert_eq!(rig.runner.execute(&assignment, &control).unwrap_err(), ExecuteError::Cancelled);
    }
}

#[test]
fn a_frame_that_is_given_its_work_takes_that_and_has_the_same_bits_on_any_number_of_threads() {
    for mut rig in [Rig::new(), Rig::cached(1)] {
        rig.settings.spp = 12;
        let TaskSpec::Render(spec) = rig.render_spec(0) else { panic!() };
        let TaskResult::Render(even) = rig.run(TaskSpec::Render(spec.clone()), None).unwrap().result else {
            panic!()
        };
        let work = 2 * even.stats.work;
        let made = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let spec = TaskSpec::Render(RenderSpec { work: Some(work), ..spec.clone() });
            let control = Control::default();
            let outcome = pool.install(|| rig.run_from(spec, None, None, &control)).unwrap();
            let TaskResult::Render(result) = outcome.result else { panic!() };
            (result, control.pixels().unwrap())
        };
        let ((one, told), (three, _)) = (made(1), made(3));
        // The other file contains times.
        assert_eq!(one.artifacts.image_png, three.artifacts.image_png);
        assert_eq!(one.artifacts.cost_map_png, three.artifacts.cost_map_png);
        assert_eq!((one.stats.work, one.stats.rays), (three.stats.work, three.stats.rays));
        let share = one.stats.work as f64 / work as f64;
        assert!((share - 1.0).abs() < 0.02, "{share} of its work");
        let samples = one.stats.allotted.unwrap();
        assert!(samples.most > samples.least && one.stats.spp > 12, "{samples:?}");
        assert!(told.all == 32 * 24 && told.done >= told.all * 97 / 100, "{told:?}");
        assert!(told.work <= one.stats.work && told.cpu_nanos > 0, "{told:?}");
    }
}
