//! Indirect light from the irradiance cache, and the rays that plan and fill it.

use super::{Pixels, Point, Segment, off_surface};
use crate::cache::{Irradiance, Mean, PLAN_RAYS, Planned, Sample, Site, Strata};
use crate::cost::Category;
use crate::geometry::Basis;
use crate::response::Response;
use forelight_bvh::{Hit, Ray};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// One in so many plan rays of the first level's records is followed to plan the second level. For every further level
/// it is half as many, and at least one of a record. All rays would call for more records at each level than at the
/// one before. Where no record covers a point, one ray gathers, which costs less.
const FOLLOWED: usize = 4;

impl Pixels<'_> {
    /// Indirect diffuse light: interpolated, or gathered where no record covers the point.
    pub fn interpolate(&mut self, s: &Segment, p: &Point, response: &Response) -> Vec3 {
        if self.tracer.planned().is_followed(s.level as usize) {
            return self.gather_uncovered(s, p, response);
        }
        let site = site(p, response);
        let cache = self.tracer.planned();
        let (irradiance, looked_at) = match s.level {
            0 => {
                self.counters.reads += 1;
                cache.read(0, &site)
            }
            deeper => {
                self.counters.single_reads += 1;
                cache.read_one(deeper as usize, &site)
            }
        };
        self.counters.records += looked_at;
        let by_secondary = self.secondary_lights(s, p, response);
        let gathered = match irradiance {
            Some(irradiance) => response.outgoing(p.wi) * irradiance * FRAC_1_PI,
            None => {
                self.counters.uncovered += 1;
                self.gather_uncovered(s, p, response)
            }
        };
        by_secondary + gathered
    }

    /// Notes that the cache would be read at this point.
    pub fn note(&mut self, p: &Point, response: &Response) -> Vec3 {
        self.sites.push(site(p, response));
        Vec3::ZERO
    }

    /// The hit of a ray from a site, and the direct light that it brings, mean over the channels. Without
    /// `with_light`, the light is 0.
    pub fn plan_ray(&mut self, site: &Site, direction: Vec3, with_light: bool) -> (Option<Hit>, f32) {
        self.counters.ray(Category::Ambient);
        let hit = self.closest(&ray_from(site, direction), None);
        if !with_light {
            return (hit, 0.0);
        }
        // At the last level, nothing is gathered, and no cache is read.
        let segment = self.gathered_segment(self.tracer.settings.ambient_bounces, site, direction);
        let radiance = self.arriving(segment, hit).element_sum() / 3.0;
        (hit, if radiance.is_nan() { 0.0 } else { radiance.clamp(0.0, Planned::BRIGHTEST) })
    }

    /// Follows some of a record's plan rays to where they read `level`, the level after the record's own.
    pub fn walk_gather(&mut self, strata: &Strata, level: u32, planned: &Planned) {
        let basis = Basis::new(planned.site.normal);
        let step = PLAN_RAYS.min(FOLLOWED << (level - 1));
        let first = (planned.key % step as u64) as usize;
        for (ray, hit) in planned.hits.iter().enumerate().skip(first).step_by(step) {
            let direction = basis.to_world(strata.direction(strata.of_plan(ray), 0, &self.sampler));
            self.arriving(self.gathered_segment(level, &planned.site, direction), *hit);
        }
    }

    fn gathered_segment(&self, level: u32, site: &Site, direction: Vec3) -> Segment {
        let ray = ray_from(site, direction);
        Segment { ray, passed: None, arrival: self.gathered(), level, depth: 0, vertex: 1, weight: 1.0 }
    }

    /// Gathers the hemisphere above a record of `level`. The plan's rays are not traced again. `counts` is
    /// the number of rays of each stratum, 1 if absent.
    pub fn gather_record(
        &mut self,
        strata: &Strata,
        counts: Option<&[u16]>,
        level: u32,
        planned: &Planned,
    ) -> Irradiance {
        // All work of a gather is ambient.
        self.counters.caused_by(Category::Ambient);
        let basis = Basis::new(planned.site.normal);
        let samples: Vec<Sample> = (0..strata.len())
            .map(|stratum| {
                let mut mean = Mean::default();
                for ray in 0..counts.map_or(1, |counts| counts[stratum]) {
                    let direction = basis.to_world(strata.direction(stratum, ray, &self.sampler));
                    let segment = self.gathered_segment(level + 1, &planned.site, direction);
                    let hit = match strata.plan_ray(stratum) {
                        Some(known) if ray == 0 => planned.hits[known],
                        _ => {
                            self.counters.ray(Category::Ambient);
                            self.closest(&segment.ray, None)
                        }
                    };
                    let distance = hit.as_ref().map_or(f32::INFINITY, |hit| hit.t);
                    mean.add(self.without_secondary_lights(segment, hit), distance);
                }
                mean.sample()
            })
            .collect();
        strata.integrate(&samples, &basis, planned.site.coat)
    }
}

fn site(p: &Point, response: &Response) -> Site {
    Site {
        position: p.position,
        size: p.size,
        normal: p.basis.normal,
        geometric: p.geometric,
        coat: response.coat.map_or(0.0, |coat| coat.ior),
    }
}

fn ray_from(site: &Site, direction: Vec3) -> Ray {
    Ray::new(off_surface(site.position, site.geometric, site.size, direction), direction)
}
