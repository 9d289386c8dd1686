//! Frames that are rendered in parts have the bits of frames in one piece.

use crate::division_farm::{Divided, Farm, named, pixels, ranges};
use crate::room::Rig;
use bytes::Bytes;
use forelight_protocol::{
    CacheMode, Integrator, PartRange, PixelRange, RenderResult, RenderSettings, RenderSettingsRequest,
    RenderStats, SampleRange, TaskResult,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome};
use forelight_tracer::{Cache, Profile};
use serde_json::json;
use std::path::Path;
use std::time::Duration;

/// A shipped scene, small.
fn shipped(name: &str, frame: u32, bounces: u32) -> Farm {
    let request = RenderSettingsRequest {
        spp: Some(2),
        ambient_bounces: Some(bounces),
        cache: Some(CacheMode::On),
        cache_rays: Some(48),
        ..Default::default()
    };
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../deploy/scenes");
    Farm::new(&scenes.join(name), request.complete((40, 24)), frame)
}

fn farm(rig: &Rig) -> Farm {
    Farm::new(&rig.bundle(), rig.settings.clone(), 1)
}

/// A room in which the window moves.
pub(crate) fn moving(rig: Rig) -> Rig {
    rig.animate(json!({
        "target": "object:window", "property": "translation", "interpolation": "linear",
        "keys": [{ "frame": 0, "value": [0, 0, 0] }, { "frame": 2, "value": [0, 1, 0] }],
    }));
    rig
}

pub(crate) fn result(outcome: &Outcome) -> &RenderResult {
    let TaskResult::Render(result) = &outcome.result else { panic!("{:?}", outcome.result) };
    result
}

/// All that does not depend on this machine's time and memory, or on what this run traced.
fn counted(stats: &RenderStats) -> RenderStats {
    RenderStats {
        work_by_class: None,
        cpu_seconds: 0.0,
        once: None,
        wall_seconds: 0.0,
        peak_rss_bytes: 0,
        reused_cpu_seconds: 0.0,
        ..stats.clone()
    }
}

/// Every channel of an image by name, as bits, without the times of its pixels.
fn channels(exr: &[u8]) -> Vec<(String, Vec<u32>)> {
    use exr::prelude::*;
    let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let image = image.all_attributes().from_buffered(std::io::Cursor::new(exr)).unwrap();
    let bits = |samples: &FlatSamples| match samples {
        FlatSamples::F32(values) => values.iter().map(|value| value.to_bits()).collect(),
        FlatSamples::U32(values) => values.clone(),
        FlatSamples::F16(_) => panic!("no channel has 16 bits"),
    };
    let channels = image.layer_data.channel_data.list.iter();
    let named = channels.map(|channel| (channel.name.to_string(), bits(&channel.sample_data)));
    named.filter(|(name, _)| name != "cost.cpu_nanos").collect()
}

/// Fails on any difference between two renders of a frame.
pub(crate) fn assert_same(whole: &Outcome, other: &Outcome, what: &str) {
    let (one, two) = (result(whole), result(other));
    assert_eq!(counted(&one.stats), counted(&two.stats), "{what}");
    let pictures = |result: &RenderResult| {
        let artifacts = &result.artifacts;
        (artifacts.image_png, artifacts.cost_map_png, artifacts.preview_png)
    };
    assert_eq!(pictures(one), pictures(two), "{what}");
    let (one, two) = (channels(&whole.artifacts[0]), channels(&other.artifacts[0]));
    assert!(one.len() > 20, "{} channels", one.len());
    for (one, two) in one.iter().zip(&two) {
        assert!(one == two, "{what}: channel {}", one.0);
    }
    assert_eq!(one.len(), two.len());
}

/// Divides a frame in several ways. Checks bits, and that parts hold each pixel once and pay for it.
fn check(farm: &Farm, counts: &[u32], what: &str) {
    let whole = farm.whole();
    let stats = &result(&whole).stats;
    for &parts in counts {
        let what = format!("{what}, {parts} parts");
        let Divided { outcome, parts, filled, divided } = farm.divided(parts);
        assert_same(&whole, &outcome, &what);
        assert_eq!(result(&outcome).stats.work_by_class, None, "{what}: other tasks traced the pixels");
        let (count, cost) =
            parts.iter().map(pixels).fold((0, 0), |sum, part| (sum.0 + part.0, sum.1 + part.1.work));
        assert_eq!(count + stats.reused_pixels, farm.settings.pixels(), "{what}");
        assert!(parts.iter().all(|part| part.spent.work >= pixels(part).1.work), "{what}");
        // Whole frames and divided ones trace the same: pixels, the plan, records that were not taken over.
        let traced = stats.work - stats.reused_work;
        let planned = stats.cache.filter(|_| farm.profile.is_none()).map_or(0, |cache| cache.plan_work);
        let build = stats.work_by_class.unwrap().build;
        assert_eq!(traced, cost + filled + planned + build, "{what}: {stats:?}");
        assert!(divided.spent.work > planned, "{what}");
        // A part pays for its pixels and its tree alone.
        let tree = build.max(stats.once.unwrap().build.work);
        for part in &parts {
            let beside = part.spent.work - pixels(part).1.work;
            assert!(beside == 0 || beside == tree, "{what}: {beside} of {tree}");
        }
    }
}

const COUNTS: [u32; 4] = [1, 2, 7, 64];

#[test]
fn a_frame_in_parts_has_the_bits_of_one_in_one_piece_with_every_integrator() {
    for (integrator, bounces) in
        [(Integrator::Ambient, 0), (Integrator::Ambient, 1), (Integrator::Ambient, 2), (Integrator::Path, 3)]
    {
        let mut rig = Rig::new();
        rig.settings.integrator = integrator;
        rig.settings.ambient_bounces = bounces;
        let mut farm = farm(&rig);
        check(&farm, &COUNTS, &format!("{integrator:?} {bounces}"));
        farm.profile();
        check(&farm, &COUNTS, &format!("{integrator:?} {bounces}, profiled"));
    }
}

#[test]
fn a_frame_in_parts_that_makes_its_own_cache_has_the_bits_of_one_in_one_piece() {
    for bounces in [1, 2] {
        for moves in [false, true] {
            let rig = if moves { moving(Rig::cached(bounces)) } else { Rig::cached(bounces) };
            let mut farm = farm(&rig);
            check(&farm, &COUNTS, &format!("{bounces} bounces, moving: {moves}"));
            farm.profile();
            check(&farm, &COUNTS, &format!("{bounces} bounces, profiled, moving: {moves}"));
            let taken_over = result(&farm.whole()).stats.cache.unwrap().reused_records;
            assert!(taken_over > 0, "the profile's records are taken over");
        }
    }
}

#[test]
fn a_frame_in_parts_that_reads_a_shared_cache_has_the_bits_of_one_in_one_piece() {
    // Planned for frames 0 and 24: frame 12 needs some records of its own.
    for (frame, is_planned) in [(24, true), (12, false)] {
        let mut farm = shipped("corridor", frame, 2);
        farm.share(&[0, 24]);
        let (divided, own, _) = farm.divide(2);
        assert_eq!((divided.cache.is_none(), own.is_none()), (is_planned, is_planned), "{divided:?}");
        check(&farm, &[1, 2, 7], &format!("corridor, frame {frame}"));
    }
    let stats = |farm: &Farm| result(&farm.whole()).stats.cache.unwrap();
    // Something has moved: records are dropped, and the frame makes its own in their place.
    let mut farm = shipped("kitchen", 40, 1);
    farm.share(&[0, 40]);
    assert!(stats(&farm).dropped_records > 0 && stats(&farm).shared_records > 0);
    check(&farm, &[1, 7], "kitchen, moving");
    let rig = moving(Rig::cached(2));
    let mut farm = self::farm(&rig);
    farm.share(&[0, 1, 2]);
    assert!(stats(&farm).dropped_records > 0 && stats(&farm).own_records > 0, "{:?}", stats(&farm));
    check(&farm, &COUNTS, "room, moving");
}

#[test]
fn a_coarse_picture_of_a_divided_frame_looks_like_the_frame() {
    let mut farm = shipped("kitchen", 0, 1);
    farm.settings =
        RenderSettings { width: 160, height: 96, spp: 16, cache: CacheMode::Off, ..farm.settings.clone() };
    let read = |png: &Bytes| image::load_from_memory(png).unwrap().into_rgb8();
    let coarse = read(&farm.coarse(4));
    let whole = farm.whole();
    let image = read(&named(&whole.artifacts, result(&whole).artifacts.image_png));
    assert_eq!(coarse.dimensions(), image.dimensions());
    // One sample of a pixel is noisy, so means over blocks are compared.
    let blocks = |picture: &image::RgbImage| -> Vec<f64> {
        let mut sums = vec![0.0; 10 * 6];
        for (x, y, pixel) in picture.enumerate_pixels() {
            sums[(y / 16 * 10 + x / 16) as usize] +=
                pixel.0.iter().map(|&value| f64::from(value)).sum::<f64>();
        }
        let mean = sums.iter().sum::<f64>() / sums.len() as f64;
        sums.iter().map(|sum| sum - mean).collect()
    };
    let (seen, rendered) = (blocks(&coarse), blocks(&image));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let correlation = dot(&seen, &rendered) / (dot(&seen, &seen) * dot(&rendered, &rendered)).sqrt();
    assert!(
        correlation > 0.8,
        "the blocks of the coarse picture and of the image correlate by {correlation}"
    );
    // Profiled pixels are in it as they will be in the image.
    farm.profile();
    let coarse = read(&farm.coarse(4));
    let same = image.enumerate_pixels().filter(|(x, y, pixel)| coarse.get_pixel(*x, *y) == *pixel).count();
    assert!(same >= 100, "{same} pixels");
}

#[test]
fn a_part_that_was_broken_off_goes_on_from_its_finished_pixels_to_the_same_bits() {
    for rig in [Rig::new(), Rig::cached(1)] {
        let mut farm = farm(&rig);
        farm.settings.spp = 16;
        let whole = farm.whole();
        let (divided, own, _) = farm.divide(2);
        let mut files = Vec::new();
        for (range, part) in ranges(&divided).into_iter().zip(0..) {
            let task = farm.part(Some(range), (part, 2), own.as_ref());
            let control = Control::with_checkpoints(Duration::ZERO);
            let tiles = std::thread::scope(|scope| {
                let work = scope.spawn(|| farm.execute(&task, &control));
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
                control.take_checkpoint().unwrap_or(tiles)
            });
            // Times show which pixels were taken over.
            let mut marked = Profile::from_bytes(&tiles).unwrap();
            assert!(!marked.pixels.is_empty() && marked.cache.is_none());
            marked.pixels.iter_mut().for_each(|(_, pixel)| pixel.cpu_nanos = 77_000_000_000);
            let stray = (0, marked.pixels[0].1);
            let outside = !marked.pixels.iter().any(|(index, _)| *index == 0) && part == 1;
            let before = marked.pixels.len();
            // A pixel of another part, as of a frame that was divided in another way.
            marked.pixels.extend(outside.then_some(stray));
            let checkpoint = Some(Bytes::from(marked.to_bytes()));
            let control = Control::default();
            let task = Assignment { checkpoint, ..task };
            let outcome = farm.execute(&task, &control).unwrap();
            let TaskResult::RenderPart(result) = &outcome.result else { panic!() };
            let file = Profile::from_bytes(&outcome.artifacts[0]).unwrap();
            let taken = file.pixels.iter().filter(|(_, pixel)| pixel.cpu_nanos == 77_000_000_000).count();
            assert_eq!(taken, before, "finished pixels are not traced again");
            let (count, cost) = pixels(result);
            let told = control.pixels().unwrap();
            assert_eq!((told.done, told.all, told.work), (count, count, cost.work));
            assert!(result.spent.cpu_nanos > cost.cpu_nanos && result.spent.work == cost.work, "{result:?}");
            assert!(control.unsent().iter().any(|line| line.text.starts_with("continuing from")));
            files.push(outcome.artifacts[0].clone());
        }
        assert_same(&whole, &farm.put_together(own.as_ref(), files), "restarted");
    }
}

#[test]
fn what_a_part_leaves_to_others_is_rendered_once_and_to_the_same_bits() {
    for rig in [Rig::new(), Rig::cached(1)] {
        let mut farm = farm(&rig);
        // Large enough that threads have not begun all pixels when the first are finished.
        farm.settings = RenderSettings { width: 128, height: 96, spp: 4, ..farm.settings };
        let whole = farm.whole();
        for profiled in [false, true] {
            if profiled && farm.settings.cache == CacheMode::Off {
                farm.profile();
            }
            let whole = if profiled { farm.whole() } else { whole.clone() };
            let (divided, own, _) = farm.divide(2);
            let [first, second] = ranges(&divided)[..] else { panic!() };
            let PartRange::Pixels(range) = first else { panic!() };
            let task = farm.part(Some(first), (0, 2), own.as_ref());
            let control = Control::default();
            // Others become idle as soon as a few pixels are finished.
            let outcome = std::thread::scope(|scope| {
                let work = scope.spawn(|| farm.execute(&task, &control));
                while control.pixels().is_none_or(|pixels| pixels.done == 0) && !work.is_finished() {
                    std::thread::yield_now();
                }
                control.divide_rest(3);
                work.join().unwrap().unwrap()
            });
            let TaskResult::RenderPart(result) = &outcome.result else { panic!() };
            let rest = result.rest.as_ref().expect("most pixels are left");
            assert_eq!((rest.ends.len(), rest.work.len()), (4, 4));
            assert!(rest.ends.is_sorted() && rest.ends.last() == Some(&range.to), "{rest:?}");
            let (count, cost) = pixels(result);
            assert!(count > 0 && rest.work[0] == cost.work, "{rest:?}");
            // Pieces of equal forecast cost.
            let (least, most) = (rest.work[1..].iter().min(), rest.work[1..].iter().max());
            assert!(*most.unwrap() < 2 * *least.unwrap(), "{rest:?}");
            let pieces = rest.ends.windows(2).map(|ends| PixelRange { from: ends[0], to: ends[1] });
            let others: Vec<PartRange> = pieces.map(PartRange::Pixels).chain([second]).collect();
            let rendered = others.iter().zip(1..);
            let made = rendered
                .map(|(range, part)| farm.render_part(farm.part(Some(*range), (part, 5), own.as_ref())));
            let (results, mut files): (Vec<_>, Vec<_>) = made.unzip();
            files.insert(0, outcome.artifacts[0].clone());
            let all: u64 = results.iter().map(|result| pixels(result).0).sum::<u64>() + count;
            let stats = &self::result(&whole).stats;
            assert_eq!(all + stats.reused_pixels, farm.settings.pixels(), "no pixel twice");
            assert_same(&whole, &farm.put_together(own.as_ref(), files), "divided again");
        }
    }
}

#[test]
fn pixels_that_no_part_brought_are_traced() {
    for rig in [Rig::new(), Rig::cached(2)] {
        let farm = farm(&rig);
        let whole = farm.whole();
        let (divided, own, _) = farm.divide(3);
        let rendered = ranges(&divided).into_iter().zip(0..);
        let file = |(range, part)| farm.render_part(farm.part(Some(range), (part, 3), own.as_ref())).1;
        let mut files: Vec<Bytes> = rendered.map(file).collect();
        // Times show which pixels were taken over.
        let mut first = Profile::from_bytes(&files[0]).unwrap();
        first.pixels.iter_mut().for_each(|(_, pixel)| pixel.cpu_nanos = 77_000_000_000);
        files[0] = first.to_bytes().into();
        let mut damaged = files[1].to_vec();
        damaged[300] ^= 1;
        files[1] = damaged.into();
        files[2] = Bytes::from_static(b"FLprof01 but no more");
        let outcome = farm.put_together(own.as_ref(), files);
        assert_same(&whole, &outcome, "two files are damaged");
        let share = result(&outcome).stats.cpu_seconds / (77.0 * first.pixels.len() as f64);
        assert!((1.0..1.01).contains(&share), "pixels of the first part were traced again: {share}");
    }
}

#[test]
fn parts_and_their_cache_are_the_same_on_any_number_of_threads() {
    let rig = Rig::cached(1);
    let farm = farm(&rig);
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (divided, own, _) = farm.divide(3);
            let part = farm.render_part(farm.part(Some(ranges(&divided)[1]), (1, 3), own.as_ref())).1;
            let mut part = Profile::from_bytes(&part).unwrap();
            part.pixels.iter_mut().for_each(|(_, pixel)| pixel.cpu_nanos = 0);
            let cache = Cache::from_bytes(&own.unwrap()).unwrap().without_times().to_bytes();
            (divided.ends, divided.work, cache, part)
        })
    };
    assert!(made(1) == made(3));
}

#[test]
fn a_frame_of_fewer_pixels_than_parts_has_empty_parts() {
    let mut rig = Rig::cached(1);
    (rig.settings.width, rig.settings.height) = (3, 2);
    check(&farm(&rig), &[6, 9], "6 pixels");
}

/// Records that were carried over come first in a level.
#[test]
fn the_tasks_that_fill_a_cache_gather_equally_many_of_the_records_that_are_missing() {
    let rig = moving(Rig::cached(1));
    let mut farm = farm(&rig);
    farm.share(&[0, 1, 2]);
    let own = result(&farm.whole()).stats.cache.unwrap().own_records;
    let planned = farm.divide_only(2).1.expect("a cache of the frame's own");
    let filled = [0, 1, 2].map(|part| farm.fill(&planned, 0, (part, 3)).0.filled);
    assert_eq!(filled.iter().sum::<u64>(), own);
    assert!(own > 9 && filled.iter().all(|&filled| filled.abs_diff(own / 3) <= 1), "{filled:?}");
}

#[test]
fn what_cannot_be_divided_or_rendered_is_said() {
    let rig = Rig::new();
    let mut farm = farm(&rig);
    for parts in [0, 513] {
        let error = farm.try_to_divide(parts).unwrap_err();
        let ExecuteError::Permanent(text) = &error else { panic!("{error:?}") };
        assert_eq!(*text, format!("cannot divide a frame into {parts} parts, only into 1 to 512"));
    }
    let pixels = |from, to| Some(PartRange::Pixels(PixelRange { from, to }));
    let samples = Some(PartRange::Samples(SampleRange { offset: 0, count: 1 }));
    for range in [pixels(0, 769), pixels(9, 8), samples] {
        let error = farm.run(farm.part(range, (0, 2), None)).unwrap_err();
        assert!(matches!(&error, ExecuteError::Permanent(text) if text.contains("has no part")), "{error:?}");
    }
    let error = farm.run(farm.part(None, (0, 2), None)).unwrap_err();
    assert!(matches!(&error, ExecuteError::Transient(text) if text.contains("not divided yet")), "{error:?}");
    // The cache of another version of the renderer: another worker may be able to read it.
    farm.settings = RenderSettings { cache: CacheMode::On, ..farm.settings };
    let old = Bytes::from_static(b"FLcach05 and so on");
    let error = farm.run(farm.part(pixels(0, 9), (0, 2), Some(&old))).unwrap_err();
    assert!(matches!(&error, ExecuteError::Transient(text) if text.contains("this version")), "{error:?}");
}
