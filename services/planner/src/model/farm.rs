//! Nodes, their time and their price.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::units::{MICROSECONDS_PER_HOUR, MICROSECONDS_PER_SECOND, in_millionths};

/// A machine that renders one frame at a time, with all its cores. A machine that renders several at once is as
/// many nodes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Node {
    /// Identity, opaque to the planner; ties go to the lower one.
    pub id: u64,
    /// Name for people.
    pub name: String,
    /// Work per second, with all cores, for every class of work that `speeds` does not name; not zero.
    pub speed: u64,
    /// Work per second by class of work. Zero: the node cannot do work of this class, for want of memory, cores or a
    /// graphics processor.
    pub speeds: BTreeMap<u32, u64>,
    /// Price of a rented hour in micro-units; not negative.
    pub price_per_hour: i64,
    /// Rented time is billed in multiples of this many microseconds; zero and one: to the microsecond.
    pub billing_step: i64,
    /// The least rented time that is billed, microseconds.
    pub minimum_booking: i64,
    /// Microseconds from the start of a rental to the first frame: waking up, fetching the scene. They are
    /// billed.
    pub setup: i64,
    /// Price of a set-up on top of its time, micro-units.
    pub setup_cost: i64,
    /// Whether the node runs at the instant from which it is available.
    pub power: Power,
    /// Nothing may start before this instant.
    pub available_from: i64,
    /// When the node is free for rendering, in any order; overlapping and touching intervals count as one.
    pub calendar: Vec<Interval>,
    /// When it is not, whatever the calendar says.
    pub maintenance: Vec<Interval>,
}

/// Whether a node has to be woken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Power {
    /// It sleeps: the first rental needs a set-up.
    #[default]
    Standby,
    /// It runs: a rental that starts the instant it is available needs none.
    On,
}

/// A half-open interval of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interval {
    /// First instant.
    pub start: i64,
    /// The instant after the last, or none for an interval without end.
    pub end: Option<i64>,
}

/// Time on a node that is not to be planned again, from `start` to just before `end`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct FixedBooking {
    /// The node.
    pub node: u64,
    /// First instant.
    pub start: i64,
    /// The instant after the last.
    pub end: i64,
    /// The job it is for, where that is known: for explanations.
    pub job: Option<u64>,
}

impl Node {
    /// Work per second of this class. Zero if the node cannot do it.
    pub fn speed_of(&self, class: u32) -> u64 {
        self.speeds.get(&class).copied().unwrap_or(self.speed)
    }

    /// What work of a class costs on the node, for comparing: a billion times its price an hour over its speed. That of work it cannot do is beyond all others.
    pub fn price_of_work(&self, class: u32) -> i128 {
        match self.speed_of(class) {
            0 => i128::MAX,
            speed => i128::from(self.price_per_hour) * 1_000_000_000 / i128::from(speed),
        }
    }

    /// Microseconds that the node takes for this much work of a class, rounded up, and at least one. None if
    /// that leaves the range of time, or the node cannot do it.
    pub fn duration(&self, work: u64, class: u32) -> Option<i64> {
        let speed = self.speed_of(class);
        if speed > 0
            && let Some(amount) = work.checked_mul(MICROSECONDS_PER_SECOND as u64)
        {
            return i64::try_from(amount.div_ceil(speed).max(1)).ok();
        }
        (speed > 0)
            .then(|| in_millionths(u128::from(work)).div_ceil(u128::from(speed)).max(1))
            .and_then(|duration| i64::try_from(duration).ok())
    }

    /// What a rental of this many microseconds costs, set-up included if it begins with one: the time, raised
    /// to the minimum and then to whole steps, at the hourly price, rounded up once for each rental.
    pub fn price(&self, rented: i64, with_setup: bool) -> i64 {
        let time = price_of(self.price_per_hour, self.billed(rented));
        if with_setup { time.saturating_add(self.setup_cost) } else { time }
    }

    /// The time that is billed for a rental of this many microseconds.
    pub fn billed(&self, rented: i64) -> i64 {
        round_up_to(rented.max(self.minimum_booking), self.billing_step)
    }

    /// Whether rented time is billed as it is, so that a rental is never longer than its frames.
    pub(crate) fn is_plainly_billed(&self) -> bool {
        self.billing_step <= 1 && self.minimum_booking <= 1 && self.setup == 0 && self.setup_cost == 0
    }
}

/// Price of so many microseconds at a price per hour, in micro-units, rounded up.
pub(crate) fn price_of(price_per_hour: i64, time: i64) -> i64 {
    // What planners ask fits into 64 bits, whose division is several times as fast.
    if let Some(product) = price_per_hour.checked_mul(time).filter(|&product| product >= 0) {
        return (product as u64).div_ceil(MICROSECONDS_PER_HOUR as u64) as i64;
    }
    let product = i128::from(price_per_hour) * i128::from(time);
    let rounded = (product + MICROSECONDS_PER_HOUR - 1).div_euclid(MICROSECONDS_PER_HOUR);
    i64::try_from(rounded).unwrap_or(i64::MAX)
}

/// The least multiple of the step that is not below the value; the end of the range if there is none.
pub(crate) fn round_up_to(value: i64, step: i64) -> i64 {
    if step <= 1 {
        return value;
    }
    match value.rem_euclid(step) {
        0 => value,
        over => value.saturating_add(step - over),
    }
}
