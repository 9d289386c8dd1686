//! What tasks demand of their nodes: a class of work, memory and cores.
//!
//! All that the planner knows of a node's abilities is its speed for each class of work: zero if it cannot do it. So every
//! demand that differs from the others becomes a class of its own, and nodes that lack the memory or the cores have speed
//! zero for it.

use std::collections::{BTreeMap, BTreeSet};

use super::entries::{JobEntry, NodeEntry};
use super::error::DescriptionError;
use super::values::scaled;

/// Work of a second at speed one.
pub(super) const WORK_PER_SECOND: f64 = 1e9;
const GIB: f64 = (1u64 << 30) as f64;

#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Demand {
    /// The class by name; `None` for work that is not named.
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

/// The classes of work of a description: their numbers by demand. Number zero is work without a demand.
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
        // The least of all.
        all.insert(Demand::default());
        Ok(Demands(all.into_iter().zip(0..).collect()))
    }

    /// The number of a job's class of work.
    pub(super) fn class(&self, class: &Option<String>, job: &JobEntry) -> Result<u32, DescriptionError> {
        Ok(self.0.get(&Demand::new(class, job)?).copied().unwrap_or(0))
    }

    /// A node's speed for each class of work.
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
