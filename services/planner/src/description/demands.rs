//! Demands of jobs on nodes, as classes of work.
//!
//! The planner knows a node's abilities only as a speed for each class of work. So every distinct demand for
//! memory and cores becomes a class. Nodes that do not meet it have speed zero for that class.

use std::collections::{BTreeMap, BTreeSet};

use super::entries::{JobEntry, NodeEntry};
use super::error::DescriptionError;
use super::values::scaled;

/// Work of a second at speed one.
pub(super) const WORK_PER_SECOND: f64 = 1e9;
const GIB: f64 = (1u64 << 30) as f64;

#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Demand {
    /// The class's name. `None` for unnamed work.
    class: Option<String>,
    memory: u64,
    gpu_memory: u64,
    cores: u32,
}

impl Demand {
    fn new(class: &Option<String>, job: &JobEntry) -> Result<Self, DescriptionError> {
        let at = format!("job {:?}", job.name);
        Ok(Demand {
            class: class.clone(),
            memory: scaled(job.memory_gib, GIB, &at, "memory_gib")?,
            gpu_memory: scaled(job.gpu_memory_gib, GIB, &at, "gpu_memory_gib")?,
            cores: job.cores,
        })
    }
}

/// The classes of work of a description: their numbers by demand. Number zero is work without demands.
pub(super) struct Demands(BTreeMap<Demand, u32>);

impl Demands {
    pub(super) fn new(nodes: &[NodeEntry], jobs: &[JobEntry]) -> Result<Self, DescriptionError> {
        let of_nodes = nodes.iter().flat_map(|node| node.speeds.keys());
        let mut all: BTreeSet<Demand> =
            of_nodes.map(|class| Demand { class: Some(class.clone()), ..Demand::default() }).collect();
        for job in jobs {
            all.insert(Demand::new(&job.class, job)?);
            all.insert(Demand::new(&job.shared_cache_class, job)?);
        }
        // It sorts first, so it is number zero.
        all.insert(Demand::default());
        Ok(Demands(all.into_iter().zip(0..).collect()))
    }

    pub(super) fn class(&self, class: &Option<String>, job: &JobEntry) -> Result<u32, DescriptionError> {
        Ok(self.0.get(&Demand::new(class, job)?).copied().unwrap_or(0))
    }

    pub(super) fn speeds(&self, node: &NodeEntry) -> Result<BTreeMap<u32, u64>, DescriptionError> {
        let at = format!("node {:?}", node.name);
        let memory = scaled(node.memory_gib, GIB, &at, "memory_gib")?;
        let gpu_memory = scaled(node.gpu_memory_gib, GIB, &at, "gpu_memory_gib")?;
        let mut speeds = BTreeMap::new();
        for (demand, &number) in &self.0 {
            let named = demand.class.as_ref().and_then(|class| node.speeds.get(class));
            let fits =
                memory >= demand.memory && gpu_memory >= demand.gpu_memory && node.cores >= demand.cores;
            let (speed, field) = named.map_or((node.speed, "speed"), |&speed| (speed, "speeds"));
            let speed = scaled(speed, WORK_PER_SECOND, &at, field)?;
            speeds.insert(number, if fits { speed } else { 0 });
        }
        Ok(speeds)
    }
}
