//! The `ambient` integrator: distribution ray tracing (Whitted 1980, Cook et al. 1984, Ward et al. 1988).
//!
//! At every diffuse or glossy surface, lights are sampled directly (next-event estimation): all, or some if
//! there are many. Rays follow mirrors, glass and glossy lobes. The first `ambient_bounces` diffuse hits
//! gather their hemisphere.
//!
//! Light is counted once. Rays gathered by a diffuse surface do not see the lights that it sampled. Glossy
//! lobes, and diffuse surfaces for near lights, share them with light sampling by multiple importance
//! sampling (Veach 1997, balance heuristic).
//!
//! Caustics are left out, as in Radiance: a gathered hemisphere would find them by rare, very bright rays.

use super::segment::{Arrival, Segment};
use super::{Interface, Passed, Pixels, Point, cap_height, fluence, leaving};
use crate::cost::Category;
use crate::environment::Sky;
use crate::fresnel;
use crate::geometry;
use crate::microfacet as ggx;
use crate::random::Purpose;
use crate::response::{Coat, Glossy, Response, Tint};
use crate::settings::UncoveredGathers;
use forelight_bvh::{Hit, Ray};
use forelight_scene::{Color, Surface};
use glam::Vec3;

/// Russian roulette before the first diffuse bounce: for branches that add less than this to the pixel.
const FAINT: f32 = 0.02;

/// After a diffuse bounce, glossy lobes with a smaller alpha do not see the lights (caustics).
const CAUSTIC_ALPHA: f32 = 0.2;

impl Pixels<'_> {
    /// Radiance along a camera ray.
    pub fn ambient(&mut self, ray: Ray) -> Vec3 {
        let arrival = Arrival::Everything;
        self.radiance(Segment { ray, passed: None, arrival, level: 0, depth: 0, vertex: 0, weight: 1.0 })
    }

    /// Radiance that arrives along a segment.
    pub(super) fn radiance(&mut self, s: Segment) -> Vec3 {
        let hit = self.closest(&s.ray, s.passed);
        self.arriving(s, hit)
    }

    /// Radiance that arrives along a segment that ends at `hit`.
    pub(super) fn arriving(&mut self, s: Segment, hit: Option<Hit>) -> Vec3 {
        let Some(hit) = hit else {
            return self.leave(&s);
        };
        let p = self.point(&s.ray, &hit);
        if s.vertex == 0 && self.met.is_none() {
            self.met = Some(p.stratum);
        }
        let material = &self.tracer.materials[p.material];
        if material.opacity < 1.0 && self.sampler.next(Purpose::Opacity, s.vertex).x >= material.opacity {
            return self.going_straight(&s, p.passed());
        }
        self.counters.shadings += 1;
        let emitted = if material.is_emissive() { self.emission(&s, &p) } else { Vec3::ZERO };
        emitted + self.scattered(&s, &p, &hit)
    }

    /// Radiance that the surface scatters towards the viewer.
    fn scattered(&mut self, s: &Segment, p: &Point, hit: &Hit) -> Vec3 {
        match self.tracer.materials[p.material].surface {
            Surface::Lambert { albedo } => {
                let diffuse = self.color(&albedo, p.uv);
                self.reflecting(s, p, Response { diffuse, coat: None, glossy: None })
            }
            Surface::Plastic { albedo, ior, alpha } => self.plastic(s, p, &albedo, ior, alpha),
            Surface::Metal { f0, alpha } if alpha < ggx::SMOOTH => {
                let f0 = self.color(&f0, p.uv);
                self.mirror(s, p, fresnel::conductor(p.wi.z, f0))
            }
            Surface::Metal { f0, alpha } => {
                let fresnel = Tint::Conductor(self.color(&f0, p.uv));
                let glossy = Some(Glossy { alpha, fresnel });
                self.reflecting(s, p, Response { diffuse: Vec3::ZERO, coat: None, glossy })
            }
            Surface::ThinGlass { ior, transmittance } => self.pane(s, p, ior, &transmittance),
            Surface::Glass { .. } => {
                let outer = self.media;
                let interface = (self.kernel.interface)(self, &s.ray, hit, p);
                self.media = interface.before;
                let radiance = self.glass(s, p, &interface);
                self.media = outer;
                radiance
            }
        }
    }

    /// Radiance seen by a ray that leaves the scene.
    fn leave(&mut self, s: &Segment) -> Vec3 {
        let tracer = self.tracer;
        match s.arrival {
            Arrival::Nothing => Vec3::ZERO,
            Arrival::Shared { .. } | Arrival::Sky => tracer.sky.radiance(s.ray.direction),
            Arrival::Everything if s.level > 0 => tracer.sky.radiance(s.ray.direction),
            Arrival::Everything => {
                let suns = tracer.frame.suns.iter().map(|sun| {
                    let height = cap_height(sun.angle_deg);
                    if height > 0.0 && s.ray.direction.dot(sun.direction) >= 1.0 - height {
                        fluence(sun) / (std::f32::consts::TAU * height)
                    } else {
                        Vec3::ZERO
                    }
                });
                tracer.sky.radiance(s.ray.direction) + suns.sum::<Vec3>()
            }
        }
    }

    /// Radiance that the surface emits towards the viewer.
    fn emission(&mut self, s: &Segment, p: &Point) -> Vec3 {
        let material = &self.tracer.materials[p.material];
        let cos = p.geometric.dot(p.viewer);
        let cos = if material.emits_both_sides { cos.abs() } else { cos };
        if cos <= 0.0 {
            return Vec3::ZERO;
        }
        let weight = match s.arrival {
            Arrival::Nothing | Arrival::Sky => return Vec3::ZERO,
            Arrival::Everything if s.level > 0 => return Vec3::ZERO,
            Arrival::Everything => 1.0,
            Arrival::Shared { receiver, density } => {
                let distance2 = p.distance * p.distance;
                let by_light = self.density_of_lights(&receiver, s.level, p.primitive, distance2, cos);
                by_light.map_or(1.0, |by_light| density / (density + by_light))
            }
        };
        let emission = material.emission;
        weight * self.color(&emission, p.uv)
    }

    /// Radiance from a diffuse or glossy surface: samples lights, gathers the hemisphere, follows the lobe.
    fn reflecting(&mut self, s: &Segment, p: &Point, mut response: Response) -> Vec3 {
        let mut total = Vec3::ZERO;
        let lobe = response.glossy;
        let caustic = s.level > 0 && lobe.is_some_and(|g| g.alpha < CAUSTIC_ALPHA);
        if caustic {
            response.glossy = None;
        }
        let kernel = self.kernel;
        let ambient = match kernel.ambient {
            Some(ambient) if response.has_diffuse() && s.level < self.tracer.settings.ambient_bounces => {
                Some(ambient)
            }
            _ => None,
        };
        let gathers_sky = ambient.is_some() && self.gathers_sky();
        total += self.caused_by(Category::Shadow, |this| {
            let mut arriving = Vec3::ZERO;
            if response.has_diffuse() || response.glossy.is_some() {
                arriving += this.direct(p, &response, s.level, s.vertex);
            }
            if let Some(sky) = kernel.sky
                && response.has_diffuse()
                && !gathers_sky
            {
                arriving += sky(this, p, &response, s.vertex);
            }
            arriving
        });
        if let Some(ambient) = ambient {
            total += self.caused_by(Category::Ambient, |this| ambient(this, s, p, &response));
        }
        if let Some(glossy) = lobe
            && let Some((wo, share, density)) =
                glossy.sample(p.wi, self.sampler.next(Purpose::Glossy, s.vertex))
        {
            let shared = Arrival::Shared { receiver: p.receiver(), density };
            let arrival = if caustic { Arrival::Sky } else { shared };
            let turned = s.turned(p, p.basis.to_world(wo), arrival);
            total += self.follow(turned, share, Category::Specular);
        }
        total
    }

    fn plastic(&mut self, s: &Segment, p: &Point, albedo: &Color, ior: f32, alpha: f32) -> Vec3 {
        let diffuse = self.color(albedo, p.uv);
        let coat = Some(Coat { ior, internal: self.tracer.internal[p.material] });
        if alpha >= ggx::SMOOTH {
            let glossy = Some(Glossy { alpha, fresnel: Tint::Dielectric(ior) });
            return self.reflecting(s, p, Response { diffuse, coat, glossy });
        }
        let share = Vec3::splat(fresnel::dielectric(p.wi.z, ior).reflectance);
        self.reflecting(s, p, Response { diffuse, coat, glossy: None }) + self.mirror(s, p, share)
    }

    fn mirror(&mut self, s: &Segment, p: &Point, share: Vec3) -> Vec3 {
        let direction = ggx::reflect(p.viewer, p.basis.normal);
        self.follow(s.turned(p, direction, Arrival::Everything), share, Category::Reflected)
    }

    fn pane(&mut self, s: &Segment, p: &Point, ior: f32, transmittance: &Color) -> Vec3 {
        let reflectance = fresnel::pane(p.wi.z, ior);
        let through = (1.0 - reflectance) * self.color(transmittance, p.uv);
        let straight = Segment { depth: s.depth + 1, ..s.beyond(p.passed()) };
        let forward = |this: &mut Self, share| this.follow(straight, share, Category::Transparent);
        self.split(s, p, reflectance, through, forward)
    }

    fn glass(&mut self, s: &Segment, p: &Point, between: &Interface) -> Vec3 {
        let &Interface { eta, transmittance, alpha, before, beyond, passed } = between;
        let Some(eta) = eta else {
            self.media = beyond;
            return self.going_straight(s, passed);
        };
        let normal = if alpha < ggx::SMOOTH {
            p.basis.normal
        } else {
            p.basis.to_world(ggx::sample_visible(p.wi, alpha, self.sampler.next(Purpose::Glossy, s.vertex)))
        };
        let cos_i = p.viewer.dot(normal);
        let interface = fresnel::dielectric(cos_i, eta);
        // Refraction changes the solid angle: radiance times 1/η² on the way in, and η² on the way out.
        let through = (1.0 - interface.reflectance) * transmittance / (eta * eta);
        if alpha < ggx::SMOOTH {
            let direction = ggx::refract(p.viewer, normal, eta, interface.cos_t);
            let forward = |this: &mut Self, share| {
                this.media = beyond;
                let refracted = s.turned(p, direction, Arrival::Everything);
                let radiance = this.follow(refracted, share, Category::Refracted);
                this.media = before;
                radiance
            };
            return self.split(s, p, interface.reflectance, through, forward);
        }
        // Rough glass: one of the two directions about the microfacet, weighted by the masking on the other
        // side.
        let reflects = self.sampler.next(Purpose::Lobe, s.vertex).x < interface.reflectance;
        let direction = if reflects {
            ggx::reflect(p.viewer, normal)
        } else {
            ggx::refract(p.viewer, normal, eta, interface.cos_t)
        };
        let wo = p.basis.to_local(direction);
        if (wo.z > 0.0) != reflects {
            return Vec3::ZERO;
        }
        let up = wo.with_z(wo.z.abs());
        let masking = ggx::masking_shadowing(p.wi, up, alpha) / ggx::masking(p.wi, alpha);
        let (share, category) = if reflects {
            (Vec3::splat(masking), Category::Specular)
        } else {
            self.media = beyond;
            (masking * through / (1.0 - interface.reflectance), Category::Refracted)
        };
        self.follow(s.turned(p, direction, Arrival::Everything), share, category)
    }

    /// Reflection and transmission of a smooth interface: both at the first hit, then one at random.
    fn split(
        &mut self,
        s: &Segment,
        p: &Point,
        reflectance: f32,
        through: Vec3,
        forward: impl Fn(&mut Self, Vec3) -> Vec3,
    ) -> Vec3 {
        if s.level == 0 && s.depth == 0 {
            let reflected = self.mirror(s, p, Vec3::splat(reflectance));
            return reflected + forward(self, through);
        }
        if self.sampler.next(Purpose::Lobe, s.vertex).x < reflectance {
            self.mirror(s, p, Vec3::ONE)
        } else {
            forward(self, through / (1.0 - reflectance))
        }
    }

    /// `share` × the radiance of the next segment, with Russian roulette for little weight.
    fn follow(&mut self, next: Segment, share: Vec3, category: Category) -> Vec3 {
        let largest = share.max_element();
        if largest <= 0.0 || next.depth > self.tracer.settings.max_depth {
            return Vec3::ZERO;
        }
        let importance = if next.level == 0 { next.weight * largest / FAINT } else { 2.0 * largest };
        let survival = importance.min(1.0);
        if survival < 1.0 && self.sampler.next(Purpose::Roulette, next.vertex - 1).x >= survival {
            return Vec3::ZERO;
        }
        let share = share / survival;
        let next = Segment { weight: next.weight * share.max_element(), ..next };
        share * self.sent(category, next)
    }

    /// Radiance of a segment behind a surface that it passes straight.
    fn going_straight(&mut self, s: &Segment, passed: Passed) -> Vec3 {
        self.sent(Category::Transparent, s.beyond(passed))
    }

    /// Radiance along a ray that is counted as one of `category`.
    fn sent(&mut self, category: Category, s: Segment) -> Vec3 {
        self.caused_by(category, |this| {
            this.counters.ray(category);
            this.radiance(s)
        })
    }

    /// Whether gathered rays bring the environment's light. A constant one needs no rays of its own.
    fn gathers_sky(&self) -> bool {
        matches!(self.tracer.sky, Sky::Constant(_))
    }

    /// The lights that gathered rays see.
    pub(super) fn gathered(&self) -> Arrival {
        if self.gathers_sky() { Arrival::Sky } else { Arrival::Nothing }
    }

    /// Indirect diffuse light: the mean over stratified, cosine-weighted rays.
    pub fn gather(&mut self, s: &Segment, p: &Point, response: &Response) -> Vec3 {
        let divisions = self.tracer.settings.ambient_divisions;
        let count = if s.level == 0 {
            ((divisions as f32 * s.weight).ceil() as u32).clamp(1, divisions)
        } else {
            (divisions >> (3 * s.level).min(31)).max(1)
        };
        self.gather_rays(count, s, p, response)
    }

    /// Indirect diffuse light at an uncovered point: a few rays for a sample, one within a record's gather.
    pub(super) fn gather_uncovered(&mut self, s: &Segment, p: &Point, response: &Response) -> Vec3 {
        if s.level > 0 {
            return self.gather_rays(1, s, p, response);
        }
        let rule = self.tracer.settings.cache.unwrap_or_default().uncovered();
        // Samples that contribute little to their pixel get proportionally fewer rays.
        let rule = UncoveredGathers { first: (rule.first as f32 * s.weight.min(1.0)) as u32, ..rule };
        let (count, before) = (rule.of_sample(self.sampler.samples()), self.counters.work());
        let radiance = self.gather_rays(count, s, p, response);
        let spent = self.counters.work() - before;
        self.counters.extra_work += spent * u64::from(count - rule.least) / u64::from(count);
        radiance
    }

    fn gather_rays(&mut self, count: u32, s: &Segment, p: &Point, response: &Response) -> Vec3 {
        let mut sum = Vec3::ZERO;
        for _ in 0..count {
            let wo = geometry::cosine_hemisphere(self.sampler.next(Purpose::Gather, s.vertex));
            if wo.z <= 0.0 {
                continue;
            }
            self.counters.ray(Category::Ambient);
            let share = response.diffuse(p.wi, wo);
            let segment = self.gathering(s, p, wo, share);
            let hit = self.closest(&segment.ray, None);
            sum += share * self.without_secondary_lights(segment, hit);
        }
        sum / count as f32
    }

    /// A ray that gathers, in direction `wo` of the point's frame. `share`: the diffuse lobe towards it.
    pub(super) fn gathering(&self, s: &Segment, p: &Point, wo: Vec3, share: Vec3) -> Segment {
        Segment {
            ray: leaving(p, p.basis.to_world(wo)),
            passed: None,
            arrival: self.gathered(),
            level: s.level + 1,
            depth: 0,
            vertex: s.vertex + 1,
            weight: s.weight * share.max_element(),
        }
    }
}
