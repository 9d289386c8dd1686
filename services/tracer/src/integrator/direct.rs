//! Direct light: samples lights from a surface point. Lights near a diffuse surface are sampled by points and
//! by directions, combined by multiple importance sampling.

use super::{Passed, Pixels, Point, cap_height, fluence, leaving};
use crate::cost::Category;
use crate::environment::Sky;
use crate::geometry::{self, Basis};
use crate::lights::{Choice, Emitter, LightPoint, MOST_LOOKS, Receiver};
use crate::random::Purpose;
use crate::response::Response;
use forelight_bvh::{Hit, offset_origin};
use forelight_scene::{Material, PointLight};
use glam::{Vec2, Vec3};
use std::cell::Cell;

impl Pixels<'_> {
    /// Direct light, without the environment, at a point after `level` diffuse bounces.
    pub(super) fn direct(&mut self, p: &Point, response: &Response, level: u32, vertex: u32) -> Vec3 {
        let kernel = self.kernel;
        let lights = if level == 0 { &kernel.lights } else { &kernel.gathered_lights };
        lights.iter().map(|light| light(self, p, response, vertex)).sum()
    }

    /// Light from all area lights. Samples one point of each.
    pub fn all_area_lights(&mut self, p: &Point, response: &Response, vertex: u32) -> Vec3 {
        let tracer = self.tracer;
        let luminaires = &tracer.luminaires;
        let near = |index: usize| response.has_diffuse() && luminaires.all[index].is_near(p.position);
        let mut sum = if (0..luminaires.reaching()).any(near) {
            self.near_lights(p, response, vertex, |_, hit, distance2, cos| {
                let stratum = tracer.frame.geometry.triangle_stratum[hit.primitive as usize];
                let index = luminaires.of_stratum(stratum).filter(|&index| near(index))?;
                Some(luminaires.density(index, distance2, cos))
            })
        } else {
            Vec3::ZERO
        };
        let points = self.sampler.draw(Purpose::Light, vertex);
        for (index, luminaire) in luminaires.all.iter().enumerate() {
            let light = luminaire.sample(self.sampler.related(points, luminaire.stratum));
            let density = |distance2, cos| luminaires.density(index, distance2, cos);
            sum += self.triangle_light(p, response, &light, near(index), density);
        }
        sum
    }

    /// Light from some of the lights with a position. Their number depends on `level`, the diffuse bounces.
    pub fn some_lights(&mut self, p: &Point, response: &Response, level: u32, vertex: u32) -> Vec3 {
        let tracer = self.tracer;
        let Some(looks) = tracer.looks.at(level) else { return Vec3::ZERO };
        let emitters = &tracer.lights.emitters;
        let receiver = p.receiver();
        let mut sum = if response.has_diffuse() && emitters.any_near(p.position) {
            self.near_lights(p, response, vertex, |this, hit, distance2, cos| {
                let emitter = emitters.of_triangle(hit.primitive)?;
                let near = emitters.is_near(emitter, p.position);
                near.then(|| this.density_of_choice(&receiver, emitter, looks, distance2, cos))
            })
        } else {
            Vec3::ZERO
        };
        let points = self.sampler.draw(Purpose::Light, vertex);
        let fine_choices = self.sampler.draw(Purpose::LightChoice, vertex);
        let few = emitters.are_few();
        let mut places = [Vec2::ZERO; MOST_LOOKS];
        let mut choices = [Choice::default(); MOST_LOOKS];
        let choices = &mut choices[..looks as usize];
        for (i, (place, choice)) in (0..).zip(places.iter_mut().zip(&mut *choices)) {
            *place = self.sampler.related(points, i);
            let u = if few { place.x.into() } else { fine(self.sampler.related(fine_choices, i)) };
            // Stratify: one choice in each part of the unit interval.
            *choice = Choice::by((f64::from(i) + u) / f64::from(looks));
        }
        emitters.choose(&receiver, choices, &mut self.counters.traversal.nodes);
        for (place, choice) in places.into_iter().zip(choices) {
            let Some(emitter) = emitters.chosen(choice) else { continue };
            let expected = choice.probability * f64::from(looks);
            sum += match emitter {
                Emitter::Patch(emitter) => {
                    let place = if few { place.with_x(choice.number as f32) } else { place };
                    let light = emitters.point(emitter, place);
                    let near = response.has_diffuse() && emitters.is_near(emitter, p.position);
                    let density = |distance2, cos| emitters.density(emitter, expected, distance2, cos);
                    self.triangle_light(p, response, &light, near, density)
                }
                Emitter::Point(index) => self.point_light(p, response, index) / expected as f32,
            };
        }
        sum
    }

    /// Density per steradian of [`Self::some_lights`], all choices together, for an emitting patch seen at
    /// `cos`.
    fn density_of_choice(
        &mut self,
        receiver: &Receiver,
        emitter: usize,
        looks: u32,
        distance2: f32,
        cos: f32,
    ) -> f32 {
        let emitters = &self.tracer.lights.emitters;
        let probability = emitters.probability(receiver, emitter, &mut self.counters.traversal.nodes);
        emitters.density(emitter, probability * f64::from(looks), distance2, cos)
    }

    /// Density per steradian with which light sampling chooses a direction, at a receiver after `level`
    /// diffuse bounces. The light leaves at an angle of cosine `cos`, at the squared distance `distance2`.
    /// `None` for triangles that light sampling does not choose.
    pub(super) fn density_of_lights(
        &mut self,
        receiver: &Receiver,
        level: u32,
        triangle: u32,
        distance2: f32,
        cos: f32,
    ) -> Option<f32> {
        let tracer = self.tracer;
        if let Some(looks) = tracer.looks.at(level) {
            let emitter = tracer.lights.emitters.of_triangle(triangle)?;
            return Some(self.density_of_choice(receiver, emitter, looks, distance2, cos));
        }
        let stratum = tracer.frame.geometry.triangle_stratum[triangle as usize];
        let index = tracer.luminaires.of_stratum(stratum)?;
        Some(tracer.luminaires.density(index, distance2, cos))
    }

    /// Light from a sampled point of an emitting triangle. `density` gives the density per steradian of the
    /// choice, from squared distance and cosine. For a near light, the diffuse lobe's part is weighted
    /// against [`Self::near_lights`].
    fn triangle_light(
        &mut self,
        p: &Point,
        response: &Response,
        light: &LightPoint,
        near: bool,
        density: impl Fn(f32, f32) -> f32,
    ) -> Vec3 {
        let to = light.position - p.position;
        let distance2 = to.length_squared();
        let direction = to / distance2.sqrt();
        let wo = p.basis.to_local(direction);
        let cos = -direction.dot(light.normal);
        let cos_light = if self.emitter(light).emits_both_sides { cos.abs() } else { cos };
        // Written so that a light point on the surface itself (0/0) is rejected.
        if !(wo.z > 0.0 && cos_light > 0.0) {
            return Vec3::ZERO;
        }
        let (diffuse, glossy, by_lobe) = response.evaluate(p.wi, wo);
        let density = density(distance2, cos_light);
        let by_cosine = if near { wo.z * std::f32::consts::FRAC_1_PI } else { 0.0 };
        let reflected = diffuse / (density + by_cosine) + glossy / (density + by_lobe);
        if reflected.max_element() <= 0.0 {
            return Vec3::ZERO;
        }
        let target = offset_origin(light.position, light.normal * cos.signum(), light.size);
        let passed = self.shadow(p, direction, Some(target));
        if passed == Vec3::ZERO { Vec3::ZERO } else { passed * reflected * self.emitted_at(light) }
    }

    fn emitter(&self, light: &LightPoint) -> &Material {
        &self.tracer.materials[light.material as usize]
    }

    /// Radiance emitted at a point of an emitting triangle. Accounts for opacity and cut-outs.
    pub(super) fn emitted_at(&mut self, light: &LightPoint) -> Vec3 {
        let texels = Cell::new(0);
        let present = self.tracer.present(&light.hit, &texels);
        self.counters.texels += texels.get();
        if !present {
            return Vec3::ZERO;
        }
        let (emission, opacity) = (self.emitter(light).emission, self.emitter(light).opacity);
        let Hit { primitive, u, v, .. } = light.hit;
        opacity * self.color(&emission, self.tracer.frame.geometry.uv(primitive, u, v))
    }

    /// The diffuse lobe's part of the near lights: one cosine-weighted ray, straight through panes.
    /// `by_light` returns the density per steradian of light sampling for a hit, `None` if that is not on a
    /// near light.
    fn near_lights(
        &mut self,
        p: &Point,
        response: &Response,
        vertex: u32,
        by_light: impl Fn(&mut Self, &Hit, f32, f32) -> Option<f32>,
    ) -> Vec3 {
        let wo = geometry::cosine_hemisphere(self.sampler.next(Purpose::NearLight, vertex));
        if wo.z <= 0.0 {
            return Vec3::ZERO;
        }
        self.counters.ray(Category::Shadow);
        let tracer = self.tracer;
        let geometry = &tracer.frame.geometry;
        let density = wo.z * std::f32::consts::FRAC_1_PI;
        let ray = leaving(p, p.basis.to_world(wo));
        let mut met = None;
        let mut passed = response.diffuse(p.wi, wo);
        let mut sum = Vec3::ZERO;
        for _ in 0..tracer.settings.max_depth {
            let Some(hit) = self.closest(&ray, met) else { break };
            let material = &tracer.materials[geometry.material(hit.primitive) as usize];
            if material.is_emissive() {
                let cos = -geometry.geometric_normal(hit.primitive).dot(ray.direction);
                let cos = if material.emits_both_sides { cos.abs() } else { cos };
                let distance2 = p.position.distance_squared(hit.position(geometry.corners(hit.primitive)));
                if cos > 0.0
                    && let Some(by_light) = by_light(self, &hit, distance2, cos)
                {
                    let (emission, opacity) = (material.emission, material.opacity);
                    let color = self.color(&emission, geometry.uv(hit.primitive, hit.u, hit.v));
                    sum += passed * color * (opacity * density / (density + by_light));
                }
            }
            let Some(share) = self.pass(&hit, ray.direction) else { break };
            passed *= share;
            met = Some(Passed::from(&hit));
        }
        sum
    }

    /// Light from all point lights.
    pub fn all_point_lights(&mut self, p: &Point, response: &Response) -> Vec3 {
        self.tracer.points.iter().map(|&index| self.point_light(p, response, index)).sum()
    }

    fn point_light(&mut self, p: &Point, response: &Response, index: usize) -> Vec3 {
        let light = &self.tracer.frame.points[index];
        let to = light.position - p.position;
        let distance2 = to.length_squared();
        let direction = to / distance2.sqrt();
        let wo = p.basis.to_local(direction);
        let cone = falloff(light, direction);
        if !(wo.z > 0.0 && cone > 0.0) {
            return Vec3::ZERO;
        }
        let (diffuse, glossy, _) = response.evaluate(p.wi, wo);
        let reflected = (diffuse + glossy) * (light.intensity * (cone / distance2));
        if reflected.max_element() > 0.0 {
            reflected * self.shadow(p, direction, Some(light.position))
        } else {
            Vec3::ZERO
        }
    }

    pub fn suns(&mut self, p: &Point, response: &Response, vertex: u32) -> Vec3 {
        let tracer = self.tracer;
        let points = self.sampler.draw(Purpose::Sun, vertex);
        let mut sum = Vec3::ZERO;
        for &i in &tracer.suns {
            let sun = &tracer.frame.suns[i];
            let height = cap_height(sun.angle_deg);
            let local = geometry::cap(self.sampler.related(points, i as u32), height);
            let direction = Basis::new(sun.direction).to_world(local);
            let wo = p.basis.to_local(direction);
            if wo.z > 0.0 {
                let (diffuse, glossy, _) = response.evaluate(p.wi, wo);
                let reflected = (diffuse + glossy) * fluence(sun);
                if reflected.max_element() > 0.0 {
                    sum += reflected * self.shadow(p, direction, None);
                }
            }
        }
        sum
    }

    /// Light from the environment on the diffuse lobe. The glossy lobe finds it with its own rays.
    pub fn sky(&mut self, p: &Point, response: &Response, vertex: u32) -> Vec3 {
        let tracer = self.tracer;
        if tracer.sky.is_black() {
            return Vec3::ZERO;
        }
        let u = self.sampler.next(Purpose::Sky, vertex);
        let (direction, wo, value) = match &tracer.sky {
            Sky::Black => return Vec3::ZERO,
            Sky::Constant(radiance) => {
                let wo = geometry::cosine_hemisphere(u);
                (p.basis.to_world(wo), wo, response.diffuse(p.wi, wo) * *radiance)
            }
            Sky::Image(image) => {
                let Some((direction, density)) = image.sample(u.as_dvec2()) else { return Vec3::ZERO };
                let wo = p.basis.to_local(direction);
                let cos = wo.z.max(0.0) / (std::f32::consts::PI * density);
                (direction, wo, response.diffuse(p.wi, wo) * tracer.sky.radiance(direction) * cos)
            }
        };
        if wo.z > 0.0 && value.max_element() > 0.0 {
            value * self.shadow(p, direction, None)
        } else {
            Vec3::ZERO
        }
    }
}

/// A random number with 48 bits, combined from two with 24 bits. 24 bits are too few for a choice among many.
pub(super) fn fine(u: Vec2) -> f64 {
    f64::from(u.x) + f64::from(u.y) * LAST_BIT
}

/// Weight of the last bit of the sampler's numbers.
pub(super) const LAST_BIT: f64 = 1.0 / (1 << 24) as f64;

/// Fraction of a spot light's intensity that arrives from `direction` (unit, towards the light).
pub(super) fn falloff(light: &PointLight, direction: Vec3) -> f32 {
    light.cone.map_or(1.0, |(axis, inner, outer)| {
        let cosine = -direction.dot(axis);
        if inner > outer {
            let t = ((cosine - outer) / (inner - outer)).clamp(0.0, 1.0);
            t * t // the falloff that KHR_lights_punctual recommends
        } else if cosine >= outer {
            1.0
        } else {
            0.0
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cone_with_equal_angles_has_a_sharp_edge() {
        let light = |inner, outer| PointLight {
            position: Vec3::ZERO,
            intensity: Vec3::ONE,
            cone: Some((Vec3::X, inner, outer)),
        };
        let towards = |cosine: f32| Vec3::new(-cosine, (1.0 - cosine * cosine).sqrt(), 0.0);
        let sharp = light(0.5, 0.5);
        for (cosine, expected) in [(1.0, 1.0), (0.6, 1.0), (0.5, 1.0), (0.499, 0.0), (-1.0, 0.0)] {
            assert_eq!(falloff(&sharp, towards(cosine)), expected, "{cosine}");
        }
        let soft = light(0.75, 0.5);
        for (cosine, expected) in [(0.8, 1.0), (0.75, 1.0), (0.625, 0.25), (0.5, 0.0), (0.4, 0.0)] {
            assert_eq!(falloff(&soft, towards(cosine)), expected, "{cosine}");
        }
    }
}
