//! Survey: where the light of the first bounce comes from, to choose the secondary lights.
//!
//! The plan's rays tell whether much of the light comes by way of small places. They are too few to tell their
//! extent: the inside of a lamp shade fills a thousandth of the view. So records that see a bright place send
//! further rays: first around it, then into every cell that may be bright.

use super::hemisphere::PLAN_RAYS;
use super::record::Planned;
use super::secondary::{Cell, MOST_CELLS, MOST_CUTS, PARTS, SecondaryLight, SecondaryLights, is_behind};
use crate::geometry::triangle;
use crate::random::{Sampler, hash};
use forelight_bvh::Hit;
use forelight_scene::Geometry;
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};
use std::mem::take;
use std::ops::Range;

/// A place is bright if its radiance is above this multiple of the mean.
const BRIGHT: f32 = 8.0;

/// Smallest share of the light that bright places must bring together.
const LEAST_SHARE: f64 = 0.2;

/// Edge of the cells that are explored, as a fraction of the median distance from which bright hits are seen.
const EDGE: f32 = 0.125;

/// Rays of an exploration go to within this multiple of the edge.
const AROUND: f32 = 1.5;

/// How often rays are sent around the bright places that are known.
const EXPLORATIONS: usize = 2;

/// The edge of the lights is halved at most so often, while their number stays below [`ENOUGH`].
const HALVINGS: usize = 3;
const ENOUGH: usize = 96;

/// Least radiance that a part of a light is taken to have, as a fraction of what a bright ray brings that is in the
/// light, or else in one beside it. Its rays may have missed what is lit.
const DARK: f32 = 0.2;
const DARK_BESIDE: f32 = 0.05;

/// Least share of the points that see a light. A triangle's share is that of the plan's rays that meet its lights,
/// among those that would if nothing were between.
const LEAST_SEEN: f32 = 0.05;

/// A ray: the record that sent it, its hit, and the radiance that it brings.
type Seen = (u32, Hit, f32);

/// Rays, and what they show.
pub struct Survey<'a> {
    planned: &'a [Planned],
    geometry: &'a Geometry,
    /// A ray is bright if it brings more than this radiance.
    bright: f32,
    /// Light of all rays of the plan.
    all: f64,
    /// Edge of the cells, metres.
    edge: f32,
    /// Those of the plan come first.
    rays: Vec<Seen>,
    of_plan: usize,
    explored: BTreeSet<Cell>,
}

/// What is known of a cell.
#[derive(Default)]
struct Known {
    count: u32,
    sum: f64,
    /// Light of the plan's rays.
    planned: f64,
    /// The nearest bright ray.
    nearest: Option<Seen>,
}

impl Known {
    fn radiance(&self) -> f32 {
        (self.sum / f64::from(self.count.max(1))) as f32
    }
}

/// Rays that a record is to send around a bright place.
pub struct Wanted {
    pub record: u32,
    /// Key of the random numbers of their light.
    pub key: u64,
    pub directions: [Vec3; PLAN_RAYS],
}

/// Each hit of a record's rays, and the radiance that it brings.
pub type Traced = [(Option<Hit>, f32); PLAN_RAYS];

impl<'a> Survey<'a> {
    /// The survey by the rays of planned records, whose mean radiance is `mean`. `None` if not much of the light
    /// comes from bright places.
    pub fn of(planned: &'a [Planned], mean: f32, geometry: &'a Geometry) -> Option<Self> {
        let bright = BRIGHT * mean;
        let all: f64 = planned.iter().flat_map(|planned| &*planned.lit).map(|&lit| f64::from(lit)).sum();
        let seen = (0..).zip(planned).flat_map(|(record, planned)| {
            let hits = planned.hits.iter().zip(&*planned.lit);
            hits.filter_map(move |(hit, &lit)| Some((record, (*hit)?, lit)))
        });
        let are_bright = seen.clone().filter(|(_, _, lit)| *lit > bright);
        let (mut distances, mut light) = (Vec::new(), 0.0);
        for (_, hit, lit) in are_bright {
            distances.push(hit.t);
            light += f64::from(lit);
        }
        if distances.is_empty() || light < LEAST_SHARE * all {
            return None;
        }
        let middle = distances.len() / 2;
        let edge = EDGE * *distances.select_nth_unstable_by(middle, f32::total_cmp).1;
        let rays: Vec<Seen> = seen.collect();
        let of_plan = rays.len();
        Some(Self { planned, geometry, bright, all, edge, rays, of_plan, explored: BTreeSet::new() })
    }

    /// The rays that meet triangles with these numbers of cuts, with the cells that they meet. Those of the plan
    /// come first.
    fn rays_in(&self, cuts: &BTreeMap<u32, u32>) -> impl Iterator<Item = (usize, Cell, &Seen)> {
        self.rays.iter().enumerate().filter_map(|(number, seen)| {
            let (record, hit, _) = seen;
            Some((number, self.cell_of(*record, hit, *cuts.get(&hit.primitive)?), seen))
        })
    }

    fn cell_of(&self, record: u32, hit: &Hit, cuts: u32) -> Cell {
        let from = self.planned[record as usize].site.position;
        Cell::of(hit, cuts, is_behind(from, hit.primitive, self.geometry))
    }

    /// All cells of the triangles on which there is a bright hit.
    fn cells(&self, edge: f32) -> BTreeMap<Cell, Known> {
        let bright = self.rays.iter().filter(|(_, _, lit)| *lit > self.bright);
        let mut cuts: BTreeMap<u32, u32> = BTreeMap::new();
        for (_, hit, _) in bright {
            cuts.entry(hit.primitive).or_insert_with(|| {
                let [a, b, c] = self.geometry.corners(hit.primitive);
                let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
                ((longest / edge).ceil() as u32).clamp(1, MOST_CUTS)
            });
        }
        let mut cells: BTreeMap<Cell, Known> = BTreeMap::new();
        for (number, cell, &(record, hit, lit)) in self.rays_in(&cuts) {
            let known = cells.entry(cell).or_default();
            known.count += 1;
            known.sum += f64::from(lit);
            known.planned += if number < self.of_plan { f64::from(lit) } else { 0.0 };
            let is_nearer = known.nearest.is_none_or(|(_, nearest, _)| hit.t < nearest.t);
            if lit > self.bright && is_nearer {
                known.nearest = Some((record, hit, lit));
            }
        }
        cells
    }

    /// Cells with a bright ray. Those that send most light come first.
    fn bright_cells(&self, edge: f32) -> Vec<(Cell, Known)> {
        let mut bright: Vec<(Cell, Known)> =
            self.cells(edge).into_iter().filter(|(_, known)| known.nearest.is_some()).collect();
        let power = |(cell, known): &(Cell, Known)| cell.area(self.geometry) * known.radiance();
        bright.sort_by(|a, b| power(b).total_cmp(&power(a)).then(a.0.cmp(&b.0)));
        bright
    }

    /// The secondary lights. `trace` traces rays that are wanted, and returns each hit with the radiance that it
    /// brings.
    pub fn lights(mut self, trace: &mut dyn FnMut(&[Wanted]) -> Vec<Traced>) -> SecondaryLights {
        for _ in 0..EXPLORATIONS {
            let wanted = self.around_bright_cells();
            self.send(&wanted, trace);
        }
        let mut bright = self.bright_cells(self.edge);
        for _ in 0..HALVINGS {
            if 4 * bright.len() > ENOUGH {
                break;
            }
            self.edge *= 0.5;
            bright = self.bright_cells(self.edge);
        }
        bright.truncate(MOST_CELLS);
        if bright.iter().map(|(_, known)| known.planned).sum::<f64>() < LEAST_SHARE * self.all {
            return SecondaryLights::none();
        }
        let lights = self.measured(bright, trace);
        SecondaryLights::of(self.with_parts(&lights)).unwrap_or_default()
    }

    /// Cells with the radiances of their parts. `bright`: the radiance of a bright ray in it or beside it.
    fn with_parts(&self, bright: &BTreeMap<Cell, f32>) -> Vec<SecondaryLight> {
        let cuts: BTreeMap<u32, u32> = bright.keys().map(|cell| (cell.triangle, cell.cuts)).collect();
        let mut seen: BTreeMap<Cell, ([(f32, f32); PARTS], bool)> = BTreeMap::new();
        let mut met: BTreeMap<(u32, bool), f32> = BTreeMap::new();
        for (number, cell, (_, hit, lit)) in self.rays_in(&cuts) {
            if bright.contains_key(&cell) {
                let (parts, is_lit) = seen.entry(cell).or_default();
                let (count, sum) = &mut parts[cell.part_at(hit)];
                (*count, *sum) = (*count + 1.0, *sum + lit);
                *is_lit |= *lit > self.bright;
                *met.entry(cell.side()).or_default() += if number < self.of_plan { 1.0 } else { 0.0 };
            }
        }
        let mut expected: BTreeMap<(u32, bool), f32> = BTreeMap::new();
        for cell in bright.keys() {
            *expected.entry(cell.side()).or_default() += self.expected_rays(cell);
        }
        let light = |(&cell, &bright): (&Cell, &f32)| {
            let (seen, is_lit) = seen.get(&cell).copied().unwrap_or_default();
            let (count, sum) = seen.iter().fold((0.0, 0.0), |all, part| (all.0 + part.0, all.1 + part.1));
            // Parts that no ray has met are taken to be like the others, and cells like the one beside.
            let unseen = if count > 0.0 { sum / count } else { bright };
            let dark = if is_lit { DARK } else { DARK_BESIDE };
            let [met, expected] =
                [&met, &expected].map(|of| of.get(&cell.side()).copied().unwrap_or_default());
            let share = ((met + 1.0) / (expected + 1.0)).clamp(LEAST_SEEN, 1.0);
            let mut parts = [0.0; PARTS];
            for part in Cell::parts() {
                let (count, sum) = seen[part];
                let radiance = if count > 0.0 { sum / count } else { unseen }.max(dark * bright);
                parts[part] = (share * radiance).clamp(f32::MIN_POSITIVE, Planned::BRIGHTEST);
            }
            SecondaryLight { cell, parts }
        };
        bright.iter().filter(|(cell, _)| cell.area(self.geometry) > 0.0).map(light).collect()
    }

    /// Number of the plan's rays that would meet a cell if nothing were between.
    fn expected_rays(&self, cell: &Cell) -> f32 {
        let light = cell.placed(self.geometry);
        let share = |planned: &Planned| light.form_factor(planned.site.position, planned.site.normal);
        PLAN_RAYS as f32 * self.planned.iter().map(share).sum::<f32>()
    }

    /// Sends rays into bright cells, and into those beside them, until all around are dark. Returns each with the
    /// radiance of a bright ray in it or beside it.
    fn measured(
        &mut self,
        bright: Vec<(Cell, Known)>,
        trace: &mut dyn FnMut(&[Wanted]) -> Vec<Traced>,
    ) -> BTreeMap<Cell, f32> {
        let from = |(cell, known): (Cell, Known)| Some((cell, known.nearest?));
        let mut open: Vec<(Cell, Seen)> = bright.into_iter().filter_map(from).collect();
        let mut lights: BTreeMap<Cell, f32> = open.iter().map(|&(cell, (_, _, lit))| (cell, lit)).collect();
        let mut is_first = true;
        while !open.is_empty() {
            let wanted: Vec<Wanted> = open.iter().map(|&(cell, from)| self.within(cell, from)).collect();
            let sent = self.send(&wanted, trace);
            for ((cell, from), rays) in take(&mut open).into_iter().zip(sent) {
                let is_lit = |(record, hit, lit): &&Seen| {
                    *lit > self.bright && self.cell_of(*record, hit, cell.cuts) == cell
                };
                let lit = self.rays[rays].iter().find(is_lit).copied();
                let Some(from) = lit.or(is_first.then_some(from)) else { continue };
                for beside in cell.beside() {
                    if lights.len() < MOST_CELLS && !lights.contains_key(&beside) {
                        lights.insert(beside, from.2);
                        open.push((beside, from));
                    }
                }
            }
            is_first = false;
        }
        lights
    }

    /// Rays around the bright cells that were not explored yet.
    fn around_bright_cells(&mut self) -> Vec<Wanted> {
        let mut bright = self.bright_cells(self.edge);
        bright.truncate(MOST_CELLS);
        bright.retain(|(cell, _)| self.explored.insert(*cell));
        let around = |(cell, known): (Cell, Known)| {
            let from = known.nearest?;
            let at = from.1.position(self.geometry.corners(cell.triangle));
            let width = 2.0 * AROUND * self.edge;
            Some(self.rays_to(cell, from, |_, u| at + width * (u - 0.5)))
        };
        bright.into_iter().filter_map(around).collect()
    }

    /// Rays into a cell.
    fn within(&self, cell: Cell, from: Seen) -> Wanted {
        let parts: Vec<usize> = Cell::parts().collect();
        self.rays_to(cell, from, |ray, u| {
            cell.point_of_part(parts[ray % parts.len()], triangle(u.truncate()), self.geometry)
        })
    }

    /// Rays from a record that saw a bright place to others, which are chosen by points of the unit cube.
    fn rays_to(&self, cell: Cell, (record, hit, _): Seen, target: impl Fn(usize, Vec3) -> Vec3) -> Wanted {
        let site = &self.planned[record as usize].site;
        let known = hit.position(self.geometry.corners(hit.primitive));
        let key = hash(self.planned[record as usize].key ^ hash(cell.key()));
        let sampler = Sampler::keyed(key);
        let directions = std::array::from_fn(|ray| {
            let [a, b] = [0, 1].map(|part| sampler.independent(2 * ray as u32 + part));
            let towards = (target(ray, a.extend(b.x)) - site.position).normalize_or_zero();
            let is_above = towards.dot(site.normal) > 0.0;
            if is_above { towards } else { (known - site.position).normalize_or(site.normal) }
        });
        Wanted { record, key, directions }
    }

    /// Traces rays, and returns the places of each record's hits among all.
    fn send(
        &mut self,
        wanted: &[Wanted],
        trace: &mut dyn FnMut(&[Wanted]) -> Vec<Traced>,
    ) -> Vec<Range<usize>> {
        let traced = wanted.iter().zip(trace(wanted));
        let add = |(wanted, traced): (&Wanted, Traced)| {
            let first = self.rays.len();
            let hits = traced.into_iter().filter_map(|(hit, lit)| Some((wanted.record, hit?, lit)));
            self.rays.extend(hits);
            first..self.rays.len()
        };
        traced.map(add).collect()
    }
}
