//! What jobs ask of nodes, and how fast nodes do it. Pure.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use forelight_protocol::{ByClass, Node, RendererRequest};
use forelight_store::FarmJob;

use super::farm::units;

/// The class of work that a planner's node does at its general speed.
const GENERAL: u32 = 0;

/// The demands of some jobs, each once: thousands of jobs on thousands of nodes would else be looked at pair by
/// pair.
#[derive(Default)]
pub(super) struct Demands {
    renderers: Vec<RendererRequest>,
    /// The place of the renderer, if the job names one, and the work by class. A demand's class of work in the
    /// plan is its place here and one.
    list: Vec<(Option<usize>, Option<ByClass>)>,
    /// By job, its class of work in the plan.
    classes: Vec<u32>,
}

impl Demands {
    /// Those of the jobs that have a forecast, in their order.
    pub fn of(jobs: &[FarmJob]) -> Self {
        let mut demands = Self::default();
        let mut renderers: HashMap<RendererRequest, usize> = HashMap::new();
        let mut known = HashMap::new();
        for (job, forecast) in jobs.iter().filter_map(|job| Some((&job.job, job.forecast.as_ref()?))) {
            let renderer = job.needs().map(|renderer| {
                *renderers.entry(renderer).or_insert_with_key(|renderer| {
                    demands.renderers.push(renderer.clone());
                    demands.renderers.len() - 1
                })
            });
            let work = forecast.work_by_class;
            let class = *known.entry((renderer, work.map(ByClass::to_array))).or_insert_with(|| {
                demands.list.push((renderer, work));
                u32::try_from(demands.list.len()).unwrap_or(GENERAL)
            });
            demands.classes.push(class);
        }
        demands
    }

    /// The class of work of the job at this place.
    pub fn class(&self, job: usize) -> u32 {
        self.classes.get(job).copied().unwrap_or(GENERAL)
    }

    /// Speeds of a node for the classes that it does not do at its general speed. 0 without the renderer.
    pub fn speeds(&self, node: &Node) -> Arc<BTreeMap<u32, u64>> {
        let has: Vec<bool> = self.renderers.iter().map(|renderer| node.has_renderer(renderer)).collect();
        let speed = |(&(renderer, work), class): (&(Option<usize>, Option<ByClass>), u32)| {
            if renderer.is_some_and(|renderer| !has[renderer]) {
                return Some((class, 0));
            }
            let speed = node.corrected_speed(work.as_ref())?;
            Some((class, units(speed * f64::from(node.cores)).max(1)))
        };
        Arc::new(self.list.iter().zip(GENERAL + 1..).filter_map(speed).collect())
    }
}
