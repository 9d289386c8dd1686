//! Frames that are divided anew before each pass over their pixels have the bits of frames in one piece.

use crate::divided::{assert_same, moving, result};
use crate::division_farm::{Farm, InPasses, pixels};
use crate::room::Rig;
use bytes::Bytes;
use forelight_protocol::{
    Confidence, ErrorTarget, Integrator, PartPass, PixelRange, RenderPartResult, RenderPartSpec,
    RenderSettings, TaskResult, TaskSpec,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome};
use forelight_tracer::Unfinished;
use std::cell::RefCell;
use std::time::Duration;

/// A frame that gets so many times the work of one sample in every pixel.
fn farm(rig: &Rig, times: u64) -> Farm {
    let settings = RenderSettings { spp: 1, ..rig.settings.clone() };
    let mut farm = Farm::new(&rig.bundle(), settings, 1);
    let stats = result(&farm.whole()).stats.clone();
    let cache = stats.cache.map_or(0, |cache| cache.plan_work + cache.fill_work);
    farm.work = Some(cache + times * (stats.work - cache));
    farm
}

/// Renders a frame in passes, by several numbers of parts.
fn check(farm: &Farm, counts: &[u32], what: &str) {
    let whole = farm.whole();
    let stats = &result(&whole).stats;
    let allotted = stats.allotted.as_ref().expect("samples go where they help");
    assert!(allotted.most > allotted.least, "{what}: {allotted:?}");
    for &parts in counts {
        let what = format!("{what}, {parts} parts");
        let made = farm.in_passes(parts, &|task| vec![farm.render_part(task)]);
        let InPasses { outcome, passes, pictures, .. } = &made;
        assert_same(&whole, outcome, &what);
        check_costs(farm, &whole, &made, &what);
        // A coarse error may be met after the second.
        let few = if farm.error_target.is_some() { 1 } else { 2 };
        assert!(passes.len() > few, "{what}: {} passes", passes.len());
        assert_eq!(pictures.len(), passes.len(), "{what}");
        let last = image::load_from_memory(pictures.last().unwrap()).unwrap().into_rgb8();
        let png = &result(outcome).artifacts.image_png;
        let image = image::load_from_memory(&crate::division_farm::named(&outcome.artifacts, *png)).unwrap();
        assert!(last == image.into_rgb8(), "{what}: the last picture is not the image");
    }
}

/// What the parts of all passes trace is what a frame in one piece traces.
fn check_costs(farm: &Farm, whole: &Outcome, made: &InPasses, what: &str) {
    let stats = &result(whole).stats;
    let cost: u64 = made.passes.iter().flatten().map(|part| pixels(part).1.work).sum();
    let cache = stats.cache.map_or(0, |cache| cache.plan_work + cache.fill_work);
    assert_eq!(cost, stats.work - cache - stats.work_by_class.unwrap().build, "{what}");
    assert_eq!(made.filled, stats.cache.map_or(0, |cache| cache.fill_work), "{what}");
    for pass in &made.passes {
        let count: u64 = pass.iter().map(|part| pixels(part).0).sum();
        assert_eq!(count, farm.settings.pixels(), "{what}: a pass has all pixels");
    }
}

#[test]
fn a_frame_in_passes_has_the_bits_of_one_in_one_piece_with_every_integrator() {
    for (integrator, bounces) in
        [(Integrator::Ambient, 0), (Integrator::Ambient, 1), (Integrator::Ambient, 2), (Integrator::Path, 3)]
    {
        let mut rig = Rig::new();
        rig.settings.integrator = integrator;
        rig.settings.ambient_bounces = bounces;
        check(&farm(&rig, 24), &[1, 2, 7, 64], &format!("{integrator:?} {bounces}"));
    }
}

#[test]
fn a_frame_in_passes_that_makes_its_own_cache_has_the_bits_of_one_in_one_piece() {
    for bounces in [1, 2] {
        for moves in [false, true] {
            let rig = if moves { moving(Rig::cached(bounces)) } else { Rig::cached(bounces) };
            check(&farm(&rig, 40), &[1, 3, 64], &format!("{bounces} bounces, moving: {moves}"));
        }
    }
}

/// A frame that is finished at an error. Its forecast work is only for progress.
fn for_error(rig: &Rig, ppm: u32) -> Farm {
    let mut farm = Farm::new(&rig.bundle(), RenderSettings { spp: 4, ..rig.settings.clone() }, 1);
    farm.work = Some(1);
    farm.error_target = Some(ErrorTarget { ppm, confidence: Confidence::P80 });
    farm
}

#[test]
fn a_frame_for_an_error_has_the_bits_of_one_in_one_piece_and_all_its_parts_stop_at_that_error() {
    for rig in [Rig::new(), Rig::cached(1), moving(Rig::cached(2))] {
        let [coarse, fine] = [200_000, 50_000].map(|ppm| {
            let farm = for_error(&rig, ppm);
            check(&farm, &[1, 2, 7, 64], &format!("{ppm} ppm"));
            let stats = result(&farm.whole()).stats.clone();
            let error = stats.allotted.clone().unwrap().error.p80;
            assert!(error <= 1.01e-6 * f64::from(ppm), "{error} at {ppm}");
            stats
        });
        assert!(fine.work > coarse.work, "{} and {}", fine.work, coarse.work);
    }
}

#[test]
fn the_profile_of_a_frame_for_an_error_says_what_it_takes_and_its_cache_is_not_made_again() {
    for rig in [Rig::new(), Rig::cached(1)] {
        let mut farm = for_error(&rig, 50_000);
        let alone = farm.whole();
        let profiled = farm.profile();
        let found = profiled.samples_for_error.expect("an error is asked for");
        assert!(found.p50 >= 2.0 && found.p50 <= found.p80 && found.p80 <= found.p95, "{found:?}");
        let made = result(&alone).stats.allotted.clone().unwrap().mean;
        assert!((0.4..2.5).contains(&(found.p50 / made)), "{found:?}, the mean was {made}");
        let after = farm.whole();
        let made = |outcome| (result(outcome).artifacts.image_png, result(outcome).stats.work);
        assert_eq!(made(&alone), made(&after));
        let cache =
            |outcome| result(outcome).stats.cache.map_or(0, |cache| cache.plan_work + cache.fill_work);
        let reused = result(&after).stats.reused_work;
        assert_eq!(reused, cache(&after), "all of the profile's cache is taken over");
        let divided = farm.in_passes(3, &|task| vec![farm.render_part(task)]);
        assert_eq!(made(&alone), made(&divided.outcome));
        assert_eq!(divided.filled, 0, "no records are missing");
    }
}

#[test]
fn the_parts_of_a_pass_have_about_equal_work() {
    let rig = Rig::new();
    let farm = farm(&rig, 200);
    let made = farm.in_passes(4, &|task| vec![farm.render_part(task)]);
    let work = |part: &RenderPartResult| pixels(part).1.work as f64;
    for (pass, number) in made.passes.iter().zip(0..).skip(1) {
        let mean = pass.iter().map(work).sum::<f64>() / pass.len() as f64;
        let most = pass.iter().map(work).fold(0.0, f64::max);
        assert!(most < 1.25 * mean, "pass {number}: the longest part has {} times the mean", most / mean);
    }
}

#[test]
fn a_part_of_a_pass_that_was_broken_off_goes_on_from_its_samples_to_the_same_bits() {
    for rig in [Rig::new(), Rig::cached(1)] {
        let farm = farm(&rig, 60);
        let whole = farm.whole();
        let broken_off = RefCell::new(0);
        let render = |task: Assignment| {
            let control = Control::with_checkpoints(Duration::ZERO);
            let checkpoint = std::thread::scope(|scope| {
                let work = scope.spawn(|| farm.execute(&task, &control));
                let mut checkpoint = None;
                while checkpoint.is_none() && !work.is_finished() {
                    checkpoint = control.take_checkpoint();
                    std::thread::yield_now();
                }
                control.cancel();
                let ended = work.join().unwrap();
                assert!(matches!(ended, Err(ExecuteError::Cancelled) | Ok(_)), "{ended:?}");
                control.take_checkpoint().or(checkpoint)
            });
            let control = Control::default();
            let taken =
                checkpoint.as_ref().map_or(0, |bytes| Unfinished::from_bytes(bytes).unwrap().totals().work);
            let outcome = farm.execute(&Assignment { checkpoint, ..task }, &control).unwrap();
            let TaskResult::RenderPart(result) = outcome.result else { panic!() };
            let (_, cost) = pixels(&result);
            let told = control.pixels().unwrap();
            assert_eq!((told.done, told.work), (told.all, cost.work), "taken over: {taken}");
            *broken_off.borrow_mut() += u32::from(taken > 0);
            vec![(result, outcome.artifacts[0].clone())]
        };
        let made = farm.in_passes(2, &render);
        assert_same(&whole, &made.outcome, "broken off");
        assert!(*broken_off.borrow() > 2, "{} parts went on from their samples", broken_off.borrow());
    }
}

#[test]
fn what_a_part_of_a_pass_leaves_to_others_continues_from_its_samples_to_the_same_bits() {
    for rig in [Rig::new(), Rig::cached(1)] {
        // Large enough that threads have not begun all pixels when the first are finished.
        let rig = Rig { settings: RenderSettings { width: 128, height: 96, ..rig.settings.clone() }, ..rig };
        let farm = farm(&rig, 24);
        let whole = farm.whole();
        let left = RefCell::new(0);
        let render = |task: Assignment| {
            let control = Control::default();
            let outcome = std::thread::scope(|scope| {
                let work = scope.spawn(|| farm.execute(&task, &control));
                while control.pixels().is_none_or(|pixels| pixels.work == 0) && !work.is_finished() {
                    std::thread::yield_now();
                }
                control.divide_rest(3);
                work.join().unwrap().unwrap()
            });
            let TaskResult::RenderPart(result) = outcome.result else { panic!() };
            let file = outcome.artifacts[0].clone();
            let Some(rest) = &result.rest else { return vec![(result, file)] };
            *left.borrow_mut() += 1;
            let TaskSpec::RenderPart(spec) = &task.spec else { panic!() };
            let pass = spec.pass.clone().unwrap();
            assert_eq!((rest.ends.len(), rest.ends.last()), (4, Some(&pass.pixels.to)));
            assert!(rest.work[1..].iter().all(|&work| work > 0), "in the first pass too: {rest:?}");
            let (count, cost) = pixels(&result);
            assert_eq!((count, rest.work[0]), (u64::from(rest.ends[0] - pass.pixels.from), cost.work));
            let pieces = rest.ends.windows(2).map(|ends| {
                let pixels = PixelRange { from: ends[0], to: ends[1] };
                let pass = PartPass { pixels, before: vec![result.finished.hash()], ..pass.clone() };
                let spec = RenderPartSpec { pass: Some(pass), ..spec.clone() };
                let task = Assignment { parts: vec![file.clone()], ..task.clone() };
                farm.render_part(Assignment { spec: TaskSpec::RenderPart(spec), ..task })
            });
            let pieces: Vec<_> = pieces.collect();
            std::iter::once((result, file.clone())).chain(pieces).collect()
        };
        let made = farm.in_passes(2, &render);
        assert_same(&whole, &made.outcome, "divided again");
        check_costs(&farm, &whole, &made, "divided again");
        assert!(*left.borrow() > 2, "{} parts left pixels to others", left.borrow());
    }
}

#[test]
fn a_frame_whose_passes_cannot_be_read_is_rendered_again() {
    let rig = Rig::cached(1);
    let farm = farm(&rig, 12);
    let files = RefCell::new(Vec::new());
    let keep = |task| {
        let (result, file) = farm.render_part(task);
        files.borrow_mut().push(file.clone());
        vec![(result, file)]
    };
    let made = farm.in_passes(2, &keep);
    let mut damaged: Vec<Bytes> = files.borrow().iter().rev().take(2).rev().cloned().collect();
    damaged[1] = Bytes::from_static(b"FLpass00 of another version");
    let whole = farm.whole();
    assert_same(&whole, &made.outcome, "not damaged");
    // Its cache is not among the files, so the frame makes it again.
    assert_same(&whole, &farm.put_together(None, damaged), "damaged");
}
