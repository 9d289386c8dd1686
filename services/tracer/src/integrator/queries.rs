//! Queries of the BVH: what a ray meets first, what a shadow ray meets, and which faces of solids lie in one
//! place.

use super::Passed;
use crate::cost::Counters;
use crate::tracer::Tracer;
use forelight_bvh::{Hit, Ray};
use forelight_scene::Surface;
use std::cell::Cell;

/// What a shadow ray meets.
pub enum Shadow {
    /// Something that lets no light pass.
    Blocked,
    /// Nothing.
    Clear,
    /// Only surfaces that let a part of the light pass.
    Attenuated,
}

impl Tracer {
    /// The first hit of a ray, behind what it has already passed, if nothing is cut out.
    pub(crate) fn closest(&self, ray: &Ray, passed: Option<Passed>, counters: &mut Counters) -> Option<Hit> {
        let steps = &mut counters.traversal;
        match passed {
            None => self.bvh.closest(ray, |_| true, steps),
            Some(passed) => self.bvh.closest(&passed.rest(ray), |hit| passed.is_before(hit), steps),
        }
    }

    /// The first hit of a ray, behind what it has already passed, where surfaces are present.
    pub(crate) fn closest_present(
        &self,
        ray: &Ray,
        passed: Option<Passed>,
        counters: &mut Counters,
    ) -> Option<Hit> {
        let texels = Cell::new(0);
        let present = |hit: &Hit| self.present(hit, &texels);
        let steps = &mut counters.traversal;
        let hit = match passed {
            None => self.bvh.closest(ray, present, steps),
            Some(passed) => {
                let counts = |hit: &Hit| passed.is_before(hit) && present(hit);
                self.bvh.closest(&passed.rest(ray), counts, steps)
            }
        };
        counters.texels += texels.get();
        hit
    }

    /// What a shadow ray meets if all surfaces block light.
    pub(crate) fn opaque_shadow(&self, ray: &Ray, counters: &mut Counters) -> Shadow {
        match self.bvh.any(ray, |_| true, &mut counters.traversal) {
            true => Shadow::Blocked,
            false => Shadow::Clear,
        }
    }

    /// What a shadow ray meets if some surfaces let light pass.
    pub(crate) fn shadow(&self, ray: &Ray, counters: &mut Counters) -> Shadow {
        let attenuates = Cell::new(false);
        let texels = Cell::new(0);
        let blocks = |hit: &Hit| {
            let material = &self.materials[self.frame.geometry.material(hit.primitive) as usize];
            if !self.present(hit, &texels) {
                return false;
            }
            let passes = material.opacity < 1.0 || matches!(material.surface, Surface::ThinGlass { .. });
            attenuates.set(attenuates.get() | passes);
            !passes
        };
        let blocked = self.bvh.any(ray, blocks, &mut counters.traversal);
        counters.texels += texels.get();
        match (blocked, attenuates.get()) {
            (true, _) => Shadow::Blocked,
            (false, false) => Shadow::Clear,
            (false, true) => Shadow::Attenuated,
        }
    }

    /// Ranks, as bits, of the solids that a ray enters and leaves from the distance `first` on.
    pub(super) fn faces_from(&self, first: f32, ray: &Ray, counters: &mut Counters) -> [u32; 2] {
        let texels = Cell::new(0);
        let met = Cell::new([0u32; 2]);
        let note = |hit: &Hit| {
            if hit.t >= first
                && let Some((rank, leaves)) = self.face(hit, ray.direction, &texels)
            {
                let mut faces = met.get();
                faces[usize::from(leaves)] |= 1 << rank;
                met.set(faces);
            }
            false
        };
        self.bvh.any(ray, note, &mut counters.traversal);
        counters.texels += texels.get();
        met.get()
    }
}
