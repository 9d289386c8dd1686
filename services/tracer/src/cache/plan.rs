//! Plan: chooses the records' positions and radii.
//!
//! A radius is the harmonic mean distance to the hits of a few rays (split-sphere model), and smaller where they
//! bring more light than usual. Radii from the occlusion Hessian (Schwarzhaupt et al. 2012) would need a complete
//! gather at every candidate. RMSE against the uncached image was measured, at equal numbers of records (192 × 192
//! pixels, 768 rays per record):
//!
//! | scene | split sphere | Hessian |
//! | --- | --- | --- |
//! | furnished hall | 0.96 % | 1.03 % |
//! | kitchen | 0.35 % | 0.35 % |
//! | empty box | 0.69 % | 0.48 % |

use super::coverage::Coverage;
use super::guide::mean_radiance;
use super::hemisphere::{PLAN_RAYS, RINGS, SECTORS, Strata};
use super::record::Planned;
use super::secondary::SecondaryLights;
use super::site::Keyed;
use super::survey::{Survey, Wanted};
use super::{Cache, Level};
use crate::CacheSettings;
use crate::bounds::Bounds;
use crate::cost::{Cost, Counters, Rays, add_rays, clocked};
use crate::geometry::Basis;
use crate::random::{Sampler, hash};
use crate::tracer::Tracer;
use forelight_scene::Camera;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::RangeInclusive;
use std::slice::Chunks;
use std::sync::OnceLock;

/// Number of pixels whose sites are found together. For deeper levels, the number of plan rays of the records whose
/// sites are.
const CHUNK: usize = 4096;

/// Number of pixels or sites that one thread processes at a time.
const TOGETHER: usize = 64;

/// Number of sites whose rays are traced at the same time. Rays are wasted for sites that turn out to be
/// covered by others of their batch. These are few, because successive sites are far apart.
const BATCH: usize = 32;

/// Coarsest spacing of the pixels that are visited.
const COARSEST: u32 = 32;

/// Approximate number of pixels from which the bounds of the radii are computed.
const PILOTS: u32 = 1024;

/// Most of their sites whose light is looked at.
const LIT_PILOTS: usize = 256;

/// Spacing of the densest records, in pixels of the planning view.
const SPACING: f32 = 1.5;

/// Above an allowed error of `FINE`, the densest records are spaced farther apart in proportion. Above
/// `COARSEST_SEEN`, the other records no longer change. Dense places would need most of the records and
/// contribute least. At an allowed error of 0.6 (192 × 192 pixels, 512 rays per record), compared with
/// relaxing all records:
///
/// | scene | records before | after | image RMSE before | after |
/// | --- | --- | --- | --- | --- |
/// | kitchen | 4,935 | 4,613 | 3.01 % | 2.97 % |
/// | empty box | 975 | 1,102 | 3.15 % | 2.14 % |
const FINE: f32 = 0.3;
const COARSEST_SEEN: f32 = 0.4;

/// Upper bounds of the radii: times the smallest radius, and as a fraction of the visible extent (as in
/// Radiance).
const LARGEST: f32 = 64.0;
const LARGEST_OF_VIEW: f32 = 0.2;

/// Each deeper level allows this many times the error of the one before, because gathers average out its errors. Above
/// `COARSE`, dozens of records would have to be looked at for one that covers a point.
const DEEPER: f32 = 2.0;
const COARSE: f32 = 0.4;

/// For the same reason, each level gathers with this many times fewer rays than the one before. (96 × 96
/// pixels, two bounces, rooms and kitchens: filling costs 20 to 30 % less, errors grow by 0 to 4 %.)
const FEWER: u32 = 4;

impl Cache {
    /// Plans the additional records that the tracer's image needs, on the current thread pool.
    pub fn plan(&mut self, tracer: &Tracer, settings: &CacheSettings) {
        if self.is_planned_for(tracer) {
            return;
        }
        self.images.push(tracer.fingerprint());
        let mut planning = Planning { tracer, plan: PlanCost::default() };
        if self.levels.is_empty() {
            self.fingerprint = tracer.cache_fingerprint();
            self.origin = tracer.origin();
            self.world = world(tracer);
        }
        // Also choose bounds again if an earlier view had no diffuse surface to derive them from.
        if self.levels.iter().all(|level| level.planned.is_empty()) {
            self.levels = planning.levels(settings);
        }
        for depth in 0..self.levels.len() {
            let (before, level) = self.levels.split_at_mut(depth);
            planning.cover(before.last(), depth as u32, &mut level[0], self.world);
        }
        for level in &mut self.levels {
            level.records.resize_with(level.planned.len(), OnceLock::new);
            level.known = level.known_values();
            level.smoothed = OnceLock::new();
            level.explored = level.planned.len();
        }
        self.plan += planning.plan.cost;
        add_rays(&mut self.plan_rays, &planning.plan.rays);
    }
}

/// Bounding box of a frame's vertices.
pub fn world(tracer: &Tracer) -> Bounds {
    Bounds::of(tracer.frame.geometry.positions.iter().copied())
}

struct Planning<'a> {
    tracer: &'a Tracer,
    plan: PlanCost,
}

#[derive(Default)]
struct PlanCost {
    cost: Cost,
    rays: Rays,
}

impl PlanCost {
    fn charge(&mut self, counters: &Counters, cpu_nanos: u64) {
        self.cost += Cost { work: counters.work(), cpu_nanos };
        add_rays(&mut self.rays, &counters.rays);
    }

    /// Charges for results that come with their counters and CPU times, in order.
    fn charged<T>(&mut self, results: Vec<((T, Counters), u64)>) -> Vec<T> {
        let charged = |((result, counters), nanos): ((T, Counters), u64)| {
            self.charge(&counters, nanos);
            result
        };
        results.into_iter().map(charged).collect()
    }

    fn add(&mut self, other: &Self) {
        self.cost += other.cost;
        add_rays(&mut self.rays, &other.rays);
    }
}

/// Sites that may need records, in order, and the cost of finding them.
#[derive(Default)]
struct Found {
    places: Vec<Keyed>,
    cost: PlanCost,
}

impl Found {
    /// Concatenates the results of all parts, on the current thread pool. Each part comes with its CPU time.
    fn of(parts: impl IndexedParallelIterator<Item = ((Vec<Keyed>, Counters), u64)>) -> Self {
        let mut cost = PlanCost::default();
        let places = cost.charged(parts.collect()).concat();
        Self { places, cost }
    }
}

/// The first diffuse hits of some pixels.
fn sites_of_pixels(tracer: &Tracer, pixels: &[u32]) -> Found {
    let sites_of = |pixels: &[u32]| {
        let (mut sites, mut counters) = (Vec::new(), Counters::default());
        for &pixel in pixels {
            tracer.kernel.sites(tracer, pixel, 1, &mut sites, &mut counters);
        }
        (sites, counters)
    };
    Found::of(pixels.par_chunks(TOGETHER).map(|pixels| clocked(|| sites_of(pixels))))
}

impl Planning<'_> {
    /// Empty levels for a new cache.
    fn levels(&mut self, settings: &CacheSettings) -> Vec<Level> {
        let accuracy = settings.accuracy as f32 * 1e-3;
        let seen = accuracy.min(COARSEST_SEEN);
        let spacing = SPACING * (accuracy / FINE).max(1.0);
        let pilots = self.pilots();
        let (smallest, largest) = bounds(&pilots, &self.tracer.frame.camera, spacing, seen).into_inner();
        let level = |depth: u32| {
            let deeper = DEEPER.powi(depth as i32);
            Level {
                strata: Strata::for_rays(settings.rays / FEWER.pow(depth)),
                is_first: depth == 0,
                accuracy: if depth == 0 { seen } else { (accuracy * deeper).min(COARSE) },
                smallest: (smallest * deeper).min(largest),
                largest,
                ..Level::default()
            }
        };
        let mut levels: Vec<Level> = (0..self.tracer.settings.ambient_bounces).map(level).collect();
        if let Some(first) = levels.first_mut() {
            first.brightness = self.brightness(pilots, first);
        }
        levels
    }

    /// Mean radiance of the plan's rays at some of the pilots' sites.
    fn brightness(&mut self, mut pilots: Vec<Keyed>, level: &Level) -> f32 {
        pilots.sort_unstable_by_key(|(key, _)| *key);
        pilots.truncate(LIT_PILOTS);
        mean_radiance(&self.planned(&pilots, level))
    }

    /// Plans records at sites, whether they are covered or not.
    fn planned(&mut self, places: &[Keyed], level: &Level) -> Vec<Planned> {
        let planned = |&place: &Keyed| clocked(|| plan_record(self.tracer, place, level));
        let planned = places.par_iter().map(planned).collect();
        self.plan.charged(planned)
    }

    /// The first diffuse hits of pixels at regular distances.
    fn pilots(&mut self) -> Vec<Keyed> {
        let camera = &self.tracer.frame.camera;
        let stride = (camera.pixels() as u32 / PILOTS).isqrt().max(1);
        let pilots: Vec<u32> = (stride / 2..camera.height)
            .step_by(stride as usize)
            .flat_map(|y| {
                let columns = (stride / 2..camera.width).step_by(stride as usize);
                columns.map(move |x| y * camera.width + x)
            })
            .collect();
        let Found { places, cost } = sites_of_pixels(self.tracer, &pilots);
        self.plan.add(&cost);
        places
    }

    /// Plans the missing records of a level.
    fn cover(&mut self, before: Option<&Level>, depth: u32, level: &mut Level, world: Bounds) {
        let (mut coverage, starting) = clocked(|| Coverage::of(level, world));
        match before {
            None => self.cover_pixels(&mut coverage),
            Some(before) => self.cover_gathers(before, depth, &mut coverage),
        }
        // The first plan decides. Filled records leave out what was chosen then.
        if level.is_first && level.explored == 0 {
            level.secondary = self.secondary_lights(level);
        }
        let ((), indexing) = clocked(|| {
            level.leave_out_secondary_lights(&self.tracer.frame.geometry);
            level.prepare(world);
            level.make_ready_to_gather();
        });
        self.plan.cost.cpu_nanos += starting + indexing;
    }

    /// The secondary lights that a level's rays, and further ones around bright places, show.
    fn secondary_lights(&mut self, level: &Level) -> SecondaryLights {
        let tracer = self.tracer;
        let geometry = &tracer.frame.geometry;
        // CPU time of this thread within `trace`: that is charged with the rays.
        let mut tracing = 0;
        let mut trace = |wanted: &[Wanted]| {
            let rays = |wanted: &Wanted| {
                let site = &level.planned[wanted.record as usize].site;
                clocked(|| tracer.kernel.plan_rays(tracer, site, wanted.key, &wanted.directions, true))
            };
            let (traced, nanos) = clocked(|| wanted.par_iter().map(rays).collect::<Vec<_>>());
            tracing += nanos;
            self.plan.charged(traced)
        };
        let (lights, nanos) = clocked(|| {
            let survey = Survey::of(&level.planned, level.brightness, geometry);
            survey.map_or_else(SecondaryLights::none, |survey| survey.lights(&mut trace))
        });
        self.plan.cost.cpu_nanos += nanos.saturating_sub(tracing);
        lights
    }

    /// Plans the first level, from the first diffuse hits of all pixels, coarse to fine. Within each stage
    /// the order is scattered, so that the sites of a batch are far apart.
    fn cover_pixels(&mut self, coverage: &mut Coverage) {
        let camera = &self.tracer.frame.camera;
        let mut stride = COARSEST;
        while stride > 0 {
            let coarser = |i: u32| i.is_multiple_of(2 * stride);
            let seen = |x: u32, y: u32| stride < COARSEST && coarser(x) && coarser(y);
            let mut pixels: Vec<u32> = (0..camera.height)
                .step_by(stride as usize)
                .flat_map(|y| {
                    let columns = (0..camera.width).step_by(stride as usize).filter(move |&x| !seen(x, y));
                    columns.map(move |x| y * camera.width + x)
                })
                .collect();
            pixels.sort_by_cached_key(|&pixel| hash(u64::from(pixel)));
            let tracer = self.tracer;
            self.cover_in_turn(coverage, pixels.chunks(CHUNK), |chunk| sites_of_pixels(tracer, chunk));
            stride /= 2;
        }
    }

    /// Plans a deeper level, from the diffuse hits of the plan rays of the previous level's new records.
    fn cover_gathers(&mut self, before: &Level, depth: u32, coverage: &mut Coverage) {
        let (explored, strata, before) = (before.explored as u32, before.strata, &before.planned);
        let mut order: Vec<u32> = (explored..before.len() as u32).collect();
        order.sort_by_cached_key(|&index| hash(u64::from(index)));
        let tracer = self.tracer;
        let beyond =
            |&index: &u32| tracer.kernel.sites_beyond(tracer, &strata, depth, &before[index as usize]);
        self.cover_in_turn(coverage, order.chunks(CHUNK / PLAN_RAYS), |chunk| {
            Found::of(chunk.par_iter().map(|index| clocked(|| beyond(index))))
        });
    }

    /// Applies the insertion rule to each list in sequence. Insertion is mostly single-threaded, so the next
    /// list's sites are found meanwhile.
    fn cover_in_turn(
        &mut self,
        coverage: &mut Coverage,
        mut lists: Chunks<u32>,
        find: impl Fn(&[u32]) -> Found + Sync,
    ) {
        let mut found = lists.next().map(&find);
        while let Some(Found { places, cost }) = found {
            self.plan.add(&cost);
            let next = lists.next();
            ((), found) = rayon::join(|| self.insert_all(coverage, &places), || next.map(&find));
        }
    }

    /// Applies the insertion rule to sites, in order.
    fn insert_all(&mut self, coverage: &mut Coverage, places: &[Keyed]) {
        let open_of = |coverage: &Coverage, places: &[Keyed]| -> Vec<Keyed> {
            places.iter().copied().filter(|(_, site)| !coverage.covers(site)).collect()
        };
        let open = places.par_chunks(TOGETHER).map(|places| clocked(|| open_of(coverage, places)));
        let (open, nanos): (Vec<Vec<Keyed>>, Vec<u64>) = open.unzip();
        self.plan.cost.cpu_nanos += nanos.into_iter().sum::<u64>();
        let open = open.concat();
        let mut rest = open.as_slice();
        let mut batch = Vec::with_capacity(BATCH);
        while !rest.is_empty() {
            batch.clear();
            let ((), choosing) = clocked(|| {
                while let Some((first, others)) = rest.split_first()
                    && batch.len() < BATCH
                {
                    rest = others;
                    if !coverage.covers(&first.1) {
                        batch.push(*first);
                    }
                }
            });
            let planned = self.planned(&batch, coverage.level());
            let ((), entering) = clocked(|| {
                for planned in planned {
                    if !coverage.covers(&planned.site) {
                        coverage.insert(planned);
                    }
                }
            });
            self.plan.cost.cpu_nanos += choosing + entering;
        }
    }
}

/// Bounds of the radii in metres: world-space lengths, valid for any view. At the smallest radius and the allowed
/// error `accuracy`, records are `spacing` pixels apart at the median distance of the pilots' sites.
fn bounds(pilots: &[Keyed], camera: &Camera, spacing: f32, accuracy: f32) -> RangeInclusive<f32> {
    let mut distances: Vec<f32> =
        pilots.iter().map(|(_, site)| site.position.distance(camera.origin)).collect();
    distances.sort_unstable_by(f32::total_cmp);
    let Some(&median) = distances.get(distances.len() / 2) else { return 0.0..=0.0 };
    let extent = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| {
        let mut along: Vec<f32> = pilots.iter().map(|(_, site)| site.position.dot(axis)).collect();
        along.sort_unstable_by(f32::total_cmp);
        let cut = along.len() / 50;
        along[along.len() - 1 - cut] - along[cut]
    });
    let pixel = 2.0 * camera.tan_half_x / camera.width as f32;
    let smallest = spacing * pixel * median / accuracy;
    let largest = (LARGEST * smallest).min(LARGEST_OF_VIEW * Vec3::from(extent).length()).max(smallest);
    smallest..=largest
}

/// Plans a record at a site: traces the plan's rays and computes the radius.
fn plan_record(tracer: &Tracer, (key, site): Keyed, level: &Level) -> (Planned, Counters) {
    let basis = Basis::new(site.normal);
    let sampler = Sampler::keyed(key);
    let side = if site.geometric.dot(site.normal) < 0.0 { -site.geometric } else { site.geometric };
    let locals: [Vec3; PLAN_RAYS] =
        std::array::from_fn(|ray| level.strata.direction(level.strata.of_plan(ray), 0, &sampler));
    let directions = locals.map(|local| basis.to_world(local));
    let (traced, counters) = tracer.kernel.plan_rays(tracer, &site, key, &directions, level.is_first);
    let (hits, lit) = (traced.map(|(hit, _)| hit), traced.map(|(_, lit)| lit));
    let mut inverse = 0.0f64;
    let mut corral = [f32::INFINITY; SECTORS];
    for (ray, hit) in hits.iter().enumerate().filter_map(|(ray, hit)| Some((ray, hit.as_ref()?))) {
        // A bent shading normal may send rays below the surface. They say nothing about the surroundings.
        if directions[ray].dot(side) > 0.0 {
            inverse += 1.0 / f64::from(hit.t.max(level.smallest * 1e-3));
            if ray / SECTORS == RINGS - 1 {
                corral[ray % SECTORS] = hit.t * locals[ray].truncate().length();
            }
        }
    }
    let harmonic = if inverse > 0.0 { (PLAN_RAYS as f64 / inverse) as f32 } else { f32::INFINITY };
    let radius = (harmonic.min(level.largest) * closer(&lit, level.brightness)).max(level.smallest);
    (Planned { key, site, radius, corral, hits: Box::new(hits), lit: Box::new(lit) }, counters)
}

/// Factor of a radius where the mean radiance is above the `usual` one: errors there are a larger share of the
/// image. If an error is E · r, and there are 1 / r² records, then the sum of the squared errors for a number of
/// records is least with r ~ E^−½. (128 × 128 pixels, default settings: in veach-ajar the error falls from 6.5 to
/// 4.6 % for 1.27 times the work. In six plainer scenes both change by less than 5 %.)
fn closer(lit: &[f32; PLAN_RAYS], usual: f32) -> f32 {
    let mean = lit.iter().sum::<f32>() / PLAN_RAYS as f32;
    if mean > usual && usual > 0.0 { (usual / mean).sqrt() } else { 1.0 }
}
