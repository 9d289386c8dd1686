//! Errors of images from pixels whose variance is known in closed form.

use forelight_forecast::accuracy::{
    ImageNoise, NoiseCell, NoiseSample, PixelNoise, PixelSamples, Point, Sampled, front,
};
use forelight_forecast::{Calibration, ForecastError, Stratum};
use forelight_random::hash;
use proptest::prelude::*;

/// Uniform in [0, 1), a hash of its arguments.
fn uniform(parts: &[u64]) -> f64 {
    let mixed = |state: u64, part: &u64| hash(state ^ part);
    (parts.iter().fold(7, mixed) >> 11) as f64 / (1u64 << 53) as f64
}

/// A pixel of independent samples, uniform around `mean` with a standard deviation of `deviation`.
fn pixel(mean: f64, deviation: f64, samples: u64, seed: u64) -> PixelNoise {
    let mut pixel = PixelSamples::default();
    for sample in 0..samples {
        let value = mean + deviation * 12f64.sqrt() * (uniform(&[seed, sample]) - 0.5);
        pixel.push([value as f32; 3]);
    }
    pixel.noise()
}

/// Cells of an image of which some pixels were profiled, and others scanned.
fn cells(
    strata: &[Stratum],
    counts: &[u32],
    profiled: &[NoiseSample],
    scanned: &[NoiseSample],
) -> Result<Vec<NoiseCell>, ForecastError> {
    let sampled = Sampled { profiled, scattered: profiled.len(), scanned };
    Ok(sampled.groups(strata, counts)?.into_iter().flat_map(|group| group.cells).collect())
}

/// Half of the pixels of mean 1 and deviation 0.5, half of mean 3 and deviation 2.
fn two_halves(samples: u64, pixels: u64) -> ImageNoise {
    let cell = |mean, deviation, seed| NoiseCell {
        pixels: 10_000,
        samples: (0..pixels).map(|i| pixel(mean, deviation, samples, seed + i)).collect(),
    };
    ImageNoise::new(vec![cell(1.0, 0.5, 1 << 20), cell(3.0, 2.0, 1 << 40)]).unwrap()
}

#[test]
fn independent_samples_have_the_error_of_the_closed_form_at_any_number_of_them() {
    // Mean variance (0.25 + 4) / 2 of one sample, over a mean of 2.
    let one = (2.125f64).sqrt() / 2.0;
    let noise = two_halves(64, 400);
    assert!((noise.mean() / 2.0 - 1.0).abs() < 0.01, "{}", noise.mean());
    for spp in [1, 2, 3, 8, 16, 50, 64, 200, 1024] {
        let error = noise.at(spp).error(Calibration::NONE);
        let expected = one / f64::from(spp).sqrt();
        let off = error.p50 / expected - 1.0;
        let allowed = if spp <= 64 { 0.03 } else { 0.12 };
        assert!(off.abs() < allowed, "{spp} samples: {off}");
        let (low, high) = (error.p05 * 0.99, error.p95 * 1.01);
        assert!(low < expected && expected < high, "{spp} samples: {error:?} for {expected}");
    }
}

#[test]
fn samples_that_make_up_for_each_other_are_known_to_converge_faster() {
    // Antithetic pairs on top of independent ones: the variance of one sample is 1 + 4, of a pair only 1 / 2.
    let pixel = |seed: u64| {
        let mut pixel = PixelSamples::default();
        for pair in 0..32 {
            let common = |side: u64| 12f64.sqrt() * (uniform(&[seed, pair, side]) - 0.5);
            let swing = 2.0 * 12f64.sqrt() * (uniform(&[seed, pair, 9]) - 0.5);
            pixel.push([(10.0 + common(0) + swing) as f32; 3]);
            pixel.push([(10.0 + common(1) - swing) as f32; 3]);
        }
        pixel.noise()
    };
    let cell = NoiseCell { pixels: 100_000, samples: (0..500).map(pixel).collect() };
    let noise = ImageNoise::new(vec![cell]).unwrap();
    for (spp, variance) in [(1, 5.0), (2, 0.5), (4, 0.25), (16, 1.0 / 16.0)] {
        let found = noise.at(spp).value * 100.0;
        assert!((found / variance - 1.0).abs() < 0.08, "{spp} samples: {found} for {variance}");
    }
}

#[test]
fn variances_that_fall_by_the_law_are_forecast_beyond_what_was_sampled() {
    // Smooth light, edges, and light found by chance: A / n² + B / n^1.5 + C / n.
    let laws = [
        ([1.0, 0.0, 0.0], 1.2),
        ([1.0, 0.0, 0.02], 1.15),
        ([1.0, 0.0, 0.2], 1.1),
        ([1.0, 0.1, 0.01], 1.2),
        ([0.0, 1.0, 0.0], 1.2),
        ([0.0, 1.0, 0.2], 1.1),
        ([0.0, 0.0, 1.0], 1.05),
    ];
    for ([smooth, edge, random], times) in laws {
        let law = |n: f64| smooth / (n * n) + edge / (n * n.sqrt()) + random / n;
        let drops: Vec<f64> = (0..4).map(|k| law(f64::from(1 << k)) - law(f64::from(2 << k))).collect();
        // The pixels of the cell differ by a factor of up to three.
        let pixel = |i: usize| {
            let factor = 0.5 + (i % 5) as f64 / 4.0;
            let drops = drops.iter().map(|drop| drop * factor).collect();
            PixelNoise { brightness: 1.0, drops, bias_square: 0.0 }
        };
        let samples = (0..250).map(pixel).collect();
        let noise = ImageNoise::new(vec![NoiseCell { pixels: 10_000, samples }]).unwrap();
        let error = noise.at(16).error(Calibration::NONE);
        let truth = law(16.0).sqrt();
        assert!(
            error.p50 > 0.9 * truth && error.p50 < times * truth,
            "{:?}: {error:?} for {truth}",
            [smooth, edge, random]
        );
        // Beyond, it is not known whether light found by chance will show. The interval includes that.
        for spp in [16, 64, 256] {
            let error = noise.at(spp).error(Calibration::NONE);
            let truth = law(f64::from(spp)).sqrt();
            assert!(error.p05 <= truth && truth <= error.p95, "{spp} samples: {error:?} for {truth}");
        }
    }
}

#[test]
fn what_does_not_fall_with_samples_stays() {
    let mut cell = NoiseCell { pixels: 1000, samples: (0..100).map(|i| pixel(1.0, 1.0, 16, i)).collect() };
    let without = ImageNoise::new(vec![cell.clone()]).unwrap();
    for (i, sample) in cell.samples.iter_mut().enumerate() {
        // Of single pixels it may come out negative; the mean is 0.01.
        sample.bias_square = if i % 2 == 0 { 0.05 } else { -0.03 };
    }
    let with = ImageNoise::new(vec![cell]).unwrap();
    let added = (with.at(4096).value - without.at(4096).value) * with.mean() * with.mean();
    assert!((added / 0.01 - 1.0).abs() < 1e-6, "{added}");
    assert!(with.at(4096).error(Calibration::NONE).p05 > 0.05);
}

#[test]
fn a_stratum_counts_by_its_pixels_and_one_without_samples_is_like_its_material() {
    let stratum = |object, material| Stratum { object, material, prior_cost: 1.0, apart: false };
    let strata = [stratum(0, 0), stratum(1, 1), stratum(2, 1), stratum(3, 2)];
    let flat = |brightness: f64, drop: f64| PixelNoise { brightness, drops: vec![drop], bias_square: 0.0 };
    let sample = |stratum, brightness, drop| NoiseSample { stratum, noise: flat(brightness, drop) };
    let samples = [
        sample(0, 1.0, 1.0),
        sample(0, 1.0, 1.0),
        sample(1, 3.0, 5.0),
        sample(2, 3.0, 5.0),
        sample(3, 9.0, 7.0),
    ];
    let of_all = cells(&strata, &[600, 100, 100, 200], &samples, &[]).unwrap();
    let shape: Vec<(u64, usize)> = of_all.iter().map(|cell| (cell.pixels, cell.samples.len())).collect();
    // The last has a single sample and no kin: it is taken to be like everything.
    assert_eq!(shape, [(600, 2), (200, 2), (200, 5)]);
    let unsampled = cells(&strata, &[600, 100, 0, 0], &samples[..3], &[]).unwrap();
    assert_eq!(unsampled.iter().map(|cell| cell.pixels).sum::<u64>(), 700);
}

/// One pixel in 200 holds nearly all of the error. The profiled pixels are 300, the scanned ones 2,000.
#[test]
fn a_scan_finds_the_few_pixels_that_hold_most_of_the_error() {
    const SEEDS: u64 = 60;
    let strata = [Stratum { object: 0, material: 0, prior_cost: 1.0, apart: false }];
    let sample = |samples: u64, place: u64| {
        let deviation = if hash(place).is_multiple_of(200) { 20.0 } else { 0.2 };
        NoiseSample { stratum: 0, noise: pixel(1.0, deviation, samples, place) }
    };
    let images = |scanned: u64| -> Vec<ImageNoise> {
        let of = |seed: u64| {
            let profiled: Vec<NoiseSample> = (0..300).map(|i| sample(16, (seed << 32) + i)).collect();
            let scanned: Vec<NoiseSample> =
                (0..scanned).map(|i| sample(8, (seed << 32) + 1000 + i)).collect();
            ImageNoise::new(cells(&strata, &[100_000], &profiled, &scanned).unwrap()).unwrap()
        };
        (1..=SEEDS).map(of).collect()
    };
    let (without, with) = (images(0), images(2000));
    for spp in [1, 4, 16, 64] {
        // The mean variance of a pixel is 400 / 200 + 0.04.
        let truth = 2.04 / f64::from(spp);
        let ratios = |images: &[ImageNoise]| -> Vec<f64> {
            images.iter().map(|image| image.noise_at(spp).value / truth).collect()
        };
        let mean = |values: &[f64]| values.iter().sum::<f64>() / SEEDS as f64;
        let spread = |values: &[f64]| {
            mean(&values.iter().map(|value| value.ln().powi(2)).collect::<Vec<f64>>()).sqrt()
        };
        let (few, many) = (ratios(&without), ratios(&with));
        assert!((mean(&many) - 1.0).abs() < 0.25, "{spp} samples: {} times the truth", mean(&many));
        let (few, many) = (spread(&few), spread(&many));
        assert!(many < 0.6 * few, "{spp} samples: {many} with a scan, {few} without");
        let holds = |image: &&ImageNoise| {
            let error = image.noise_at(spp).error(Calibration::NONE);
            // Brightness is 1 but for the noise.
            (error.p05..=error.p95).contains(&truth.sqrt())
        };
        let inside = with.iter().filter(holds).count();
        assert!(
            inside as u64 * 10 >= SEEDS * 8,
            "{spp} samples: the truth is in {inside} of {SEEDS} intervals"
        );
    }
}

#[test]
fn the_first_drops_are_means_of_all_pixels_and_the_later_ones_those_of_profiled_pixels_in_proportion() {
    let strata = [0, 1].map(|object| Stratum { object, material: object, prior_cost: 1.0, apart: false });
    let flat = |stratum, brightness: f64, drops: &[f64]| {
        let noise = PixelNoise { brightness, drops: drops.to_vec(), bias_square: 0.0 };
        NoiseSample { stratum, noise }
    };
    let mut profiled = [0, 0, 1, 1, 0].map(|stratum| flat(stratum, 2.0, &[8.0, 2.0, 1.0]));
    // The last is not scattered, so its brightness and first drops count for nothing.
    profiled[4] = flat(0, 9.0, &[2.0, 2.0, 4.0]);
    let of_first = |i| if i % 2 == 0 { flat(0, 1.0, &[4.0, 3.0]) } else { flat(0, 3.0, &[6.0, 1.0]) };
    let mut scanned: Vec<NoiseSample> = (0..98).map(of_first).collect();
    scanned.push(flat(1, 4.0, &[0.0, 8.0]));
    let sampled = Sampled { profiled: &profiled, scattered: 4, scanned: &scanned };
    for counts in [[6000, 4000], [3, 2]] {
        let groups = sampled.groups(&strata, &counts).unwrap();
        let found: Vec<NoiseCell> = groups.into_iter().flat_map(|group| group.cells).collect();
        assert_eq!(found.iter().map(|cell| cell.pixels).sum::<u64>(), u64::from(counts[0] + counts[1]));
        let image = ImageNoise::new(found).unwrap();
        // Weights of the strata are 0.6 and 0.4.
        let mean = |first: f64, second: f64| 0.6 * first + 0.4 * second;
        let first = mean((2.0 * 8.0 + 98.0 * 5.0) / 100.0, (2.0 * 8.0 + 0.0) / 3.0);
        let second = mean(2.0, (2.0 * 2.0 + 8.0) / 3.0);
        let of_profiled = mean((2.0 * 12.0 + 6.0) / 3.0, 12.0);
        let third = mean(2.0, 1.0) * (first + 2.0 * second) / of_profiled;
        for (found, expected) in image.drops().iter().zip([first, second, third]) {
            assert!((found - expected).abs() < 1e-9, "{found} for {expected}");
        }
        assert!((image.mean() - mean(2.0, 8.0 / 3.0)).abs() < 1e-9, "{}", image.mean());
    }
    // A single pixel cannot be shared.
    let one = cells(&strata[..1], &[1], &profiled[..2], &scanned[..9]).unwrap();
    assert_eq!((one.len(), one[0].pixels, &one[0].samples[0]), (1, 1, &profiled[0].noise));
}

#[test]
fn what_says_nothing_is_refused() {
    let stratum = Stratum { object: 0, material: 0, prior_cost: 1.0, apart: false };
    let sample = |stratum, samples| NoiseSample { stratum, noise: pixel(1.0, 1.0, samples, 3) };
    assert_eq!(cells(&[stratum], &[4], &[], &[sample(0, 4)]), Err(ForecastError::NoSamples));
    assert!(matches!(cells(&[stratum], &[4, 4], &[], &[]), Err(ForecastError::CountsLength { .. })));
    for (profiled, scanned) in [(1, 0), (0, 1)] {
        let foreign = cells(&[stratum], &[4], &[sample(profiled, 4)], &[sample(scanned, 4)]);
        assert!(matches!(foreign, Err(ForecastError::UnknownStratum { .. })));
    }
    let single = cells(&[stratum], &[4], &[sample(0, 1)], &[]).unwrap();
    assert!(matches!(ImageNoise::new(single), Err(ForecastError::NoSamples)));
    assert!(matches!(ImageNoise::new(Vec::new()), Err(ForecastError::NoSamples)));
}

#[test]
fn a_black_image_and_one_without_noise_have_no_error() {
    for brightness in [0.0, 2.0] {
        let pixel = PixelNoise { brightness, drops: vec![0.0; 4], bias_square: 0.0 };
        let noise = ImageNoise::new(vec![NoiseCell { pixels: 9, samples: vec![pixel; 3] }]).unwrap();
        for spp in [1, 7, 16, 4000] {
            let error = noise.at(spp).error(Calibration::NONE);
            assert_eq!([error.p05, error.p50, error.p80, error.p95], [0.0; 4]);
        }
    }
}

proptest! {
    #[test]
    fn more_samples_are_never_worse_and_quantiles_are_in_order(
        drops in prop::collection::vec(prop::collection::vec(0.0..1e6f64, 3), 2..12),
        brightness in 1e-3..1e3f64,
    ) {
        let samples = drops
            .into_iter()
            .map(|drops| PixelNoise { brightness, drops, bias_square: 0.0 })
            .collect();
        let noise = ImageNoise::new(vec![NoiseCell { pixels: 500, samples }]).unwrap();
        let mut before = f64::INFINITY;
        for spp in [1, 2, 3, 4, 6, 8, 9, 100, 65_536] {
            let error = noise.at(spp).error(Calibration::NONE);
            prop_assert!(error.p50 <= before * (1.0 + 1e-12), "{} samples: {} after {}", spp, error.p50, before);
            prop_assert!(error.p05 <= error.p50 && error.p50 <= error.p80 && error.p80 <= error.p95);
            prop_assert!(error.p95.is_finite());
            before = error.p50;
        }
    }

    #[test]
    fn the_front_holds_what_no_other_rung_beats_and_nothing_else(
        rungs in prop::collection::vec((0u8..12, 0u8..12), 0..40),
    ) {
        let points: Vec<Point> =
            rungs.iter().map(|&(cost, error)| Point { cost: cost.into(), error: error.into() }).collect();
        let steps = front(&points);
        let beats = |a: &Point, b: &Point| {
            a.cost <= b.cost && a.error <= b.error && (a.cost < b.cost || a.error < b.error)
        };
        for (index, point) in points.iter().enumerate() {
            let beaten = points.iter().any(|other| beats(other, point));
            let twin = points[..index].contains(point);
            prop_assert_eq!(steps.iter().any(|step| step.rung == index), !beaten && !twin);
        }
        for pair in steps.windows(2) {
            prop_assert_eq!(pair[0].next, Some(pair[1].rung));
            prop_assert!(points[pair[0].rung].cost < points[pair[1].rung].cost);
            prop_assert!(points[pair[0].rung].error > points[pair[1].rung].error);
        }
        prop_assert_eq!(steps.last().and_then(|step| step.next), None);
    }
}

#[test]
fn a_rung_without_a_number_is_never_on_the_front() {
    let point = |cost, error| Point { cost, error };
    let points = [point(f64::NAN, 0.0), point(1.0, f64::INFINITY), point(2.0, 3.0), point(0.0, f64::NAN)];
    let steps = front(&points);
    assert_eq!(steps.iter().map(|step| step.rung).collect::<Vec<_>>(), [2]);
}
