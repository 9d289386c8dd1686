//! What the living estimate must hold: it begins as the quote, ends as the truth, and is honest in between.

mod common;

use common::Stream;
use forelight_forecast::{Band, FramePopulation, Known, Live, LiveFrame, Measure, Stratum, live, shot_times};

/// Quantiles of a lognormal number, as a quote gives them.
fn lognormal(median: f64, deviation: f64) -> Band {
    let at = |normal: f64| median * (deviation * normal).exp();
    Band { mean: median, p50: median, p80: at(0.8416), p95: at(1.6449) }
}

/// Deviations of frames from their quotes: what they share, what drifts, and their own.
#[derive(Clone, Copy)]
struct Truth {
    common: f64,
    smooth: f64,
    own: f64,
}

const AS_QUOTED: Truth = Truth { common: 0.12, smooth: 0.08, own: 0.08 };

struct Job {
    total: Band,
    frames: Vec<LiveFrame>,
    truth: Vec<f64>,
}

impl Job {
    /// A job of `count` similar frames, quoted with the spreads `quoted`, true costs as in `truth`.
    fn new(seed: u64, count: usize, quoted: Truth, truth: Truth) -> Self {
        let mut stream = Stream::new(seed);
        let medians: Vec<f64> = (0..count).map(|_| 100.0 * (0.3 * stream.normal()).exp()).collect();
        let Truth { common, smooth, own } = quoted;
        let of_frame = common.hypot(smooth).hypot(own);
        // The mean over a shot keeps six tenths of the variance of what drifts over a third of it.
        let of_job = common.hypot(0.6f64.sqrt() * smooth).hypot(own / (count as f64).sqrt());
        let sum: f64 = medians.iter().sum();
        let frames = medians
            .iter()
            .enumerate()
            .map(|(t, &median)| LiveFrame {
                time: t as f64,
                lights: 0,
                quote: lognormal(median, of_frame),
                known: Known::Nothing,
            })
            .collect();
        // The drift as assumed: a Gaussian process with Matérn covariance, a third of the shot long.
        let x = 3.0f64.sqrt() / (count as f64 / 3.0);
        let fall = (-x).exp();
        let step = [[fall * (1.0 + x), fall * x], [-fall * x, fall * (1.0 - x)]];
        let kept = |i: usize, j: usize| step[i][0] * step[j][0] + step[i][1] * step[j][1];
        let (level, both) = ((1.0 - kept(0, 0)).max(0.0), -kept(0, 1));
        let slope = (1.0 - kept(1, 1) - both * both / level).max(0.0);
        let shared = truth.common * stream.normal();
        let mut drift = [stream.normal(), stream.normal()];
        let costs = medians.iter().map(|median| {
            let cost = median * (shared + truth.smooth * drift[0] + truth.own * stream.normal()).exp();
            let new = stream.normal();
            drift = [
                step[0][0] * drift[0] + step[0][1] * drift[1] + level.sqrt() * new,
                step[1][0] * drift[0]
                    + step[1][1] * drift[1]
                    + both / level.sqrt() * new
                    + slope.sqrt() * stream.normal(),
            ];
            cost
        });
        Self { truth: costs.collect(), total: lognormal(sum, of_job), frames }
    }

    fn finish(&mut self, frame: usize) {
        self.frames[frame].known = Known::All(self.truth[frame]);
    }

    fn live(&self) -> Live {
        live(&self.total, &self.frames, Measure::Work)
    }

    fn whole(&self) -> f64 {
        self.truth.iter().sum()
    }
}

fn width(band: &Band) -> f64 {
    band.p95 - band.p50
}

#[test]
fn nothing_finished_is_the_quote_itself_and_everything_finished_is_the_truth() {
    let mut job = Job::new(1, 48, AS_QUOTED, AS_QUOTED);
    job.total.mean *= 0.9;
    let begin = job.live();
    assert_eq!((begin.whole, begin.remaining, begin.spent), (job.total, job.total, 0.0));
    (0..48).for_each(|frame| job.finish(frame));
    let end = job.live();
    assert_eq!(end.whole, Band::known(end.spent));
    assert_eq!(end.remaining, Band::default());
    assert!((end.spent / job.whole() - 1.0).abs() < 1e-14);
}

#[test]
fn from_the_quote_to_the_first_frame_is_no_leap() {
    let mut job = Job::new(2, 200, AS_QUOTED, AS_QUOTED);
    // A frame that costs exactly its median, of a quote whose shape past jobs have changed.
    job.total = Band { mean: job.total.p50 / 1.1, p50: job.total.p50, ..job.total };
    job.frames.iter_mut().for_each(|frame| frame.quote.mean /= 1.1);
    job.truth[70] = job.frames[70].quote.p50;
    job.finish(70);
    let first = job.live();
    for (now, quoted) in [
        (first.whole.mean, job.total.mean),
        (first.whole.p50, job.total.p50),
        (first.whole.p80, job.total.p80),
        (first.whole.p95, job.total.p95),
    ] {
        // A frame that costs what was quoted takes variance away. How much depends on the model of the common
        // error. No quantile moves by more than a standard deviation of the job, about 0.14.
        assert!((now / quoted - 1.0).abs() < 0.14, "{now} for {quoted}");
    }
    assert!(width(&first.whole) < width(&job.total));
}

#[test]
fn intervals_shrink_to_nothing_as_frames_finish() {
    let mut mean = [0.0; 5];
    for seed in 0..40 {
        let mut job = Job::new(seed, 48, AS_QUOTED, AS_QUOTED);
        for (step, width_there) in mean.iter_mut().enumerate() {
            (0..step * 12).for_each(|frame| job.finish(frame));
            *width_there += width(&job.live().whole) / job.whole() / 40.0;
        }
    }
    assert!(mean.windows(2).all(|pair| pair[1] < 0.8 * pair[0]), "{mean:?}");
    assert_eq!(mean[4], 0.0);
}

#[test]
fn a_job_thirty_percent_dearer_than_its_quote_is_seen_as_such_after_a_few_frames() {
    let mut job = Job::new(5, 48, AS_QUOTED, Truth { common: 0.0, smooth: 0.0, own: 0.03 });
    job.truth.iter_mut().for_each(|cost| *cost *= 1.3);
    let off = |job: &Job| job.live().whole.p50 / job.whole() - 1.0;
    assert!(off(&job) < -0.2);
    let mut in_order = Job { frames: job.frames.clone(), truth: job.truth.clone(), total: job.total };
    (0..6).for_each(|frame| {
        job.finish(8 * frame);
        in_order.finish(frame);
    });
    let live = job.live();
    // The posterior mean of n = 6 equal residuals keeps at least n c / (n c + s + e), with the variances of
    // AS_QUOTED: 3.4 % of ln 1.3 is lost. Three sigmas of the frames' noise of 3 % add 3 · 0.03 / √6 = 3.7 %.
    // An eighth of the whole is known.
    let lost = 0.034 + 0.037;
    assert!(off(&job).abs() < 7.0 / 8.0 * lost, "{} {live:?}", off(&job));
    assert!((live.factor / 1.3 - 1.0).abs() < lost, "{live:?}");
    assert!(live.whole.p50 > job.total.p80, "the quote's P80 is out of reach");
    // Neighbours may share a passing error, so they count less: c / (c + s) = 69 % is common to the job.
    let live = in_order.live();
    assert!(
        off(&in_order).abs() < 7.0 / 8.0 * (0.31 * 0.262 + 0.037) && live.whole.p95 > job.whole(),
        "{} {live:?}",
        off(&in_order)
    );
}

#[test]
fn an_error_that_all_frames_share_is_found_even_if_the_quote_thinks_that_errors_average_out() {
    // Frames are known to a tenth, the whole to a thirtieth: next to nothing is left for what they share.
    let mut job = Job::new(12, 10, Truth { common: 0.0, smooth: 0.0, own: 0.1 }, AS_QUOTED);
    (0..10).for_each(|frame| job.truth[frame] = 1.5 * job.frames[frame].quote.p50);
    let mut factors = Vec::new();
    for frame in 0..6 {
        job.finish(frame);
        factors.push(job.live().factor);
    }
    assert!(factors.windows(2).all(|pair| pair[1] > pair[0]), "{factors:?}");
    assert!(factors[3] > 1.35 && factors[5] > 1.4 && factors[5] < 1.51, "{factors:?}");
}

#[test]
fn it_does_not_matter_in_which_order_frames_arrived() {
    let mut one = Job::new(6, 30, AS_QUOTED, AS_QUOTED);
    let mut other = Job::new(6, 30, AS_QUOTED, AS_QUOTED);
    let finished = [3, 29, 0, 14, 15, 7, 21];
    for &frame in &finished {
        one.finish(frame);
        one.live();
    }
    finished.iter().rev().for_each(|&frame| other.finish(frame));
    assert_eq!(one.live(), other.live());
}

/// Share of seeded jobs whose true cost stayed below P50, P80 and P95 with these frames finished.
fn hits(
    jobs: u64,
    [quoted, truth]: [Truth; 2],
    change: impl Fn(&mut Job, u64),
    finished: &[usize],
) -> [f64; 3] {
    let mut hits = [0.0; 3];
    for seed in 1000..1000 + jobs {
        let mut job = Job::new(seed, 48, quoted, truth);
        change(&mut job, seed);
        finished.iter().for_each(|&frame| job.finish(frame));
        let Band { p50, p80, p95, .. } = job.live().whole;
        for (hit, quantile) in hits.iter_mut().zip([p50, p80, p95]) {
            *hit += f64::from(u8::from(job.whole() <= quantile)) / jobs as f64;
        }
    }
    hits
}

/// Four standard deviations of a share of so many jobs, for about twenty such bounds.
fn by_chance(probability: f64, jobs: u64) -> f64 {
    4.0 * (probability * (1.0 - probability) / jobs as f64).sqrt()
}

/// Distribution of Student's t, by Simpson's rule on its density from zero.
fn student(t: f64, freedom: f64) -> f64 {
    let density = |x: f64| (1.0 + x * x / freedom).powf(-0.5 * (freedom + 1.0));
    let integral = |end: f64| {
        let steps = 4000;
        let h = end / f64::from(steps);
        let weight = |i: i32| if i == 0 || i == steps { 1.0 } else { 2.0 + 2.0 * f64::from(i % 2) };
        (0..=steps).map(|i| weight(i) * density(h * f64::from(i))).sum::<f64>() * h / 3.0
    };
    0.5 + 0.5 * integral(t) / integral(400.0)
}

/// Standard normal quantiles at 0.50, 0.80 and 0.95.
const NORMAL: [f64; 3] = [0.0, 0.8416, 1.6449];

/// The true levels of P50, P80 and P95 of a job whose intervals are `stretch` times as long as they should
/// be. The scale is learnt from this many frames, and from the quote, which counts for four.
fn kept(stretch: f64, seen: usize) -> [f64; 3] {
    let freedom = 4.0 + seen as f64;
    NORMAL
        .map(|normal| student(stretch * normal * (1.0 + (normal * normal + 1.0) / (4.0 * freedom)), freedom))
}

/// Whether the hits of 500 jobs are those of intervals of the right length, to within three sigmas. The
/// intervals may be half as long again: they allow for errors that these jobs do not have.
fn about(hits: [f64; 3], seen: usize, what: &str) {
    let (least, most) = (kept(1.0, seen), kept(1.5, 1_000_000));
    for ((hit, least), most) in hits.iter().zip(least).zip(most) {
        let (low, high) = (least - by_chance(least, 500), most + by_chance(most, 500));
        assert!((low..=high).contains(hit), "{what}: {hits:?}, {low} to {high}");
    }
}

#[test]
fn quantiles_hold_what_they_promise_where_the_quote_knows_itself() {
    let scattered: Vec<usize> = (0..48).step_by(4).collect();
    let in_order: Vec<usize> = (0..12).collect();
    let half: Vec<usize> = (0..24).collect();
    let most: Vec<usize> = (0..42).collect();
    for (finished, what) in [
        (&scattered[..3], "three here and there"),
        (&scattered[..], "a quarter here and there"),
        (&in_order[..], "the first quarter"),
        (&half[..], "the first half"),
        (&most[..], "all but six"),
    ] {
        let found = hits(500, [AS_QUOTED; 2], |_, _| {}, finished);
        println!("{what}: {found:?}");
        about(found, finished.len(), what);
    }
}

#[test]
fn a_quote_that_is_far_too_sure_of_itself_is_found_out() {
    // Quoted with a third of the true spread: at first, P95 lies at 1.645 / 3 standard deviations.
    let third = Truth { common: 0.04, smooth: 0.027, own: 0.027 };
    let none = hits(500, [third, AS_QUOTED], |_, _| {}, &[]);
    let before = 0.708;
    assert!((none[2] - before).abs() < by_chance(before, 500), "{none:?}");
    println!("before {none:?}");
    let quarter: Vec<usize> = (0..48).step_by(4).collect();
    let seen = hits(500, [third, AS_QUOTED], |_, _| {}, &quarter);
    // Twelve frames, each nine times as surprising: a variance of (4 + 9 · 12) / (4 + 12) = 7 times the
    // quote's.
    println!("a quarter {seen:?}");
    let [_, at_80, at_95] = kept((7.0f64 / 9.0).sqrt(), 12);
    assert!(seen[1] > at_80 - by_chance(at_80, 500), "{seen:?}");
    assert!(seen[2] > at_95 - by_chance(at_95, 500), "{seen:?}");
}

/// A light goes on half-way, and the quote is off by another factor on each side. The error of the whole
/// stays as uncertain: half of the common variance is that of the sides.
fn switched_on(job: &mut Job, seed: u64) {
    let mut stream = Stream::new(seed ^ 0x5eed);
    let sides = [0, 1].map(|_| AS_QUOTED.common * stream.normal());
    for (t, frame) in job.frames.iter_mut().enumerate() {
        frame.lights = (t / 24) as u32;
        frame.time += 48.0 * (t / 24) as f64;
        job.truth[t] *= sides[t / 24].exp();
    }
}

#[test]
fn a_light_that_is_yet_to_go_on_is_allowed_for_and_frames_here_and_there_see_it_soon() {
    let scattered: Vec<usize> = (0..48).step_by(4).collect();
    let before: Vec<usize> = (0..24).collect();
    let after: Vec<usize> = (0..32).collect();
    let shared = Truth { common: 0.5f64.sqrt() * AS_QUOTED.common, ..AS_QUOTED };
    for (finished, what) in [(scattered, "here and there"), (before, "before it"), (after, "after it")] {
        let found = hits(300, [AS_QUOTED, shared], switched_on, &finished);
        println!("{what}: {found:?}");
        let [_, at_80, at_95] = kept(1.0, finished.len());
        assert!(found[1] > at_80 - by_chance(at_80, 300), "{what}: {found:?}");
        assert!(found[2] > at_95 - by_chance(at_95, 300), "{what}: {found:?}");
    }
}

#[test]
fn frames_in_a_light_that_was_not_seen_yet_are_thought_less_like_those_that_were_and_less_sure() {
    let estimate = |lights: u32| {
        let mut job = Job::new(14, 40, AS_QUOTED, Truth { common: 0.0, smooth: 0.0, own: 0.01 });
        for t in 0..40 {
            // Far apart, so that nothing but the lights tells the halves apart.
            job.frames[t].time += if t < 20 { 0.0 } else { 4000.0 };
            job.frames[t].lights = if t < 20 { 0 } else { lights };
            job.truth[t] *= 1.4;
        }
        (0..20).for_each(|frame| job.finish(frame));
        job.live()
    };
    let (same, other) = (estimate(0), estimate(1));
    assert!(other.factor > 1.02 && other.factor < same.factor - 0.05, "{other:?} {same:?}");
    let spread = |live: &Live| (live.remaining.p95 / live.remaining.p50).ln();
    assert!(spread(&other) > 1.2 * spread(&same), "{other:?} {same:?}");
    // Numbers of sets of lights are only names, and more sets than are told apart change nothing.
    assert_eq!(estimate(7), other);
}

#[test]
fn a_light_that_comes_back_is_known() {
    let mut job = Job::new(15, 48, AS_QUOTED, Truth { common: 0.0, smooth: 0.0, own: 0.01 });
    for t in 0..48 {
        job.frames[t].time += 4000.0 * (t / 12) as f64;
        // Twelve frames of each in turn; the quote is wrong in one of them alone.
        job.frames[t].lights = (t / 12 % 2) as u32;
        job.truth[t] *= if t / 12 % 2 == 1 { 1.4 } else { 1.0 };
    }
    (0..24).for_each(|frame| job.finish(frame));
    let forgetful = {
        let frames = job.frames.iter().map(|frame| LiveFrame { lights: 0, ..*frame }).collect();
        Job { frames, truth: job.truth.clone(), total: job.total }.live()
    };
    let left: f64 = job.truth[24..].iter().sum();
    let off = |live: &Live| (live.remaining.p50 / left - 1.0).abs();
    assert!(off(&job.live()) <= off(&forgetful) + 1e-9, "{} {}", off(&job.live()), off(&forgetful));
    // A third set, which takes up where the second was, is not taken for it.
    (36..48).for_each(|t| job.frames[t].lights = 2);
    assert!(job.live().factor < 1.4f64.sqrt());
}

#[test]
fn finished_tiles_move_the_estimate_of_a_job_of_one_frame() {
    let mut job = Job::new(8, 1, AS_QUOTED, AS_QUOTED);
    let quoted = job.frames[0].quote.p50;
    let at = |job: &mut Job, share: f64| {
        job.frames[0].known = Known::Part { share, cost: 1.5 * share * quoted };
        job.live()
    };
    let early = at(&mut job, 0.1);
    let late = at(&mut job, 0.9);
    assert!(job.total.p50 < early.whole.p50 && early.whole.p50 < late.whole.p50);
    assert!((late.whole.p50 / (1.5 * quoted) - 1.0).abs() < 0.05, "{late:?}");
    assert!(width(&late.whole) < 0.3 * width(&early.whole), "{early:?} {late:?}");
    assert_eq!(late.spent, 1.5 * 0.9 * quoted);
}

#[test]
fn two_sides_of_a_cut_say_little_of_each_other() {
    let estimate = |cut: f64| {
        let quiet = Truth { common: 0.03, smooth: 0.15, own: 0.03 };
        let mut job = Job::new(9, 40, quiet, Truth { common: 0.0, smooth: 0.0, own: 0.01 });
        job.frames[20..].iter_mut().for_each(|frame| frame.time += cut);
        (0..20).for_each(|frame| {
            job.truth[frame] *= 1.4;
            job.finish(frame);
        });
        job.live().factor
    };
    assert!(estimate(0.0) > estimate(400.0) + 0.03, "{} {}", estimate(0.0), estimate(400.0));
}

#[test]
fn the_clock_of_the_estimate_has_a_cut_where_lights_change() {
    let strata = [Stratum { object: 0, material: 0, prior_cost: 1.0, apart: false }];
    let frame =
        |number, lights| FramePopulation { number, counts: vec![64], lights, shining: 0, triangles: 0 };
    let frames = [frame(0, 0), frame(1, 0), frame(2, 1), frame(5, 1)];
    assert_eq!(shot_times(&strata, &frames).unwrap(), [0.0, 1.0, 7.0, 10.0]);
    assert_eq!(shot_times(&strata, &[]).unwrap(), Vec::<f64>::new());
    assert!(shot_times(&strata, &[frame(3, 0), frame(3, 0)]).is_err());
}

#[test]
fn frames_that_cost_nothing_and_numbers_that_are_none_do_no_harm() {
    let nothing = Band::default();
    let odd = [0.0, 1.0, 1e-300, 1e18, f64::NAN, f64::INFINITY, -3.0];
    let mut stream = Stream::new(10);
    let mut pick = |n: usize| ((stream.uniform() * n as f64) as usize).min(n - 1);
    for _ in 0..3000 {
        let mut number = || odd[pick(odd.len())];
        let mut frames: Vec<LiveFrame> = (0..6)
            .map(|t| {
                let quote = Band { mean: number(), p50: number(), p80: number(), p95: number() };
                let known = match number() {
                    0.0 => Known::Nothing,
                    1.0 => Known::Part { share: number(), cost: number() },
                    _ => Known::All(number()),
                };
                LiveFrame { time: f64::from(t), lights: t % 3, quote, known }
            })
            .collect();
        let total = lognormal(100.0, 0.2);
        for total in [total, nothing] {
            let Live { spent, remaining, whole, factor } = live(&total, &frames, Measure::CpuTime);
            for band in [remaining, whole] {
                let Band { mean, p50, p80, p95 } = band;
                assert!(mean >= 0.0 && p50 >= 0.0 && p50 <= p80 && p80 <= p95, "{band:?} of {frames:?}");
                assert!(mean.is_finite() && p95.is_finite(), "{band:?} of {frames:?}");
            }
            assert!(spent >= 0.0 && spent.is_finite() && factor > 0.0 && factor.is_finite());
        }
        frames.truncate(1);
        live(&total, &frames, Measure::Work);
    }
    let empty = live(&nothing, &[], Measure::Work);
    assert_eq!((empty.whole, empty.spent), (nothing, 0.0));
    let free = [LiveFrame { time: 0.0, lights: 0, quote: nothing, known: Known::All(0.0) }; 3];
    assert_eq!(live(&nothing, &free, Measure::Work).whole, nothing);
}
