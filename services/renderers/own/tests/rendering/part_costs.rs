//! Where parts of equal forecast cost end, against the costs of their pixels.

use forelight_forecast::PixelCurve;
use forelight_preview::Choice;
use forelight_protocol::{CacheMode, Integrator, RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::{Given, OwnRenderer, OwnShot, render_frame};
use forelight_tracer::Image;
use std::path::Path;
use std::sync::atomic::AtomicBool;

fn scene(name: &str) -> OwnShot {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../deploy/scenes");
    OwnRenderer::new(Choice::Cpu).open(&scenes.join(name)).unwrap()
}

/// Small images with as many samples as those that are worth dividing: 8 parts of 1,000 pixels.
fn settings(integrator: Integrator, bounces: u32, cache: CacheMode) -> RenderSettings {
    let request = RenderSettingsRequest {
        spp: Some(16),
        integrator: Some(integrator),
        ambient_bounces: Some(bounces),
        ambient_divisions: Some(4),
        cache: Some(cache),
        cache_rays: Some(48),
        ..Default::default()
    };
    request.complete((128, 72))
}

fn whole(shot: &OwnShot, settings: &RenderSettings) -> Image {
    let never = AtomicBool::new(false);
    render_frame(shot, 0, settings, Given::default(), &|_| (), &never).unwrap().unwrap().image
}

/// Bounds fit one deterministic run, with room for a change of samples.
#[test]
fn parts_cost_about_the_same_and_about_what_is_forecast_of_them() {
    for name in ["kitchen", "corridor"] {
        let shot = scene(name);
        for (integrator, bounces, cache) in [
            (Integrator::Ambient, 1, CacheMode::Off),
            (Integrator::Path, 4, CacheMode::Off),
            (Integrator::Ambient, 1, CacheMode::On),
        ] {
            let settings = settings(integrator, bounces, cache);
            let image = whole(&shot, &settings);
            let curve = PixelCurve::new(settings.width, settings.height);
            let divided = shot.frame(0, &settings).unwrap().divide(8, &[], &|| false).unwrap();
            let mut from = 0;
            let found = divided.parts.iter().map(|part| {
                let pixels = curve.pixels(std::mem::replace(&mut from, part.to)..part.to);
                pixels.iter().map(|&pixel| image.pixels[pixel as usize].work).sum::<u64>()
            });
            let found: Vec<u64> = found.collect();
            assert_eq!(from, curve.count());
            let all = image.totals().work as f64;
            let forecast: u64 = divided.parts.iter().map(|part| part.cost).sum();
            let most = *found.iter().max().unwrap() as f64 * 8.0 / all;
            let probed = divided.spent.work as f64 / all;
            println!(
                "{name} {integrator:?} {cache:?}: {most:.3}, {:+.3}, {probed:.4}",
                forecast as f64 / all - 1.0
            );
            assert!(most < 1.1, "{name} {integrator:?} {cache:?}: {most}");
            assert!((forecast as f64 / all - 1.0).abs() < 0.06, "{forecast} of {all}");
            assert!(probed < 0.025, "{probed}");
        }
    }
}

#[test]
fn a_frame_is_divided_the_same_way_on_any_number_of_threads_and_finished_pixels_cost_nothing() {
    let shot = scene("corridor");
    let settings = settings(Integrator::Ambient, 0, CacheMode::Off);
    let image = whole(&shot, &settings);
    let divided = |threads: usize, finished: &[_]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let ready = shot.frame(0, &settings).unwrap();
        pool.install(|| ready.divide(4, finished, &|| false)).unwrap().parts
    };
    let open = divided(1, &[]);
    assert_eq!(open, divided(3, &[]));
    // The first part is finished already: its pixels go to the first of four new parts, which share the rest.
    let curve = PixelCurve::new(settings.width, settings.height);
    let first = curve.pixels(0..open[0].to);
    let finished: Vec<_> = first.iter().map(|&index| (index, image.pixels[index as usize])).collect();
    let rest = divided(1, &finished);
    assert!(rest[0].to > open[0].to, "{rest:?} after {open:?}");
    let sum = |parts: &[forelight_forecast::Stretch]| parts.iter().map(|part| part.cost).sum::<u64>();
    let share = sum(&rest) as f64 / sum(&open) as f64;
    assert!((share - 0.75).abs() < 0.01, "{share} of the cost is left");
    assert!(rest.iter().all(|part| (part.cost as f64 * 4.0 / sum(&rest) as f64 - 1.0).abs() < 0.01));
}
