//! What jobs ask of nodes, and how fast nodes do it. Pure.

use std::collections::BTreeMap;
use std::sync::Arc;

use forelight_protocol::{ByClass, Job, Needs, Node};
use indexmap::IndexSet;

use super::farm::units;

/// The class of work that a planner's node does at its general speed.
const GENERAL: u32 = 0;

/// The demands of jobs, each once. Otherwise thousands of jobs and thousands of nodes would be looked at pair
/// by pair.
#[derive(Default)]
pub(super) struct Demands {
    needs: IndexSet<Needs>,
    /// The place of what the job needs, if not every node will do, and the work by class. The places here, from 1, are
    /// the classes of work of the plan.
    list: IndexSet<(Option<usize>, Option<[u64; ByClass::CLASSES]>)>,
}

impl Demands {
    /// The class of work, in the plan, of a job with this work by class.
    pub fn class(&mut self, job: &Job, work: Option<ByClass>) -> u32 {
        let needs = job.needs().map(|needs| self.needs.insert_full(needs).0);
        let (place, _) = self.list.insert_full((needs, work.map(ByClass::to_array)));
        u32::try_from(place + 1).unwrap_or(GENERAL)
    }

    /// Speeds of a node for the classes that it does not do at its general speed. 0 if it lacks what they need.
    pub fn speeds(&self, node: &Node) -> Arc<BTreeMap<u32, u64>> {
        let has: Vec<bool> = self.needs.iter().map(|needs| node.has(needs)).collect();
        let speed = |&(needs, work): &(Option<usize>, Option<[u64; ByClass::CLASSES]>)| {
            if needs.is_some_and(|needs| !has[needs]) {
                return Some(0);
            }
            let speed = node.corrected_speed(work.map(ByClass::from_array).as_ref())?;
            Some(units(speed * f64::from(node.cores)).max(1))
        };
        let classes = (GENERAL + 1..).zip(&self.list);
        Arc::new(classes.filter_map(|(class, demand)| Some((class, speed(demand)?))).collect())
    }
}
