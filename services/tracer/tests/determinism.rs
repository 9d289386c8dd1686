//! The same bits, whoever renders.

mod support;

use forelight_protocol::Integrator;
use forelight_scene::Frame;
use forelight_tracer::{Image, Passes, Pixel, Profile, SampleCounts, SampleCountsError, Settings, Tracer};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use support::everything;

fn settings() -> Settings {
    Settings {
        width: 40,
        height: 28,
        spp: 2,
        ambient_bounces: 2,
        ambient_divisions: 8,
        ..Settings::default()
    }
}

fn with_threads(threads: usize, reuse: Option<&Profile>) -> Image {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    let tracer = Tracer::new(&everything(), &settings());
    pool.install(|| tracer.render(reuse, &|_| {}, &AtomicBool::new(false))).expect("nobody cancels")
}

/// Colour, rays, work, the same by ray, and stratum of a pixel.
type Bits = ([u32; 3], [u32; 7], u64, [u64; 7], u32);

fn bits(pixels: &[Pixel]) -> Vec<Bits> {
    pixels.iter().map(|p| (p.color.map(f32::to_bits), p.rays, p.work, p.work_by_ray, p.stratum)).collect()
}

#[test]
fn one_two_and_seven_threads_give_the_same_bits() {
    let one = with_threads(1, None);
    assert!(
        one.totals().rays.iter().all(|&r| r > 0),
        "every kind of ray must be exercised: {:?}",
        one.totals()
    );
    for threads in [2, 7] {
        assert_eq!(bits(&one.pixels), bits(&with_threads(threads, None).pixels), "{threads} threads");
    }
}

#[test]
fn profiled_pixels_taken_over_give_the_same_image_and_are_not_traced_again() {
    let tracer = Tracer::new(&everything(), &settings());
    let chosen: Vec<u32> = (0..40 * 28).filter(|i| i % 7 == 3).rev().collect();
    let pixels = chosen.iter().copied().zip(tracer.profile(&chosen)).collect();
    let profile = Profile { origin: tracer.origin(), fingerprint: tracer.fingerprint(), pixels, cache: None };
    let profile = Profile::from_bytes(&profile.to_bytes()).expect("reads back");
    let whole = with_threads(2, None);
    let with_reuse = with_threads(2, Some(&profile));
    assert_eq!(bits(&whole.pixels), bits(&with_reuse.pixels));
    assert_eq!(with_reuse.reused_totals().pixels, chosen.len() as u64);
    assert_eq!(whole.totals().work, with_reuse.totals().work);
    // Taken over means taken over: the profile's own clock readings are still there.
    for (index, pixel) in &profile.pixels {
        assert_eq!(with_reuse.pixels[*index as usize].cpu_nanos, pixel.cpu_nanos);
    }
}

#[test]
fn camera_samples_that_are_told_are_those_of_the_pixel_and_of_an_image_of_fewer() {
    let chosen: Vec<u32> = (0..40 * 28).filter(|i| i % 37 == 5).collect();
    let told = |spp: u32| {
        let tracer = Tracer::new(&everything(), &Settings { spp, ..settings() });
        let mut samples = vec![Vec::new(); chosen.len()];
        let mut each = |place: usize, sample| samples[place].push(sample);
        let pixels = tracer.profile_samples(&chosen, &mut each, &|| false).unwrap();
        assert_eq!(bits(&pixels), bits(&tracer.profile(&chosen)));
        for (pixel, samples) in pixels.iter().zip(&samples) {
            assert_eq!(samples.len(), spp as usize);
            let mean = |c: usize| samples.iter().map(|s| f64::from(s[c])).sum::<f64>() / f64::from(spp);
            assert_eq!(pixel.color, [0, 1, 2].map(|c| mean(c) as f32));
        }
        samples
    };
    let (few, many) = (told(2), told(8));
    assert!(few.iter().zip(&many).all(|(few, many)| few[..] == many[..2]));
}

#[test]
fn a_fingerprint_changes_with_anything_that_changes_the_image() {
    let base = Tracer::new(&everything(), &settings()).fingerprint();
    let moved = {
        let mut f = everything();
        f.camera.origin.x += 1e-3;
        Tracer::new(&f, &settings()).fingerprint()
    };
    let reseeded = Tracer::new(&everything(), &Settings { seed: 1, ..settings() }).fingerprint();
    let later = Tracer::new(&Frame { number: 1, ..everything() }, &settings()).fingerprint();
    let all = [base, moved, reseeded, later];
    for i in 0..all.len() {
        for j in 0..i {
            assert_ne!(all[i], all[j], "{i} and {j}");
        }
    }
}

#[test]
fn a_pixel_with_samples_of_its_own_is_that_of_an_image_of_so_many() {
    let (frame, settings) = (everything(), settings());
    let counts: Vec<u16> = (0..40 * 28).map(|pixel| if pixel % 3 == 0 { 5 } else { 2 }).collect();
    let tracer = Tracer::new(&frame, &settings);
    let plain = tracer.fingerprint();
    assert_eq!(SampleCounts::new(vec![1, 0]), Err(SampleCountsError::None(1)));
    let few = SampleCounts::new(vec![1; 7]).unwrap();
    assert_eq!(tracer.allot(few), Err(SampleCountsError::Length { found: 7, expected: 40 * 28 }));
    let counts = SampleCounts::new(counts).unwrap();
    tracer.allot(counts.clone()).unwrap();
    assert_eq!(tracer.allot(counts), Err(SampleCountsError::Late));
    assert_ne!(tracer.fingerprint(), plain);
    let whole = |tracer: &Tracer| tracer.render(None, &|_| (), &AtomicBool::new(false)).unwrap();
    let mixed = whole(&tracer);
    let images = [2, 5].map(|spp| whole(&Tracer::new(&frame, &Settings { spp, ..settings.clone() })));
    for (pixel, mixed) in mixed.pixels.iter().enumerate() {
        let alike = &images[usize::from(pixel % 3 == 0)].pixels[pixel];
        assert_eq!(bits(&[*mixed]), bits(&[*alike]), "pixel {pixel}");
    }
}

#[test]
fn an_image_made_in_passes_has_the_bits_of_one_made_at_once() {
    for integrator in [Integrator::Ambient, Integrator::Path] {
        let settings = Settings { integrator, ..settings() };
        let counts = |of: &dyn Fn(usize) -> usize| {
            SampleCounts::new((0..40 * 28).map(|pixel| of(pixel) as u16).collect()).unwrap()
        };
        let finally = |pixel: usize| if pixel % 50 == 3 { 70 } else { 1 + pixel % 7 };
        let tracer = Tracer::new(&everything(), &settings);
        let mut passes = Passes::new(&tracer);
        assert!(passes.counts().is_err(), "no pixel has a sample yet");
        let mut work = 0;
        for wanted in [counts(&|_| 1), counts(&|pixel| finally(pixel).min(3)), counts(&finally)] {
            work += passes.go_on(&tracer, &wanted, &|| false, &|_| ()).unwrap().work;
        }
        // What a pixel has got it keeps.
        assert_eq!(passes.go_on(&tracer, &counts(&|_| 1), &|| false, &|_| ()).unwrap().work, 0);
        assert_eq!(passes.counts(), Ok(counts(&finally)));
        let at_once = Tracer::new(&everything(), &settings);
        at_once.allot(counts(&finally)).unwrap();
        let at_once = at_once.render(None, &|_| (), &AtomicBool::new(false)).unwrap();
        assert_eq!(bits(&passes.image().pixels), bits(&at_once.pixels), "{integrator:?}");
        assert_eq!(work, at_once.totals().work);
        assert_eq!(tracer.work_by_class().0.iter().sum::<u64>(), work, "classes are parts of the whole");
    }
}

#[test]
fn what_the_later_samples_changed_is_known_whatever_the_passes() {
    let tracer = Tracer::new(&everything(), &settings());
    let all = |samples: u16| SampleCounts::new(vec![samples; 40 * 28]).unwrap();
    let image = |samples: u16| {
        let mut passes = Passes::new(&tracer);
        passes.go_on(&tracer, &all(samples), &|| false, &|_| ()).unwrap();
        passes.image().pixels
    };
    let mut passes = Passes::new(&tracer);
    for (samples, before) in [(1, 0), (2, 1), (3, 1), (6, 2), (7, 2), (8, 4), (48, 16)] {
        passes.go_on(&tracer, &all(samples), &|| false, &|_| ()).unwrap();
        if before == 0 {
            assert!(passes.so_far().iter().all(|pixel| pixel.grown.is_none()));
            continue;
        }
        let (then, now) = (image(before), image(samples));
        for (pixel, (then, now)) in passes.so_far().iter().zip(then.iter().zip(&now)) {
            let grown = pixel.grown.unwrap();
            let changes = then.color.iter().zip(now.color).map(|(then, now)| f64::from(now - then).powi(2));
            let square = changes.sum::<f64>() / 3.0;
            assert_eq!(grown.before, u32::from(before));
            assert!((grown.square.sqrt() - square.sqrt()).abs() < 1e-5, "{samples}: {grown:?}, {square}");
        }
    }
}

#[test]
fn a_pass_that_is_stopped_leaves_every_pixel_with_the_samples_that_it_says() {
    let tracer = Tracer::new(&everything(), &settings());
    let all = |samples: u16| SampleCounts::new(vec![samples; 40 * 28]).unwrap();
    let mut passes = Passes::new(&tracer);
    passes.go_on(&tracer, &all(1), &|| false, &|_| ()).unwrap();
    let asked = AtomicU32::new(0);
    passes.go_on(&tracer, &all(3), &|| asked.fetch_add(1, Ordering::Relaxed) >= 400, &|_| ()).unwrap();
    let counts = passes.counts().unwrap();
    let given = counts.as_slice().iter().filter(|&&count| count == 3).count();
    assert_eq!(given, 400);
    let again = Tracer::new(&everything(), &settings());
    again.allot(counts).unwrap();
    let again = again.render(None, &|_| (), &AtomicBool::new(false)).unwrap();
    assert_eq!(bits(&passes.image().pixels), bits(&again.pixels));
}

#[test]
fn a_cancelled_render_has_no_image() {
    let tracer = Tracer::new(&everything(), &settings());
    assert!(tracer.render(None, &|_| {}, &AtomicBool::new(true)).is_none());
}
