//! Renders to an error, on the shipped kitchen.

mod common;

use common::{Nobody, kitchen, scene};
use forelight_protocol::{CacheMode, Confidence, RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::{
    Aim, AllotError, AllotOptions, Allotted, Given, Rendered, render_allotted, render_as_allotted,
    render_frame,
};
use std::sync::atomic::AtomicBool;

fn settings(spp: u32) -> RenderSettings {
    let request = RenderSettingsRequest {
        spp: Some(spp),
        ambient_bounces: Some(0),
        ..RenderSettingsRequest::default()
    };
    request.complete((64, 36))
}

fn allotted(aim: Aim<'_>) -> Result<Allotted, AllotError> {
    allotted_with(aim, &settings(1))
}

fn allotted_with(aim: Aim<'_>, settings: &RenderSettings) -> Result<Allotted, AllotError> {
    let options = AllotOptions { aim, confidence: Confidence::P50, samples: 256, seed: 3 };
    let (shot, nobody) = (kitchen(), Nobody::default());
    let rendered = render_allotted(&shot, 0, settings, Given::default(), &options, &|_| (), &nobody);
    rendered.map(Option::unwrap)
}

fn uniform(spp: u32, seed: u64) -> Rendered {
    let settings = RenderSettings { seed, ..settings(spp) };
    let rendered = render_frame(&kitchen(), 0, &settings, Given::default(), &|_| (), &AtomicBool::new(false));
    rendered.unwrap().unwrap()
}

/// Root mean square over pixels and channels, as a share of the reference's mean.
fn error(image: &Rendered, reference: &Rendered) -> f64 {
    let (mut squares, mut sum, mut count) = (0.0, 0.0, 0.0);
    for (a, b) in image.image.pixels.iter().zip(&reference.image.pixels) {
        for (a, b) in a.color.iter().zip(b.color) {
            squares += f64::from(a - b).powi(2);
            sum += f64::from(b);
            count += 1.0;
        }
    }
    (squares / count).sqrt() / (sum / count)
}

#[test]
fn an_error_that_is_asked_for_is_made_with_less_work_than_equally_many_samples_everywhere() {
    let reference = uniform(1024, 77);
    let image = allotted(Aim::Error(0.04)).unwrap().rendered;
    let made = error(&image, &reference);
    let samples = image.stats.allotted.clone().unwrap();
    // An error up to a hundredth above the target is accepted.
    assert!(samples.error.p50 > 0.035 && samples.error.p50 < 1.01 * 0.04, "{samples:?}");
    assert!(made > 0.02 && made < 0.06, "asked for 4 %, made {made}");
    assert!(samples.most > 4 * samples.least, "edges of lamps need more than walls: {samples:?}");
    let work = image.stats.work as f64;
    let forecast = samples.forecast.unwrap().work;
    assert!((forecast.p50 / work - 1.0).abs() < 0.1, "forecast {forecast:?}, took {work}");
    // Uniform images of less and of more work.
    let at_equal_work = [64, 128, 256, 512].map(|spp| uniform(spp, 1));
    let worse = at_equal_work.iter().rfind(|other| (other.stats.work as f64) < work).unwrap();
    let better = at_equal_work.iter().find(|other| (other.stats.work as f64) >= work).unwrap();
    let between = (error(worse, &reference) * error(better, &reference)).sqrt();
    assert!(made < between, "{made} with samples where they pay, {between} with equally many everywhere");
}

#[test]
fn what_a_frame_takes_whose_samples_are_where_dear_pixels_are_is_forecast_too() {
    // In the corridor, the tiles that need most samples have the cheapest pixels of their zones. With a
    // cache, the first samples of a pixel cost more than later ones.
    let settings = RenderSettings { ambient_bounces: 1, cache: CacheMode::On, ..settings(1) };
    for (profiled, tolerance) in [(256, 0.06), (64 * 36, 0.015)] {
        let options =
            AllotOptions { aim: Aim::Error(0.03), confidence: Confidence::P50, samples: profiled, seed: 3 };
        let (shot, nobody) = (scene("corridor"), Nobody::default());
        let made = render_allotted(&shot, 0, &settings, Given::default(), &options, &|_| (), &nobody);
        let stats = made.unwrap().unwrap().rendered.stats;
        let (forecast, work) = (stats.allotted.unwrap().forecast.unwrap().work, stats.work as f64);
        let off = forecast.p50 / work - 1.0;
        assert!(off.abs() < tolerance, "{profiled} pixels: {forecast:?}, took {work}, {:+.1} %", 100.0 * off);
    }
}

#[test]
fn an_image_of_an_error_hangs_on_no_threads_and_is_made_again_of_its_samples() {
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| allotted(Aim::Error(0.15)).unwrap())
    };
    let (one, three) = (made(1), made(3));
    let samples = &one.samples;
    let nobody = Nobody::default();
    let again = render_as_allotted(&kitchen(), 0, &settings(1), Given::default(), samples, &|_| (), &nobody);
    let again = again.unwrap().unwrap();
    let bits =
        |made: &Rendered| made.image.pixels.iter().map(|p| p.color.map(f32::to_bits)).collect::<Vec<_>>();
    assert_eq!(one.samples, three.samples);
    for other in [&three.rendered, &again.rendered] {
        assert_eq!(bits(&one.rendered), bits(other));
        assert_eq!((one.rendered.stats.work, one.rendered.stats.rays), (other.stats.work, other.stats.rays));
    }
}

#[test]
fn images_of_few_pixels_come_to_an_end_and_so_does_an_error_that_cannot_be_had() {
    for (width, height, wanted) in [(1, 1, 0.2), (3, 1, 0.05), (9, 2, 0.1), (1, 1, 1e-9), (2, 2, 1e9)] {
        let settings = RenderSettings { width, height, ..settings(1) };
        let made = allotted_with(Aim::Error(wanted), &settings).unwrap();
        let (least, most, _) = made.samples.range();
        assert!(least >= 1 && most <= 65_535, "{width} x {height}, {wanted}: {least} to {most}");
        assert!(made.rendered.stats.allotted.unwrap().error.p95.is_finite());
    }
}
