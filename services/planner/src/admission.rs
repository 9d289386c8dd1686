//! Which deadlines can be met together, at what least cost, and on which nodes: a linear programme over slots
//! of time.
//!
//! Frames are treated as a fluid. For every job, class of nodes and slot, a variable holds the hours of the
//! class that the job gets. Each job's hours, converted to its fastest class, must add up to its work. In
//! each slot, all jobs' hours must fit into the class's free time. Work that does not fit is *unserved*, at a
//! penalty that outweighs any price and grows with the job's priority and weight.
//!
//! Slots are cut at deadlines, releases and calendars. If there are too many, only some are kept, and the
//! programme is solved twice. A job may use all of a slot that it touches: that can only lower the optimum,
//! which therefore remains a bound. For the plan, it may use all of a slot of which it covers a quarter:
//! otherwise the jobs that end just after a slot begins would count on time after their deadlines. Jobs that
//! do not fit into such slots may use all that they touch.

use crate::model::{Infeasible, Prices, Proof, Reserved, in_millionths};
use crate::problem::{Problem, Work};
use crate::proof::{Counted, value};
use crate::slots::{capacity, slots};
use crate::transport::{Demand, Programme, Solution, Solutions, Way};

/// The most rows of classes and slots: as many as can be solved in half a second for hundreds of jobs. With
/// two thirds of them, the bound of a studio's week is 0.5 % lower, and prices are too coarse for good
/// plans.
pub(crate) const MOST_ROWS: usize = 660;
/// A plan counts on a slot for a job that covers one part in this many of it. On nearly full farms, a half
/// leaves more to rent, and less than a sixth lets jobs count on time that they do not have.
const COVERED: i64 = 4;
const MICROSECONDS_PER_HOUR: f64 = 3.6e9;
/// Resolution of prices of time, as parts of the most expensive node's price.
const PARTS: i64 = 1 << 20;
/// Resolution of [`Admission::worth`], fine enough to need no rounding.
pub(crate) const IN_A_MICRO_UNIT: i128 = PARTS as i128 * 3_600_000_000;

#[derive(Clone, Debug, Default)]
pub(crate) struct Admission {
    pub allotments: Vec<Vec<Allotted>>,
    /// By job: whether the fluid model can meet its deadline together with all other admitted jobs. True
    /// without a deadline.
    pub admitted: Vec<bool>,
    /// Prices that prove the cost bound of the admitted jobs.
    pub proof: Proof,
    /// Prices of the narrow solution by class and slot, as parts of the most expensive node's price. They do
    /// not depend on the unit of money, so rounding does not separate equally good places.
    worths: Vec<Vec<i64>>,
    dearest: i64,
    pub infeasible: Option<Infeasible>,
}

/// Time of a class that a job gets in a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Allotted {
    pub class: usize,
    pub start: i64,
    pub end: i64,
    /// Node time of the class that is not used up, microseconds.
    pub left: i64,
}

impl Admission {
    /// Admits everyone, with no information on prices.
    pub fn none(problem: &Problem) -> Self {
        let jobs = problem.jobs.len();
        Admission { allotments: vec![Vec::new(); jobs], admitted: vec![true; jobs], ..Admission::default() }
    }

    pub fn with_proof(self, proof: Proof) -> Self {
        Admission { proof, ..self }
    }

    /// The slot that holds this instant: 0 before the first.
    pub fn slot(&self, instant: i64) -> usize {
        self.proof.slots.partition_point(|&start| start <= instant)
    }

    /// What others would pay for this time of a class on top of its price, in units of 1 /
    /// [`IN_A_MICRO_UNIT`] micro-unit.
    pub fn worth(&self, class: usize, start: i64, end: i64) -> i128 {
        let Some(worths) = self.worths.get(class) else { return 0 };
        let slots = &self.proof.slots;
        let first = slots.partition_point(|&slot| slot <= start).saturating_sub(1);
        let mut worth = 0i128;
        for (edges, &part) in slots.windows(2).zip(worths).skip(first) {
            if edges[0] >= end {
                break;
            }
            let time = end.min(edges[1]).saturating_sub(start.max(edges[0]));
            if time > 0 {
                worth = worth.saturating_add(i128::from(part) * i128::from(time));
            }
        }
        worth.saturating_mul(i128::from(self.dearest))
    }

    /// The next instant at which time of the class is worth less.
    pub fn cheaper_from(&self, class: usize, instant: i64) -> Option<i64> {
        let worths = self.worths.get(class)?;
        let slots = &self.proof.slots;
        let slot = slots.partition_point(|&start| start <= instant).checked_sub(1)?;
        let worth = *worths.get(slot)?;
        if worth == 0 {
            return None;
        }
        let next = (slot + 1..worths.len()).find(|&later| worths[later] < worth).unwrap_or(worths.len());
        slots.get(next).copied()
    }

    /// Whether others would pay for an hour of this class at this instant.
    pub fn is_scarce(&self, class: usize, instant: i64) -> bool {
        let slot = self.proof.slots.partition_point(|&start| start <= instant).checked_sub(1);
        let worths = self.worths.get(class);
        slot.zip(worths).and_then(|(slot, worths)| worths.get(slot)).is_some_and(|&worth| worth > 0)
    }
}

/// Solves the programme, with slots so coarse that it has at most about `most_rows` rows.
pub(crate) fn admit(problem: &Problem, most_rows: usize) -> Admission {
    let mut admitted: Vec<bool> = problem.jobs.iter().map(Work::has_nodes).collect();
    let slots = slots(problem, most_rows);
    let capacity = capacity(problem, &slots);
    let setting = Setting { problem, slots: &slots, capacity: &capacity };
    let first = Model::new(&setting, &admitted, true);
    let solutions = first.programme.solve(&problem.looks);
    let unserved = first.unserved(&solutions.wide);
    if unserved.is_empty() {
        return first.admission(&solutions, admitted, None);
    }
    // Not all fit. Prices of time alone prove that. Then the rest is planned without the unserved jobs.
    let infeasible = Model::new(&setting, &admitted, false).infeasible();
    unserved.into_iter().for_each(|job| admitted[job] = false);
    let rest = Model::new(&setting, &admitted, true);
    let solutions = rest.programme.solve(&problem.looks);
    rest.admission(&solutions, admitted, infeasible)
}

/// Hourly price of the most expensive node, at least one micro-unit.
fn dearest(problem: &Problem) -> i64 {
    problem.nodes.iter().map(|node| node.price_per_hour).max().unwrap_or(0).max(1)
}

struct Setting<'s, 'a> {
    problem: &'s Problem<'a>,
    slots: &'s [i64],
    capacity: &'s [Vec<u128>],
}

/// Work of a job to be served by its deadline: its frames, or its shared cache.
struct Asked<'s> {
    job: usize,
    class: u32,
    amount: u128,
    classes: &'s [usize],
    release: i64,
    deadline: i64,
    rank: f64,
}

/// The programme, and the meaning of its demands, ways and rows.
struct Model<'s, 'a> {
    setting: &'s Setting<'s, 'a>,
    programme: Programme,
    /// By demand: the job, and the class of each way.
    demands: Vec<(usize, Vec<usize>)>,
    /// By class: its first row, and the slots of its rows. Slots without free time have no row.
    rows: Vec<(usize, Vec<usize>)>,
    /// Micro-units per hour in one unit of the programme's cost.
    unit: f64,
}

impl<'s, 'a> Model<'s, 'a> {
    /// With `priced`, nodes have their prices. Otherwise only unserved work has a cost.
    fn new(setting: &'s Setting<'s, 'a>, admitted: &[bool], priced: bool) -> Self {
        let problem = setting.problem;
        let mut model = Model {
            setting,
            programme: Programme::default(),
            demands: Vec::new(),
            rows: Vec::new(),
            unit: if priced { dearest(problem) as f64 } else { 1e6 },
        };
        for capacity in setting.capacity {
            let slots: Vec<usize> = (0..capacity.len()).filter(|&slot| capacity[slot] > 0).collect();
            let hours = slots.iter().map(|&slot| capacity[slot] as f64 / MICROSECONDS_PER_HOUR);
            let first = model.programme.capacities.len();
            model.programme.capacities.extend(hours);
            model.rows.push((first, slots));
        }
        let ranks = ranks(problem);
        for (index, work) in problem.jobs.iter().enumerate() {
            let Some(deadline) = work.job.deadline.filter(|_| admitted[index]) else { continue };
            let release = work.release(problem.input.now);
            let asked = |class, amount, classes| Asked {
                job: index,
                class,
                amount,
                classes,
                release,
                deadline,
                rank: ranks[index],
            };
            let frames = asked(work.job.class, work.total(), &work.classes);
            let cache = work.job.shared_cache.zip(work.shared_cache);
            let cache =
                cache.map(|(cache, work_of)| asked(cache.class, work_of.into(), &work.shared_cache_classes));
            for asked in [Some(frames), cache].into_iter().flatten().filter(|asked| asked.amount > 0) {
                model.demand(&asked, priced);
            }
        }
        model
    }

    /// Adds a job's work, and a way for each class that it can use.
    fn demand(&mut self, asked: &Asked, priced: bool) {
        let &Asked { job, class: class_of_work, amount, classes, release, deadline, rank } = asked;
        let Setting { problem, slots, .. } = self.setting;
        // Hours that one node of a class needs for all of it. Computed exactly, so that the unit of work does
        // not matter.
        let hours = |class: usize| {
            let speed = u128::from(problem.representative(class).speed_of(class_of_work)).max(1);
            in_millionths(amount).div_ceil(speed) as f64 / MICROSECONDS_PER_HOUR
        };
        let fastest = classes.iter().map(|&class| hours(class)).fold(f64::INFINITY, f64::min);
        let needed = if fastest.is_finite() { fastest } else { 1.0 };
        let price = |class: usize| {
            if priced { problem.representative(class).price_per_hour as f64 / self.unit } else { 0.0 }
        };
        // More than the most expensive way to serve it. Without prices, one per hour.
        let dearest = classes.iter().map(|&class| price(class) * hours(class) / needed).fold(0.0, f64::max);
        let penalty = if priced { (20.0 * dearest + 20.0) * rank } else { 1.0 };
        let way = |&class: &usize| {
            let (first, of_class) = &self.rows[class];
            let before = of_class.partition_point(|&slot| slots[slot + 1] <= release);
            let until = of_class.partition_point(|&slot| slots[slot] < deadline).max(before);
            let rows = first + before..first + until;
            let covered = |slot: &usize| {
                let (start, end) = (slots[*slot], slots[*slot + 1]);
                let length = end.saturating_sub(start);
                deadline.min(end).saturating_sub(release.max(start)) >= length / COVERED
            };
            // Only the first and the last may be covered in part.
            let touched = &of_class[before..until];
            let skipped = touched.iter().take_while(|slot| !covered(slot)).count();
            let left_out = touched.iter().rev().take_while(|slot| !covered(slot)).count();
            let start = rows.start + skipped;
            let narrow = start..rows.end.saturating_sub(left_out).max(start);
            Way { cost: price(class), served: needed / hours(class), rows, narrow }
        };
        let ways = classes.iter().map(way).collect();
        self.programme.demands.push(Demand { needed, penalty, ways });
        self.demands.push((job, classes.to_vec()));
    }

    fn unserved(&self, solution: &Solution) -> Vec<usize> {
        let missing = (0..self.demands.len()).filter(|&demand| self.programme.misses(solution, demand));
        let mut jobs: Vec<usize> = missing.map(|demand| self.demands[demand].0).collect();
        jobs.dedup();
        jobs
    }

    fn allotments(&self, solution: &Solution) -> Vec<Vec<Allotted>> {
        let slots = self.setting.slots;
        let mut all: Vec<Vec<Allotted>> = vec![Vec::new(); self.setting.problem.jobs.len()];
        for &(demand, way, row, hours) in &solution.given {
            let (job, classes) = &self.demands[demand];
            let (first, of_class) = &self.rows[classes[way]];
            let slot = of_class[row - first];
            let left = (hours * MICROSECONDS_PER_HOUR).round() as i64;
            if left > 0 {
                all[*job].push(Allotted {
                    class: classes[way],
                    start: slots[slot],
                    end: slots[slot + 1],
                    left,
                });
            }
        }
        all
    }

    /// By class and slot: a number from the worth of an hour there.
    fn by_slot(&self, solution: &Solution, number: impl Fn(f64) -> i64) -> Vec<Vec<i64>> {
        let count = self.setting.slots.len().saturating_sub(1);
        let of_class = |(first, slots): &(usize, Vec<usize>)| {
            let mut all = vec![0; count];
            slots.iter().zip(*first..).for_each(|(&slot, row)| all[slot] = number(solution.worths[row]));
            all
        };
        self.rows.iter().map(of_class).collect()
    }

    fn admission(
        &self,
        solutions: &Solutions,
        admitted: Vec<bool>,
        infeasible: Option<Infeasible>,
    ) -> Admission {
        let part = |worth: f64| (worth * PARTS as f64).clamp(0.0, 1e12).round() as i64;
        Admission {
            allotments: self.allotments(&solutions.narrow),
            proof: self.proof(&solutions.wide),
            worths: self.by_slot(&solutions.narrow, part),
            dearest: dearest(self.setting.problem),
            admitted,
            infeasible,
        }
    }

    /// Prices in micro-units per hour.
    fn proof(&self, solution: &Solution) -> Proof {
        let problem = self.setting.problem;
        let price = |worth: f64| (worth * self.unit).clamp(0.0, i64::MAX as f64 / 4.0).round() as i64;
        let ids = |members: &Vec<usize>| members.iter().map(|&node| problem.nodes[node].id).collect();
        let nodes = problem
            .classes
            .iter()
            .zip(self.by_slot(solution, price))
            .map(|(members, per_hour)| Prices { of: ids(members), per_hour });
        Proof { slots: self.setting.slots.to_vec(), nodes: nodes.collect() }
    }

    /// Proof that not everything can be served, if one exists in integers.
    fn infeasible(&self) -> Option<Infeasible> {
        let problem = self.setting.problem;
        let proof = self.proof(&self.programme.solve(&problem.looks).wide);
        let by = |job: &crate::model::Job| job.deadline.map_or(Counted::Not, Counted::By);
        if value(problem.input, &proof, false, by) <= 0 {
            return None;
        }
        let alone = |id: u64| {
            let only = |job: &crate::model::Job| if job.id == id { by(job) } else { Counted::Not };
            let none = |_: &crate::model::Job| Counted::Not;
            value(problem.input, &proof, false, only) > value(problem.input, &proof, false, none)
        };
        let jobs = problem.jobs.iter().filter(|work| work.job.deadline.is_some()).map(|work| work.job.id);
        Some(Infeasible { jobs: jobs.filter(|&id| alone(id)).collect(), short: short(&proof), proof })
    }
}

/// Where time is scarce: neighbouring slots with the same priced nodes are joined.
fn short(proof: &Proof) -> Vec<Reserved> {
    let priced = |slot: usize| -> Vec<u64> {
        let has_price = |prices: &&Prices| prices.per_hour.get(slot).is_some_and(|&price| price > 0);
        let mut ids: Vec<u64> =
            proof.nodes.iter().filter(has_price).flat_map(|prices| prices.of.iter().copied()).collect();
        ids.sort_unstable();
        ids
    };
    let mut found: Vec<Reserved> = Vec::new();
    for (slot, ends) in proof.slots.windows(2).enumerate() {
        let nodes = priced(slot);
        if nodes.is_empty() {
            continue;
        }
        match found.last_mut() {
            Some(last) if last.end == ends[0] && last.nodes == nodes => last.end = ends[1],
            _ => found.push(Reserved { nodes, start: ends[0], end: ends[1] }),
        }
    }
    found
}

/// By job: what leaving it unserved costs, relative to the lowest priority. Each rank of priority is worth
/// eight times the one below it. Only the six highest steps are distinguished, to limit the range of the
/// numbers.
fn ranks(problem: &Problem) -> Vec<f64> {
    let mut priorities: Vec<i32> = problem.jobs.iter().map(|work| work.job.priority).collect();
    priorities.sort_unstable();
    priorities.dedup();
    let rank = |priority: i32| {
        let above = priorities.len() - priorities.partition_point(|&other| other < priority) - 1;
        let rank = 6usize.min(priorities.len() - 1).saturating_sub(above);
        8f64.powi(rank as i32)
    };
    let worth = |work: &Work| 1.0 + f64::from(work.job.worth()).log2().min(2.0);
    problem.jobs.iter().map(|work| rank(work.job.priority) * worth(work)).collect()
}

#[cfg(test)]
mod tests {
    use super::{COVERED, admit};
    use crate::chance::between;
    use crate::model::{Confidence, Frame, Input, Interval, Job, Node, WorkTotal};
    use crate::problem::Problem;

    #[test]
    fn a_plan_counts_on_a_slot_only_for_jobs_that_cover_a_quarter_of_it() {
        let node = |id: u64| Node {
            id,
            speed: 1 + id,
            price_per_hour: 1_000_000 + 4_000_000 * id as i64,
            calendar: vec![Interval { start: 0, end: None }],
            ..Node::default()
        };
        let job = |id: u64| {
            let release = between(1, &[id], 0, 1_000_000_000);
            Job {
                id,
                release,
                deadline: Some(release + between(2, &[id], 200_000_000, 400_000_000)),
                confidence: Confidence::P50,
                total: WorkTotal { p50: 13, p80: 13, p95: 13 },
                frames: vec![Frame { number: 0, work: 13, ..Frame::default() }],
                ..Job::default()
            }
        };
        let input = Input {
            nodes: (0..2).map(node).collect(),
            jobs: (0..200).map(job).collect(),
            ..Input::default()
        };
        let problem = Problem::new(&input);
        let admission = admit(&problem, 40);
        let slots = &admission.proof.slots;
        assert_eq!(slots.len(), 21, "as many slots as there may be");
        assert!(slots.is_sorted_by(|one, next| one < next), "{slots:?}");
        let mut pieces = 0;
        for (job, work) in problem.jobs.iter().enumerate() {
            for piece in &admission.allotments[job] {
                let covered =
                    work.job.deadline.unwrap_or(i64::MAX).min(piece.end) - work.job.release.max(piece.start);
                assert!(covered >= (piece.end - piece.start) / COVERED, "job {job}: {covered} of {piece:?}");
                pieces += 1;
            }
        }
        assert!(pieces >= 200 && admission.admitted.iter().all(|&admitted| admitted), "{pieces}");
    }
}
