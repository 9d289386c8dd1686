//! The code that traces a frame, put together once from the effects that the frame calls for.
//!
//! What decides inside the innermost loops (how rays are intersected, which lobes there are, whether colours are looked up) is
//! a constant parameter of the kernel: each of the 32 combinations is compiled for itself. What is called once a vertex or
//! less (camera, kinds of light, indirect light, integrator) is a function of the kernel, chosen or left out. A frame pays
//! for nothing that it does not hold; and since an effect that is forced on only meets data that it has nothing to do for,
//! a larger kernel computes the same bits.

use crate::Integrator;
use crate::cache::{Irradiance, Keyed, PLAN_RAYS, Planned, Site, Strata};
use crate::cost::{Counters, add_rays};
use crate::effects::Effects;
use crate::integrator::{Interface, Pixels, Point, Segment};
use crate::lights::Looks;
use crate::passes::Underway;
use crate::random::{Sampler, hash};
use crate::response::Response;
use crate::tracer::{Pixel, Tracer};
use forelight_bvh::{Hit, Ray};
use glam::Vec3;
use std::time::Instant;

/// Constant parameters of a kernel, as bits.
pub mod has {
    /// Rough reflections are followed.
    pub const GLOSSY: u32 = 1;
    /// Mirrors, panes and solid glass are followed.
    pub const SPECULAR: u32 = 1 << 1;
    /// Light passes some surfaces straight: panes, partial opacity.
    pub const PASSING: u32 = 1 << 2;
    /// Some surfaces are cut out by a texture: every hit has to be looked at.
    pub const CUT_OUTS: u32 = 1 << 3;
    /// Colours may come from images.
    pub const TEXTURES: u32 = 1 << 4;
}

/// Light that reaches a point from one kind of light; the last argument is the path's vertex.
pub type Light<const K: u32> = fn(&mut Pixels<'_, K>, &Point, &Response, u32) -> Vec3;

/// Indirect diffuse light at a point, without the lights that are sampled.
pub type Ambient<const K: u32> = fn(&mut Pixels<'_, K>, &Segment, &Point, &Response) -> Vec3;

/// What a ray meets at the face of a solid dielectric.
pub type AtInterface<const K: u32> = fn(&mut Pixels<'_, K>, &Ray, &Hit, &Point) -> Interface;

/// The functions of a frame's kernel.
#[derive(Clone)]
pub struct Kernel<const K: u32> {
    /// The ray of a camera sample of a pixel.
    pub camera: fn(&mut Pixels<'_, K>, u32, u32) -> Ray,
    /// Lights with a position or a direction, by kind, at points that the camera sees.
    pub lights: Vec<Light<K>>,
    /// The same at points that gathered rays meet.
    pub gathered_lights: Vec<Light<K>>,
    /// What surrounds the scene.
    pub sky: Option<Light<K>>,
    /// Indirect light.
    pub ambient: Option<Ambient<K>>,
    /// Solid dielectrics, alone or among others.
    pub interface: AtInterface<K>,
    /// Radiance along a camera ray.
    pub integrate: fn(&mut Pixels<'_, K>, Ray) -> Vec3,
    /// The same without light, for finding out where the cache will be read.
    pub probe: Option<Box<Kernel<K>>>,
}

/// A kernel, whatever its parameters.
pub trait Trace: Send + Sync {
    /// One finished pixel by its row-major index; `each` is told the radiance of every camera sample, in order.
    fn pixel(&self, tracer: &Tracer, index: u32, each: &mut dyn FnMut([f32; 3])) -> Pixel;

    /// A pixel that has some samples, brought to `samples` of them; `each` is told those that are new.
    fn go_on(
        &self,
        tracer: &Tracer,
        index: u32,
        underway: &mut Underway,
        samples: u32,
        each: &mut dyn FnMut([f32; 3]),
    );

    /// The places at which the first `samples` samples of a pixel read the first level of the cache.
    fn sites(
        &self,
        tracer: &Tracer,
        pixel: u32,
        samples: u32,
        found: &mut Vec<Keyed>,
        counters: &mut Counters,
    );

    /// The places of level `level` that the plan's rays of a record of the level before meet.
    fn sites_beyond(
        &self,
        tracer: &Tracer,
        strata: &Strata,
        level: u32,
        planned: &Planned,
    ) -> (Vec<Keyed>, Counters);

    /// What rays from a site meet.
    fn plan_rays(
        &self,
        tracer: &Tracer,
        site: &Site,
        directions: &[Vec3; PLAN_RAYS],
    ) -> ([Option<Hit>; PLAN_RAYS], Counters);

    /// What the hemisphere above a planned record of a level sends.
    fn gather(
        &self,
        tracer: &Tracer,
        strata: &Strata,
        level: u32,
        planned: &Planned,
    ) -> (Irradiance, Counters);
}

impl<const K: u32> Kernel<K> {
    /// Adds samples to a pixel, up to so many.
    fn trace<'a>(
        &'a self,
        tracer: &'a Tracer,
        index: u32,
        underway: &mut Underway,
        samples: u32,
        each: &mut dyn FnMut([f32; 3]),
    ) -> Pixels<'a, K> {
        let start = Instant::now();
        let settings = &tracer.settings;
        let (x, y) = (index % settings.width, index / settings.width);
        let sampler = Sampler::resumed(settings.seed, tracer.frame.number, index, &underway.drawn);
        let mut pixels = Pixels::new(tracer, self, sampler);
        let stratum = underway.pixel.stratum;
        pixels.stratum = (stratum != Pixel::NOTHING).then_some(stratum);
        while underway.samples < samples {
            let sample = pixels.sample(x, y);
            each(sample.to_array());
            underway.add(sample);
        }
        let known = &mut underway.pixel;
        known.rays.iter_mut().zip(pixels.counters.rays).for_each(|(all, new)| *all += new);
        add_rays(&mut known.work_by_ray, &pixels.counters.work_by_ray());
        let work = pixels.counters.work_by_class();
        tracer.pixel_work.add(work);
        known.work += work.iter().sum::<u64>();
        known.extra_work += pixels.counters.extra_work;
        known.uncovered += pixels.counters.uncovered;
        known.stratum = pixels.stratum.unwrap_or(Pixel::NOTHING);
        known.cpu_nanos += start.elapsed().as_nanos() as u64;
        pixels
    }

    fn new(effects: Effects, integrator: Integrator, looks: Looks) -> Self {
        let sky: Option<Light<K>> = match effects.has(Effects::ENVIRONMENT) {
            true => Some(|pixels, p, response, vertex| pixels.sky(p, response, vertex)),
            false => None,
        };
        let cached = effects.has(Effects::CACHE);
        let ambient: Option<Ambient<K>> = match effects.has(Effects::AMBIENT) {
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
}

/// The kinds of light that a point after `level` diffuse bounces looks at.
fn lights<const K: u32>(effects: Effects, level: u32, looks: Looks) -> Vec<Light<K>> {
    let mut lights: Vec<Light<K>> = Vec::new();
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

impl<const K: u32> Trace for Kernel<K> {
    fn pixel(&self, tracer: &Tracer, index: u32, each: &mut dyn FnMut([f32; 3])) -> Pixel {
        let mut underway = Underway::default();
        self.trace(tracer, index, &mut underway, tracer.samples_of(index), each);
        underway.finished()
    }

    fn go_on(
        &self,
        tracer: &Tracer,
        index: u32,
        underway: &mut Underway,
        samples: u32,
        each: &mut dyn FnMut([f32; 3]),
    ) {
        self.trace(tracer, index, underway, samples, each).note_drawn(&mut underway.drawn);
    }

    fn sites(
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

    fn sites_beyond(
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

    fn plan_rays(
        &self,
        tracer: &Tracer,
        site: &Site,
        directions: &[Vec3; PLAN_RAYS],
    ) -> ([Option<Hit>; PLAN_RAYS], Counters) {
        let mut pixels = Pixels::new(tracer, self, Sampler::keyed(0));
        let hits = directions.map(|direction| pixels.plan_ray(site, direction));
        (hits, pixels.counters)
    }

    fn gather(
        &self,
        tracer: &Tracer,
        strata: &Strata,
        level: u32,
        planned: &Planned,
    ) -> (Irradiance, Counters) {
        let mut pixels = Pixels::new(tracer, self, Sampler::keyed(planned.key));
        let irradiance = pixels.gather_record(strata, level, planned);
        (irradiance, pixels.counters)
    }
}

/// The kernel for these effects.
pub fn kernel(effects: Effects, integrator: Integrator, looks: Looks) -> Box<dyn Trace> {
    let parameters = [
        (has::GLOSSY, Effects::GLOSSY),
        (has::SPECULAR, Effects::MIRROR),
        (has::SPECULAR, Effects::REFRACTION),
        (has::SPECULAR | has::PASSING, Effects::THIN_GLASS),
        (has::PASSING, Effects::OPACITY),
        (has::PASSING, Effects::TRANSPARENT_SHADOWS),
        (has::CUT_OUTS, Effects::CUT_OUTS),
        (has::TEXTURES, Effects::TEXTURES),
    ];
    let wanted = parameters.iter().filter(|p| effects.has(p.1)).fold(0, |set, p| set | p.0);
    macro_rules! compiled {
        ($($k:literal)*) => {
            match wanted {
                $($k => Box::new(Kernel::<$k>::new(effects, integrator, looks)) as Box<dyn Trace>,)*
                _ => Box::new(Kernel::<31>::new(effects, integrator, looks)),
            }
        };
    }
    compiled!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30)
}
