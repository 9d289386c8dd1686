//! Reads the animations of a glTF file. All play at the same time, since exporters often write one per
//! object.

use super::Reader;
use crate::animation::{Curve, Interpolation, Keyed};
use crate::error::SceneError;
use crate::limits::LARGEST_COORDINATE;
use crate::tracks::Motion;
use glam::{DQuat, DVec3};
use gltf::animation::{Channel, Interpolation as Between, Property};
use std::collections::BTreeSet;

impl Reader<'_, '_> {
    /// Applies all channels that move a node of the scene.
    pub(super) fn animations(&mut self) -> Result<(), SceneError> {
        let opened = self.opened;
        let mut seen = BTreeSet::new();
        for animation in opened.document.animations() {
            for (c, channel) in animation.channels().enumerate() {
                let at = format!("/animations/{}/channels/{c}", animation.index());
                let (target, property) = (channel.target().node().index(), channel.target().property());
                let Some(node) = self.nodes[target] else { continue };
                let slot = match property {
                    Property::Translation => 0,
                    Property::Rotation => 1,
                    Property::Scale => 2,
                    Property::MorphTargetWeights => {
                        self.ignore("morph targets");
                        continue;
                    }
                };
                if !seen.insert((target, slot)) {
                    self.ignore("second animations of the same property of a node");
                    continue;
                }
                let motion = self.motion(&channel, property, &at)?;
                self.assembly.shot.nodes[node].animate(motion);
            }
        }
        Ok(())
    }

    fn motion(&mut self, channel: &Channel<'_>, property: Property, at: &str) -> Result<Motion, SceneError> {
        let sampler = channel.sampler();
        let times = self.key_times(&sampler.input(), at)?;
        if let (Some(&first), Some(&last)) = (times.first(), times.last()) {
            let (begin, end) = self.assembly.keys.unwrap_or((first, last));
            self.assembly.keys = Some((begin.min(first), end.max(last)));
        }
        let most = self.spend(times.len() as u64 * 4)?;
        let (between, output) = (sampler.interpolation(), sampler.output());
        if property == Property::Rotation {
            let keys = self.opened.floats::<4>(&output, most)?;
            let raw =
                keys.iter().map(|&[x, y, z, w]| DQuat::from_array([x, y, z, w].map(f64::from))).collect();
            return Ok(Motion::Rotation(self.curve(times, raw, between, at, |q: DQuat| {
                (q.length_squared() > 1e-12).then(|| q.normalize())
            })?));
        }
        let raw: Vec<DVec3> = self
            .opened
            .floats::<3>(&output, most)?
            .into_iter()
            .map(|v| DVec3::from_array(v.map(f64::from)))
            .collect();
        if raw.iter().any(|v| v.abs().max_element() > LARGEST_COORDINATE) {
            return self.opened.fail(at, format!("a value is larger than {LARGEST_COORDINATE:e}"));
        }
        let curve = self.curve(times, raw, between, at, Some)?;
        Ok(if property == Property::Scale { Motion::Scale(curve) } else { Motion::Translation(curve) })
    }

    /// Key times, in frames.
    fn key_times(&mut self, input: &gltf::Accessor<'_>, at: &str) -> Result<Vec<f64>, SceneError> {
        let most = self.spend(0)?;
        let seconds = self.opened.floats::<1>(input, most)?;
        self.spend(seconds.len() as u64)?;
        let mut times: Vec<f64> = Vec::with_capacity(seconds.len());
        for [second] in seconds {
            let frame = f64::from(second) * self.assembly.fps;
            // Times are f32 seconds, so a key may lie slightly after its frame. Rounding keeps a step from
            // coming a frame late.
            let near = (frame - frame.round()).abs() < 1e-3 + frame.abs() * 1e-6;
            let free = times.last().is_none_or(|&before| before < frame.round());
            times.push(if near && free { frame.round() } else { frame });
        }
        let ascending = times.windows(2).all(|pair| pair[0] < pair[1]);
        if !ascending || times[0] < 0.0 {
            return self.opened.fail(at, "the key times are negative or not ascending");
        }
        Ok(times)
    }

    fn curve<T: Keyed>(
        &self,
        times: Vec<f64>,
        raw: Vec<T>,
        between: Between,
        at: &str,
        valid: impl Fn(T) -> Option<T>,
    ) -> Result<Curve<T>, SceneError> {
        let checked = |values: Vec<T>| match values.into_iter().map(&valid).collect::<Option<Vec<T>>>() {
            Some(values) => Ok(values),
            None => self.opened.fail(at, "a rotation must be a unit quaternion"),
        };
        let per_key = if between == Between::CubicSpline { 3 } else { 1 };
        if raw.len() != times.len() * per_key {
            let reason =
                format!("{} keys need {} values, not {}", times.len(), times.len() * per_key, raw.len());
            return self.opened.fail(at, reason);
        }
        let curve = match between {
            Between::Step => Curve::new(times, checked(raw)?, Interpolation::Step),
            Between::Linear => Curve::new(times, checked(raw)?, Interpolation::Linear),
            Between::CubicSpline => {
                // Tangents are per second in the file, and per frame here.
                let scale = 1.0 / self.assembly.fps;
                let tangents =
                    raw.chunks_exact(3).map(|k| (k[0].scaled(scale), k[2].scaled(scale))).collect();
                let values = checked(raw.chunks_exact(3).map(|k| k[1]).collect())?;
                Curve::hermite(times, values, tangents)
            }
        };
        curve.map_or_else(|| self.opened.fail(at, "has no keys"), Ok)
    }
}
