//! The interface of a solid dielectric: what lies on its two sides.

use super::{Passed, Pixels, Point, off_surface};
use crate::media::Media;
use crate::tracer::Tracer;
use forelight_bvh::{Hit, Ray, Traversal};
use forelight_scene::{MOST_NESTED, Surface};
use glam::Vec3;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;

/// Directions in which a camera looks for the solids that it is inside of. One that passes through an edge may
/// count a face twice; the middle of five counts.
const PROBES: [Vec3; 5] = [
    Vec3::new(0.267, 0.534, 0.802),
    Vec3::new(-0.683, 0.146, 0.715),
    Vec3::new(0.418, -0.871, -0.258),
    Vec3::new(-0.361, 0.722, -0.590),
    Vec3::new(0.912, 0.228, -0.342),
];

/// Cosine below which a ray is taken to graze a face: it would pass others far away within the same distance from the plane.
const GRAZING: f32 = 1e-2;

/// What a ray meets at the face of a solid dielectric.
#[derive(Debug, Clone, Copy)]
pub struct Interface {
    /// Index of refraction beyond, relative to this side; none: the place is filled by the same medium on both sides, and nothing
    /// happens to the ray.
    pub eta: Option<f32>,
    /// Share of light that passes, per channel.
    pub transmittance: Vec3,
    /// GGX alpha.
    pub alpha: f32,
    /// What the viewer's side is inside of.
    pub before: Media,
    /// What the other side is inside of.
    pub beyond: Media,
    /// How far a ray has come to which nothing happens.
    pub passed: Passed,
}

impl<const K: u32> Pixels<'_, K> {
    /// An interface by itself: its index is that of its inside relative to its outside.
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

    /// An interface among solids that overlap or touch. Faces in the same place are crossed together: the ray that goes on starts beyond
    /// all of them, so each has to be counted here.
    pub fn nested_interface(&mut self, ray: &Ray, hit: &Hit, p: &Point) -> Interface {
        let tracer = self.tracer;
        let ranks = &tracer.ranks;
        if ranks.of(p.material).is_none() {
            return self.plain_interface(ray, hit, p);
        }
        let ([entered, left], t) = self.faces_at(ray, hit, p);
        let passed = Passed { t, primitive: u32::MAX };
        // Who leaves a solid was inside it, whether or not the ray began there.
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

    /// Ranks, as bits, of the solids that a ray enters and of those that it leaves at a hit: by all faces between the hit and where a
    /// ray that goes on starts; and how far along the ray that is. Where faces of one solid share an edge that is hit, they count once.
    fn faces_at(&mut self, ray: &Ray, hit: &Hit, p: &Point) -> ([u32; 2], f32) {
        let step = (off_surface(p.position, p.geometric, p.size, ray.direction) - p.position).length();
        let cos = p.geometric.dot(ray.direction).abs();
        let piece = Ray { t_max: hit.t + step / cos.max(GRAZING), ..*ray };
        let texels = Cell::new(0);
        let met = Cell::new([0u32; 2]);
        let note = |other: &Hit| {
            if other.t >= hit.t
                && let Some((rank, leaves)) = self.tracer.face(other, ray.direction, &texels)
            {
                let mut faces = met.get();
                faces[usize::from(leaves)] |= 1 << rank;
                met.set(faces);
            }
            false
        };
        self.tracer.bvh.any(&piece, note, &mut self.counters.traversal);
        self.counters.texels += texels.get();
        (met.get(), piece.t_max)
    }
}

impl Tracer {
    /// What a place is inside of: by the faces that rays from there leave and do not enter.
    pub(crate) fn media_at(&self, place: Vec3) -> Media {
        let counts = PROBES.map(|direction| {
            // The tree may offer a triangle more than once.
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

    /// The rank of the solid whose face is hit, if it has one, and whether the ray leaves it.
    fn face(&self, hit: &Hit, direction: Vec3, texels: &Cell<u64>) -> Option<(u8, bool)> {
        let geometry = &self.frame.geometry;
        let rank = self.ranks.of(geometry.material(hit.primitive) as usize)?;
        let leaves = geometry.geometric_normal(hit.primitive).dot(direction) > 0.0;
        self.present(hit, texels).then_some((rank, leaves))
    }
}

/// The ranks of a set, from the lowest.
fn each(ranks: u32) -> impl Iterator<Item = u8> {
    (0..MOST_NESTED as u8).filter(move |rank| ranks >> rank & 1 == 1)
}
