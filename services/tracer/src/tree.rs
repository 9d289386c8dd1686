//! The BVH over the triangles that can affect the image.

use crate::Reach;
use forelight_bvh::{Bvh, Hit, Ray, Traversal};
use forelight_scene::Geometry;

/// A BVH over a frame's triangles, or those that light paths can meet. Hits use the frame's indices.
pub struct Tree {
    bvh: Bvh,
    /// The triangles in the tree, ascending. `None` means all triangles.
    held: Option<Box<[u32]>>,
}

impl Tree {
    /// Builds the tree over the triangles that can be met.
    pub(crate) fn new(geometry: &Geometry, reach: &Reach) -> Self {
        let held = Self::to_hold(geometry, reach);
        let bvh = match &held {
            None => Bvh::build(&geometry.positions, &geometry.triangles),
            Some(held) => {
                let triangles: Vec<[u32; 3]> = held.iter().map(|&t| geometry.triangles[t as usize]).collect();
                Bvh::build(&geometry.positions, &triangles)
            }
        };
        Self { bvh, held }
    }

    /// Whether this tree, built for the same geometry, holds exactly the triangles that can be met.
    pub(crate) fn is_over(&self, geometry: &Geometry, reach: &Reach) -> bool {
        self.held == Self::to_hold(geometry, reach)
    }

    fn to_hold(geometry: &Geometry, reach: &Reach) -> Option<Box<[u32]>> {
        let all = 0..geometry.triangles.len() as u32;
        reach.hides_triangles().then(|| all.filter(|&t| reach.triangle(t)).collect())
    }

    /// Number of triangles in the tree. `all` is the number of triangles in the frame.
    pub(crate) fn triangles(&self, all: usize) -> usize {
        self.held.as_ref().map_or(all, |held| held.len())
    }

    /// Number of nodes and of triangle groups; see [`Bvh::size`].
    pub fn size(&self) -> (usize, usize) {
        self.bvh.size()
    }

    /// Memory used, bytes.
    pub fn bytes(&self) -> usize {
        self.bvh.bytes() + self.held.as_ref().map_or(0, |held| size_of_val(&**held))
    }

    /// See [`Bvh::closest`]. Ties go to the lowest index, because the held triangles are ascending.
    #[inline(always)]
    pub(crate) fn closest(
        &self,
        ray: &Ray,
        keep: impl Fn(&Hit) -> bool,
        steps: &mut Traversal,
    ) -> Option<Hit> {
        self.bvh.closest(ray, |hit| keep(&self.named(*hit)), steps).map(|hit| self.named(hit))
    }

    /// See [`Bvh::any`].
    #[inline(always)]
    pub(crate) fn any(&self, ray: &Ray, keep: impl Fn(&Hit) -> bool, steps: &mut Traversal) -> bool {
        self.bvh.any(ray, |hit| keep(&self.named(*hit)), steps)
    }

    #[inline(always)]
    fn named(&self, hit: Hit) -> Hit {
        match &self.held {
            None => hit,
            Some(held) => Hit { primitive: held[hit.primitive as usize], ..hit },
        }
    }
}
