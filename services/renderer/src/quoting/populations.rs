//! What frames show, as the forecast needs it.

use crate::door::{FrameCounts, PixelCount};
use forelight_forecast::{FramePopulation, Stratum};
use std::collections::BTreeMap;

/// Expected cost of a pixel of the background, relative to others.
const BACKGROUND: f64 = 0.1;

type Key = (Option<u32>, Option<u32>);

/// The strata of a shot. The last one is the background.
pub(super) struct Populations {
    places: BTreeMap<Key, usize>,
    pub strata: Vec<Stratum>,
    pub frames: Vec<FramePopulation>,
}

impl Populations {
    /// Strata are every pair of object and material that any frame shows. Pixels without both are the
    /// background if the renderer `knows` objects or materials. Otherwise nobody knows what they are, and
    /// they are a stratum like any other.
    pub fn new(previews: &[FrameCounts], knows: bool) -> Self {
        let shown = previews.iter().flat_map(|preview| &preview.counts).map(key);
        let mut places: BTreeMap<Key, usize> =
            shown.filter(|key| !knows || *key != (None, None)).map(|key| (key, 0)).collect();
        places.values_mut().enumerate().for_each(|(at, place)| *place = at);
        let stratum = |&(object, material): &Key| Stratum {
            object: object.unwrap_or(u32::MAX),
            material: material.unwrap_or(u32::MAX),
            prior_cost: 1.0,
            apart: false,
        };
        let background = Stratum::background(BACKGROUND);
        let strata = places.keys().map(stratum).chain([background]).collect();
        let mut all = Self { places, strata, frames: Vec::new() };
        all.frames = previews.iter().map(|preview| all.frame(preview)).collect();
        all
    }

    /// Index of the stratum of these pixels.
    pub fn place(&self, count: &PixelCount) -> usize {
        self.places.get(&key(count)).copied().unwrap_or(self.places.len())
    }

    fn frame(&self, preview: &FrameCounts) -> FramePopulation {
        let mut counts = vec![0u32; self.strata.len()];
        for count in &preview.counts {
            counts[self.place(count)] = u32::try_from(count.pixels).unwrap_or(u32::MAX);
        }
        FramePopulation { number: i64::from(preview.frame), counts, lights: 0, shining: 0, triangles: 0 }
    }
}

fn key(count: &PixelCount) -> Key {
    (count.object, count.material)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::door::Cost;

    #[test]
    fn pixels_of_nothing_are_the_background_only_if_objects_are_known() {
        let count = |object, pixels| PixelCount { object, material: None, pixels };
        let counts = vec![count(None, 10), count(Some(3), 6)];
        let preview = [FrameCounts { frame: 1, counts, sampled_pixels: 16, cost: Cost::default() }];
        let known = Populations::new(&preview, true);
        assert_eq!(known.frames[0].counts, [6, 10]);
        let unknown = Populations::new(&preview, false);
        assert_eq!(unknown.frames[0].counts, [10, 6, 0]);
        assert_eq!(unknown.strata[0].prior_cost, 1.0);
    }
}
