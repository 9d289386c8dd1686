//! What pixels show, for denoisers; and independent samples of them.

mod support;

use forelight_scene::{Color, Environment, Frame, Surface};
use forelight_tracer::{Feature, Settings, Tracer};
use glam::Vec3;
use support::{Builder, everything, lambert, material};

const SIZE: u32 = 8;

fn settings() -> Settings {
    Settings {
        width: SIZE,
        height: SIZE,
        spp: 4,
        ambient_bounces: 1,
        ambient_divisions: 4,
        ..Settings::default()
    }
}

fn features(frame: &Frame) -> Vec<Feature> {
    Tracer::new(frame, &settings()).features(4, &|| false).expect("nobody stops").0
}

/// A grey floor below the camera, which looks down at what lies on it. Above is a sky of radiance 0.25.
fn seen_from_above(on_it: impl FnOnce(Builder) -> Builder) -> Vec<Feature> {
    let floor = material("floor", lambert(0.5), 0.0);
    let floor = Builder::default().quad(Vec3::new(-9.0, 0.0, -9.0), 18.0 * Vec3::Z, 18.0 * Vec3::X, floor);
    let sky = Environment::Constant(Vec3::splat(0.25));
    features(&on_it(floor).frame(Vec3::new(0.0, 4.0, 0.1), Vec3::ZERO, SIZE, sky))
}

/// A square one metre above the floor, which fills the view.
fn square(builder: Builder, surface: Surface, emission: f32) -> Builder {
    let at = Vec3::new(-4.0, 1.0, -4.0);
    builder.quad(at, 8.0 * Vec3::Z, 8.0 * Vec3::X, material("square", surface, emission))
}

#[track_caller]
fn all_are(found: &[Feature], albedo: f32, normal: Vec3) {
    for feature in found {
        assert!((feature.albedo - albedo).abs().max_element() < 1e-6, "{feature:?}");
        assert!((feature.normal - normal).length() < 1e-5, "{feature:?}");
    }
}

#[test]
fn pixels_show_the_colour_and_normal_of_what_they_meet() {
    all_are(&seen_from_above(|floor| floor), 0.5, Vec3::Y);
    all_are(&seen_from_above(|floor| square(floor, lambert(0.2), 0.0)), 0.2, Vec3::Y);
    // A light is as bright as it can be.
    all_are(&seen_from_above(|floor| square(floor, lambert(0.2), 7.0)), 1.0, Vec3::Y);
}

#[test]
fn mirrors_show_what_they_reflect_and_panes_what_is_behind_them() {
    let color = |value| Color::plain(Vec3::splat(value));
    // A mirror of this reflectance at any angle, under the sky.
    let mirror = Surface::Metal { f0: color(1.0), alpha: 0.0 };
    all_are(&seen_from_above(|floor| square(floor, mirror, 0.0)), 0.25, Vec3::ZERO);
    let pane = Surface::ThinGlass { ior: 1.5, transmittance: color(0.5) };
    all_are(&seen_from_above(|floor| square(floor, pane, 0.0)), 0.25, Vec3::Y);
}

#[test]
fn features_are_finite_and_in_range_and_the_same_on_any_number_of_threads() {
    let frame = everything();
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| features(&frame))
    };
    let found = on(1);
    assert!(found == on(3));
    for Feature { albedo, normal } in found {
        assert!(albedo.is_finite() && albedo.min_element() >= 0.0 && albedo.max_element() <= 1.0, "{albedo}");
        assert!(normal.is_finite() && normal.length() < 1.0 + 1e-5, "{normal}");
    }
}

#[test]
fn independent_samples_have_the_mean_of_the_image_and_differ_from_each_other() {
    let frame = everything();
    let tracer = Tracer::new(&frame, &settings());
    let pixels: Vec<u32> = (0..SIZE * SIZE).collect();
    let (traced, cost) = tracer.independent_pixels(&pixels, (64, 4), &|| false).expect("nobody stops");
    let (again, _) = tracer.independent_pixels(&pixels, (64, 4), &|| false).expect("nobody stops");
    let image = tracer.profile(&pixels);
    let (mut noisy, mut repeated) = (0, 0);
    assert_eq!(cost.work, traced.iter().flatten().map(|pixel| pixel.work).sum::<u64>());
    for (pixel, (traced, again)) in image.iter().zip(traced.iter().zip(&again)) {
        let colors = |pixels: &[forelight_tracer::Pixel]| pixels.iter().map(|p| p.color).collect::<Vec<_>>();
        assert_eq!(colors(traced), colors(again));
        let values: Vec<f64> = traced.iter().map(|pixel| f64::from(pixel.color[1])).collect();
        let mean = values.iter().sum::<f64>() / 64.0;
        let deviation = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 63.0).sqrt();
        // The image has 4 samples too. Rare bright samples are allowed for.
        let difference = (f64::from(pixel.color[1]) - mean).abs();
        assert!(difference <= 8.0 * deviation + 1e-6, "{} is not {mean} ± {deviation}", pixel.color[1]);
        // The sky has no noise.
        if deviation > 1e-6 {
            noisy += 1;
            repeated += traced.iter().filter(|other| other.color == pixel.color).count();
        }
    }
    // Behind glass, four samples take few values.
    assert!(
        noisy > 20 && repeated < noisy * 64 / 10,
        "{repeated} of {noisy} × 64 values are those of the image"
    );
    assert_eq!(tracer.independent_pixels(&pixels, (1, 1), &|| true), None);
}
