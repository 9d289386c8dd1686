//! Surfaces and materials of pixels: what a camera ray meets first.

use crate::opened::Opened;
use crate::rays::{Rays, rays_of};
use crate::scene::SceneFrame;
use crate::tracer::Tracer;
use forelight_pictures::id_color;
use forelight_renderer::door::{Common, Cost, PixelCount, RendererError, Run, Shown};
use image::{Rgb, RgbImage};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// Rays that are traced at a time.
const AT_A_TIME: usize = 1 << 16;

/// Numbers of names. A name has the same number on every machine: that of its hash.
#[derive(Debug, Default)]
pub(crate) struct Names {
    by_number: Mutex<BTreeMap<u32, String>>,
}

impl Names {
    /// Number of a name. Two names may have the same one, by a chance of 2⁻³²; then they are one stratum.
    fn number(&self, name: &str) -> u32 {
        let hash = blake3::hash(name.as_bytes());
        let number = u32::from_le_bytes([0, 1, 2, 3].map(|byte| hash.as_bytes()[byte])) >> 1;
        self.by_number.lock().entry(number).or_insert_with(|| name.to_owned());
        number
    }

    /// The name of a number, if it was seen.
    pub fn name(&self, number: u32) -> Option<String> {
        self.by_number.lock().get(&number).cloned()
    }
}

/// Name that all triangles of all meshes have.
const OF_MESH: &str = "M-Tri";

/// `chair` of `chair.12.3`: programs that make several surfaces number them. Triangles of meshes are told
/// apart by their modifiers.
fn object<'a>(surface: &'a str, modifier: &'a str) -> &'a str {
    if surface == OF_MESH {
        return modifier;
    }
    let mut name = surface;
    while let Some((before, after)) = name.rsplit_once('.') {
        if before.is_empty() || after.is_empty() || !after.bytes().all(|byte| byte.is_ascii_digit()) {
            break;
        }
        name = before;
    }
    name
}

/// Frames whose pixels are kept after their preview, for their profile.
const KEPT: usize = 16;

/// What pixels of previewed frames show, by frame and size of the image.
#[derive(Default)]
pub(crate) struct Kept {
    seen: Mutex<BTreeMap<(i32, u32, u32), Arc<Seen>>>,
}

impl Kept {
    /// What the frame shows, and the cost of finding it now. It is kept for the frame's profile.
    pub fn see(
        &self,
        opened: &Opened,
        frame: &SceneFrame,
        common: &Common,
        run: &Run<'_>,
    ) -> Result<(Arc<Seen>, Cost), RendererError> {
        let (seen, cost) = self.take(opened, frame, common, run)?;
        let mut kept = self.seen.lock();
        if kept.len() < KEPT {
            kept.insert((frame.number, common.width, common.height), seen.clone());
        }
        Ok((seen, cost))
    }

    /// What the frame shows, and the cost of finding it now: none if a preview found it. It is not kept.
    pub fn take(
        &self,
        opened: &Opened,
        frame: &SceneFrame,
        common: &Common,
        run: &Run<'_>,
    ) -> Result<(Arc<Seen>, Cost), RendererError> {
        let key = (frame.number, common.width, common.height);
        if let Some(seen) = self.seen.lock().remove(&key) {
            return Ok((seen, Cost::default()));
        }
        let seen = Arc::new(see(opened, frame, common, run)?);
        let cost = seen.cost.clone();
        Ok((seen, cost))
    }
}

/// What every pixel shows, and what finding it took.
pub(crate) struct Seen {
    /// In rows from the top.
    pub shown: Vec<Shown>,
    pub cost: Cost,
    /// CPU time of vwrays, nanoseconds.
    pub view_nanos: u64,
}

/// What every pixel of an image of this size shows.
fn see(opened: &Opened, frame: &SceneFrame, common: &Common, run: &Run<'_>) -> Result<Seen, RendererError> {
    let since = Instant::now();
    let one = Common { samples: 1, ..*common };
    let mut tracer = Tracer::of_names(&opened.radiance, &opened.scene, &frame.octree, run)?;
    let pixels: Vec<u32> = (0..common.width * common.height).collect();
    let mut shown = Vec::with_capacity(pixels.len());
    let mut view_nanos = 0;
    for chunk in pixels.chunks(AT_A_TIME) {
        let Rays { rays, cpu_nanos } =
            rays_of((&opened.radiance, &opened.scene, frame), &one, chunk, 0..1, run)?;
        view_nanos += cpu_nanos;
        for names in tracer.names(&rays, run)? {
            let number = |[surface, modifier, material]: [String; 3]| Shown {
                object: Some(opened.names.number(object(&surface, &modifier))),
                material: Some(opened.names.number(&material)),
            };
            shown.push(names.map_or(Shown { object: None, material: None }, number));
        }
        (run.progress)(shown.len() as f64 / pixels.len() as f64);
    }
    let finished = tracer.finish(run)?;
    let cost = Cost {
        cpu_nanos: finished.usage.cpu_nanos + view_nanos,
        wall_nanos: u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX),
        peak_memory_bytes: finished.usage.peak_memory_bytes,
        counters: Default::default(),
    };
    Ok(Seen { shown, cost, view_nanos })
}

/// Pixels by what they show, scaled to an image of `pixels`.
pub(crate) fn counts(shown: &[Shown], pixels: u64) -> Vec<PixelCount> {
    let mut counts = BTreeMap::new();
    for &shown in shown {
        *counts.entry(shown).or_insert(0u64) += 1;
    }
    let own = shown.len().max(1) as u64;
    let scaled = |n: u64| {
        let exact = (u128::from(n) * u128::from(pixels) + u128::from(own) / 2) / u128::from(own);
        u64::try_from(exact).unwrap_or(u64::MAX)
    };
    let count = |(Shown { object, material }, n)| PixelCount { object, material, pixels: scaled(n) };
    counts.into_iter().map(count).collect()
}

/// Surface and material of every pixel as a colour.
pub(crate) fn picture(shown: &[Shown], common: &Common) -> RgbImage {
    RgbImage::from_fn(common.width, common.height, |x, y| {
        let here = shown.get((y * common.width + x) as usize);
        let colour = here.and_then(|here| Some(id_color(here.object?, here.material?)));
        Rgb(colour.unwrap_or([0; 3]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_that_were_numbered_are_one_object() {
        for (surface, expected) in [
            ("box.1523", "box"),
            ("chair.leg.12.3", "chair.leg"),
            ("v1.5m", "v1.5m"),
            (".5", ".5"),
            ("a.", "a."),
        ] {
            assert_eq!(object(surface, "wood"), expected);
        }
    }

    #[test]
    fn triangles_of_meshes_have_the_names_of_their_modifiers() {
        assert_eq!(object("M-Tri", "chair_wood"), "chair_wood");
    }

    #[test]
    fn a_name_has_the_same_number_wherever_it_is_seen() {
        let (here, there) = (Names::default(), Names::default());
        let first = here.number("floor");
        there.number("wall");
        assert_eq!(there.number("floor"), first);
        assert_eq!(here.name(first).as_deref(), Some("floor"));
        assert_ne!(here.number("wall"), first);
        assert_eq!(here.name(first ^ 1), None);
    }

    #[test]
    fn counts_are_scaled_to_the_image() {
        let wall = Shown { object: Some(1), material: Some(2) };
        let nothing = Shown { object: None, material: None };
        let found = counts(&[wall, nothing, wall, wall], 400);
        let pairs: Vec<(Option<u32>, u64)> = found.iter().map(|count| (count.object, count.pixels)).collect();
        assert_eq!(pairs, [(None, 100), (Some(1), 300)]);
    }
}
