//! Indirect light by way of secondary lights: see `cache/secondary`.

use super::direct::fine;
use super::{Pixels, Point, Segment, leaving};
use crate::cache::Seen;
use crate::cost::Category;
use crate::geometry;
use crate::random::Purpose;
use crate::response::Response;
use forelight_bvh::Hit;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Rays to secondary lights from a point that contributes fully to its pixel; proportionally fewer with less.
const RAYS: f32 = 4.0;

impl Pixels<'_> {
    /// Diffuse light from the secondary lights, at a first diffuse hit.
    pub(super) fn secondary_lights(&mut self, s: &Segment, p: &Point, response: &Response) -> Vec3 {
        let tracer = self.tracer;
        let lights = tracer.secondary_lights();
        if s.level > 0 || lights.is_empty() {
            return Vec3::ZERO;
        }
        let geometry = &tracer.frame.geometry;
        // Looking at one takes as long as looking at a record.
        self.counters.records += lights.all().len() as u64;
        let seen = lights.seen_from(p.position, p.basis.normal, geometry);
        let count = (RAYS * s.weight).ceil().clamp(1.0, RAYS) as u32;
        let points = self.sampler.draw(Purpose::Gather, s.vertex);
        let mut sum = Vec3::ZERO;
        for ray in 0..count {
            // Sequences of their own: two points of one sequence are not independent.
            let place = self.sampler.related(points, 2 * ray);
            let choice = fine(self.sampler.related(points, 2 * ray + 1));
            if seen.any_near {
                let wo = geometry::cosine_hemisphere(place);
                sum += self.toward_secondary(s, p, response, wo, &seen, |_| true);
            }
            let which = (f64::from(ray) + choice) / f64::from(count);
            if let Some((number, position)) = seen.choose(which, place, geometry) {
                let origin = leaving(p, position - p.position).origin;
                let wo = p.basis.to_local((position - origin).normalize_or_zero());
                sum += self.toward_secondary(s, p, response, wo, &seen, |met| met == number);
            }
        }
        sum / count as f32
    }

    /// Diffuse light along one ray that was chosen in direction `wo`, if it meets a light whose number is wanted.
    /// Both ways to choose a direction are combined by the balance heuristic (Veach 1997).
    fn toward_secondary(
        &mut self,
        s: &Segment,
        p: &Point,
        response: &Response,
        wo: Vec3,
        seen: &Seen<'_>,
        is_wanted: impl Fn(usize) -> bool,
    ) -> Vec3 {
        if wo.z <= 0.0 {
            return Vec3::ZERO;
        }
        self.counters.ray(Category::Ambient);
        let (tracer, share) = (self.tracer, response.diffuse(p.wi, wo));
        let segment = self.gathering(s, p, wo, share);
        let Some(hit) = self.closest(&segment.ray, None) else { return Vec3::ZERO };
        let lights = tracer.secondary_lights();
        let met = lights.met(&hit, segment.ray.origin, &tracer.frame.geometry);
        let Some(place) = met.filter(|place| is_wanted(place.0)) else { return Vec3::ZERO };
        let by_cosine = wo.z * FRAC_1_PI;
        let density = seen.density(place, hit.t * hit.t, segment.ray.direction);
        let all = density + if seen.any_near { by_cosine } else { 0.0 };
        // A light that is never chosen and not near cannot be reached, but for rounding.
        let factor = if all > 0.0 { by_cosine / all } else { 0.0 };
        factor * share * self.arriving(segment, Some(hit))
    }

    /// Radiance along a ray of a gather whose first hit is known. Gathers of the first bounce leave secondary
    /// lights out.
    pub(super) fn without_secondary_lights(&mut self, segment: Segment, hit: Option<Hit>) -> Vec3 {
        let lights = self.tracer.secondary_lights();
        let geometry = &self.tracer.frame.geometry;
        let is_met = |hit: &Hit| lights.met(hit, segment.ray.origin, geometry).is_some();
        let left_out = segment.level == 1 && hit.as_ref().is_some_and(is_met);
        if left_out { Vec3::ZERO } else { self.arriving(segment, hit) }
    }
}
