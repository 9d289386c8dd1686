//! Nodes, their time and their price.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::units::{MICROSECONDS_PER_HOUR, MICROSECONDS_PER_SECOND, in_millionths};

/// A machine that renders one frame at a time, with all its cores. A machine that renders several at once is
/// as many nodes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Node {
    /// Identity, opaque to the planner. Ties go to the lower one.
    pub id: u64,
    /// Name for people.
    pub name: String,
    /// Work per second with all cores, for classes of work that `speeds` does not name. Not zero.
    pub speed: u64,
    /// Work per second by class of work. Zero if the node lacks the memory, cores or GPU for it. Copies of
    /// a farm share it.
    pub speeds: Arc<BTreeMap<u32, u64>>,
    /// Microseconds that every task takes beyond its work, by class of work: time that cores do not share. Copies
    /// of a farm share it.
    pub serial: Arc<BTreeMap<u32, i64>>,
    /// Price of a rented hour in micro-units. Not negative.
    pub price_per_hour: i64,
    /// Rented time is billed in multiples of this many microseconds. 0 or 1: to the microsecond.
    pub billing_step: i64,
    /// The least rented time that is billed, microseconds.
    pub minimum_booking: i64,
    /// Microseconds from the start of a rental to its first frame: waking up, fetching the scene. They are
    /// billed.
    pub setup: i64,
    /// Price of a set-up on top of its time, micro-units.
    pub setup_cost: i64,
    /// Whether the node runs at `available_from`.
    pub power: Power,
    /// Nothing may start before this instant.
    pub available_from: i64,
    /// When the node is free for rendering, in any order. Overlapping and touching intervals are joined.
    pub calendar: Vec<Interval>,
    /// When the node is closed, whatever the calendar says.
    pub maintenance: Vec<Interval>,
}

/// Whether a node has to be woken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Power {
    /// It sleeps: its first rental needs a set-up.
    #[default]
    Standby,
    /// It runs: a rental that starts when the node becomes available needs no set-up.
    On,
}

/// A half-open interval of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interval {
    /// First instant.
    pub start: i64,
    /// The instant after the last. `None`: the interval has no end.
    pub end: Option<i64>,
}

/// Time on a node that is not planned again, from `start` to just before `end`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct FixedBooking {
    /// The node.
    pub node: u64,
    /// First instant.
    pub start: i64,
    /// The instant after the last.
    pub end: i64,
    /// The job that it belongs to, if known. Used in explanations.
    pub job: Option<u64>,
}

impl Node {
    /// Work per second of this class. Zero if the node cannot do it.
    pub fn speed_of(&self, class: u32) -> u64 {
        self.speeds.get(&class).copied().unwrap_or(self.speed)
    }

    /// Cost of a unit of work of this class, for comparing nodes: 10⁹ × hourly price / speed. `i128::MAX` if
    /// the node cannot do it.
    pub fn price_of_work(&self, class: u32) -> i128 {
        match self.speed_of(class) {
            0 => i128::MAX,
            speed => i128::from(self.price_per_hour) * 1_000_000_000 / i128::from(speed),
        }
    }

    /// Microseconds that a task of this work keeps the node: [`Node::time_of`] and its serial time.
    pub fn duration(&self, work: u64, class: u32) -> Option<i64> {
        self.time_of(work, class)?.checked_add(self.serial.get(&class).copied().unwrap_or(0))
    }

    /// Microseconds that the node needs for this work, rounded up, at least one. `None` if that overflows, or
    /// the node cannot do work of this class.
    pub fn time_of(&self, work: u64, class: u32) -> Option<i64> {
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

    /// Cost of a rental of this many microseconds, in micro-units. The time includes a set-up; `with_setup`
    /// adds the price of one. Billed time is charged at the hourly price, rounded up once per rental.
    pub fn price(&self, rented: i64, with_setup: bool) -> i64 {
        let time = price_of(self.price_per_hour, self.billed(rented));
        if with_setup { time.saturating_add(self.setup_cost) } else { time }
    }

    /// Billed time of a rental: at least the minimum, in whole billing steps.
    pub fn billed(&self, rented: i64) -> i64 {
        round_up_to(rented.max(self.minimum_booking), self.billing_step)
    }

    /// Rented time is billed to the microsecond, without minimum or set-up. A rental then never exceeds its
    /// frames.
    pub(crate) fn is_plainly_billed(&self) -> bool {
        self.billing_step <= 1 && self.minimum_booking <= 1 && self.setup == 0 && self.setup_cost == 0
    }
}

/// Price in micro-units of this many microseconds at this hourly price, rounded up.
pub(crate) fn price_of(price_per_hour: i64, time: i64) -> i64 {
    // Usually 64 bits are enough, and their division is several times as fast.
    if let Some(product) = price_per_hour.checked_mul(time).filter(|&product| product >= 0) {
        return (product as u64).div_ceil(MICROSECONDS_PER_HOUR as u64) as i64;
    }
    let product = i128::from(price_per_hour) * i128::from(time);
    let rounded = (product + MICROSECONDS_PER_HOUR - 1).div_euclid(MICROSECONDS_PER_HOUR);
    i64::try_from(rounded).unwrap_or(i64::MAX)
}

/// The least multiple of `step` that is not below `value`. Saturates.
pub(crate) fn round_up_to(value: i64, step: i64) -> i64 {
    if step <= 1 {
        return value;
    }
    match value.rem_euclid(step) {
        0 => value,
        over => value.saturating_add(step - over),
    }
}
