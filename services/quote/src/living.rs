//! The estimate of a running job: its final cost and its end, updated as frames finish.
//!
//! The quote never changes and is what calibration judges. [`forelight_forecast::live`] learns from finished
//! frames about the others. This module decides when a new estimate is due ([`is_due`]), compares it with the
//! bookings ([`Baseline`]), and reports when it exceeds them or is back within them ([`news()`]).
//!
//! An estimate takes three steps, because the end depends on the farm:
//!
//! 1. [`Estimate::new`]: work and CPU time from the quote and the frames.
//! 2. [`Baseline::stretch`]: the factor by which bookings take longer than planned. The caller projects the
//!    stretched bookings onto the farm.
//! 3. [`Comparison::live`]: the whole estimate, compared with the bookings.

mod frames;
mod news;
mod rhythm;

use forelight_forecast::{Band, LiveFrame, Measure, live};
use forelight_protocol::{
    Booked, Confidence, ForecastTotals, LiveFigure, LiveForecast, Money, MoneyQuantiles, Quantiles, Timestamp,
};

pub use frames::{FrameCost, FrameState, Frames};
pub use news::{News, cause_of_plan, is_news, news};
pub use rhythm::{BETWEEN_PIXELS, Last, Occasion, is_due};

/// An estimate must exceed its booking by this share to count as off. Without a margin, a job that runs
/// exactly as planned would switch with every frame.
const MARGIN: f64 = 0.02;

/// A job must end at least this much later than booked to count as late: ten seconds, in microseconds.
const LEAST_DELAY: i64 = 10_000_000;

/// A job must take at least this much more than booked to count as off: CPU seconds.
const LEAST_EXCESS: f64 = 1.0;

/// Expected work and CPU time of a job.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Estimate {
    /// Count of operations.
    pub work: LiveFigure,
    /// CPU seconds on a node of speed 1.
    pub cpu_seconds: LiveFigure,
}

impl Estimate {
    /// The estimate of a job that was quoted at `total`. If `is_given_up`, the job was cancelled or failed,
    /// and nothing more is expected.
    pub fn new(total: &ForecastTotals, frames: &Frames, is_given_up: bool) -> Self {
        let mut estimate = Self {
            work: figure(&total.work, &frames.work, Measure::Work),
            cpu_seconds: figure(&total.cpu_seconds, &frames.cpu_seconds, Measure::CpuTime),
        };
        if is_given_up {
            estimate.work.give_up();
            estimate.cpu_seconds.give_up();
        }
        estimate
    }
}

fn figure(quote: &Quantiles, frames: &[LiveFrame], measure: Measure) -> LiveFigure {
    let &Quantiles { mean, p50, p80, p95 } = quote;
    let found = live(&Band { mean, p50, p80, p95 }, frames, measure);
    let quantiles = |Band { mean, p50, p80, p95 }| Quantiles { mean, p50, p80, p95 };
    LiveFigure {
        quote: *quote,
        spent: found.spent,
        remaining: quantiles(found.remaining),
        whole: quantiles(found.whole),
        factor: found.factor,
    }
}

/// The CPU time that a plan was made for, at the job's confidence.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Baseline {
    /// CPU seconds of the whole job.
    pub cpu_seconds: f64,
    /// CPU seconds of the remaining part.
    pub rest: f64,
    /// The remaining part as a share of the quote, 0 to 1.
    pub share: f64,
}

impl Baseline {
    /// Of the first plan, which uses the quote.
    pub fn of_quote(cpu_seconds: &Quantiles, confidence: Confidence) -> Self {
        let quoted = cpu_seconds.at(confidence);
        Self { cpu_seconds: quoted, rest: quoted, share: 1.0 }
    }

    /// Of a later plan, which uses the estimate of CPU time before it.
    pub fn of_estimate(before: &LiveFigure, confidence: Confidence) -> Self {
        let Quantiles { p50, .. } = before.quote;
        let left = before.remaining.p50 / before.factor;
        let share = if p50 > 0.0 { (left / p50).clamp(0.0, 1.0) } else { 1.0 };
        Self { cpu_seconds: before.whole.at(confidence), rest: before.remaining.at(confidence), share }
    }

    /// Factor by which bookings are expected to take longer than planned: expected CPU seconds of the rest
    /// over planned ones. `share_left` is [`Frames::share_left`].
    pub fn stretch(&self, share_left: f64, expected: f64) -> f64 {
        let planned = if self.share > 0.0 { self.rest * share_left / self.share } else { 0.0 };
        if planned > 0.0 { expected / planned } else { 1.0 }
    }
}

/// Least delay that counts as late, in microseconds, for a job whose bookings begin at `begin`.
pub fn delay_that_counts(begin: Option<Timestamp>, finish: Option<Timestamp>) -> i64 {
    let length = begin.zip(finish).map_or(0, |(begin, finish)| finish.micros_since(begin));
    ((length as f64 * MARGIN) as i64).max(LEAST_DELAY)
}

/// Cost of the whole job in money: `spent` plus the rest at the quote's mean price. `cache` is the CPU time
/// that the shared cache still needs, and `quoted` the mean CPU time that `price` is for, in seconds. `None`
/// if the quote has no price.
pub fn cost(
    remaining: &Quantiles,
    cache: &Quantiles,
    (price, quoted): (MoneyQuantiles, f64),
    spent: Money,
) -> Option<MoneyQuantiles> {
    let per_second = price.mean.micro_units() as f64 / quoted;
    per_second.is_finite().then(|| remaining.plus(cache).in_money(per_second).plus(spent))
}

/// An estimate and its bookings.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Comparison {
    /// Time of the estimate.
    pub at: Timestamp,
    /// Finished frames.
    pub frames_done: u32,
    /// Work and CPU time.
    pub estimate: Estimate,
    /// Cost of the job in money ([`cost`]).
    pub cost: Option<MoneyQuantiles>,
    /// Expected end of the last frame.
    pub finish: Option<Timestamp>,
    /// The bookings.
    pub booked: Booked,
    /// Least delay that counts as late, in microseconds ([`delay_that_counts`]).
    pub delay: i64,
    /// Whether the previous estimate under the same plan was off.
    pub was_off: Off,
}

/// Whether an estimate exceeds its bookings.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Off {
    /// It costs more.
    pub cost: bool,
    /// It ends later.
    pub finish: bool,
}

impl Comparison {
    /// The estimate as it is stored and shown.
    pub fn live(self) -> LiveForecast {
        let Self { at, frames_done, estimate: Estimate { work, cpu_seconds }, cost, finish, booked, .. } =
            self;
        let expected = cpu_seconds.whole.at(booked.confidence);
        let limit = booked.cpu_seconds;
        LiveForecast {
            at,
            frames_done,
            work,
            cpu_seconds,
            cost,
            finish,
            booked,
            cost_is_off: is_off(self.was_off.cost, expected, limit, (MARGIN * limit).max(LEAST_EXCESS)),
            finish_is_off: match (finish, booked.finish) {
                (Some(finish), Some(booked)) => {
                    is_off(self.was_off.finish, finish.micros_since(booked) as f64, 0.0, self.delay as f64)
                }
                _ => false,
            },
        }
    }
}

/// Hysteresis: an estimate turns off above the margin, and back only when it is within the booking.
fn is_off(was: bool, expected: f64, booked: f64, margin: f64) -> bool {
    if was { expected > booked } else { expected > booked + margin }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(value: f64) -> Quantiles {
        Quantiles::known(value)
    }

    fn frame(number: u32, actual: Option<f64>) -> FrameState {
        let of = |mean: f64| Quantiles { mean, p50: mean, p80: 1.2 * mean, p95: 1.4 * mean };
        let cost = |mean: f64| FrameCost { quote: of(mean), actual: actual.map(|it| it * mean), part: None };
        FrameState { number, clock: None, share: None, work: cost(900.0), cpu_seconds: cost(4.0) }
    }

    fn quote(frames: f64) -> ForecastTotals {
        let of = |mean: f64| Quantiles { mean, p50: mean, p80: 1.1 * mean, p95: 1.2 * mean };
        ForecastTotals {
            work: of(900.0 * frames),
            cpu_seconds: of(4.0 * frames),
            ..ForecastTotals::default()
        }
    }

    #[test]
    fn the_estimate_is_the_quote_at_first_and_the_truth_at_last() {
        let total = quote(2.0);
        let begin = Frames::new(&[frame(0, None), frame(1, None)], &[]);
        let estimate = Estimate::new(&total, &begin, false);
        assert_eq!((estimate.work.whole, begin.share_left), (total.work, 1.0));
        let end = Frames::new(&[frame(0, Some(1.5)), frame(1, Some(1.0))], &[]);
        let estimate = Estimate::new(&total, &end, false);
        assert_eq!((estimate.work.whole, estimate.cpu_seconds.whole), (known(2250.0), known(10.0)));
        assert!(end.all_done && end.share_left == 0.0);
        let half = Frames::new(&[frame(0, Some(1.5)), frame(1, None)], &[]);
        assert_eq!(Estimate::new(&total, &half, true).work.whole, known(1350.0), "given up");
    }

    #[test]
    fn bookings_are_stretched_by_what_is_expected_over_what_was_planned_for_the_same_share() {
        let first = Baseline::of_quote(&known(100.0), Confidence::P80);
        assert_eq!((first.stretch(1.0, 100.0), first.stretch(0.5, 75.0)), (1.0, 1.5));
        let before = LiveFigure {
            quote: known(100.0),
            spent: 60.0,
            remaining: known(60.0),
            whole: known(120.0),
            factor: 1.2,
        };
        let second = Baseline::of_estimate(&before, Confidence::P80);
        assert_eq!(second, Baseline { cpu_seconds: 120.0, rest: 60.0, share: 0.5 });
        assert_eq!((second.stretch(0.5, 60.0), second.stretch(0.25, 60.0)), (1.0, 2.0));
        let nothing = Baseline { share: 0.0, ..second };
        assert_eq!(nothing.stretch(0.5, 60.0), 1.0);
    }

    #[test]
    fn an_estimate_leaves_by_more_than_the_margin_and_comes_back_only_at_what_is_booked() {
        assert!(!is_off(false, 101.9, 100.0, 2.0) && is_off(false, 102.1, 100.0, 2.0));
        assert!(is_off(true, 101.0, 100.0, 2.0) && !is_off(true, 100.0, 100.0, 2.0));
    }

    #[test]
    fn a_delay_counts_from_a_fiftieth_of_the_booked_time_and_from_ten_seconds() {
        let at = |seconds: i64| Some(Timestamp::from_micros(seconds * 1_000_000));
        assert_eq!(delay_that_counts(at(0), at(1000)), 20_000_000);
        assert_eq!(delay_that_counts(at(0), at(1)), 10_000_000);
        assert_eq!(delay_that_counts(None, at(1000)), 10_000_000);
    }

    #[test]
    fn the_rest_costs_the_mean_price_of_the_quote() {
        let price = MoneyQuantiles { mean: Money(500), ..MoneyQuantiles::default() };
        let found = cost(&known(10.0), &known(2.0), (price, 50.0), Money(7)).unwrap();
        assert_eq!((found.mean, found.p95), (Money(127), Money(127)));
        assert_eq!(cost(&known(10.0), &known(0.0), (MoneyQuantiles::default(), 0.0), Money(0)), None);
    }
}
