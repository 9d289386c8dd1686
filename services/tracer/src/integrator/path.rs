//! The `path` integrator: unbiased path tracing, the ground truth for the other integrator.
//!
//! At every surface, a path continues in one direction sampled from the BSDF (Kajiya 1986). At surfaces that
//! spread light, one light is sampled as well, combined by multiple importance sampling (Veach 1997, power
//! heuristic). Light that arrives only through mirrors and glass, including caustics, is found by BSDF
//! sampling alone.
//!
//! Shadow rays and path rays pass straight through panes and cut-outs; a light seen through them counts for
//! both techniques.
//!
//! `ambient_bounces` limits how often a path is spread after the first time (diffuse, glossy or rough glass).
//! `max_depth` limits each chain of mirrors, smooth glass and panes. Russian roulette does not change the
//! mean.
//!
//! The loop over a path's vertices is one function of 96 lines. Its steps share a dozen values, which smaller
//! functions would have to hand to each other.

use super::direct::{LAST_BIT, falloff, fine};
use super::{Interface, Pixels, Point, cap_height, fluence, leaving};
use crate::bsdf::{Bsdf, Coat, Lobe, Scattering};
use crate::cost::Category;
use crate::environment::Sky;
use crate::geometry::{self, Basis};
use crate::lights::{Light, Receiver};
use crate::random::Purpose;
use forelight_bvh::{Ray, offset_origin};
use forelight_scene::{PointLight, Surface};
use glam::{DVec2, Vec3};
use std::f32::consts::TAU;

/// From this vertex on, paths are subject to Russian roulette.
const ROULETTE: u32 = 4;

/// From this vertex on, even a path without losses may end, as in a closed room of mirrors.
const LONG: u32 = 32;

/// Largest probability of survival per vertex of a long path.
const SURVIVAL: f32 = 0.95;

/// How the direction of a path's ray was chosen.
#[derive(Debug, Clone, Copy)]
enum Origin {
    /// By the camera, a mirror or smooth glass. No other technique finds the lights that the ray hits.
    Only,
    /// By a BSDF, with this density per steradian, at a point where a light was sampled as well.
    Spread { receiver: Receiver, density: f32 },
}

/// The contribution of a sampled light, before its shadow ray is traced.
struct Candidate {
    direction: Vec3,
    /// End of the shadow ray. `None` means infinity.
    target: Option<Vec3>,
    /// Radiance over the density of the choice. For lights without size: irradiance over its probability.
    light: Vec3,
    /// Density of the choice per steradian. `None` for lights without size, which BSDF sampling cannot find.
    density: Option<f32>,
}

impl Pixels<'_> {
    /// Radiance along a camera ray, estimated by one path. It is one long loop, because each step reads and
    /// changes most of the path's state.
    pub fn path(&mut self, mut ray: Ray) -> Vec3 {
        let settings = &self.tracer.settings;
        let mut origin = Origin::Only;
        let (mut total, mut throughput) = (Vec3::ZERO, Vec3::ONE);
        // Factor by which refraction has increased the radiance. Russian roulette ignores it.
        let mut compression = 1.0;
        let (mut spreads, mut depth) = (0, 0);
        let mut passed = None;
        for vertex in 0u32.. {
            let Some(hit) = self.closest(&ray, passed) else {
                total += throughput * self.surroundings(&origin, ray.direction);
                break;
            };
            let p = self.point(&ray, &hit);
            if vertex == 0 {
                self.met = Some(p.stratum);
            }
            let material = &self.tracer.materials[p.material];
            if material.opacity < 1.0 && self.sampler.next(Purpose::Opacity, vertex).x >= material.opacity {
                self.goes_on(Category::Transparent);
                passed = Some(p.passed());
                continue;
            }
            self.counters.shadings += 1;
            if material.is_emissive() {
                total += throughput * self.emitted(&origin, &p);
            }
            let (bsdf, beyond) = match material.surface {
                Surface::Glass { .. } => {
                    let Interface { eta, transmittance, alpha, before, beyond, passed: through } =
                        (self.kernel.interface)(self, &ray, &hit, &p);
                    let Some(eta) = eta else {
                        // Shadow rays do not pass here, so no other technique finds what the ray hits next.
                        (origin, self.media) = (Origin::Only, beyond);
                        self.goes_on(Category::Transparent);
                        passed = Some(through);
                        continue;
                    };
                    self.media = before;
                    (Bsdf::glass(eta, transmittance, alpha), beyond)
                }
                surface => (self.bsdf(&p, surface), self.media),
            };
            let exhausted = bsdf.spreads() && spreads > settings.ambient_bounces;
            let chosen = if exhausted {
                bsdf.mirror(p.wi)
            } else {
                if bsdf.spreads() {
                    total += throughput
                        * self.caused_by(Category::Shadow, |this| this.sampled_light(&p, &bsdf, vertex));
                }
                self.chosen(&p, &bsdf, vertex)
            };
            let Some(scattering) = chosen else { break };
            origin = match (scattering.density, scattering.lobe) {
                (Some(density), _) => {
                    (spreads, depth) = (spreads + 1, 0);
                    Origin::Spread { receiver: receiver(&p, &bsdf), density }
                }
                (None, lobe) => {
                    depth += 1;
                    if lobe == Lobe::Straight { origin } else { Origin::Only }
                }
            };
            if depth > settings.max_depth {
                break;
            }
            throughput *= scattering.weight;
            if let (Bsdf::Glass { eta, .. }, Lobe::Refraction) = (bsdf, scattering.lobe) {
                compression *= eta * eta;
                self.media = beyond;
            }
            let Some(survival) = self.roulette(throughput.max_element() * compression, vertex) else { break };
            throughput /= survival;
            self.goes_on(category(scattering.lobe));
            if scattering.lobe == Lobe::Straight {
                passed = Some(p.passed());
            } else {
                ray = leaving(&p, p.basis.to_world(scattering.direction).normalize());
                passed = None;
            }
        }
        self.counters.back_to(Category::Primary);
        total
    }

    /// Ends long paths of little weight at random (Russian roulette). `None` if the path ends, else the
    /// probability that it went on.
    fn roulette(&mut self, weight: f32, vertex: u32) -> Option<f32> {
        let most = match vertex {
            ..ROULETTE => return Some(1.0),
            ROULETTE..LONG => 1.0,
            _ => SURVIVAL,
        };
        let survival = weight.min(most);
        if survival >= 1.0 {
            return Some(1.0);
        }
        (self.sampler.next(Purpose::Roulette, vertex).x < survival).then_some(survival)
    }

    /// Counts the path's next ray.
    fn goes_on(&mut self, category: Category) {
        self.counters.caused_by(category);
        self.counters.ray(category);
    }

    /// The BSDF of any surface except a solid dielectric's.
    #[inline]
    fn bsdf(&mut self, p: &Point, surface: Surface) -> Bsdf {
        match surface {
            Surface::Lambert { albedo } => Bsdf::lambert(self.color(&albedo, p.uv)),
            Surface::Plastic { albedo, ior, alpha } => {
                let coat = Coat { ior, internal: self.tracer.internal[p.material] };
                Bsdf::coated(self.color(&albedo, p.uv), coat, alpha)
            }
            Surface::Metal { f0, alpha } => Bsdf::metal(self.color(&f0, p.uv), alpha),
            Surface::ThinGlass { ior, transmittance } => Bsdf::pane(ior, self.color(&transmittance, p.uv)),
            Surface::Glass { .. } => unreachable!("a solid dielectric's face is an interface"),
        }
    }

    /// Samples the direction in which the path continues.
    #[inline]
    fn chosen(&mut self, p: &Point, bsdf: &Bsdf, vertex: u32) -> Option<Scattering> {
        let u = self.sampler.next(Purpose::Gather, vertex);
        let choice = if self.kernel.several_lobes { self.sampler.next(Purpose::Lobe, vertex).x } else { 0.0 };
        bsdf.sample(p.wi, u, choice)
    }

    /// Radiance that the surface emits towards the viewer, weighted against light sampling.
    fn emitted(&mut self, origin: &Origin, p: &Point) -> Vec3 {
        let tracer = self.tracer;
        let material = &tracer.materials[p.material];
        let cos = p.geometric.dot(p.viewer);
        let cos = if material.emits_both_sides { cos.abs() } else { cos };
        if cos <= 0.0 {
            return Vec3::ZERO;
        }
        let weight = match origin {
            Origin::Only => 1.0,
            Origin::Spread { receiver, density } => {
                let lights = &tracer.lights;
                lights.emitters.of_triangle(p.primitive).map_or(1.0, |emitter| {
                    let visited = &mut self.counters.traversal.nodes;
                    let probability = lights.of_patch(receiver, emitter, visited);
                    let distance2 = p.distance * p.distance;
                    let by_light = lights.emitters.density(emitter, probability, distance2, cos);
                    power(*density, by_light)
                })
            }
        };
        let emission = material.emission;
        weight * self.color(&emission, p.uv)
    }

    /// Radiance seen by a path that leaves the scene, weighted against light sampling.
    fn surroundings(&mut self, origin: &Origin, direction: Vec3) -> Vec3 {
        let tracer = self.tracer;
        let weight = |by_light: &dyn Fn(&Receiver) -> f32| match origin {
            Origin::Only => 1.0,
            Origin::Spread { receiver, density } => power(*density, by_light(receiver)),
        };
        let sky = match &tracer.sky {
            Sky::Black => Vec3::ZERO,
            Sky::Constant(radiance) => *radiance,
            Sky::Image(image) => {
                let density = |r: &Receiver| tracer.lights.of_sky(r) as f32 * image.density(direction);
                weight(&density) * tracer.sky.radiance(direction)
            }
        };
        let suns = tracer.frame.suns.iter().enumerate().map(|(i, sun)| {
            let height = cap_height(sun.angle_deg);
            if height > 0.0 && direction.dot(sun.direction) >= 1.0 - height {
                let density = |r: &Receiver| tracer.lights.of_sun(r, i) as f32 / (TAU * height);
                weight(&density) * fluence(sun) / (TAU * height)
            } else {
                Vec3::ZERO
            }
        });
        sky + suns.sum::<Vec3>()
    }

    /// Light from one sampled light, weighted against BSDF sampling.
    fn sampled_light(&mut self, p: &Point, bsdf: &Bsdf, vertex: u32) -> Vec3 {
        let tracer = self.tracer;
        let u = fine(self.sampler.next(Purpose::LightChoice, vertex));
        let visited = &mut self.counters.traversal.nodes;
        let Some((light, probability)) = tracer.lights.choose(&receiver(p, bsdf), u, visited) else {
            return Vec3::ZERO;
        };
        let candidate = match light {
            Light::Patch(patch) => self.toward_patch(p, patch, probability, vertex),
            Light::Point(index) => toward_point(p, &tracer.frame.points[index], probability as f32),
            Light::Sun(index) => {
                let sun = &tracer.frame.suns[index];
                let height = cap_height(sun.angle_deg);
                let local = geometry::cap(self.sampler.next(Purpose::Sun, vertex), height);
                let probability = probability as f32;
                Some(Candidate {
                    direction: Basis::new(sun.direction).to_world(local),
                    target: None,
                    light: fluence(sun) / probability,
                    density: (height > 0.0).then_some(probability / (TAU * height)),
                })
            }
            Light::Sky => self.toward_sky(probability as f32, vertex),
        };
        let Some(candidate) = candidate else { return Vec3::ZERO };
        let wo = p.basis.to_local(candidate.direction);
        let (reflected, by_direction) = bsdf.light(p.wi, wo);
        let weight = candidate.density.map_or(1.0, |by_light| power(by_light, by_direction));
        let brought = reflected * candidate.light * weight;
        if brought.max_element() > 0.0 && brought.is_finite() {
            brought * self.shadow(p, candidate.direction, candidate.target)
        } else {
            Vec3::ZERO
        }
    }

    fn toward_patch(&mut self, p: &Point, patch: usize, chance: f64, vertex: u32) -> Option<Candidate> {
        let tracer = self.tracer;
        let emitters = &tracer.lights.emitters;
        let light = emitters.point(patch, self.sampler.next(Purpose::Light, vertex));
        let material = &tracer.materials[light.material as usize];
        let to = light.position - p.position;
        let distance2 = to.length_squared();
        let direction = to / distance2.sqrt();
        let cos = -direction.dot(light.normal);
        let cos_light = if material.emits_both_sides { cos.abs() } else { cos };
        let density = emitters.density(patch, chance, distance2, cos_light);
        // Written so that a light point on the surface itself (0/0) is rejected.
        if !(cos_light > 0.0 && density > 0.0 && density.is_finite()) {
            return None;
        }
        Some(Candidate {
            direction,
            target: Some(offset_origin(light.position, light.normal * cos.signum(), light.size)),
            light: self.emitted_at(&light) / density,
            density: Some(density),
        })
    }

    fn toward_sky(&mut self, probability: f32, vertex: u32) -> Option<Candidate> {
        let Sky::Image(image) = &self.tracer.sky else { return None };
        let [coarse, fine] = [Purpose::Sky, Purpose::Light].map(|purpose| self.sampler.next(purpose, vertex));
        let (direction, density) =
            image.sample(coarse.as_dvec2() + fine.as_dvec2() * DVec2::splat(LAST_BIT))?;
        let density = density * probability;
        let light = self.tracer.sky.radiance(direction) / density;
        Some(Candidate { direction, target: None, light, density: Some(density) })
    }
}

fn toward_point(p: &Point, light: &PointLight, probability: f32) -> Option<Candidate> {
    let to = light.position - p.position;
    let distance2 = to.length_squared();
    let direction = to / distance2.sqrt();
    let arriving = light.intensity * (falloff(light, direction) / distance2);
    let light_at = Some(light.position);
    arriving.is_finite().then_some(Candidate {
        direction,
        target: light_at,
        light: arriving / probability,
        density: None,
    })
}

/// The point as a receiver for light selection.
fn receiver(p: &Point, bsdf: &Bsdf) -> Receiver {
    if bsdf.spreads_through() { Receiver { normal: None, ..p.receiver() } } else { p.receiver() }
}

fn category(lobe: Lobe) -> Category {
    match lobe {
        Lobe::Diffuse => Category::Ambient,
        Lobe::Glossy => Category::Specular,
        Lobe::Reflection => Category::Reflected,
        Lobe::Refraction => Category::Refracted,
        Lobe::Straight => Category::Transparent,
    }
}

/// Weight of a sample with density `own` that another technique would choose with density `other`: the power
/// heuristic with exponent 2 (Veach 1997). The quotient's square overflows to the correct limit.
fn power(own: f32, other: f32) -> f32 {
    if own <= 0.0 {
        return 0.0;
    }
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}
