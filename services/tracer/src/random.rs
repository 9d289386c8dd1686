//! Counter-based random numbers and scrambled (0,2)-sequences.
//!
//! Every number is a hash of (seed, frame, pixel, dimension, index), without shared state. Within a pixel and
//! a dimension, successive points form a Sobol' (0,2)-sequence with nested uniform scrambling (Owen 1995),
//! computed by hashing (Laine and Karras 2011). Their order is scrambled alike (Burley 2020, "Practical
//! Hash-based Owen Scrambling"), so dimensions are uncorrelated.

pub use forelight_random::hash;
use glam::Vec2;

/// The use of a random point. Purpose and path vertex together are a dimension.
#[derive(Debug, Clone, Copy)]
pub enum Purpose {
    Pixel,
    Lens,
    Light,
    LightChoice,
    Gather,
    Lobe,
    Glossy,
    Sky,
    Sun,
    Roulette,
    Opacity,
    NearLight,
}

/// Path vertices beyond this one share their dimensions, with different points.
const VERTICES: usize = 16;
const PURPOSES: usize = 12;

/// How far each sequence of a pixel was drawn, as needed to continue later. Unused sequences are left out.
#[derive(Debug, Clone, Default)]
pub struct Drawn(Box<[(u8, u32)]>);

impl Drawn {
    /// The dimension of each sequence, and how far it was drawn.
    pub fn sequences(&self) -> &[(u8, u32)] {
        &self.0
    }

    /// From what [`Self::sequences`] returned. `None` if a dimension does not exist.
    pub fn of(sequences: Vec<(u8, u32)>) -> Option<Self> {
        let exists = |(dimension, _): &(u8, u32)| usize::from(*dimension) < VERTICES * PURPOSES;
        sequences.iter().all(exists).then(|| Self(sequences.into()))
    }
}

/// The random points of one pixel.
pub struct Sampler {
    key: u64,
    drawn: [u32; VERTICES * PURPOSES],
}

impl Sampler {
    /// The sampler of one pixel in one frame.
    pub fn new(seed: u64, frame: u32, pixel: u32) -> Self {
        let key = hash(hash(seed) ^ (u64::from(frame) << 32 | u64::from(pixel)));
        Self { key, drawn: [0; VERTICES * PURPOSES] }
    }

    /// The sampler of a pixel, continuing where an earlier one stopped.
    pub fn resumed(seed: u64, frame: u32, pixel: u32, Drawn(left): &Drawn) -> Self {
        let mut sampler = Self::new(seed, frame, pixel);
        left.iter().for_each(|&(dimension, drawn)| sampler.drawn[usize::from(dimension)] = drawn);
        sampler
    }

    /// Stores how far its sequences are drawn.
    pub fn note_drawn(&self, Drawn(left): &mut Drawn) {
        const { assert!(VERTICES * PURPOSES <= 256) };
        let begun = || {
            // Most paths have few vertices, so skip unused rows quickly.
            let used = |row: &[u32; PURPOSES]| row.iter().fold(0, |all, drawn| all | drawn) > 0;
            let rows =
                (0u8..).step_by(PURPOSES).zip(self.drawn.as_chunks().0).filter(move |(_, row)| used(row));
            rows.flat_map(|(first, row)| (first..).zip(row.iter().copied())).filter(|(_, drawn)| *drawn > 0)
        };
        // The sequences are nearly always the same as before, so reuse the allocation.
        let mut slots = left.iter_mut();
        let fits = begun().all(|drawn| slots.next().map(|slot| *slot = drawn).is_some());
        if !fits || slots.next().is_some() {
            *left = begun().collect();
        }
    }

    /// A sampler for something other than a pixel, with a key of its own.
    pub fn keyed(key: u64) -> Self {
        Self { key: hash(key), drawn: [0; VERTICES * PURPOSES] }
    }

    /// Number of camera samples begun for its pixel.
    pub fn samples(&self) -> u32 {
        self.drawn[Purpose::Pixel as usize]
    }

    /// The key of its points.
    pub fn key(&self) -> u64 {
        self.key
    }

    /// A point in [0, 1)² that depends only on `index`. Points of different indices are independent.
    pub fn independent(&self, index: u32) -> Vec2 {
        let bits = hash(self.key ^ u64::from(index).wrapping_mul(0xa076_1d64_78bd_642f));
        Vec2::new(unit(bits as u32), unit((bits >> 32) as u32))
    }

    /// The next point in [0, 1)² for this purpose at path vertex `vertex`.
    pub fn next(&mut self, purpose: Purpose, vertex: u32) -> Vec2 {
        let (dimension, index) = self.draw(purpose, vertex);
        self.point(dimension, index)
    }

    /// Draws the next index for this purpose, for [`Sampler::related`] points.
    pub fn draw(&mut self, purpose: Purpose, vertex: u32) -> (u64, u32) {
        let dimension = (vertex as usize).min(VERTICES - 1) * PURPOSES + purpose as usize;
        let index = self.drawn[dimension];
        self.drawn[dimension] = index.wrapping_add(1);
        (dimension as u64, index)
    }

    /// Point `index` of a family of sequences, one per `member`.
    pub fn related(&self, (dimension, index): (u64, u32), member: u32) -> Vec2 {
        self.point(dimension | (u64::from(member) + 1) << 16, index)
    }

    fn point(&self, dimension: u64, index: u32) -> Vec2 {
        let key = hash(self.key ^ dimension.wrapping_mul(0xd6e8_feb8_6659_fd93));
        let index = reversed_scramble(index.reverse_bits(), hash(key) as u32).reverse_bits();
        // First dimension: van der Corput (bit reversal). Second: Sobol' with the primitive polynomial x + 1.
        let x = reversed_scramble(index, key as u32).reverse_bits();
        let y = reversed_scramble(sobol_second_reversed(index), (key >> 32) as u32).reverse_bits();
        Vec2::new(unit(x), unit(y))
    }
}

/// The leading 24 bits as a number in [0, 1).
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / (1 << 24) as f32)
}

/// Second dimension of the Sobol' sequence, with reversed bits. The columns of its matrix are the rows of
/// Pascal's triangle modulo 2: "k over j" is odd if every set bit of j is set in k (Lucas 1878). So bit j of
/// the result is the sum of all index bits k whose number contains the bits of j, taken in five steps.
fn sobol_second_reversed(index: u32) -> u32 {
    /// Masks of the bits whose number does not contain 1, 2, 4, 8 or 16.
    const WITHOUT: [u32; 5] = [0x5555_5555, 0x3333_3333, 0x0f0f_0f0f, 0x00ff_00ff, 0x0000_ffff];
    let mut sum = index;
    for (bit, without) in WITHOUT.into_iter().enumerate() {
        sum ^= sum >> (1 << bit) & without;
    }
    sum
}

/// Nested uniform scrambling of a number with reversed bits: a hash of the bits below flips each bit. All
/// steps carry upwards only. Constants by Vegdahl 2021.
fn reversed_scramble(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_power_of_two_of_points_fills_every_elementary_interval_once() {
        let sampler = |pixel| Sampler::new(7, 3, pixel);
        for pixel in 0..4 {
            for log in 0..7u32 {
                let mut s = sampler(pixel);
                let points: Vec<Vec2> = (0..1 << log).map(|_| s.next(Purpose::Gather, 1)).collect();
                for columns in 0..=log {
                    let (w, h) = (1usize << columns, 1usize << (log - columns));
                    let mut cells = vec![0; w * h];
                    for p in &points {
                        cells[(p.y * h as f32) as usize * w + (p.x * w as f32) as usize] += 1;
                    }
                    assert!(cells.iter().all(|&c| c == 1), "pixel {pixel}, 2^{log} points in {w} × {h}");
                }
            }
        }
    }

    #[test]
    fn the_second_dimension_is_pascals_triangle_row_by_row() {
        for index in (0..100_000u64).map(|number| hash(number) as u32 >> (number % 32)) {
            let (mut point, mut column) = (0, 1u32 << 31);
            for bit in 0..32 {
                if index >> bit & 1 == 1 {
                    point ^= column;
                }
                column ^= column >> 1;
            }
            assert_eq!(sobol_second_reversed(index), point.reverse_bits(), "{index:#x}");
        }
    }

    #[test]
    fn dimensions_and_pixels_do_not_correlate() {
        let mut worst = 0.0f64;
        for member in 0..8 {
            let s = Sampler::new(1, 0, 5);
            let product: f64 = (0..256)
                .map(|i| {
                    let a = s.related((3, i), member).x - 0.5;
                    let b = s.related((3, i), member + 1).x - 0.5;
                    f64::from(a * b)
                })
                .sum();
            worst = worst.max((product / 256.0 * 12.0).abs());
        }
        assert!(worst < 0.3, "correlation {worst}");
    }
}
