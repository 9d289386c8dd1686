//! Light by way of a small bright spot: the irradiance cache against the integral over the spot.

mod support;

use forelight_scene::{Environment, Frame, PointLight};
use forelight_tracer::{Cache, CacheSettings, Pixel, Settings, Tracer};
use glam::{Vec2, Vec3};
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;
use support::{Builder, lambert, material};

const CEILING: f32 = 2.5;
const LAMP: f32 = 1.9;
const INTENSITY: f32 = 50.0;
/// Cosines at which the lamp's cone begins and ends.
const CONE: (f32, f32) = (0.98, 0.96);
const REFLECTANCE: (f32, f32) = (0.7, 0.5);

/// A spot lamp that shines at a white ceiling above a grey floor. Nothing else reflects.
fn room() -> Frame {
    let half = Vec3::new(3.0, 0.0, 3.0);
    let mut frame = Builder::default()
        .quad(-half, Vec3::Z * 6.0, Vec3::X * 6.0, material("floor", lambert(REFLECTANCE.1), 0.0))
        .quad(
            -half + Vec3::Y * CEILING,
            Vec3::X * 6.0,
            Vec3::Z * 6.0,
            material("ceiling", lambert(REFLECTANCE.0), 0.0),
        )
        .frame(Vec3::new(1.2, 1.4, 0.3), Vec3::new(1.0, 0.0, 0.0), 24, Environment::Black);
    frame.points.push(PointLight {
        position: Vec3::new(0.0, LAMP, 0.0),
        intensity: Vec3::splat(INTENSITY),
        cone: Some((Vec3::Y, CONE.0, CONE.1)),
    });
    frame
}

/// Radiance of the floor at a point: the sum over the lit part of the ceiling of its radiance times the
/// form factor.
fn radiance(x: f64, z: f64) -> f64 {
    const STEPS: i32 = 200;
    let above = f64::from(CEILING - LAMP);
    let reach = above * (1.0 / f64::from(CONE.1).powi(2) - 1.0).sqrt();
    let step = 2.0 * reach / f64::from(STEPS);
    let place = |i: i32| (f64::from(i) + 0.5) * step - reach;
    let mut irradiance = 0.0;
    for (u, v) in (0..STEPS).flat_map(|i| (0..STEPS).map(move |j| (place(i), place(j)))) {
        let from_lamp2 = u * u + v * v + above * above;
        let cos = above / from_lamp2.sqrt();
        let (inner, outer) = (f64::from(CONE.0), f64::from(CONE.1));
        let falloff = ((cos - outer) / (inner - outer)).clamp(0.0, 1.0).powi(2);
        let ceiling = f64::from(INTENSITY) * falloff * cos / from_lamp2 * f64::from(REFLECTANCE.0) / PI;
        let height = f64::from(CEILING);
        let distance2 = (x - u).powi(2) + (z - v).powi(2) + height * height;
        irradiance += ceiling * (height * height / distance2) / distance2 * step * step;
    }
    irradiance * f64::from(REFLECTANCE.1) / PI
}

#[test]
fn the_cache_finds_a_small_bright_spot_and_shows_no_blotches() {
    let (frame, seeds) = (room(), 6u64);
    let (mut squares, mut mean, mut pixels, mut rays, mut records) = (0.0, 0.0, 0.0, 0, 0);
    for seed in 0..seeds {
        let settings = Settings {
            width: 24,
            height: 24,
            spp: 4,
            ambient_bounces: 1,
            cache: Some(CacheSettings { accuracy: 200, rays: 768 }),
            seed,
            ..Settings::default()
        };
        let tracer = Tracer::new(&frame, &settings);
        let image = tracer.render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels");
        let camera = &tracer.frame().camera;
        for (index, pixel) in image.pixels.iter().enumerate() {
            let (column, row) = (index as u32 % 24, index as u32 / 24);
            let direction = camera.direction(Vec2::new(column as f32 + 0.5, row as f32 + 0.5));
            let at = camera.origin - direction * (camera.origin.y / direction.y);
            let relative = f64::from(pixel.color[0]) / radiance(f64::from(at.x), f64::from(at.z)) - 1.0;
            squares += relative * relative;
            mean += relative;
            pixels += 1.0;
        }
        let cache = tracer.cache().expect("the floor reads it");
        let totals = cache.totals();
        assert!(totals.secondary_lights > 0, "the spot on the ceiling is one");
        let again = Tracer::new(&frame, &settings);
        again
            .take_cache(Cache::from_bytes(&cache.to_bytes()).expect("it is whole"))
            .expect("it is of this frame");
        let from_file = again.render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels");
        let same = |(a, b): (&Pixel, &Pixel)| a.color == b.color && a.work == b.work;
        assert!(image.pixels.iter().zip(&from_file.pixels).all(same), "the file has the secondary lights");
        rays += totals.fill_rays[5] + totals.plan_rays[5];
        records += totals.records[0];
    }
    let (rms, mean) = ((squares / pixels).sqrt(), mean / pixels);
    assert!(rms < 0.1, "rms {rms}");
    assert!(mean.abs() < 0.02, "mean {mean}");
    assert!(rays < records * 900, "{rays} rays for {records} records");
}
