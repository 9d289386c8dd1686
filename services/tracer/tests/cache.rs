//! The irradiance cache: same bits whoever makes it, right where the answer is known, bad files refused.

mod support;

use forelight_scene::{Environment, Frame};
use forelight_tracer::{Cache, CacheError, CacheSettings, Image, Pixel, Settings, Shared, Tracer};
use glam::Vec3;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use support::{Builder, lambert, material};

/// A room with a lamp, a box, a mirror and a pane.
fn room(builder: impl FnOnce(Builder) -> Builder) -> Frame {
    let color = forelight_scene::Color::plain(Vec3::splat(0.9));
    let mirror = forelight_scene::Surface::Metal { f0: color, alpha: 0.0 };
    let pane = forelight_scene::Surface::ThinGlass { ior: 1.5, transmittance: color };
    let room = Builder::default()
        .cuboid(Vec3::splat(-2.0), Vec3::splat(2.0), true, material("room", lambert(0.6), 0.0))
        .cuboid(
            Vec3::new(0.2, -2.0, -1.5),
            Vec3::new(1.2, -0.8, -0.5),
            false,
            material("box", lambert(0.5), 0.0),
        )
        .quad(Vec3::new(-1.9, -1.5, -1.9), Vec3::new(1.5, 0.0, 0.2), Vec3::Y, material("mirror", mirror, 0.0))
        .quad(Vec3::new(-0.4, -1.5, 0.5), Vec3::X * 0.8, Vec3::Y, material("pane", pane, 0.0))
        .quad(Vec3::new(-0.5, 1.9, -0.5), Vec3::X, Vec3::Z, material("lamp", lambert(0.0), 20.0));
    builder(room).frame(Vec3::new(0.0, 0.0, 1.9), Vec3::new(0.0, -0.2, 0.0), 48, Environment::Black)
}

fn settings(bounces: u32) -> Settings {
    Settings {
        width: 48,
        height: 48,
        spp: 2,
        ambient_bounces: bounces,
        ambient_divisions: 16,
        cache: Some(CacheSettings { accuracy: 300, rays: 192 }),
        ..Settings::default()
    }
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool")
}

fn render(tracer: &Tracer) -> Image {
    tracer.render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels")
}

fn bits(image: &Image) -> Vec<([u32; 3], [u32; 7], u64, u32)> {
    let of = |p: &Pixel| (p.color.map(f32::to_bits), p.rays, p.work, p.uncovered);
    image.pixels.iter().map(of).collect()
}

/// A cache as bytes, without the times that its making took.
fn timeless(cache: &Cache) -> Cache {
    cache.without_times()
}

#[test]
fn image_counters_and_records_are_the_same_for_one_two_and_seven_threads() {
    for bounces in [1, 2] {
        let with = |threads: usize| {
            let tracer = Tracer::new(&room(|b| b), &settings(bounces));
            let image = pool(threads).install(|| render(&tracer));
            (bits(&image), timeless(tracer.cache().unwrap()).to_bytes())
        };
        let one = with(1);
        assert!(one == with(2) && one == with(7), "{bounces} bounces");
    }
}

#[test]
fn the_larger_the_error_that_is_allowed_the_fewer_records_are_planned() {
    let frame = room(|b| b);
    let records = |accuracy: u32| {
        let cache = Some(CacheSettings { accuracy, ..settings(1).cache.unwrap() });
        let tracer = Tracer::new(&frame, &Settings { cache, ..settings(1) });
        tracer.plan();
        tracer.cache().unwrap().records()[0]
    };
    let ladder: Vec<u64> = [50, 100, 200, 300, 400, 600, 800, 1000].map(records).into();
    assert!(ladder.is_sorted_by(|finer, coarser| coarser < finer), "{ladder:?}");
}

#[test]
fn a_fill_in_parts_that_are_merged_is_the_fill_in_one() {
    let frame = room(|b| b);
    let settings = settings(2);
    let whole = Tracer::new(&frame, &settings);
    let expected = bits(&render(&whole));
    let nobody = AtomicBool::new(false);

    let planner = Tracer::new(&frame, &settings);
    planner.plan();
    let mut merged = planner.cache().unwrap().clone();
    for level in [1, 0] {
        let records = merged.records()[level] as usize;
        let cuts = [0, records / 5, records / 2, records];
        let parts: Vec<Vec<u8>> = cuts
            .windows(2)
            .map(|cut| {
                // Another process: it knows the plan, and the deeper levels, from the artefact.
                let worker = Tracer::new(&frame, &settings);
                worker.take_cache(Cache::from_bytes(&merged.to_bytes()).unwrap()).unwrap();
                worker.plan();
                let cache = worker.cache().unwrap();
                let records: Vec<usize> = (cut[0]..cut[1]).collect();
                assert!(cache.fill(&worker, level, &records, &|_| {}, &nobody));
                cache.to_bytes()
            })
            .collect();
        for part in parts {
            merged.merge(&Cache::from_bytes(&part).unwrap()).unwrap();
        }
        merged.smooth_full();
    }
    assert_eq!(merged.totals().filled, merged.records().iter().sum::<u64>());
    assert_eq!(timeless(&merged).to_bytes(), timeless(whole.cache().unwrap()).to_bytes());
    let reader = Tracer::new(&frame, &settings);
    reader.take_cache(merged).unwrap();
    assert_eq!(bits(&render(&reader)), expected);

    let other = Tracer::new(&frame, &Settings { seed: 1, ..settings.clone() });
    other.plan();
    let foreign = other.cache().unwrap();
    assert_eq!(whole.cache().unwrap().clone().merge(foreign), Err(CacheError::OtherPlan));
    let refused = Tracer::new(&frame, &settings).take_cache(foreign.clone());
    assert_eq!(refused, Err(CacheError::OtherScene("seed 1, not 0".to_owned())));
}

#[test]
fn a_damaged_truncated_or_foreign_file_is_refused() {
    let tracer = Tracer::new(&room(|b| b), &Settings { width: 6, height: 6, ..settings(1) });
    render(&tracer);
    let bytes = tracer.cache().unwrap().to_bytes();
    assert_eq!(Cache::from_bytes(&bytes).unwrap().to_bytes(), bytes);
    assert_eq!(Cache::from_bytes(b"something else").unwrap_err(), CacheError::Foreign);
    for length in (0..bytes.len()).step_by(97) {
        assert!(Cache::from_bytes(&bytes[..length]).is_err(), "{length} bytes were accepted");
    }
    for bit in (0..bytes.len() * 8).step_by(1237) {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(Cache::from_bytes(&damaged).is_err(), "bit {bit} was not missed");
    }
    let longer: Vec<u8> = bytes.iter().chain(&[0; 8]).copied().collect();
    assert!(Cache::from_bytes(&longer).is_err());
    // A header that announces more than there can be must not make anyone allocate it.
    let mut greedy = bytes.clone();
    greedy[8 + 32 + 96 + 8 + 8 + 56..][..4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(Cache::from_bytes(&greedy), Err(CacheError::Length { .. })));
}

#[test]
fn a_closed_emitting_room_sums_the_truncated_series_whatever_the_radii() {
    // Albedo ρ, emission 1, everywhere: the camera sees 1, direct light adds ρ, each bounce another factor ρ.
    // Direct light at the gathers' hits is sampled, the rest is exact.
    let rho = 0.6f64;
    for bounces in [1, 2] {
        for accuracy in [100, 500] {
            let frame = Builder::default()
                .cuboid(Vec3::splat(-1.0), Vec3::ONE, true, material("room", lambert(0.6), 1.0))
                .frame(Vec3::new(0.1, 0.2, 0.3), Vec3::ZERO, 16, Environment::Black);
            let cache = Some(CacheSettings { accuracy, rays: 768 });
            let tracer =
                Tracer::new(&frame, &Settings { width: 16, height: 16, spp: 64, cache, ..settings(bounces) });
            let image = render(&tracer);
            let sum: f64 = image.pixels.iter().map(|p| f64::from(p.color[1])).sum();
            let value = sum / image.pixels.len() as f64;
            let expected: f64 = (0..=bounces as i32 + 1).map(|i| rho.powi(i)).sum();
            assert!(
                (value / expected - 1.0).abs() < 5e-3,
                "{bounces} bounces, accuracy {accuracy}: {value} against {expected}"
            );
        }
    }
}

#[test]
fn a_scene_scaled_by_a_power_of_two_has_the_same_bits_and_the_same_records() {
    let scaled = |scale: f32| {
        let mut frame = room(|b| b);
        let geometry = Arc::make_mut(&mut frame.geometry);
        geometry.positions.iter_mut().for_each(|p| *p *= scale);
        frame.camera.origin *= scale;
        let tracer = Tracer::new(&frame, &settings(2));
        (bits(&render(&tracer)), tracer.cache().unwrap().records())
    };
    let one = scaled(1.0);
    for exponent in [-10, -3, 5, 10] {
        assert!(scaled(2f32.powi(exponent)) == one, "scaled by 2^{exponent}");
    }
}

#[test]
fn samples_of_records_and_unfilled_pixels_cost_what_they_cost_in_a_render() {
    let settings = settings(2);
    let tracer = Tracer::new(&room(|b| b), &settings);
    let sampled = tracer.sample_records(8, 1);
    assert_eq!(sampled.len(), 16);
    let before: Vec<Pixel> = tracer.profile(&[0, 500, 1000, 2000]);
    let image = render(&tracer);
    for (pixel, index) in before.iter().zip([0, 500, 1000, 2000]) {
        let after = image.pixels[index];
        assert_eq!((pixel.work, pixel.rays, pixel.uncovered), (after.work, after.rays, after.uncovered));
    }
    let totals = tracer.cache().unwrap().totals();
    assert_eq!((totals.filled, totals.rejected), (totals.records.iter().sum(), 0));
    for level in 0..2 {
        let costs: Vec<u64> = (0..totals.records[level])
            .map(|i| tracer.cache().unwrap().record(level, i as usize).unwrap().cost.work)
            .collect();
        let mean = costs.iter().sum::<u64>() as f64 / costs.len() as f64;
        let sample: Vec<u64> =
            sampled.iter().filter(|s| s.level as usize == level).map(|s| s.cost.work).collect();
        let estimate = sample.iter().sum::<u64>() as f64 / sample.len() as f64;
        assert!((estimate / mean - 1.0).abs() < 0.2, "level {level}: {estimate} for {mean}");
    }
}

/// The room with a small box that stands somewhere on the floor.
fn with_box_at(x: f32) -> Frame {
    room(|b| {
        b.cuboid(
            Vec3::new(x, -2.0, 0.9),
            Vec3::new(x + 0.15, -1.8, 1.05),
            false,
            material("toy", lambert(0.8), 0.0),
        )
    })
}

#[test]
fn a_shot_shares_its_records_while_only_the_camera_moves() {
    let settings = settings(1);
    let mut frame = room(|b| b);
    let first = Tracer::new(&frame, &settings);
    render(&first);
    let records = first.cache().unwrap().records()[0];
    frame.number = 1;
    frame.camera.origin.x += 0.1;
    let second = Tracer::new(&frame, &settings);
    let (carried, shared) = first.cache().unwrap().carried(&first, &second);
    assert_eq!((shared.kept, shared.dropped), (vec![records], vec![0]));
    second.take_cache(carried).unwrap();
    second.plan();
    let more = second.cache().unwrap().records()[0] - records;
    assert!(more < records / 3, "{more} new records beside {records}");
    // An image for which it was planned needs nothing new.
    let again = Tracer::new(&frame, &settings);
    again.take_cache(second.cache().unwrap().clone()).unwrap();
    again.plan();
    assert_eq!(again.cache().unwrap().records(), second.cache().unwrap().records());
}

#[test]
fn a_cache_that_was_filled_is_not_smoothed_again_by_those_that_are_given_it() {
    for bounces in [1, 2] {
        let settings = settings(bounces);
        let mut frame = room(|b| b);
        let first = Tracer::new(&frame, &settings);
        let image = render(&first);
        let bytes = first.cache().unwrap().to_bytes();
        let given = || Cache::from_bytes(&bytes).unwrap().as_given(Shared::default());
        assert!(given().reading_nanos() > 0);
        let again = Tracer::new(&frame, &settings);
        again.take_cache(given()).unwrap();
        assert_eq!(bits(&render(&again)), bits(&image));
        assert_eq!(again.cache().unwrap().totals().fill.cpu_nanos, 0, "it gathered or smoothed something");

        // What others say stays as it was beside records of the frame's own, in memory and in a file.
        frame.camera.origin.x += 0.1;
        let one = Tracer::new(&frame, &settings);
        one.take_cache(first.cache().unwrap().clone()).unwrap();
        let other = Tracer::new(&frame, &settings);
        other.take_cache(given()).unwrap();
        assert_eq!(bits(&render(&one)), bits(&render(&other)));
        let of = |tracer: &Tracer| tracer.cache().unwrap().records()[0];
        assert!(of(&one) > of(&first));
        let third = Tracer::new(&frame, &settings);
        third.take_cache(Cache::from_bytes(&one.cache().unwrap().to_bytes()).unwrap()).unwrap();
        assert_eq!(bits(&render(&third)), bits(&render(&one)));
    }
}

#[test]
fn records_that_saw_something_move_are_dropped_and_planned_anew() {
    for bounces in [1, 2] {
        let settings = Settings { spp: 4, ..settings(bounces) };
        let before = Tracer::new(&with_box_at(-0.6), &settings);
        render(&before);
        let frame = with_box_at(-0.5);
        let after = Tracer::new(&frame, &settings);
        let (carried, shared) = before.cache().unwrap().carried(&before, &after);
        let (kept, dropped) = (shared.kept[0] as f64, shared.dropped[0] as f64);
        assert!(dropped > 0.0, "something must have seen the box");
        if bounces == 1 {
            assert!(kept > 0.5 * (kept + dropped), "{kept} of {} records kept", kept + dropped);
        }
        after.take_cache(carried).unwrap();
        let shared = render(&after);
        let fresh = render(&Tracer::new(&frame, &settings));
        let mean = |image: &Image| image.pixels.iter().map(|p| f64::from(p.color[1])).sum::<f64>();
        let square: f64 = fresh
            .pixels
            .iter()
            .zip(&shared.pixels)
            .map(|(a, b)| f64::from(a.color[1] - b.color[1]).powi(2))
            .sum();
        let error = (square / fresh.pixels.len() as f64).sqrt() / (mean(&fresh) / fresh.pixels.len() as f64);
        // Two fresh caches with different seeds differ by about as much.
        assert!(error < 0.03, "{bounces} bounces: {error}");
    }
    // If the light itself changes, nothing stays.
    let before = Tracer::new(&with_box_at(0.0), &settings(1));
    before.plan();
    let mut frame = with_box_at(0.0);
    let mut materials = frame.materials.to_vec();
    materials[4].emission.factor *= 2.0;
    frame.materials = materials.into();
    let (carried, shared) = before.cache().unwrap().carried(&before, &Tracer::new(&frame, &settings(1)));
    assert_eq!((carried.records(), shared.kept), (vec![], vec![0]));
}

#[test]
fn of_the_first_level_what_some_pixels_read_is_filled_and_enough_for_their_colours() {
    let pixels: Vec<u32> = (0..20).map(|i| i * 115).collect();
    for bounces in [1, 2] {
        // Deeper levels that are hardly noisy, since those of the part are not read at all.
        let cache = Some(CacheSettings { accuracy: 200, rays: 768 });
        let settings = Settings { spp: 5, cache, ..settings(bounces) };
        let frame = room(|b| b);
        let whole = Tracer::new(&frame, &settings);
        let image = render(&whole);
        let tracer = Tracer::new(&frame, &settings);
        let cost = pool(2).install(|| tracer.fill_for(&pixels, &|| false)).unwrap();
        let cache = tracer.cache().unwrap();
        let totals = cache.totals();
        let all: u64 = totals.records.iter().sum();
        assert!(totals.filled < all && totals.filled > 0, "{} of {all} records", totals.filled);
        assert!(cost.work > totals.fill.work, "finding them takes something too");
        let (mut filled, mut off, mut sum) = (0, 0.0, 0.0);
        for index in 0..totals.records[0] as usize {
            let Some(record) = cache.record(0, index) else { continue };
            let expected = whole.cache().unwrap().record(0, index).unwrap();
            filled += 1;
            if bounces == 1 {
                assert_eq!((record.irradiance, record.rays), (expected.irradiance, expected.rays));
            }
            off += (record.irradiance - expected.irradiance).abs().element_sum();
            sum += expected.irradiance.element_sum();
        }
        assert_eq!(filled, totals.filled, "deeper levels are followed by single rays");
        assert!(off < 0.02 * sum, "{bounces} bounces: records off by {} of the whole", off / sum);
        // More of the image's records are averaged.
        let (mut off, mut sum) = (0.0, 0.0);
        for (&index, pixel) in pixels.iter().zip(tracer.profile(&pixels)) {
            let expected = image.pixels[index as usize];
            assert_eq!((pixel.work, pixel.uncovered), (expected.work, expected.uncovered));
            off += (Vec3::from(pixel.color) - Vec3::from(expected.color)).abs().element_sum();
            sum += Vec3::from(expected.color).element_sum();
        }
        assert!(off < 0.05 * sum, "{bounces} bounces: off by {} of the whole", off / sum);
        // What is there is not gathered again.
        let again = tracer.fill_for(&pixels, &|| false).unwrap();
        assert!(again.work < cost.work && tracer.cache().unwrap().totals().filled == totals.filled);
    }
    let without = Tracer::new(&room(|b| b), &Settings { cache: None, ..settings(1) });
    assert_eq!(without.fill_for(&pixels, &|| true).unwrap().work, 0);
    let stopped = Tracer::new(&room(|b| b), &settings(1));
    assert!(stopped.fill_for(&pixels, &|| true).is_none());
    assert!(stopped.cache().unwrap().totals().filled < 8, "one on each thread at most");
}
