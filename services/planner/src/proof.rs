//! Lower bounds on cost, proven by prices of time.
//!
//! Add a price π ≥ 0 to every hour of free node time, on top of the node's own price. Under any plan, a job
//! then pays at least the price of its work in the cheapest hours that it may use. All jobs together pay at
//! most Σ π · free time for the added prices. So
//!
//! cost of any plan ≥ Σ over jobs (least price of its work) − Σ π · free time.
//!
//! If the right side is positive even with nodes that cost nothing, no plan exists (Farkas' lemma). The bound
//! holds for any prices, wherever they come from. All arithmetic is in integers and rounds the bound down.

use std::collections::BTreeMap;

use crate::calendar::{Window, windows};
use crate::model::{FixedBooking, Input, Job, MICROSECONDS_PER_HOUR, Node, Prices, Proof, in_millionths};

/// Whether a job counts for a bound, and by when its work must be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Counted {
    Not,
    Whenever,
    By(i64),
}

/// The right side of the inequality in the module's documentation, in micro-units. Without `with_own_prices`,
/// nodes themselves cost nothing.
pub(crate) fn value(
    input: &Input,
    proof: &Proof,
    with_own_prices: bool,
    counted: impl Fn(&Job) -> Counted,
) -> i128 {
    let groups = Group::all(input, proof);
    let slots = slots(proof);
    let mut value = 0i128;
    for job in &input.jobs {
        let end = match counted(job) {
            Counted::Not => continue,
            Counted::Whenever => i64::MAX,
            Counted::By(deadline) => deadline,
        };
        let start = job.release.max(input.now);
        let frames: u128 = job.open_frames().map(|(frame, work)| job.least_work(work, frame.division)).sum();
        let cache = job
            .shared_cache
            .zip(job.bought_shared_cache())
            .map(|(cache, work)| (cache.class, u128::from(work)));
        for (class, work) in [(job.class, frames)].into_iter().chain(cache) {
            let least = groups
                .iter()
                .filter_map(|group| {
                    let price = group.least_price(&slots, proof, start, end)?;
                    group.least_cost(class, work, price, with_own_prices)
                })
                .min();
            value = value.saturating_add(least.unwrap_or(0));
        }
    }
    for group in &groups {
        for (index, &time) in group.free.iter().enumerate() {
            value = value.saturating_sub(product_up(price_at(group.prices, index), time));
        }
    }
    value
}

struct Group<'a> {
    prices: Option<&'a Prices>,
    nodes: Vec<&'a Node>,
    /// Free time of all nodes of the group together, by slot.
    free: Vec<u128>,
    /// Whether some free time lies before the first slot, and after the last.
    outside: [bool; 2],
}

impl<'a> Group<'a> {
    /// Puts every node into one group: that of the first prices in the proof that name it, or else the last
    /// group, without prices.
    fn all(input: &'a Input, proof: &'a Proof) -> Vec<Self> {
        let mut group_of: BTreeMap<u64, usize> = BTreeMap::new();
        for (index, prices) in proof.nodes.iter().enumerate() {
            prices.of.iter().for_each(|&node| {
                group_of.entry(node).or_insert(index);
            });
        }
        let mut fixed: BTreeMap<u64, Vec<&FixedBooking>> = BTreeMap::new();
        for booking in &input.fixed {
            fixed.entry(booking.node).or_default().push(booking);
        }
        let slots = slots(proof);
        let mut groups: Vec<Group> = proof
            .nodes
            .iter()
            .map(Some)
            .chain([None])
            .map(|prices| Group {
                prices,
                nodes: Vec::new(),
                free: vec![0; slots.len()],
                outside: [false; 2],
            })
            .collect();
        let none = Vec::new();
        for node in &input.nodes {
            let group = &mut groups[group_of.get(&node.id).copied().unwrap_or(proof.nodes.len())];
            group.nodes.push(node);
            for window in windows(node, input.now, fixed.get(&node.id).unwrap_or(&none)) {
                group.add(window, &slots, proof);
            }
        }
        for group in &mut groups {
            // Of nodes with equal speeds and prices, one is enough.
            let terms = |node: &&'a Node| (node.speed, node.price_per_hour, &node.speeds, &node.serial);
            group.nodes.sort_unstable_by_key(terms);
            group.nodes.dedup_by_key(|node| terms(node));
        }
        groups
    }

    fn add(&mut self, window: Window, slots: &[(i64, i64)], proof: &Proof) {
        let first = slots.partition_point(|slot| slot.1 <= window.start);
        for (free, slot) in self.free[first..].iter_mut().zip(&slots[first..]) {
            if slot.0 >= window.end {
                break;
            }
            let overlap = (window.start.max(slot.0), window.end.min(slot.1));
            *free = free.saturating_add(u128::from(overlap.1.abs_diff(overlap.0)));
        }
        self.outside[0] |= proof.slots.first().is_none_or(|&first| window.start < first);
        self.outside[1] |= proof.slots.last().is_none_or(|&last| window.end > last);
    }

    /// The least added price of an hour of the group between these instants. `None` if it has no time there.
    fn least_price(&self, slots: &[(i64, i64)], proof: &Proof, start: i64, end: i64) -> Option<i128> {
        let before = self.outside[0] && proof.slots.first().is_none_or(|&first| start < first);
        let after = self.outside[1] && proof.slots.last().is_none_or(|&last| end > last);
        if before || after {
            return Some(0);
        }
        let usable = |index: usize| {
            self.free[index] > 0 && slots[index].0 < end && slots[index].1 > start && start < end
        };
        (0..slots.len()).filter(|&index| usable(index)).map(|index| price_at(self.prices, index)).min()
    }

    /// The least cost of this work on the best of the group's nodes.
    fn least_cost(&self, class: u32, work: u128, price: i128, with_own: bool) -> Option<i128> {
        self.nodes
            .iter()
            .filter(|node| node.speed_of(class) > 0)
            .map(|node| {
                let own = if with_own { i128::from(node.price_per_hour) } else { 0 };
                let time = in_millionths(work) / u128::from(node.speed_of(class));
                product_down(price.saturating_add(own), time)
            })
            .min()
    }
}

/// The slots between the proof's instants. A reversed slot is empty.
pub(crate) fn slots(proof: &Proof) -> Vec<(i64, i64)> {
    let mut reached = i64::MIN;
    let risen = proof.slots.iter().map(|&instant| {
        reached = reached.max(instant);
        reached
    });
    let instants: Vec<i64> = risen.collect();
    instants.windows(2).map(|pair| (pair[0], pair[1])).collect()
}

fn price_at(prices: Option<&Prices>, slot: usize) -> i128 {
    prices.and_then(|prices| prices.per_hour.get(slot)).map_or(0, |&price| i128::from(price.max(0)))
}

/// Price times time in micro-units, rounded down. Saturates.
fn product_down(price: i128, time: u128) -> i128 {
    let time = i128::try_from(time).unwrap_or(i128::MAX);
    let product = price.checked_mul(time).map(|product| product / MICROSECONDS_PER_HOUR);
    product.map_or(i128::from(i64::MAX), |product| product.min(i128::from(i64::MAX)))
}

/// Price times time in micro-units, rounded up.
fn product_up(price: i128, time: u128) -> i128 {
    if price == 0 {
        return 0;
    }
    let time = i128::try_from(time).unwrap_or(i128::MAX);
    price.checked_mul(time).map_or(i128::MAX / 4, |product| {
        product / MICROSECONDS_PER_HOUR + i128::from(product % MICROSECONDS_PER_HOUR > 0)
    })
}
