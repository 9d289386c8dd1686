//! Camera samples by what they come to, on the kitchen that ships with the project.

mod common;

use common::{Nobody, kitchen};
use forelight_protocol::{Confidence, RenderSettings, RenderSettingsRequest};
use forelight_tracer::{SampleCounts, process_cpu_nanos};
use forelight_worker::{
    Aim, AllotError, AllotOptions, Allotted, Budget, Given, Rendered, Stopwatch, render_allotted,
    render_as_allotted, render_frame,
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
    let options = AllotOptions { aim, confidence: Confidence::P50, samples: 256, seed: 3 };
    let (shot, nobody) = (kitchen(), Nobody::default());
    let rendered = render_allotted(&shot, 0, &settings(1), Given::default(), &options, &|_| (), &nobody);
    rendered.map(Option::unwrap)
}

/// CPU seconds from now on; other tests of this process count too.
fn cpu_seconds(seconds: f64) -> Aim<'static> {
    Aim::Within(Budget { seconds, clock: Stopwatch::Cpu(process_cpu_nanos()), rehearse: &|_, _| () })
}

fn uniform(spp: u32) -> Rendered {
    let rendered =
        render_frame(&kitchen(), 0, &settings(spp), Given::default(), &|_| (), &AtomicBool::new(false));
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
    let reference = uniform(1024);
    let image = allotted(Aim::Error(0.04)).unwrap().rendered;
    let made = error(&image, &reference);
    let samples = image.stats.allotted.clone().unwrap();
    assert!((samples.error.p50 / 0.04 - 1.0).abs() < 0.01, "{samples:?}");
    assert!(made > 0.02 && made < 0.08, "asked for 4 %, made {made}");
    assert!(samples.most > 4 * samples.least, "edges of lamps need more than walls: {samples:?}");
    let work = image.stats.work as f64;
    assert!((samples.work.p50 / work - 1.0).abs() < 0.1, "forecast {:?}, took {work}", samples.work);
    // Uniform images on both sides of that work.
    let at_equal_work = [64, 128, 256].map(uniform);
    let worse = at_equal_work.iter().rfind(|other| (other.stats.work as f64) < work).unwrap();
    let better = at_equal_work.iter().find(|other| (other.stats.work as f64) >= work).unwrap();
    let between = (error(worse, &reference) * error(better, &reference)).sqrt();
    assert!(made < between, "{made} with samples where they pay, {between} with equally many everywhere");
}

#[test]
fn more_time_buys_more_samples_and_too_little_is_refused_with_what_it_takes() {
    let refused = allotted(cpu_seconds(1e-6)).unwrap_err();
    let AllotError::TooLittle { given, least } = refused else { panic!("{refused}") };
    assert!(given < least && least < 60.0, "{least}");
    // How many they are depends on the machine's speed while it rendered, how they lie does not.
    let [few, many] = [3.0, 9.0].map(|times| allotted(cpu_seconds(times * least)).unwrap());
    let [few_stats, many_stats] = [&few, &many].map(|made| made.rendered.stats.allotted.clone().unwrap());
    assert!(many_stats.mean > 1.3 * few_stats.mean, "{few_stats:?} {many_stats:?}");
    assert!(many_stats.error.p50 < few_stats.error.p50);
    let within = many_stats.within.unwrap();
    assert!(within.passes > 2 && within.spent_seconds <= 1.02 * within.given_seconds, "{within:?}");
}

#[test]
fn what_the_clock_decided_can_be_rendered_again_to_the_last_bit() {
    let seconds = match allotted(cpu_seconds(1e-6)) {
        Err(AllotError::TooLittle { least, .. }) => 4.0 * least,
        _ => panic!("a microsecond is too little"),
    };
    let made = allotted(cpu_seconds(seconds)).unwrap();
    let (shot, nobody) = (kitchen(), Nobody::default());
    let again = render_as_allotted(&shot, 0, &settings(1), Given::default(), &made.samples, &|_| (), &nobody);
    let again = again.unwrap().unwrap().rendered;
    let bits =
        |made: &Rendered| made.image.pixels.iter().map(|p| p.color.map(f32::to_bits)).collect::<Vec<_>>();
    assert_eq!(bits(&made.rendered), bits(&again));
    assert_eq!((made.rendered.stats.work, made.rendered.stats.rays), (again.stats.work, again.stats.rays));
    let few = SampleCounts::new(vec![1; 5]).unwrap();
    assert!(
        render_as_allotted(&shot, 0, &settings(1), Given::default(), &few, &|_| (), &nobody).is_err(),
        "5 numbers are not for 64 x 36 pixels"
    );
}
