//! A frame with a time limit, on the shipped kitchen. One test only, as the clock counts the whole process.

mod common;

use common::{Nobody, kitchen};
use forelight_protocol::{Confidence, RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::{
    Aim, AllotError, AllotOptions, Allotted, Budget, Given, Rendered, Stopwatch, render_allotted,
    render_as_allotted,
};
use forelight_tracer::{SampleCounts, process_cpu_nanos};

fn settings() -> RenderSettings {
    let request = RenderSettingsRequest { ambient_bounces: Some(0), ..RenderSettingsRequest::default() };
    request.complete((64, 36))
}

/// Renders in this many CPU seconds from now.
fn within(seconds: f64) -> Result<Allotted, AllotError> {
    let clock = Stopwatch::Cpu(process_cpu_nanos());
    let aim = Aim::Within(Budget { seconds, clock, rehearse: &|_, _| () });
    let options = AllotOptions { aim, confidence: Confidence::P50, samples: 256, seed: 3 };
    let made =
        render_allotted(&kitchen(), 0, &settings(), Given::default(), &options, &|_| (), &Nobody::default());
    made.map(Option::unwrap)
}

#[test]
fn a_longer_time_buys_more_and_what_the_clock_decided_is_made_again_to_the_last_bit() {
    let refused = within(1e-6).unwrap_err();
    let AllotError::TooLittle { given, least } = refused else { panic!("{refused}") };
    assert!(given < least && least < 60.0, "{least}");

    // The machine's speed decides the number of samples, not their distribution.
    let [few, many] = [3.0, 9.0].map(|times| within(times * least).unwrap());
    let [few_stats, many_stats] = [&few, &many].map(|made| made.rendered.stats.allotted.clone().unwrap());
    assert!(many_stats.mean > 1.3 * few_stats.mean, "{few_stats:?} {many_stats:?}");
    assert!(many_stats.error.p50 < few_stats.error.p50);
    // How well a time is kept depends on the machine too.
    let (little, kept) = (few_stats.within.unwrap(), many_stats.within.unwrap());
    assert!(kept.passes > 2 && kept.spent_seconds > little.spent_seconds, "{little:?} {kept:?}");

    let again = |samples: &SampleCounts| {
        let (shot, nobody) = (kitchen(), Nobody::default());
        render_as_allotted(&shot, 0, &settings(), Given::default(), samples, &|_| (), &nobody)
    };
    let bits =
        |made: &Rendered| made.image.pixels.iter().map(|p| p.color.map(f32::to_bits)).collect::<Vec<_>>();
    let remade = again(&few.samples).unwrap().unwrap().rendered;
    assert_eq!(bits(&few.rendered), bits(&remade));
    assert_eq!((few.rendered.stats.work, few.rendered.stats.rays), (remade.stats.work, remade.stats.rays));
    assert!(again(&SampleCounts::new(vec![1; 5]).unwrap()).is_err(), "5 numbers are not for 64 x 36 pixels");
}
