//! Procedural textures made of hashes and sines: wood, tiles, cloth, leaves, and a painting.

use image::{Rgb, RgbImage};

/// An sRGB colour with components in [0, 1].
pub type Colour = [f64; 3];

/// An image whose colours are a function of (u, v), both in [0, 1]. v points up.
pub fn picture(width: u32, height: u32, colour: impl Fn(f64, f64) -> Colour) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let u = (f64::from(x) + 0.5) / f64::from(width);
        let v = 1.0 - (f64::from(y) + 0.5) / f64::from(height);
        // 128 levels per channel look the same as 256 and compress better.
        Rgb(colour(u, v).map(|c| (c.clamp(0.0, 1.0) * 127.0).round() as u8 * 2))
    })
}

/// A pseudo-random number in [0, 1) from two integers and a seed.
pub fn hash(x: i64, y: i64, seed: u64) -> f64 {
    let mut h = seed ^ 0x9e37_79b9_7f4a_7c15;
    for part in [x as u64, y as u64] {
        h = (h ^ part).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h = (h ^ (h >> 29)).wrapping_mul(0x94d0_49bb_1331_11eb);
        h ^= h >> 32;
    }
    (h >> 11) as f64 / (1u64 << 53) as f64
}

/// Smooth noise in [0, 1] that repeats every `columns` by `rows` cells; u and v run from 0 to 1 over these.
pub fn noise(u: f64, v: f64, (columns, rows): (i64, i64), seed: u64) -> f64 {
    let (x, y) = (u * columns as f64, v * rows as f64);
    let (i, j) = (x.floor() as i64, y.floor() as i64);
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (a, b) = (ease(x - x.floor()), ease(y - y.floor()));
    let at = |di: i64, dj: i64| hash((i + di).rem_euclid(columns), (j + dj).rem_euclid(rows), seed);
    mix(mix(at(0, 0), at(1, 0), a), mix(at(0, 1), at(1, 1), a), b)
}

/// Three octaves of [`noise`].
pub fn turbulence(u: f64, v: f64, (columns, rows): (i64, i64), seed: u64) -> f64 {
    (0..3)
        .map(|octave| {
            noise(u, v, (columns << octave, rows << octave), seed + octave) * 0.5f64.powi(octave as i32)
        })
        .sum::<f64>()
        / 1.75
}

/// Linear interpolation between two numbers.
pub fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// Linear interpolation between two colours. `t` is clamped to [0, 1].
pub fn blend(a: Colour, b: Colour, t: f64) -> Colour {
    let t = t.clamp(0.0, 1.0);
    [0, 1, 2].map(|i| mix(a[i], b[i], t))
}

/// A colour scaled by a factor.
pub fn shade(colour: Colour, factor: f64) -> Colour {
    colour.map(|c| c * factor)
}

/// `boards` boards side by side, with their grain along u and slightly different tones.
pub fn wood(size: u32, boards: i64, light: Colour, dark: Colour, seed: u64) -> RgbImage {
    picture(size, size, |u, v| {
        let board = (v * boards as f64).floor() as i64;
        let within = v * boards as f64 - board as f64;
        let seed = seed + 17 * board as u64;
        let bend = noise(u, v, (3, 4), seed) * 1.6;
        let rings = 0.5 + 0.5 * libm::sin((within * 5.0 + bend) * 6.3);
        let fibre = noise(u, v, (8, 96), seed + 5);
        let tone = hash(board, 3, seed);
        let colour = blend(light, dark, 0.45 * rings * rings + 0.3 * fibre + 0.35 * tone - 0.1);
        let seam = within.min(1.0 - within) * size as f64 / boards as f64;
        shade(colour, if boards > 1 && seam < 1.0 { 0.72 } else { 1.0 })
    })
}

/// A pattern of tiles.
#[derive(Clone, Copy, Debug)]
pub struct Laying {
    /// Number of tiles per row.
    pub columns: i64,
    /// Number of rows.
    pub rows: i64,
    /// Running bond: every second row is shifted by half a tile.
    pub bond: bool,
    /// Joint width, as a fraction of the tile's width and of its height.
    pub joint: [f64; 2],
}

/// Tiles with joints between them. `tone` gives a tile's colour from its column, row, u and v.
pub fn tiles(
    size: u32,
    laying: Laying,
    joint: Colour,
    tone: impl Fn(i64, i64, f64, f64) -> Colour,
) -> RgbImage {
    picture(size, size, |u, v| {
        let y = v * laying.rows as f64;
        let row = y.floor() as i64;
        let shift = if laying.bond && row % 2 == 1 { 0.5 } else { 0.0 };
        let x = u * laying.columns as f64 + shift;
        let column = (x.floor() as i64).rem_euclid(laying.columns);
        let edge = |t: f64| (t - t.floor()).min(1.0 - (t - t.floor()));
        if edge(x) < laying.joint[0] / 2.0 || edge(y) < laying.joint[1] / 2.0 {
            joint
        } else {
            tone(column, row, u, v)
        }
    })
}

/// Checked cloth: two sets of stripes that cross each other, with a weave.
pub fn gingham(size: u32, checks: i64, ground: Colour, stripe: Colour) -> RgbImage {
    picture(size, size, |u, v| {
        let on = |t: f64| ((t * checks as f64 * 2.0).floor() as i64).rem_euclid(2) as f64;
        let thread = |t: f64| ((t * f64::from(size) / 2.0).floor() as i64).rem_euclid(2) as f64;
        let colour = blend(ground, stripe, (on(u) + on(v)) * 0.47);
        shade(colour, 1.0 - 0.05 * (thread(u) - thread(v)).abs())
    })
}

/// Leaves: blotches in shades between two greens, with dark gaps.
pub fn leaves(size: u32, light: Colour, dark: Colour, seed: u64) -> RgbImage {
    picture(size, size, |u, v| {
        let coarse = turbulence(u, v, (6, 6), seed);
        let fine = noise(u, v, (40, 40), seed + 9);
        let t = coarse * 0.9 + fine * 0.7 - 0.45;
        blend(dark, light, (t * 5.0).round() / 5.0)
    })
}

/// A painting of hills in the evening, with a lake and a low sun.
pub fn landscape(width: u32, height: u32) -> RgbImage {
    picture(width, height, |u, v| {
        let sky = blend([0.98, 0.78, 0.48], [0.35, 0.55, 0.75], (v - 0.45) * 1.9);
        let cloud = turbulence(u, v, (3, 9), 7);
        let mut colour = blend(sky, [1.0, 0.93, 0.84], (cloud - 0.55) * 3.0 * (v - 0.5).max(0.0) * 2.0);
        let (du, dv) = ((u - 0.68) * 1.5, v - 0.58);
        let sun = libm::sqrt(du * du + dv * dv);
        colour = blend([1.0, 0.95, 0.75], colour, (sun - 0.06) * 16.0);
        let hills = [
            (0.52, 0.09, 2.3, 0.2, [0.45, 0.52, 0.66]),
            (0.45, 0.08, 3.1, 1.7, [0.29, 0.42, 0.50]),
            (0.36, 0.07, 4.2, 3.9, [0.20, 0.36, 0.33]),
        ];
        for (base, swing, waves, phase, paint) in hills {
            let edge = base + swing * libm::sin(u * waves * 2.0 + phase) + 0.02 * noise(u, 0.0, (24, 1), 3);
            if v < edge {
                colour = shade(paint, 0.85 + 0.3 * noise(u, v, (20, 30), 11));
            }
        }
        if v < 0.24 {
            let ripple = noise(u, v, (5, 60), 21);
            colour = blend([0.30, 0.44, 0.52], [0.95, 0.74, 0.50], ripple * 0.9 - 0.15);
        }
        let shore = 0.10 + 0.05 * libm::sin(u * 4.0 + 0.6);
        if v < shore {
            colour = blend([0.22, 0.30, 0.12], [0.62, 0.55, 0.22], noise(u, v, (30, 24), 31));
        }
        colour
    })
}

/// A clock face: twelve marks on white.
pub fn clock_face(size: u32) -> RgbImage {
    picture(size, size, |u, v| {
        let (x, y) = (u * 2.0 - 1.0, v * 2.0 - 1.0);
        let radius = libm::sqrt(x * x + y * y);
        let hour = libm::atan2(x, y) / core::f64::consts::TAU * 12.0;
        let off = (hour - hour.round()).abs() * radius;
        let quarter = (hour.round() as i64).rem_euclid(3) == 0;
        let (inner, half_width) = if quarter { (0.66, 0.075) } else { (0.76, 0.04) };
        let marked = radius > inner && radius < 0.88 && off < half_width;
        if marked { [0.12, 0.12, 0.13] } else { [0.95, 0.94, 0.90] }
    })
}
