//! What jobs ask of nodes, and how fast nodes do it. Pure.

use std::collections::BTreeMap;
use std::sync::Arc;

use forelight_protocol::{ByClass, Needs, Node};
use forelight_quote::JobForecast;
use forelight_quote::serial_time::SerialTime;
use forelight_store::FarmJob;
use indexmap::IndexSet;

use super::quantities::units;

/// The class of work that a planner's node does at its general speed.
const GENERAL: u32 = 0;

/// The demands of jobs, each once. Otherwise thousands of jobs and thousands of nodes would be looked at pair
/// by pair.
#[derive(Default)]
pub(super) struct Demands {
    needs: IndexSet<Needs>,
    /// The places here, from 1, are the classes of work of the plan.
    list: IndexSet<Demand>,
}

#[derive(PartialEq, Eq, Hash)]
struct Demand {
    /// The place of what the job needs, if not every node will do.
    needs: Option<usize>,
    /// The work by class.
    work: Option<[u64; ByClass::CLASSES]>,
    serial: SerialTime,
}

impl Demands {
    /// The class of work, in the plan, of a job.
    pub fn class(&mut self, farm_job: &FarmJob, forecast: &JobForecast) -> u32 {
        let needs = farm_job.job.needs().map(|needs| self.needs.insert_full(needs).0);
        let work = forecast.work_by_class.map(ByClass::to_array);
        let SerialTime { one_core, many_cores } = farm_job.serial_time;
        let serial = SerialTime { one_core: rounded(one_core), many_cores: rounded(many_cores) };
        let (place, _) = self.list.insert_full(Demand { needs, work, serial });
        u32::try_from(place + 1).unwrap_or(GENERAL)
    }

    /// Speeds of a node for the classes that it does not do at its general speed. 0 if it lacks what they need.
    pub fn speeds(&self, node: &Node) -> Arc<BTreeMap<u32, u64>> {
        let has: Vec<bool> = self.needs.iter().map(|needs| node.has(needs)).collect();
        let speed = |&Demand { needs, work, .. }: &Demand| {
            if needs.is_some_and(|needs| !has[needs]) {
                return Some(0);
            }
            let speed = node.corrected_speed(work.map(ByClass::from_array).as_ref())?;
            Some(units(speed * f64::from(node.cores)).max(1))
        };
        let classes = (GENERAL + 1..).zip(&self.list);
        Arc::new(classes.filter_map(|(class, demand)| Some((class, speed(demand)?))).collect())
    }

    /// Serial times of tasks by class, on nodes of one core and of several.
    pub fn serial_times(&self) -> OfNodes {
        let of_nodes = |cores| {
            let classes = (GENERAL + 1..).zip(&self.list);
            let times = classes.map(|(class, demand)| (class, demand.serial.on(cores)));
            Arc::new(times.filter(|&(_, time)| time > 0).collect())
        };
        OfNodes { one_core: of_nodes(1), many_cores: of_nodes(2) }
    }
}

/// Serial times by class of work, in microseconds.
pub(super) struct OfNodes {
    one_core: Arc<BTreeMap<u32, i64>>,
    many_cores: Arc<BTreeMap<u32, i64>>,
}

impl OfNodes {
    pub fn on(&self, cores: u32) -> Arc<BTreeMap<u32, i64>> {
        Arc::clone(if cores > 1 { &self.many_cores } else { &self.one_core })
    }
}

/// Serial time to four bits, so that many jobs share a demand. Less than ten milliseconds is none.
fn rounded(micros: i64) -> i64 {
    if micros < 10_000 {
        return 0;
    }
    let dropped = (i64::BITS - micros.leading_zeros()).saturating_sub(4);
    (micros >> dropped) << dropped
}

#[cfg(test)]
mod tests {
    use forelight_planner as planner;

    use super::*;

    #[test]
    fn serial_time_is_added_to_the_time_of_a_task_on_any_number_of_cores() {
        let of = |one_core, many_cores| Demand {
            needs: None,
            work: None,
            serial: SerialTime { one_core, many_cores },
        };
        let demands = Demands { needs: IndexSet::new(), list: [of(0, 0), of(3, 8)].into() };
        let times = demands.serial_times();
        for (cores, serial) in [(1, 3), (2, 8), (64, 8)] {
            let speed = 100 * u64::from(cores);
            let node = planner::Node { speed, serial: times.on(cores), ..planner::Node::default() };
            let alone = 1_000_000 * 1000 / i64::try_from(speed).unwrap();
            assert_eq!([1, 2].map(|class| node.duration(1000, class).unwrap() - alone), [0, serial]);
            assert_eq!(node.time_of(1000, 2), Some(alone));
        }
    }

    #[test]
    fn serial_times_that_differ_little_are_one() {
        assert_eq!([0, 9_999, 10_000, i64::MAX].map(rounded), [0, 0, 9_216, 15 << 59]);
        assert_eq!(rounded(3_000_000), rounded(3_050_000));
        for micros in [20_000, 3_333_333, 777_777_777] {
            assert!((0.88..=1.0).contains(&(rounded(micros) as f64 / micros as f64)));
        }
    }
}
