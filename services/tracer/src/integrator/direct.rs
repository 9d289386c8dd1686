//! Direct light: every light sampled from a surface, and what lies between.

use super::{Pixels, Point, cap_height, leaving};
use crate::cost::Category;
use crate::environment::Sky;
use crate::geometry::{self, Basis};
use crate::random::Purpose;
use crate::response::Response;
use forelight_bvh::offset_origin;
use forelight_scene::PointLight;
use glam::Vec3;

impl<const K: u32> Pixels<'_, K> {
    /// Light straight from the lights, the environment apart.
    pub(super) fn direct(&mut self, p: &Point, response: &Response, vertex: u32) -> Vec3 {
        let kernel = self.kernel;
        kernel.lights.iter().map(|light| light(self, p, response, vertex)).sum()
    }

    pub fn area_lights(&mut self, p: &Point, response: &Response, vertex: u32) -> Vec3 {
        let tracer = self.tracer;
        let count = tracer.luminaires.samples();
        if count == 0 {
            return Vec3::ZERO;
        }
        let near = |index: usize| response.has_diffuse() && tracer.luminaires.all[index].is_near(p.position);
        let mut sum = if (0..tracer.luminaires.all.len()).any(near) {
            self.near_lights(p, response, vertex, near)
        } else {
            Vec3::ZERO
        };
        let points = self.sampler.draw(Purpose::Light, vertex);
        let choices = self.sampler.draw(Purpose::LightChoice, vertex);
        for i in 0..count {
            let index = tracer.luminaires.choose(i, self.sampler.related(choices, i as u32).x);
            let luminaire = &tracer.luminaires.all[index];
            let light = luminaire.sample(&tracer.frame, self.sampler.related(points, index as u32));
            let to = light.position - p.position;
            let distance2 = to.length_squared();
            let direction = to / distance2.sqrt();
            let wo = p.basis.to_local(direction);
            let cos = -direction.dot(light.normal);
            let cos_light = if luminaire.both_sides { cos.abs() } else { cos };
            // Written so that a light point on the surface itself (0/0) is left out.
            if !(wo.z > 0.0 && cos_light > 0.0) {
                continue;
            }
            let (diffuse, glossy, by_lobe) = response.evaluate(p.wi, wo);
            let density = tracer.luminaires.density(index, distance2, cos_light);
            let by_cosine = if near(index) { wo.z * std::f32::consts::FRAC_1_PI } else { 0.0 };
            let reflected = diffuse / (density + by_cosine) + glossy / (density + by_lobe);
            if reflected.max_element() <= 0.0 {
                continue;
            }
            let emission = tracer.materials[luminaire.material as usize].emission;
            let target = offset_origin(light.position, light.normal * cos.signum());
            let passed = self.shadow(p, direction, Some(target));
            if passed != Vec3::ZERO {
                sum += passed * reflected * self.color(&emission, light.uv);
            }
        }
        sum
    }

    /// The diffuse lobe's share of the near lights: one cosine-weighted ray that looks for them, straight through panes.
    fn near_lights(
        &mut self,
        p: &Point,
        response: &Response,
        vertex: u32,
        near: impl Fn(usize) -> bool,
    ) -> Vec3 {
        let wo = geometry::cosine_hemisphere(self.sampler.next(Purpose::NearLight, vertex));
        if wo.z <= 0.0 {
            return Vec3::ZERO;
        }
        self.counters.ray(Category::Shadow);
        let tracer = self.tracer;
        let luminaires = &tracer.luminaires;
        let mut ray = leaving(p, p.basis.to_world(wo));
        let mut passed = response.diffuse(p.wi, wo);
        for _ in 0..tracer.settings.max_depth {
            let Some(hit) = self.closest(&ray) else { return Vec3::ZERO };
            let geometry = &tracer.frame.geometry;
            let stratum = geometry.triangle_stratum[hit.primitive as usize];
            if let Some(index) = luminaires.of_stratum(stratum).filter(|&i| near(i)) {
                let luminaire = &luminaires.all[index];
                let position = hit.position(geometry.corners(hit.primitive));
                let cos = -geometry.geometric_normal(hit.primitive).dot(ray.direction);
                let cos = if luminaire.both_sides { cos.abs() } else { cos };
                if cos > 0.0 {
                    let density = wo.z * std::f32::consts::FRAC_1_PI;
                    let by_light = luminaires.density(index, p.position.distance_squared(position), cos);
                    let emission = tracer.materials[luminaire.material as usize].emission;
                    let color = self.color(&emission, geometry.uv(hit.primitive, hit.u, hit.v));
                    return passed * color * (density / (density + by_light));
                }
            }
            let Some(share) = self.pass(&hit, ray.direction) else { return Vec3::ZERO };
            passed *= share;
            ray.origin = self.beyond(&hit, ray.direction);
        }
        Vec3::ZERO
    }

    pub fn point_lights(&mut self, p: &Point, response: &Response) -> Vec3 {
        let tracer = self.tracer;
        let mut sum = Vec3::ZERO;
        for light in &tracer.frame.points {
            let to = light.position - p.position;
            let distance2 = to.length_squared();
            let direction = to / distance2.sqrt();
            let wo = p.basis.to_local(direction);
            let cone = falloff(light, direction);
            if wo.z > 0.0 && cone > 0.0 {
                let (diffuse, glossy, _) = response.evaluate(p.wi, wo);
                let arriving = light.intensity * (cone / distance2);
                let reflected = (diffuse + glossy) * arriving;
                if reflected.max_element() > 0.0 {
                    sum += reflected * self.shadow(p, direction, Some(light.position));
                }
            }
        }
        sum
    }

    pub fn suns(&mut self, p: &Point, response: &Response, vertex: u32) -> Vec3 {
        let tracer = self.tracer;
        if tracer.frame.suns.is_empty() {
            return Vec3::ZERO;
        }
        let points = self.sampler.draw(Purpose::Sun, vertex);
        let mut sum = Vec3::ZERO;
        for (i, sun) in tracer.frame.suns.iter().enumerate() {
            let height = cap_height(sun.angle_deg);
            let local = geometry::cap(self.sampler.related(points, i as u32), height);
            let direction = Basis::new(sun.direction).to_world(local);
            let wo = p.basis.to_local(direction);
            if wo.z > 0.0 {
                let (diffuse, glossy, _) = response.evaluate(p.wi, wo);
                let reflected = (diffuse + glossy) * sun.irradiance;
                if reflected.max_element() > 0.0 {
                    sum += reflected * self.shadow(p, direction, None);
                }
            }
        }
        sum
    }

    /// Light from the environment on the diffuse lobe; the glossy lobe finds it by its own rays.
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

/// Share of a light's intensity that it sends against `direction` (unit, towards the light).
pub(super) fn falloff(light: &PointLight, direction: Vec3) -> f32 {
    light.cone.map_or(1.0, |(axis, inner, outer)| {
        let t = ((-direction.dot(axis) - outer) / (inner - outer)).clamp(0.0, 1.0);
        t * t // KHR_lights_punctual's recommended falloff
    })
}
