//! The BVH over the triangles that can affect the image.

use crate::Reach;
use crate::cost::{Cost, build_work, clocked, load_work};
use forelight_bvh::{Bvh, Hit, Ray, Traversal};
use forelight_kept::{Folder, LARGEST, named};
use forelight_scene::Geometry;
use std::borrow::Cow;

/// Trees over fewer triangles are built faster than they are found.
const LEAST_KEPT: usize = 8192;

/// A BVH over a frame's triangles, or those that light paths can meet. Hits use the frame's indices.
pub struct Tree {
    bvh: Bvh,
    /// The triangles in the tree, ascending. `None` means all triangles.
    held: Option<Box<[u32]>>,
}

/// What a tree costs.
#[derive(Debug, Clone, Copy, Default)]
pub struct TreeCost {
    /// Building it. The same whether it was built or kept.
    pub build: Cost,
    /// What was really spent on it.
    pub spent: Cost,
}

impl TreeCost {
    /// With CPU time that was spent before, in nanoseconds.
    pub(crate) fn after(self, nanos: u64) -> Self {
        let and = |cost: Cost| Cost { cpu_nanos: cost.cpu_nanos + nanos, ..cost };
        Self { build: and(self.build), spent: and(self.spent) }
    }
}

impl Tree {
    /// Builds the tree over the triangles that can be met, or takes it from `kept`.
    pub(crate) fn new(geometry: &Geometry, reach: &Reach, kept: Option<&Folder>) -> (Self, TreeCost) {
        let held = Self::to_hold(geometry, reach);
        let triangles = match &held {
            None => Cow::Borrowed(&geometry.triangles),
            Some(held) => Cow::Owned(held.iter().map(|&t| geometry.triangles[t as usize]).collect()),
        };
        let kept = kept.filter(|_| triangles.len() >= LEAST_KEPT);
        let (found, looking) = clocked(|| kept.map(|folder| find(folder, geometry, &triangles)));
        let name = match found {
            Some((_, Some((bvh, building)))) => {
                let (nodes, _) = bvh.size();
                let build = Cost { work: build_work(triangles.len(), nodes), cpu_nanos: building };
                let spent = Cost { work: load_work(triangles.len(), nodes), cpu_nanos: looking };
                return (Self { bvh, held }, TreeCost { build, spent });
            }
            Some((name, None)) => Some(name),
            None => None,
        };
        let (bvh, building) = clocked(|| Bvh::build(&geometry.positions, &triangles));
        let ((), keeping) = clocked(|| {
            if let Some((folder, name)) = kept.zip(name).filter(|_| bvh.bytes() as u64 <= LARGEST) {
                folder.write(&name, &[&building.to_le_bytes(), &bvh.to_bytes()]);
            }
        });
        let build = Cost { work: build_work(triangles.len(), bvh.size().0), cpu_nanos: building };
        let spent = Cost { cpu_nanos: looking + building + keeping, ..build };
        (Self { bvh, held }, TreeCost { build, spent })
    }

    /// Whether this tree, built for the same geometry, holds exactly the triangles that can be met.
    pub(crate) fn is_over(&self, geometry: &Geometry, reach: &Reach) -> bool {
        self.held == Self::to_hold(geometry, reach)
    }

    fn to_hold(geometry: &Geometry, reach: &Reach) -> Option<Box<[u32]>> {
        let all = 0..geometry.triangles.len() as u32;
        reach.hides_triangles().then(|| all.filter(|&t| reach.triangle(t)).collect())
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

/// The name of a kept tree over these triangles, and the tree with the CPU time of building it in
/// nanoseconds, if it was kept.
fn find(folder: &Folder, geometry: &Geometry, triangles: &[[u32; 3]]) -> (blake3::Hash, Option<(Bvh, u64)>) {
    let mut hasher = named("tree");
    hasher.update(&(triangles.len() as u64).to_le_bytes());
    hasher.update(bytemuck::cast_slice(triangles));
    hasher.update(bytemuck::cast_slice(&geometry.positions));
    let name = hasher.finalize();
    let kept = || {
        let bytes = folder.read(&name)?;
        let (building, bytes) = bytes.split_first_chunk()?;
        Some((Bvh::from_bytes(bytes, triangles.len())?, u64::from_le_bytes(*building)))
    };
    let kept = kept();
    (name, kept)
}
