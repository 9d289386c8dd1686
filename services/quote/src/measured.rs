//! Input of a quote: what workers measured of a shot.

use forelight_forecast::{Expansion, Strategy};
use forelight_protocol::{CachePlanResult, PreviewResult, ProfileResult, Spent, at_speed_one};

/// The profile of a frame, and what is needed to read its costs.
#[derive(Clone, PartialEq, Debug)]
pub struct MeasuredProfile {
    /// The profile.
    pub result: ProfileResult,
    /// Speed of the node that measured it, for the profiled classes of work if the node is calibrated. A CPU
    /// second on this node is this many on a node of speed 1.
    pub node_speed: f64,
    /// Camera samples per pixel of the profile. The job may use another number.
    pub spp: u32,
    /// How the profiled pixels represent all pixels of the frame.
    pub expansion: Expansion,
}

impl MeasuredProfile {
    /// A profile whose pixels were chosen by [`Strategy::Snapshot`], as always on a farm.
    pub fn new(result: ProfileResult, node_speed: f64, spp: u32) -> Self {
        Self { result, node_speed, spp, expansion: Expansion::Groups }
    }
}

impl MeasuredProfile {
    /// A profile by a renderer that counts no work. Its work is CPU time in microseconds, on a node of speed
    /// 1.
    pub fn of_renderer(mut result: ProfileResult, node_speed: f64, spp: u32) -> Self {
        let work = |cpu_nanos: u64| Spent::uncounted(at_speed_one(cpu_nanos, node_speed)).work;
        result.samples.iter_mut().for_each(|sample| sample.work = work(sample.cpu_nanos));
        let spent = |Spent { cpu_nanos, .. }: Spent| Spent { work: work(cpu_nanos), cpu_nanos };
        result.fixed.build = spent(result.fixed.build);
        result.spent = spent(result.spent);
        Self::new(result, node_speed, spp)
    }
}

/// The plan of a shared irradiance cache.
#[derive(Clone, Copy, Debug)]
pub struct SharedCache<'a> {
    /// The plan.
    pub plan: &'a CachePlanResult,
    /// Speed of the node that made the plan.
    pub node_speed: f64,
}

/// All input of a quote.
#[derive(Clone, Copy, Debug)]
pub struct Measured<'a> {
    /// Preview of all frames.
    pub preview: &'a PreviewResult,
    /// Profiled frames, ascending.
    pub profiles: &'a [MeasuredProfile],
    /// How the profiled pixels were chosen.
    pub strategy: Strategy,
    /// The shared irradiance cache. `None` if each frame builds its own.
    pub shared: Option<SharedCache<'a>>,
}

impl<'a> Measured<'a> {
    /// Uses [`Strategy::Snapshot`] and own caches.
    pub fn new(preview: &'a PreviewResult, profiles: &'a [MeasuredProfile]) -> Self {
        Self { preview, profiles, strategy: Strategy::Snapshot, shared: None }
    }

    /// The same frames with a shared cache, or without one.
    pub fn with_cache(self, shared: Option<SharedCache<'a>>) -> Self {
        Self { shared, ..self }
    }

    /// Records of each frame's irradiance cache: all that it reads, and those that it gathers itself.
    pub(crate) fn records(&self) -> Vec<(&'a [u32], &'a [u32])> {
        match self.shared {
            Some(shared) => {
                let frames = shared.plan.frames.iter();
                frames.map(|frame| (&frame.records[..], &frame.own[..])).collect()
            }
            None => {
                let frames = self.preview.frames.iter().map(|frame| &frame.cache_records[..]);
                frames.map(|all| (all, all)).collect()
            }
        }
    }
}
