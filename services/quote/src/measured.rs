//! The input of a quote: what workers measured of a shot.

use forelight_forecast::{Expansion, Strategy};
use forelight_protocol::{CachePlanResult, PreviewResult, ProfileResult};

/// The profile of one frame, and what is needed to read its costs.
#[derive(Clone, PartialEq, Debug)]
pub struct MeasuredProfile {
    /// The profile.
    pub result: ProfileResult,
    /// Speed of the node that measured it, for work of the profiled classes where the node is calibrated. A CPU second
    /// on this node is this many CPU seconds on a node of speed 1.
    pub node_speed: f64,
    /// Camera samples a pixel that it was profiled with. The job may be rendered with others.
    pub spp: u32,
    /// How the profiled pixels stand for all pixels of the frame.
    pub expansion: Expansion,
}

impl MeasuredProfile {
    /// A profile whose pixels were chosen by [`Strategy::Snapshot`], as all of a farm's are.
    pub fn new(result: ProfileResult, node_speed: f64, spp: u32) -> Self {
        Self { result, node_speed, spp, expansion: Expansion::Groups }
    }
}

/// The plan of an irradiance cache that all frames share.
#[derive(Clone, Copy, Debug)]
pub struct SharedCache<'a> {
    /// The plan.
    pub plan: &'a CachePlanResult,
    /// Speed of the node that made the plan.
    pub node_speed: f64,
}

/// Everything that a quote rests on.
#[derive(Clone, Copy, Debug)]
pub struct Measured<'a> {
    /// What every frame of the shot shows.
    pub preview: &'a PreviewResult,
    /// The profiled frames, ascending.
    pub profiles: &'a [MeasuredProfile],
    /// How the profiled pixels were chosen.
    pub strategy: Strategy,
    /// The irradiance cache that frames are given; `None` if each frame builds its own.
    pub shared: Option<SharedCache<'a>>,
}

impl<'a> Measured<'a> {
    /// Pixels chosen by [`Strategy::Snapshot`], and each frame builds its own irradiance cache.
    pub fn new(preview: &'a PreviewResult, profiles: &'a [MeasuredProfile]) -> Self {
        Self { preview, profiles, strategy: Strategy::Snapshot, shared: None }
    }

    /// The same frames with the shared cache, or without one.
    pub fn with_cache(self, shared: Option<SharedCache<'a>>) -> Self {
        Self { shared, ..self }
    }

    /// The records of each frame's irradiance cache: all that the frame reads, and those of them that it gathers itself.
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
