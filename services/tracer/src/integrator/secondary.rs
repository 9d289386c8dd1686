//! Indirect light by way of secondary lights: see `cache/secondary`.

use super::{Pixels, Point, Segment};
use crate::cost::Category;
use crate::geometry;
use crate::random::Purpose;
use crate::response::Response;
use crate::settings::UncoveredGathers;
use forelight_bvh::{Hit, Ray};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Rays to secondary lights from a point that contributes fully to its pixel. Points that contribute less send
/// proportionally fewer. With few camera samples, most of the noise would be that of these rays.
const RAYS: UncoveredGathers = UncoveredGathers { first: 16, least: 2 };

impl<const K: u32> Pixels<'_, K> {
    /// Diffuse light from the secondary lights, at a first diffuse hit.
    pub(super) fn secondary_lights(&mut self, s: &Segment, p: &Point, response: &Response) -> Vec3 {
        let tracer = self.tracer;
        let lights = tracer.planned().secondary_lights();
        if s.level > 0 || lights.is_empty() {
            return Vec3::ZERO;
        }
        let geometry = &tracer.frame.geometry;
        // Looking at one takes as long as looking at a record.
        self.counters.records += lights.all().len() as u64;
        let seen = lights.seen_from(p.position, p.basis.normal, geometry);
        let weighted = |rays: u32| ((rays as f32 * s.weight.min(1.0)).ceil() as u32).max(1);
        let (count, least) = (weighted(RAYS.of_sample(self.sampler.samples())), weighted(RAYS.least));
        let before = self.counters.work();
        let [places, choices] = [(); 2].map(|()| self.sampler.draw(Purpose::Gather, s.vertex));
        let by_cosine = |wo: Vec3| if seen.any_near { wo.z * FRAC_1_PI } else { 0.0 };
        let mut sum = Vec3::ZERO;
        // Both ways to choose a direction are combined by the balance heuristic (Veach 1997).
        for ray in 0..count {
            let place = self.sampler.related(places, ray);
            if seen.any_near {
                let wo = geometry::cosine_hemisphere(place);
                sum += self.toward_secondary(s, p, response, wo, |hit, ray| {
                    let place = lights.met(hit, ray.origin, geometry)?;
                    let density = seen.density(place, hit.t * hit.t, seen.cos(place.0, ray.direction));
                    Some(by_cosine(wo) / (by_cosine(wo) + density))
                });
            }
            let which = (f64::from(ray) + f64::from(self.sampler.related(choices, ray).x)) / f64::from(count);
            if let Some(chosen) = seen.choose(which, place, geometry) {
                let to = chosen.position - p.position;
                let distance2 = to.length_squared();
                let direction = to / distance2.sqrt();
                let wo = p.basis.to_local(direction);
                let cos = seen.cos(chosen.number, direction);
                let density = seen.density((chosen.number, chosen.part), distance2, cos);
                sum += self.toward_secondary(s, p, response, wo, |hit, _| {
                    let factor = wo.z * FRAC_1_PI / (by_cosine(wo) + density);
                    (hit.primitive == chosen.triangle).then_some(factor)
                });
            }
        }
        let spent = self.counters.work() - before;
        self.counters.extra_work += spent * u64::from(count - least) / u64::from(count);
        sum / count as f32
    }

    /// Diffuse light along one ray, times the factor for its first hit; nothing if there is none.
    fn toward_secondary(
        &mut self,
        s: &Segment,
        p: &Point,
        response: &Response,
        wo: Vec3,
        factor: impl Fn(&Hit, &Ray) -> Option<f32>,
    ) -> Vec3 {
        // The point itself has no direction to it.
        if wo.z.is_nan() || wo.z <= 0.0 {
            return Vec3::ZERO;
        }
        self.counters.ray(Category::Ambient);
        let share = response.diffuse(p.wi, wo);
        let segment = self.gathering(s, p, wo, share);
        let Some(hit) = self.closest(&segment.ray, None) else { return Vec3::ZERO };
        match factor(&hit, &segment.ray) {
            Some(factor) => factor * share * self.arriving(segment, Some(hit)),
            None => Vec3::ZERO,
        }
    }

    /// Radiance along a ray of a gather whose first hit is known. Secondary lights are left out of the gathers
    /// of the first bounce.
    pub(super) fn without_secondary_lights(&mut self, segment: Segment, hit: Option<Hit>) -> Vec3 {
        let lights = self.tracer.planned().secondary_lights();
        let geometry = &self.tracer.frame.geometry;
        let is_met = |hit: &Hit| lights.met(hit, segment.ray.origin, geometry).is_some();
        let left_out = segment.level == 1 && hit.as_ref().is_some_and(is_met);
        if left_out { Vec3::ZERO } else { self.arriving(segment, hit) }
    }
}
