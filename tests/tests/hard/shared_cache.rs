//! The irradiance cache across threads and frames.

use crate::cache::{AT_THE_NOOK, image, nook, records, settings, wall};
use forelight_tests::case::case;
use forelight_tests::world::{View, World, bits, lambert, material, values};
use forelight_tracer::{Image, Settings, Tracer};
use glam::{DVec3, Vec3};

#[test]
fn plan_records_and_image_are_the_same_for_any_number_of_threads() {
    let frame = nook().frame(AT_THE_NOOK);
    let settings = Settings { ambient_bounces: 2, ..settings(32, 300, 192) };
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let tracer = Tracer::new(&frame, &settings);
        pool.install(|| tracer.plan());
        let planned = records(&tracer);
        let image = pool.install(|| image(&tracer));
        let cache = tracer.cache().expect("a cache").without_times();
        (planned, cache.totals().filled, cache.to_bytes(), bits(&image))
    };
    let one = made(1);
    assert!(one.0 > 100, "{} records", one.0);
    let (mut wrong, mut unequal) = (0, u64::from(one.0 != one.1));
    for threads in [2, 7, 64] {
        let many = made(threads);
        wrong += u64::from(many.2 != one.2) + u64::from(many.3 != one.3);
        unequal += u64::from(many.0 != many.1);
    }
    case(20, "caches and images of 2, 7 and 64 threads that differ from one thread's by a bit")
        .never(wrong, 6);
    case(20, "caches whose filled records are not as many as were forecast by the plan").never(unequal, 4);
}

/// A long hall with a box at its far end, at `x`.
fn hall(x: f64) -> World {
    let (low, high) = (DVec3::new(-2.0, 0.0, -20.0), DVec3::new(2.0, 2.5, 0.0));
    let mut world = World::default().cuboid(low, high, true, wall(0.6)).cuboid(
        DVec3::new(x - 0.3, 0.0, -18.6),
        DVec3::new(x + 0.3, 0.6, -18.0),
        false,
        wall(0.4),
    );
    for i in 0..5 {
        let z = -2.0 - 4.0 * f64::from(i);
        world = world.ceiling(DVec3::new(0.0, 2.45, z), 0.3, material(lambert(0.0), 6.0));
    }
    world
}

#[test]
fn what_a_moved_object_does_not_touch_is_used_again_and_what_it_does_is_not() {
    let view = View::new(DVec3::new(0.0, 1.5, -0.3), DVec3::new(0.0, 1.0, -10.0), 0.8);
    let settings = Settings { spp: 16, ..settings(40, 200, 768) };
    let before = Tracer::new(&hall(-0.8).frame(view), &settings);
    image(&before);
    let after = hall(0.6).frame(view);
    let carried = Tracer::new(&after, &settings);
    let (cache, shared) = before.cache().expect("a cache").carried(&before, &carried);
    let kept: Vec<Vec3> = cache.planned(0).iter().map(|planned| planned.site.position).collect();
    let far = |p: &&Vec3| p.z > -9.0;
    let old = before
        .cache()
        .expect("a cache")
        .planned(0)
        .iter()
        .filter(|planned| planned.site.position.z > -9.0)
        .count();
    let reused = kept.iter().filter(far).count() as f64 / old as f64;
    println!(
        "         kept {:?}, dropped {:?}; {old} records nine metres and more away",
        shared.kept, shared.dropped
    );
    carried.take_cache(cache).expect("it was carried to this frame");
    let (carried, fresh) = (image(&carried), image(&Tracer::new(&after, &settings)));
    let other_seed = image(&Tracer::new(&after, &Settings { seed: 5, ..settings }));
    let apart = |a: &Image, b: &Image| {
        let square: f64 = values(a).iter().zip(values(b)).map(|(x, y)| (x - y) * (x - y)).sum();
        (square / a.pixels.len() as f64).sqrt()
    };
    assert!(old > 50 && shared.dropped[0] > 0);
    case(21, "records nine metres and more from a moved object that are used again, share")
        .least(reused, 0.95);
    // Another seed moves every record. Carried records must not differ more from fresh ones.
    let ratio = apart(&carried, &fresh) / apart(&fresh, &other_seed);
    case(21, "image from carried records against a fresh one, in units of another seed's difference")
        .worst(ratio, 1.1);
    // A changed light invalidates all records.
    let mut brighter = hall(0.6);
    brighter.points.push((DVec3::new(0.0, 2.0, -5.0), 1.0));
    let brighter = Tracer::new(&brighter.frame(view), &settings);
    let (_, shared) = before.cache().expect("a cache").carried(&before, &brighter);
    case(21, "records that are used again under another light")
        .never(shared.kept.iter().sum(), shared.dropped.iter().sum());
}
