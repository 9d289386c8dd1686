//! The interface of a solid dielectric, and the media on its two sides.

use super::{Passed, Pixels, Point, off_surface};
use crate::media::Media;
use crate::tracer::Tracer;
use forelight_bvh::{Hit, Ray, Traversal};
use forelight_scene::{MOST_NESTED, Surface};
use glam::Vec3;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;

/// Directions of the rays that find the solids around the camera. Edges may count twice, hence five rays.
const PROBES: [Vec3; 5] = [
    Vec3::new(0.267, 0.534, 0.802),
    Vec3::new(-0.683, 0.146, 0.715),
    Vec3::new(0.418, -0.871, -0.258),
    Vec3::new(-0.361, 0.722, -0.590),
    Vec3::new(0.912, 0.228, -0.342),
];

/// Below this cosine a ray counts as grazing. Smaller ones would include faces far along the ray.
const GRAZING: f32 = 1e-2;

/// The interface that a ray meets at the face of a solid dielectric.
#[derive(Debug, Clone, Copy)]
pub struct Interface {
    /// Index of refraction of the other side, relative to this one. `None` if the same medium fills both.
    pub eta: Option<f32>,
    /// Fraction of light transmitted, per channel.
    pub transmittance: Vec3,
    /// GGX alpha.
    pub alpha: f32,
    /// The solids that contain the viewer's side.
    pub before: Media,
    /// The solids that contain the other side.
    pub beyond: Media,
    /// The passed surface of a ray that continues unchanged.
    pub passed: Passed,
}

impl Pixels<'_> {
    /// An interface of a single solid. Its relative index is that of the inside over that of the outside.
    pub fn plain_interface(&mut self, _: &Ray, _: &Hit, p: &Point) -> Interface {
        let Surface::Glass { ior, transmittance, alpha, .. } = self.tracer.materials[p.material].surface
        else {
            unreachable!("only the faces of solid dielectrics are interfaces");
        };
        let eta = if p.geometric.dot(p.viewer) > 0.0 { ior } else { 1.0 / ior };
        let transmittance = self.color(&transmittance, p.uv);
        let (media, passed) = (self.media, p.passed());
        Interface { eta: Some(eta), transmittance, alpha, before: media, beyond: media, passed }
    }

    /// An interface among solids that overlap or touch. Faces at the same place are crossed together: the
    /// continuing ray starts behind all of them, so all must be counted here.
    pub fn nested_interface(&mut self, ray: &Ray, hit: &Hit, p: &Point) -> Interface {
        let tracer = self.tracer;
        let ranks = &tracer.ranks;
        if ranks.of(p.material).is_none() {
            return self.plain_interface(ray, hit, p);
        }
        let ([entered, left], t) = self.faces_at(ray, hit, p);
        let passed = Passed { t, primitive: u32::MAX };
        // Leaving a solid implies having been inside it, even if the ray started there.
        let mut before = self.media;
        each(left).filter(|&rank| !self.media.holds(rank)).for_each(|rank| before.enter(rank));
        let mut beyond = before;
        each(left).for_each(|rank| beyond.leave(rank));
        each(entered).for_each(|rank| beyond.enter(rank));
        let (near, far) = (before.top(), beyond.top());
        let Some(face) = near.max(far).filter(|_| near != far) else {
            return Interface { eta: None, transmittance: Vec3::ONE, alpha: 0.0, before, beyond, passed };
        };
        let Surface::Glass { transmittance, alpha, .. } = tracer.materials[ranks.material(face)].surface
        else {
            unreachable!("only solid dielectrics have ranks");
        };
        let eta = ranks.ior(far) / ranks.ior(near);
        let transmittance = self.color(&transmittance, p.uv);
        Interface { eta: Some(eta), transmittance, alpha, before, beyond, passed }
    }

    /// Ranks, as bits, of the solids that a ray enters and leaves at a hit, and the distance up to which
    /// faces were counted. All faces up to the start of the continuing ray count; those of one solid that
    /// share a hit edge count once.
    fn faces_at(&mut self, ray: &Ray, hit: &Hit, p: &Point) -> ([u32; 2], f32) {
        let step = (off_surface(p.position, p.geometric, p.size, ray.direction) - p.position).length();
        let cos = p.geometric.dot(ray.direction).abs();
        let piece = Ray { t_max: hit.t + step / cos.max(GRAZING), ..*ray };
        (self.tracer.faces_from(hit.t, &piece, &mut self.counters), piece.t_max)
    }
}

impl Tracer {
    /// The solids that contain a point: those whose faces are left by rays from there, but not entered.
    pub(crate) fn media_at(&self, place: Vec3) -> Media {
        let counts = PROBES.map(|direction| {
            // The tree may report a triangle more than once.
            let faces = RefCell::new(BTreeMap::new());
            let note = |hit: &Hit| {
                if let Some((rank, leaves)) = self.face(hit, direction, &Cell::new(0)) {
                    faces.borrow_mut().insert(hit.primitive, (rank, if leaves { 1 } else { -1 }));
                }
                false
            };
            self.bvh.any(&Ray::new(place, direction), note, &mut Traversal::default());
            let mut counts = [0; MOST_NESTED];
            faces.into_inner().into_values().for_each(|(rank, one)| counts[usize::from(rank)] += one);
            counts
        });
        let mut media = Media::default();
        for rank in 0..MOST_NESTED {
            let mut votes = counts.map(|count| count[rank]);
            votes.sort_unstable();
            (0..votes[PROBES.len() / 2]).for_each(|_| media.enter(rank as u8));
        }
        media
    }

    /// Rank of the solid that was hit, and whether the ray leaves it. `None` without a priority.
    pub(super) fn face(&self, hit: &Hit, direction: Vec3, texels: &Cell<u64>) -> Option<(u8, bool)> {
        let geometry = &self.frame.geometry;
        let rank = self.ranks.of(geometry.material(hit.primitive) as usize)?;
        let leaves = geometry.geometric_normal(hit.primitive).dot(direction) > 0.0;
        self.present(hit, texels).then_some((rank, leaves))
    }
}

/// The ranks in a bit set, ascending.
fn each(ranks: u32) -> impl Iterator<Item = u8> {
    (0..MOST_NESTED as u8).filter(move |rank| ranks >> rank & 1 == 1)
}
