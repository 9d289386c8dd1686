//! Secondary lights: small bright places that points sample themselves, as they sample lamps.
//!
//! Where much of the indirect light comes by way of a small place (a spot of sun on the floor, the ceiling above
//! a lamp in a shade), it casts shadows with edges. Records are too far apart to show them. So such places are
//! taken out of the gathers, and every point samples them instead. A place is a cell of one side of a triangle. A
//! gathered ray belongs to a secondary light if the first triangle that it meets is met in such a cell. So all
//! light is counted once, wherever the cells are and however bright they turn out to be.
//!
//! The survey of the first plan chooses the cells. If no small place is bright, there are none, and nothing
//! changes.

use super::record::Planned;
use crate::geometry::triangle;
use forelight_bvh::Hit;
use forelight_scene::Geometry;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;
use std::sync::OnceLock;

/// Most cells along the edge of a triangle.
pub const MOST_CUTS: u32 = 64;

/// Most cells. The brightest are used.
pub const MOST_CELLS: usize = 256;

/// A cell is divided once more into parts: so many along an edge. Many cells are lit in part only.
const CUTS_OF_CELL: u32 = 4;
/// Numbers of parts are below this.
pub const PARTS: usize = 2 * (CUTS_OF_CELL * CUTS_OF_CELL) as usize;

/// Where a cell is nearer than this multiple of its own radius, rays of the whole hemisphere help to find it: its
/// points contribute too unequally.
const NEAR: f32 = 3.0;

/// One of the cells into which a side of a triangle is divided. All cells of a triangle have the same area.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Cell {
    pub triangle: u32,
    /// Number of cells along an edge of the triangle, n. There are n² in all.
    pub cuts: u32,
    /// 2 (column · n + row), plus one for the cell that points the other way.
    pub number: u32,
    /// On the side from which the triangle is clockwise.
    pub back: bool,
}

impl Cell {
    /// The cell that contains a hit.
    pub fn of(hit: &Hit, cuts: u32, back: bool) -> Self {
        Self { triangle: hit.primitive, cuts, number: number_at(Vec2::new(hit.u, hit.v), cuts), back }
    }

    /// The part of the cell that contains a hit.
    pub fn part_at(&self, hit: &Hit) -> usize {
        let (column, row) = self.place();
        let within = Vec2::new(hit.u, hit.v) * self.cuts as f32 - Vec2::new(column as f32, row as f32);
        let within = if self.number % 2 == 1 { 1.0 - within } else { within };
        number_at(within.clamp(Vec2::ZERO, Vec2::ONE), CUTS_OF_CELL) as usize
    }

    /// The numbers of its parts.
    pub fn parts() -> impl Iterator<Item = usize> {
        (0..PARTS).filter(|&part| part_of_any(part).exists())
    }

    /// A point of a part, from coordinates in the part.
    pub fn point_of_part(&self, part: usize, inner: (f32, f32), geometry: &Geometry) -> Vec3 {
        let within = part_of_any(part).barycentric(inner);
        position(self, (within.x, within.y), geometry)
    }

    /// Whether the triangle has such a cell.
    pub fn exists(&self) -> bool {
        (1..=MOST_CUTS).contains(&self.cuts) && {
            let (column, row) = self.place();
            u64::from(column) + u64::from(row) + u64::from(self.number % 2) < u64::from(self.cuts)
        }
    }

    /// Metres².
    pub fn area(&self, geometry: &Geometry) -> f32 {
        // In 64 bits: slivers would lose all digits.
        let [a, b, c] = geometry.corners(self.triangle).map(Vec3::as_dvec3);
        (0.5 * (b - a).cross(c - a).length() / f64::from(self.cuts * self.cuts)) as f32
    }

    /// Where the cell is in a frame.
    pub fn placed(&self, geometry: &Geometry) -> Placed {
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|at| position(self, at, geometry));
        let centre = corners.iter().sum::<Vec3>() / 3.0;
        let front = geometry.geometric_normal(self.triangle);
        Placed {
            centre,
            normal: if self.back { -front } else { front },
            radius: corners.iter().map(|corner| corner.distance(centre)).fold(0.0, f32::max),
            area: self.area(geometry),
        }
    }

    /// The side of a triangle that it is on.
    pub fn side(&self) -> (u32, bool) {
        (self.triangle, self.back)
    }

    /// A number of its own.
    pub fn key(&self) -> u64 {
        let side = u64::from(self.back) << 31;
        u64::from(self.triangle) << 32 | side | u64::from(self.cuts) << 16 | u64::from(self.number)
    }

    /// The cells that share an edge with it.
    pub fn beside(self) -> impl Iterator<Item = Self> {
        let ((column, row), turned) = (self.place(), self.number % 2 == 1);
        [(0, 0), (1, 0), (0, 1)].into_iter().filter_map(move |(right, up)| {
            let (column, row) = match turned {
                true => (column + right, row + up),
                false => (column.checked_sub(right)?, row.checked_sub(up)?),
            };
            let number = 2 * (column * self.cuts + row) + u32::from(!turned);
            Some(Self { number, ..self }).filter(|cell| row < self.cuts && cell.exists())
        })
    }

    /// Column and row.
    fn place(&self) -> (u32, u32) {
        (self.number / 2 / self.cuts, self.number / 2 % self.cuts)
    }

    /// Barycentric coordinates of a point of the cell, from its coordinates in the cell.
    fn barycentric(&self, (b, c): (f32, f32)) -> Vec2 {
        let (column, row) = self.place();
        let corner = Vec2::new(column as f32, row as f32);
        let inner = if self.number % 2 == 1 { Vec2::new(1.0 - b, 1.0 - c) } else { Vec2::new(b, c) };
        (corner + inner) / self.cuts as f32
    }
}

/// The number of the cell with these barycentric coordinates.
fn number_at(at: Vec2, cuts: u32) -> u32 {
    let at = at * cuts as f32;
    let column = (at.x as u32).min(cuts - 1);
    let row = (at.y as u32).min(cuts - 1 - column);
    let across = at.x - column as f32 + at.y - row as f32 > 1.0;
    let turned = across && column + row + 1 < cuts;
    2 * (column * cuts + row) + u32::from(turned)
}

/// A part, as a cell of its cell.
fn part_of_any(part: usize) -> Cell {
    Cell { triangle: 0, cuts: CUTS_OF_CELL, number: part as u32, back: false }
}

/// A cell, and the radiance that each of its parts is expected to bring to a point, mean over the channels. It
/// decides how often the part is chosen, and nothing else. Parts are numbered as the cells of a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SecondaryLight {
    pub cell: Cell,
    pub parts: [f32; PARTS],
}

impl SecondaryLight {
    /// Whether the cell exists, and something can be expected from exactly the parts that exist.
    pub fn is_valid(&self) -> bool {
        let is_valid = |(part, radiance): (usize, &f32)| match part_of_any(part).exists() {
            true => (f32::MIN_POSITIVE..=Planned::BRIGHTEST).contains(radiance),
            false => *radiance == 0.0,
        };
        self.cell.exists() && self.parts.iter().enumerate().all(is_valid)
    }

    fn radiance(&self) -> f32 {
        self.parts.iter().sum::<f32>() / Cell::parts().count() as f32
    }
}

/// The secondary lights of a cache. They are told apart by triangle, so they move with the geometry.
#[derive(Debug, Default, Clone)]
pub struct SecondaryLights {
    /// In ascending order of cells.
    lights: Vec<SecondaryLight>,
    /// Where they are in the frame, and their radiances, determined when they are first sampled.
    placed: OnceLock<Vec<(Placed, f32)>>,
}

/// A cell in a frame.
#[derive(Debug, Clone, Copy)]
pub struct Placed {
    centre: Vec3,
    /// Unit normal of its side.
    normal: Vec3,
    /// Largest distance of its corners from the centre, metres.
    radius: f32,
    /// Metres².
    area: f32,
}

impl Placed {
    /// Roughly the share of the cosine-weighted rays from a point that meet the cell if nothing is between. Above
    /// 0 if a point of the cell is above the horizon: the point is as far from the cell's plane.
    pub fn form_factor(&self, position: Vec3, normal: Vec3) -> f32 {
        let to = self.centre - position;
        let above = (to.dot(normal) + self.radius).max(0.0);
        let aside = (-to.dot(self.normal)).max(0.0);
        let around = to.length_squared() + self.radius * self.radius;
        let (to_cell, from_cell) = (above / around.sqrt(), aside / around.sqrt());
        if around > 0.0 { FRAC_1_PI * to_cell * from_cell * (self.area / around) } else { 0.0 }
    }

    fn is_near(&self, position: Vec3) -> bool {
        self.centre.distance_squared(position) < NEAR * NEAR * self.radius * self.radius
    }
}

/// The secondary lights, as a point sees them.
pub struct Seen<'a> {
    placed: &'a [(Placed, f32)],
    lights: &'a [SecondaryLight],
    /// Running sums of how likely each is chosen.
    sums: [f64; MOST_CELLS],
    /// Whether one is so near that its points contribute too unequally.
    pub any_near: bool,
}

impl SecondaryLights {
    /// No lights.
    pub const fn none() -> Self {
        Self { lights: Vec::new(), placed: OnceLock::new() }
    }

    /// Some lights, in any order. `None` if they are too many, one is there twice, or a triangle is divided in
    /// two ways.
    pub fn of(mut lights: Vec<SecondaryLight>) -> Option<Self> {
        lights.sort_by_key(|light| light.cell);
        let fit = |pair: &[SecondaryLight]| {
            let [one, next] = [pair[0].cell, pair[1].cell];
            one < next && (one.triangle != next.triangle || one.cuts == next.cuts)
        };
        let valid = lights.len() <= MOST_CELLS && lights.windows(2).all(fit);
        valid.then(|| Self { lights, placed: OnceLock::new() })
    }

    /// The same lights, for another frame of the shot.
    pub fn carried(&self) -> Self {
        Self { lights: self.lights.clone(), placed: OnceLock::new() }
    }

    /// In ascending order of cells.
    pub fn all(&self) -> &[SecondaryLight] {
        &self.lights
    }

    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    /// The number of the light that a ray from `origin` meets, and of its part.
    pub fn met(&self, hit: &Hit, origin: Vec3, geometry: &Geometry) -> Option<(usize, usize)> {
        let first = self.lights.partition_point(|light| light.cell.triangle < hit.primitive);
        let of_triangle = self.lights.get(first).filter(|light| light.cell.triangle == hit.primitive)?;
        let cell = Cell::of(hit, of_triangle.cell.cuts, is_behind(origin, hit.primitive, geometry));
        let number = self.lights.binary_search_by(|light| light.cell.cmp(&cell)).ok()?;
        Some((number, cell.part_at(hit)))
    }

    fn placed(&self, geometry: &Geometry) -> &[(Placed, f32)] {
        self.placed.get_or_init(|| {
            self.lights.iter().map(|light| (light.cell.placed(geometry), light.radiance())).collect()
        })
    }

    /// The lights, as a point with this normal sees them.
    pub fn seen_from(&self, position: Vec3, normal: Vec3, geometry: &Geometry) -> Seen<'_> {
        let placed = self.placed(geometry);
        let mut seen = Seen { placed, lights: &self.lights, sums: [0.0; MOST_CELLS], any_near: false };
        let mut sum = 0.0;
        for (number, (light, radiance)) in placed.iter().enumerate() {
            let likely = f64::from(*radiance) * f64::from(light.form_factor(position, normal));
            seen.any_near |= likely > 0.0 && light.is_near(position);
            sum += likely;
            seen.sums[number] = sum;
        }
        seen
    }
}

impl Seen<'_> {
    /// Chooses a light, and a point of it. `which` is in [0, 1), `place` in the unit square. `None` if no light
    /// contributes.
    pub fn choose(&self, which: f64, place: Vec2, geometry: &Geometry) -> Option<(usize, Vec3)> {
        let sums = &self.sums[..self.lights.len()];
        let at = which * sums.last()?;
        let number = sums.partition_point(|&sum| sum <= at);
        let light = self.lights.get(number)?;
        // What is left of the random number chooses the part.
        let before = number.checked_sub(1).map_or(0.0, |before| sums[before]);
        let left = (at - before) / (sums[number] - before);
        let all: f64 = light.parts.iter().copied().map(f64::from).sum();
        let mut sum = 0.0;
        let is_chosen = |radiance: f64| {
            sum += radiance;
            left * all < sum
        };
        let mut parts = light.parts.iter().copied().map(f64::from);
        let part = parts.position(is_chosen).or(light.parts.iter().rposition(|&part| part > 0.0))?;
        Some((number, light.cell.point_of_part(part, triangle(place), geometry)))
    }

    /// Density per steradian with which [`Self::choose`] chooses a direction, for a part of a light that is met at
    /// the squared distance `distance2`.
    pub fn density(&self, (number, part): (usize, usize), distance2: f32, direction: Vec3) -> f32 {
        let before = number.checked_sub(1).map_or(0.0, |before| self.sums[before]);
        let likely = self.sums[number] - before;
        if likely <= 0.0 {
            return 0.0;
        }
        let (Placed { area, normal, .. }, radiance) = self.placed[number];
        let probability = (likely / self.sums[self.lights.len() - 1]) as f32;
        let per_area = probability / area * (self.lights[number].parts[part] / radiance);
        per_area * distance2 / normal.dot(direction).abs().max(f32::MIN_POSITIVE)
    }
}

/// Whether a point is on the side from which a triangle is clockwise.
pub fn is_behind(point: Vec3, triangle: u32, geometry: &Geometry) -> bool {
    (point - geometry.corners(triangle)[0]).dot(geometry.geometric_normal(triangle)) < 0.0
}

/// The point of a cell with these coordinates in it.
fn position(cell: &Cell, inner: (f32, f32), geometry: &Geometry) -> Vec3 {
    let [a, b, c] = geometry.corners(cell.triangle);
    let at = cell.barycentric(inner);
    a + at.x * (b - a) + at.y * (c - a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Sampler;
    use std::collections::BTreeMap;

    const EYE: Vec3 = Vec3::new(0.7, 0.9, 0.6);

    const EVEN: [f32; PARTS] = [1.0; PARTS];

    /// One triangle on the floor, and one on a wall.
    fn geometry() -> Geometry {
        let corners = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]];
        Geometry {
            positions: corners.map(Vec3::from).to_vec(),
            triangles: vec![[0, 1, 2], [2, 3, 4]],
            ..Geometry::default()
        }
    }

    fn hit(triangle: u32, at: Vec2) -> Hit {
        Hit { primitive: triangle, u: at.x, v: at.y, t: 1.0 }
    }

    #[test]
    fn every_point_of_a_triangle_lies_in_one_cell_which_has_it_among_its_own_points() {
        let sampler = Sampler::keyed(1);
        for cuts in [1, 2, 3, 7, MOST_CUTS] {
            let all = (0..2 * cuts * cuts).map(|number| Cell { triangle: 0, cuts, number, back: false });
            let cells: Vec<Cell> = all.filter(Cell::exists).collect();
            assert_eq!(cells.len(), (cuts * cuts) as usize);
            for (index, cell) in (0..).zip(&cells) {
                let inner = triangle(sampler.independent(index));
                assert_eq!(Cell::of(&hit(0, cell.barycentric(inner)), cuts, false), *cell);
            }
            for index in 0..1000 {
                let (u, v) = triangle(sampler.independent(index));
                assert!(cells.contains(&Cell::of(&hit(0, Vec2::new(u, v)), cuts, false)));
            }
        }
    }

    #[test]
    fn cells_beside_each_other_share_two_corners() {
        let (geometry, cuts) = (geometry(), 5);
        let corners =
            |cell: &Cell| [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|at| position(cell, at, &geometry));
        let all = (0..2 * cuts * cuts).map(|number| Cell { triangle: 0, cuts, number, back: false });
        let cells: Vec<Cell> = all.filter(Cell::exists).collect();
        for cell in &cells {
            let shared = |other: &Cell| {
                let near = |a: &Vec3| corners(cell).iter().any(|b| a.distance(*b) < 1e-5);
                corners(other).iter().filter(|corner| near(corner)).count()
            };
            let expected: Vec<Cell> = cells.iter().copied().filter(|other| shared(other) == 2).collect();
            let mut beside: Vec<Cell> = cell.beside().collect();
            beside.sort();
            assert_eq!(beside, expected);
        }
    }

    #[test]
    fn a_point_is_chosen_as_often_as_its_density_says() {
        let geometry = geometry();
        let cell = |triangle, number| {
            let cell = Cell { triangle, cuts: 3, number, back: false };
            Cell { back: is_behind(EYE, triangle, &geometry), ..cell }
        };
        let parts = |radiance: f32| {
            std::array::from_fn(
                |part| if part_of_any(part).exists() { radiance * (part % 5) as f32 } else { 0.0 },
            )
        };
        let light = |(triangle, number, radiance)| SecondaryLight {
            cell: cell(triangle, number),
            parts: parts(radiance),
        };
        let lights =
            SecondaryLights::of([(0, 0, 1.0), (0, 7, 5.0), (1, 3, 2.0)].map(light).to_vec()).unwrap();
        // The point sees the floor's cells, and the wall's.
        let seen = lights.seen_from(EYE, Vec3::NEG_Y, &geometry);
        let count = 100_000;
        let sampler = Sampler::keyed(3);
        let mut times = BTreeMap::new();
        for index in 0..count {
            let which = (f64::from(index) + 0.5) / f64::from(count);
            let chosen = seen.choose(which, sampler.independent(index), &geometry);
            let (number, position) = chosen.expect("all contribute");
            let on = lights.all()[number].cell.triangle;
            let met = lights.met(&hit(on, barycentric_of(position, on)), EYE, &geometry);
            let place = met.filter(|met| met.0 == number).expect("the point is on its light");
            *times.entry(place).or_insert(0.0) += 1.0 / f64::from(count);
        }
        assert_eq!(times.len(), 3 * Cell::parts().filter(|part| part % 5 > 0).count());
        for ((number, part), share) in times {
            // At distance 1 and cosine 1, densities per steradian and per area are the same.
            let area = f64::from(lights.all()[number].cell.area(&geometry)) / Cell::parts().count() as f64;
            let normal = geometry.geometric_normal(lights.all()[number].cell.triangle);
            let density = f64::from(seen.density((number, part), 1.0, normal));
            assert!((density * area - share).abs() < 1e-4 && share > 1e-3, "{share}, {density}");
        }
    }

    fn barycentric_of(position: Vec3, triangle: u32) -> Vec2 {
        match triangle {
            0 => Vec2::new(0.5 * position.x, position.z),
            // The wall's corners are (0, 0, 1), (0, 1, 0) and (0, 1, 1).
            _ => Vec2::new(1.0 - position.z, position.y + position.z - 1.0),
        }
    }

    #[test]
    fn lights_behind_a_point_in_its_plane_or_turned_away_are_not_chosen() {
        let geometry = geometry();
        let is_chosen = |eye: Vec3, normal: Vec3, back: bool| {
            let cell = Cell { triangle: 0, cuts: 1, number: 0, back };
            let lights = SecondaryLights::of(vec![SecondaryLight { cell, parts: EVEN }]).unwrap();
            let chosen = lights.seen_from(eye, normal, &geometry).choose(0.5, Vec2::splat(0.5), &geometry);
            chosen.is_some()
        };
        let above_is_back = is_behind(Vec3::Y, 0, &geometry);
        assert!(is_chosen(Vec3::Y * 9.0, Vec3::NEG_Y, above_is_back));
        assert!(!is_chosen(Vec3::Y * 9.0, Vec3::NEG_Y, !above_is_back));
        assert!(!is_chosen(Vec3::Y * 9.0, Vec3::Y, above_is_back));
        assert!(!is_chosen(Vec3::new(5.0, 0.0, 5.0), Vec3::NEG_X, above_is_back));
    }

    #[test]
    fn a_light_without_cell_or_with_parts_that_do_not_exist_is_not_valid() {
        let light = |number, parts| SecondaryLight {
            cell: Cell { triangle: 0, cuts: 2, number, back: false },
            parts,
        };
        let parts: [f32; PARTS] =
            std::array::from_fn(|part| if part_of_any(part).exists() { 1.0 } else { 0.0 });
        assert!(light(0, parts).is_valid());
        assert!(
            !light(9, parts).is_valid() && !light(0, EVEN).is_valid() && !light(0, [0.0; PARTS]).is_valid()
        );
        assert!(!light(0, parts.map(|part| part * f32::NAN)).is_valid());
    }

    #[test]
    fn lights_that_overlap_or_are_too_many_are_refused() {
        let light = |cuts, number| SecondaryLight {
            cell: Cell { triangle: 3, cuts, number, back: false },
            parts: EVEN,
        };
        assert!(SecondaryLights::of(vec![light(2, 0), light(2, 1)]).is_some());
        assert!(SecondaryLights::of(vec![light(2, 0), light(2, 0)]).is_none(), "the same cell twice");
        assert!(
            SecondaryLights::of(vec![light(2, 0), light(3, 1)]).is_none(),
            "two ways to divide a triangle"
        );
        assert!(SecondaryLights::of((0..=256).map(|number| light(64, number)).collect()).is_none());
    }
}
