//! The CPU twin of the GPU preview: one ray through the centre of every pixel.

use crate::clock::ThreadClock;
use crate::cost::Cost;
use crate::error::PreviewError;
use crate::preview::{Counts, NOTHING, Preview};
use crate::visible::{Cutouts, centre, check, near_distance, resolve};
use forelight_bvh::{Bvh, Ray, Traversal};
use forelight_scene::{Frame, Geometry};
use rayon::prelude::*;
use std::sync::Arc;

/// The preview of a frame, and its cost, for any number of threads. `bvh` must be the tree of
/// `frame.geometry`. Fails with [`PreviewError::EmptyImage`], [`PreviewError::ImageTooLarge`] or
/// [`PreviewError::Camera`].
pub fn cpu_preview_with(bvh: &Bvh, frame: &Frame) -> Result<(Preview, Cost), PreviewError> {
    check(&frame.camera)?;
    let rays = CameraRays::new(bvh, frame);
    let width = frame.camera.width as usize;
    let mut triangles = vec![NOTHING; frame.camera.pixels()];
    let mut cost = triangles
        .par_chunks_mut(width)
        .enumerate()
        .map(|(y, row)| rays.row(y as u32, |x, triangle| row[x] = triangle))
        .sum();
    Ok((resolve(frame, &triangles, &mut cost), cost))
}

/// Like [`cpu_preview_with`], but returns only the pixel counts.
pub fn cpu_counts_with(bvh: &Bvh, frame: &Frame) -> Result<(Counts, Cost), PreviewError> {
    check(&frame.camera)?;
    let rays = CameraRays::new(bvh, frame);
    let geometry = &*frame.geometry;
    let none = || Counts::none(geometry.strata.len());
    Ok((0..frame.camera.height)
        .into_par_iter()
        .fold(
            || (none(), Cost::default()),
            |(mut counts, cost), y| {
                let row = rays.row(y, |_, triangle| {
                    counts.add(geometry.triangle_stratum.get(triangle as usize).copied().unwrap_or(NOTHING));
                });
                (counts, cost + row)
            },
        )
        .reduce(|| (none(), Cost::default()), |(a, cost_a), (b, cost_b)| (a.plus(&b), cost_a + cost_b)))
}

/// A frame with everything needed to trace its camera rays.
struct CameraRays<'a> {
    bvh: &'a Bvh,
    frame: &'a Frame,
    cutouts: Cutouts,
    near: f32,
}

impl<'a> CameraRays<'a> {
    fn new(bvh: &'a Bvh, frame: &'a Frame) -> Self {
        Self { bvh, frame, cutouts: Cutouts::of(frame), near: near_distance(&frame.geometry) }
    }

    /// Calls `see` with column and triangle of every pixel of row `y`, [`NOTHING`] without a surface.
    fn row(&self, y: u32, mut see: impl FnMut(usize, u32)) -> Cost {
        let clock = ThreadClock::start();
        let camera = &self.frame.camera;
        let mut steps = Traversal::default();
        for x in 0..camera.width {
            // The direction's component along the view axis is 1, so the near distance is a ray parameter.
            let direction = camera.direction(centre(x, y));
            let ray = Ray { t_min: self.near, ..Ray::new(camera.origin, direction) };
            let hit = if self.cutouts.any {
                let keep =
                    |hit: &forelight_bvh::Hit| self.cutouts.keeps(self.frame, hit.primitive, hit.u, hit.v);
                self.bvh.closest(&ray, keep, &mut steps)
            } else {
                self.bvh.closest(&ray, |_| true, &mut steps)
            };
            see(x as usize, hit.map_or(NOTHING, |hit| hit.primitive));
        }
        Cost { nodes: steps.nodes, triangles: steps.triangles, cpu_nanos: clock.nanos(), device_nanos: 0 }
    }
}

/// The CPU twin, with the tree of the last geometry.
#[derive(Default)]
pub(crate) struct Cpu {
    tree: Option<(Arc<Geometry>, Bvh)>,
}

impl Cpu {
    pub fn preview(&mut self, frame: &Frame) -> Result<(Preview, Cost), PreviewError> {
        check(&frame.camera)?;
        let (bvh, build) = self.tree_of(frame);
        let (preview, cost) = cpu_preview_with(bvh, frame)?;
        Ok((preview, cost + build))
    }

    pub fn counts(&mut self, frame: &Frame) -> Result<(Counts, Cost), PreviewError> {
        check(&frame.camera)?;
        let (bvh, build) = self.tree_of(frame);
        let (counts, cost) = cpu_counts_with(bvh, frame)?;
        Ok((counts, cost + build))
    }

    fn tree_of(&mut self, frame: &Frame) -> (&Bvh, Cost) {
        let clock = ThreadClock::start();
        let fresh = self.tree.take().filter(|(geometry, _)| Arc::ptr_eq(geometry, &frame.geometry));
        let (_, bvh) = self.tree.insert(fresh.unwrap_or_else(|| {
            let geometry = Arc::clone(&frame.geometry);
            let bvh = Bvh::build(&geometry.positions, &geometry.triangles);
            (geometry, bvh)
        }));
        (bvh, Cost { cpu_nanos: clock.nanos(), ..Cost::default() })
    }
}
