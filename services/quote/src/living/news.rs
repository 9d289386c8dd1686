//! Reports estimates that exceed their bookings or are back within them, and those that call for a new plan.

use forelight_protocol::{BookedQuantity, LiveForecast, Money, OffForecast, Timestamp};

use super::Off;

/// A new plan is due if the factors differ by more than this logarithm, about a tenth.
const NEWS: f64 = 0.1;

/// True if a factor on the job's forecast differs enough from that of its plan.
pub fn is_news(found: f64, planned: f64) -> bool {
    found > 0.0 && planned > 0.0 && (found / planned).ln().abs() > NEWS
}

/// Why a new plan is due, or `None`. `planned` is the factor of the present plan.
pub fn cause_of_plan(live: &LiveForecast, was_off: Off, planned: f64, job: &str) -> Option<String> {
    let factor = live.cpu_seconds.factor;
    let is_late = live.finish_is_off && !was_off.finish;
    (is_news(factor, planned) || is_late).then(|| {
        let word = if factor < 1.0 { "less" } else { "longer" };
        format!("frames of job {job} take {word} than was forecast")
    })
}

/// An estimate now exceeds its booking, or is back within it.
#[derive(Clone, PartialEq, Debug)]
pub struct News {
    /// True if it exceeds the booking.
    pub is_off: bool,
    /// As a sentence.
    pub message: String,
    /// As numbers.
    pub off: OffForecast,
}

/// Changes since the previous estimate.
pub fn news(live: &LiveForecast, was_off: Off) -> Vec<News> {
    [
        (BookedQuantity::Cost, was_off.cost, live.cost_is_off),
        (BookedQuantity::Finish, was_off.finish, live.finish_is_off),
    ]
    .into_iter()
    .filter(|(_, was, is)| was != is)
    .map(|(quantity, _, is_off)| news_of(live, quantity, is_off))
    .collect()
}

fn news_of(live: &LiveForecast, quantity: BookedQuantity, is_off: bool) -> News {
    let confidence = live.booked.confidence;
    let expected = live.cpu_seconds.whole.at(confidence);
    let level = confidence.name().to_uppercase();
    let numbers = match quantity {
        BookedQuantity::Cost => format!(
            "at {level} {expected:.1} CPU seconds are expected, {:.1} are booked",
            live.booked.cpu_seconds
        ),
        BookedQuantity::Finish => {
            let time = |at: Option<Timestamp>| at.map_or("-".to_owned(), |at| at.to_string());
            format!(
                "at {level} its end is expected at {}, booked is {}",
                time(live.finish),
                time(live.booked.finish)
            )
        }
    };
    let what = quantity.name();
    let message = if is_off {
        format!("the {what} exceeds its booking: {numbers}")
    } else {
        format!("the {what} is back within its booking: {numbers}")
    };
    let cost =
        live.booked.cost.filter(|_| live.booked.cpu_seconds > 0.0).map(|cost| {
            Money((cost.micro_units() as f64 * (expected / live.booked.cpu_seconds)).round() as i64)
        });
    let off = OffForecast {
        quantity,
        frames_done: live.frames_done,
        booked: live.booked,
        cpu_seconds: expected,
        cost,
        finish: live.finish,
    };
    News { is_off, message, off }
}

#[cfg(test)]
mod tests {
    use forelight_protocol::{Booked, Confidence, LiveFigure, Quantiles};

    use super::*;

    fn live(expected: f64, factor: f64, [cost_is_off, finish_is_off]: [bool; 2]) -> LiveForecast {
        let whole = Quantiles::known(expected);
        let cpu_seconds = LiveFigure { whole, factor, ..LiveFigure::default() };
        let booked =
            Booked { confidence: Confidence::P80, cpu_seconds: 10.0, cost: Some(Money(100)), finish: None };
        LiveForecast {
            at: Timestamp::from_micros(0),
            frames_done: 3,
            work: cpu_seconds,
            cpu_seconds,
            cost: None,
            finish: None,
            booked,
            cost_is_off,
            finish_is_off,
        }
    }

    #[test]
    fn leaving_and_coming_back_are_each_said_once() {
        let within = Off::default();
        let dear = Off { cost: true, finish: false };
        assert_eq!(news(&live(12.0, 1.2, [true, false]), dear), []);
        let left = news(&live(12.0, 1.2, [true, false]), within);
        assert_eq!((left.len(), left[0].is_off, left[0].off.cost), (1, true, Some(Money(120))));
        assert!(left[0].message.contains("at P80 12.0 CPU seconds are expected, 10.0 are booked"));
        let back = news(&live(9.0, 0.9, [false, false]), dear);
        assert!(!back[0].is_off && back[0].message.contains("the cost is back"));
    }

    #[test]
    fn plans_should_know_of_a_tenth_and_of_a_job_that_turns_late() {
        let cause = |factor, planned, finish| {
            cause_of_plan(&live(10.0, factor, [false, finish]), Off::default(), planned, "a shot")
        };
        assert_eq!((cause(1.05, 1.0, false), cause(1.2, 1.2, false)), (None, None));
        assert!(cause(1.2, 1.0, false).is_some_and(|it| it.contains("longer")));
        assert!(cause(0.8, 1.0, false).is_some_and(|it| it.contains("less")));
        assert!(cause(1.0, 1.0, true).is_some());
        assert!(!is_news(0.0, 1.0));
    }
}
