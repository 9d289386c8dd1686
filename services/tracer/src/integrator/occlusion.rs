//! Shadow rays: how much light passes between a point and a light. Panes and partial opacity attenuate it.

use super::queries::Shadow;
use super::{Passed, Pixels, Point, leaving};
use crate::cost::Category;
use crate::fresnel;
use forelight_bvh::{Hit, Ray};
use forelight_scene::Surface;
use glam::Vec3;

impl Pixels<'_> {
    /// Fraction of light that reaches the point from `target`, or from infinity along `direction`.
    pub(super) fn shadow(&mut self, p: &Point, direction: Vec3, target: Option<Vec3>) -> Vec3 {
        self.counters.ray(Category::Shadow);
        let mut ray = leaving(p, direction);
        if let Some(target) = target {
            ray.direction = target - ray.origin;
            ray.t_max = 1.0;
        }
        match (self.kernel.shadow)(self.tracer, &ray, &mut self.counters) {
            Shadow::Blocked => Vec3::ZERO,
            Shadow::Clear => Vec3::ONE,
            Shadow::Attenuated => self.transmission(ray),
        }
    }

    /// Product of the transmittances of all surfaces along an unblocked shadow ray.
    fn transmission(&mut self, ray: Ray) -> Vec3 {
        let tracer = self.tracer;
        let direction = ray.direction.normalize();
        let (mut share, mut passed) = (Vec3::ONE, None);
        for _ in 0..tracer.settings.max_depth {
            let Some(hit) = self.closest(&ray, passed) else { return share };
            match self.pass(&hit, direction) {
                Some(part) => share *= part,
                None => return Vec3::ZERO,
            }
            passed = Some(Passed::from(&hit));
        }
        Vec3::ZERO
    }

    /// Fraction of light along `direction` (unit) that passes straight. `None` if all is blocked.
    pub(super) fn pass(&mut self, hit: &Hit, direction: Vec3) -> Option<Vec3> {
        let tracer = self.tracer;
        let geometry = &tracer.frame.geometry;
        let material = &tracer.materials[geometry.material(hit.primitive) as usize];
        let share = match material.surface {
            Surface::ThinGlass { ior, transmittance } => {
                let cos = geometry.geometric_normal(hit.primitive).dot(direction).abs();
                let color = self.color(&transmittance, geometry.uv(hit.primitive, hit.u, hit.v));
                let pane = (1.0 - fresnel::pane(cos, ior)) * color;
                pane * material.opacity + (1.0 - material.opacity)
            }
            _ if material.opacity < 1.0 => Vec3::splat(1.0 - material.opacity),
            _ => return None,
        };
        self.counters.ray(Category::Transparent);
        Some(share)
    }
}
