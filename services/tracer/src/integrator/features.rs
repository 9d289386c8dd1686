//! What camera rays show first, for denoisers: the colour and the normal of surfaces.

use super::{Pixels, Point, leaving};
use crate::fresnel;
use crate::microfacet as ggx;
use crate::pixel::Feature;
use crate::random::Purpose;
use forelight_scene::Surface;
use glam::Vec3;

/// Mirrors and panes after which a ray is not followed any further.
const MOST_FOLLOWED: u32 = 8;

impl Pixels<'_> {
    /// What one camera sample of the pixel at column `x` and row `y` shows: behind mirrors and panes, as far
    /// as they tint it. The camera rays are those of the image's samples.
    pub fn feature(&mut self, x: u32, y: u32) -> Feature {
        let mut ray = (self.kernel.camera)(self, x, y);
        let (mut passed, mut tint) = (None, Vec3::ONE);
        for vertex in 0..MOST_FOLLOWED {
            let Some(hit) = self.closest(&ray, passed) else {
                let albedo = (tint * self.tracer.sky.radiance(ray.direction)).min(Vec3::ONE);
                return Feature { albedo, normal: Vec3::ZERO };
            };
            let p = self.point(&ray, &hit);
            let material = &self.tracer.materials[p.material];
            if material.opacity < 1.0 && self.sampler.next(Purpose::Opacity, vertex).x >= material.opacity {
                passed = Some(p.passed());
                continue;
            }
            self.counters.shadings += 1;
            let color = match material.surface {
                Surface::Lambert { albedo } | Surface::Plastic { albedo, .. } => self.color(&albedo, p.uv),
                Surface::Metal { f0, alpha } if alpha < ggx::SMOOTH => {
                    tint *= fresnel::conductor(p.wi.z, self.color(&f0, p.uv));
                    (ray, passed) = (leaving(&p, ggx::reflect(p.viewer, p.basis.normal)), None);
                    continue;
                }
                Surface::Metal { f0, .. } => self.color(&f0, p.uv),
                Surface::ThinGlass { transmittance, .. } => {
                    tint *= self.color(&transmittance, p.uv);
                    passed = Some(p.passed());
                    continue;
                }
                Surface::Glass { .. } => Vec3::ONE,
            };
            let shown = color + self.shown_emission(&p);
            return Feature { albedo: (tint * shown).min(Vec3::ONE), normal: p.basis.normal };
        }
        Feature { albedo: tint.min(Vec3::ONE), normal: Vec3::ZERO }
    }

    /// Radiance that the surface emits towards the viewer.
    fn shown_emission(&mut self, p: &Point) -> Vec3 {
        let material = &self.tracer.materials[p.material];
        let is_shown =
            material.is_emissive() && (material.emits_both_sides || p.geometric.dot(p.viewer) > 0.0);
        let emission = material.emission;
        if is_shown { self.color(&emission, p.uv) } else { Vec3::ZERO }
    }
}
