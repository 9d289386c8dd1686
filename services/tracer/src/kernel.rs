//! Kernels: the code that traces a frame, composed once from the effects that the frame needs.
//!
//! A kernel is a table of functions, which the integrators call. Traversals that test surfaces (cut-outs,
//! panes) are functions of their own, so they cost nothing where no surface needs a test. A kernel with more
//! effects than needed computes the same bits.

use crate::cache::{Irradiance, Keyed, PLAN_RAYS, Planned, Site, Strata};
use crate::cost::{Counters, add_rays};
use crate::effects::Effects;
use crate::integrator::{Ambient, Kernel, Light, Pixels};
use crate::lights::Looks;
use crate::pixel::{Feature, Pixel, Underway};
use crate::random::{Sampler, hash};
use crate::tracer::Tracer;
use forelight_bvh::Hit;
use forelight_protocol::Integrator;
use glam::Vec3;
use std::time::Instant;

/// Surfaces that let a part of the light pass a shadow ray.
const ATTENUATING: u32 =
    Effects::CUT_OUTS | Effects::OPACITY | Effects::THIN_GLASS | Effects::TRANSPARENT_SHADOWS;

/// Surfaces with more than the diffuse lobe.
const LOBES: u32 = Effects::GLOSSY | Effects::MIRROR | Effects::REFRACTION | Effects::THIN_GLASS;

impl Kernel {
    /// The kernel for a set of effects.
    pub fn new(effects: Effects, integrator: Integrator, looks: Looks) -> Self {
        let any = |bits| effects.bits() & bits != 0;
        let sky: Option<Light> = match effects.has(Effects::ENVIRONMENT) {
            true => Some(|pixels, p, response, vertex| pixels.sky(p, response, vertex)),
            false => None,
        };
        let cached = effects.has(Effects::CACHE);
        let ambient: Option<Ambient> = match effects.has(Effects::AMBIENT) {
            true if cached => Some(|pixels, s, p, response| pixels.interpolate(s, p, response)),
            true => Some(|pixels, s, p, response| pixels.gather(s, p, response)),
            false => None,
        };
        let kernel = Self {
            camera: match effects.has(Effects::DEPTH_OF_FIELD) {
                true => |pixels, x, y| pixels.through_lens(x, y),
                false => |pixels, x, y| pixels.through_pinhole(x, y),
            },
            lights: lights(effects, 0, looks),
            gathered_lights: lights(effects, 1, looks),
            sky,
            ambient,
            interface: match effects.has(Effects::NESTED_MEDIA) {
                true => |pixels, ray, hit, p| pixels.nested_interface(ray, hit, p),
                false => |pixels, ray, hit, p| pixels.plain_interface(ray, hit, p),
            },
            integrate: match integrator {
                Integrator::Ambient => |pixels, ray| pixels.ambient(ray),
                Integrator::Path => |pixels, ray| pixels.path(ray),
            },
            closest: match effects.has(Effects::CUT_OUTS) {
                true => Tracer::closest_present,
                false => Tracer::closest,
            },
            shadow: match any(ATTENUATING) {
                true => Tracer::shadow,
                false => Tracer::opaque_shadow,
            },
            several_lobes: any(LOBES),
            probe: None,
        };
        let probe = cached.then(|| Box::new(kernel.probe()));
        Self { probe, ..kernel }
    }

    fn probe(&self) -> Self {
        Self {
            lights: Vec::new(),
            gathered_lights: Vec::new(),
            sky: None,
            ambient: Some(|pixels, _, p, response| pixels.note(p, response)),
            ..self.clone()
        }
    }

    /// Adds camera samples to a pixel until it has `samples` of them. `seed` is that of its random numbers.
    fn trace<'a>(
        &'a self,
        tracer: &'a Tracer,
        (seed, index): (u64, u32),
        underway: &mut Underway,
        samples: u32,
        each: &mut dyn FnMut([f32; 3]),
    ) -> Pixels<'a> {
        let start = Instant::now();
        let settings = &tracer.settings;
        let (x, y) = (index % settings.width, index / settings.width);
        let sampler = Sampler::resumed(seed, tracer.frame.number, index, &underway.drawn);
        let mut pixels = Pixels::new(tracer, self, sampler);
        while underway.samples < samples {
            let sample = pixels.sample(x, y);
            each(sample.to_array());
            underway.add(sample);
            let known = &mut underway.pixel;
            known.coverage.add(pixels.met);
            if known.stratum == Pixel::NOTHING {
                known.stratum = pixels.met.unwrap_or(Pixel::NOTHING);
            }
        }
        let known = &mut underway.pixel;
        known.rays.iter_mut().zip(pixels.counters.rays).for_each(|(all, new)| *all += new);
        add_rays(&mut known.work_by_ray, &pixels.counters.work_by_ray());
        let work = pixels.counters.work_by_class();
        tracer.pixel_work.add(work);
        known.work += work.iter().sum::<u64>();
        known.extra_work += pixels.counters.extra_work;
        known.uncovered += pixels.counters.uncovered;
        known.cpu_nanos += start.elapsed().as_nanos() as u64;
        pixels
    }

    /// Traces one pixel by row-major index. `each` receives the radiance of every camera sample in order.
    pub fn pixel(&self, tracer: &Tracer, index: u32, each: &mut dyn FnMut([f32; 3])) -> Pixel {
        let mut underway = Underway::default();
        self.trace(tracer, (tracer.settings.seed, index), &mut underway, tracer.samples_of(index), each);
        underway.finished()
    }

    /// Traces one pixel by other random numbers than the image's.
    pub fn again(&self, tracer: &Tracer, index: u32, seed: u64, samples: u32) -> Pixel {
        let mut underway = Underway::default();
        self.trace(tracer, (seed, index), &mut underway, samples, &mut |_| ());
        underway.finished()
    }

    /// What the first `samples` camera samples of a pixel show, on average.
    pub fn feature(&self, tracer: &Tracer, index: u32, samples: u32) -> Feature {
        let settings = &tracer.settings;
        let sampler = Sampler::new(settings.seed, tracer.frame.number, index);
        let mut pixels = Pixels::new(tracer, self, sampler);
        let (x, y) = (index % settings.width, index / settings.width);
        let mut sum = Feature::default();
        for _ in 0..samples {
            let Feature { albedo, normal } = pixels.feature(x, y);
            sum = Feature { albedo: sum.albedo + albedo, normal: sum.normal + normal };
        }
        let count = samples.max(1) as f32;
        Feature { albedo: sum.albedo / count, normal: sum.normal / count }
    }

    /// Adds camera samples to a pixel until it has `samples`. `each` receives the radiance of each new one.
    pub fn go_on(
        &self,
        tracer: &Tracer,
        index: u32,
        underway: &mut Underway,
        samples: u32,
        each: &mut dyn FnMut([f32; 3]),
    ) {
        self.trace(tracer, (tracer.settings.seed, index), underway, samples, each)
            .note_drawn(&mut underway.drawn);
    }

    /// Sites at which the first `samples` camera samples of a pixel read the first level of the cache.
    pub fn sites(
        &self,
        tracer: &Tracer,
        pixel: u32,
        samples: u32,
        found: &mut Vec<Keyed>,
        counters: &mut Counters,
    ) {
        let settings = &tracer.settings;
        let sampler = Sampler::new(settings.seed, tracer.frame.number, pixel);
        let mut pixels = Pixels::new(tracer, self.probe.as_deref().unwrap_or(self), sampler);
        std::mem::swap(&mut pixels.counters, counters);
        for _ in 0..samples {
            pixels.sample(pixel % settings.width, pixel / settings.width);
        }
        let key = pixels.key();
        found.extend(pixels.sites.iter().zip(1..).map(|(site, n)| (hash(key ^ n), *site)));
        std::mem::swap(&mut pixels.counters, counters);
    }

    /// Finds the sites of level `level` that the plan rays of a record on the level before meet.
    pub fn sites_beyond(
        &self,
        tracer: &Tracer,
        strata: &Strata,
        level: u32,
        planned: &Planned,
    ) -> (Vec<Keyed>, Counters) {
        let sampler = Sampler::keyed(planned.key);
        let mut pixels = Pixels::new(tracer, self.probe.as_deref().unwrap_or(self), sampler);
        pixels.walk_gather(strata, level, planned);
        let key = hash(planned.key);
        let sites = pixels.sites.iter().zip(1..).map(|(site, n)| (hash(key ^ n), *site));
        (sites.collect(), pixels.counters)
    }

    /// Traces rays from a site. Returns each hit, and the direct light that it brings (radiance, mean over
    /// the channels). `key` is the random key of that light. Without `with_light`, it is 0.
    pub fn plan_rays(
        &self,
        tracer: &Tracer,
        site: &Site,
        key: u64,
        directions: &[Vec3; PLAN_RAYS],
        with_light: bool,
    ) -> ([(Option<Hit>, f32); PLAN_RAYS], Counters) {
        let mut pixels = Pixels::new(tracer, self, Sampler::keyed(hash(key)));
        let traced = directions.map(|direction| pixels.plan_ray(site, direction, with_light));
        (traced, pixels.counters)
    }

    /// Gathers the irradiance at a planned record of a level. `counts` is the number of rays of each
    /// stratum, 1 if absent.
    pub fn gather(
        &self,
        tracer: &Tracer,
        strata: &Strata,
        counts: Option<&[u16]>,
        level: u32,
        planned: &Planned,
    ) -> (Irradiance, Counters) {
        let mut pixels = Pixels::new(tracer, self, Sampler::keyed(planned.key));
        let irradiance = pixels.gather_record(strata, counts, level, planned);
        (irradiance, pixels.counters)
    }
}

/// The functions that sample lights at a point after `level` diffuse bounces.
fn lights(effects: Effects, level: u32, looks: Looks) -> Vec<Light> {
    let mut lights: Vec<Light> = Vec::new();
    match (looks.at(level), level) {
        (None, _) => {
            if effects.has(Effects::AREA_LIGHTS) {
                lights.push(|pixels, p, response, vertex| pixels.all_area_lights(p, response, vertex));
            }
            if effects.has(Effects::POINT_LIGHTS) {
                lights.push(|pixels, p, response, _| pixels.all_point_lights(p, response));
            }
        }
        (Some(_), 0) => lights.push(|pixels, p, response, vertex| pixels.some_lights(p, response, 0, vertex)),
        (Some(_), _) => lights.push(|pixels, p, response, vertex| pixels.some_lights(p, response, 1, vertex)),
    }
    if effects.has(Effects::SUN) {
        lights.push(|pixels, p, response, vertex| pixels.suns(p, response, vertex));
    }
    lights
}
