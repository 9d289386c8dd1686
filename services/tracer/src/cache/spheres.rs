//! Linked lists of spheres, tested eight at a time.

use glam::{Vec3, Vec4};

/// A sphere. Lengths are in metres.
#[derive(Debug, Clone, Copy)]
pub struct Sphere {
    /// The index that a query returns.
    pub index: u32,
    pub center: Vec3,
    pub radius: f32,
    /// The sets that it belongs to, as bits.
    pub sets: u8,
}

/// Number of sets.
pub const SETS: usize = 6;

/// Storage for any number of lists of spheres.
#[derive(Debug, Default, Clone)]
pub struct Lists(Vec<Block>);

/// A list: its first and last block.
#[derive(Debug, Clone, Copy)]
pub struct List(u32, u32);

/// Up to eight spheres, in insertion order, tested together because most are too far away.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    /// Centres by axis, in groups of four.
    centers: [[Vec4; 2]; 3],
    /// Radii. NaN marks an unused entry.
    radii: [Vec4; 2],
    indices: [u32; TOGETHER],
    /// The spheres of each set, as bits.
    sets: [u8; SETS],
    len: u8,
    /// The next block of the list.
    next: u32,
}

const TOGETHER: usize = 8;

/// Marks the end of a list.
const NONE: u32 = u32::MAX;

/// Larger than a few rounding errors.
pub const WIDER: f32 = 1.0 + 1e-5;

impl List {
    pub const EMPTY: Self = Self(NONE, NONE);
}

impl Lists {
    pub fn push(&mut self, List(first, last): &mut List, sphere: Sphere) {
        let new = self.0.len() as u32;
        match self.0.get_mut(*last as usize) {
            Some(block) if usize::from(block.len) < TOGETHER => return block.push(sphere),
            Some(block) => block.next = new,
            None => *first = new,
        }
        *last = new;
        let mut block = Block::EMPTY;
        block.push(sphere);
        self.0.push(block);
    }

    pub fn blocks(&self, List(first, _): List) -> impl Iterator<Item = &Block> {
        std::iter::successors(self.0.get(first as usize), |block| self.0.get(block.next as usize))
    }
}

impl Block {
    const EMPTY: Self = Self {
        centers: [[Vec4::ZERO; 2]; 3],
        radii: [Vec4::NAN; 2],
        indices: [0; TOGETHER],
        sets: [0; SETS],
        len: 0,
        next: NONE,
    };

    fn push(&mut self, Sphere { index, center, radius, sets }: Sphere) {
        let place = usize::from(self.len);
        let (four, lane) = (place / 4, place % 4);
        (0..3).for_each(|axis| self.centers[axis][four][lane] = center[axis]);
        self.radii[four][lane] = radius;
        self.indices[place] = index;
        for (set, spheres) in self.sets.iter_mut().enumerate() {
            *spheres |= (sets >> set & 1) << place;
        }
        self.len += 1;
    }

    /// Number of spheres in a set.
    pub fn count(&self, set: usize) -> u64 {
        u64::from(self.sets[set].count_ones())
    }

    /// Indices of the spheres of a set that may contain a point. Rounding may add some.
    pub fn holding(&self, set: usize, point: Vec3) -> impl Iterator<Item = u32> {
        self.indices_of(u32::from(self.sets[set]) & self.near(point, 0.0))
    }

    /// Indices of the spheres that may touch another sphere. Rounding may add some, but never leaves one out.
    pub fn touching(&self, center: Vec3, radius: f32) -> impl Iterator<Item = u32> {
        self.indices_of(self.near(center, radius))
    }

    /// The spheres that may touch another sphere, as bits.
    fn near(&self, center: Vec3, radius: f32) -> u32 {
        let four = |four: usize| {
            let [x, y, z] = [0, 1, 2].map(|axis| self.centers[axis][four] - center[axis]);
            let farthest = (self.radii[four] + radius) * WIDER;
            (x * x + y * y + z * z).cmple(farthest * farthest).bitmask()
        };
        four(0) | four(1) << 4
    }

    fn indices_of(&self, mut places: u32) -> impl Iterator<Item = u32> {
        std::iter::from_fn(move || {
            let first = (places != 0).then(|| self.indices[places.trailing_zeros() as usize]);
            places &= places.wrapping_sub(1);
            first
        })
    }
}
