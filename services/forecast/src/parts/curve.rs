//! The order of an image's pixels along a space-filling curve.

use crate::hilbert::hilbert;
use std::ops::Range;

/// Edge of the square tiles that the curve visits, pixels. Within a tile, pixels are in rows.
const EDGE: u32 = 8;

/// The curve's square has this many levels: more cells a side than an image has tiles.
const ORDER: u32 = 16;

/// The pixels of an image along a Hilbert curve over its tiles. A pixel's number in this order is its *place*.
/// A range of places is compact: its pixels are close together in the image.
#[derive(Debug, Clone)]
pub struct PixelCurve {
    width: u32,
    height: u32,
    /// First column and row of each tile, in order.
    tiles: Vec<(u32, u32)>,
    /// Place of each tile's first pixel, and the number of pixels.
    starts: Vec<u32>,
}

impl PixelCurve {
    /// The curve of an image of this size. The curve's square is stretched over the image, so that it stays
    /// in one piece for images of any shape.
    pub fn new(width: u32, height: u32) -> Self {
        let (columns, rows) = (width.div_ceil(EDGE), height.div_ceil(EDGE));
        // The middle of a tile as a cell of the square.
        let cell = |tile: u32, tiles: u32| ((2 * u64::from(tile) + 1) << ORDER) / (2 * u64::from(tiles));
        let place = |&(x, y): &(u32, u32)| {
            // Both are below 2¹⁶.
            hilbert(ORDER, cell(x, columns) as u32, cell(y, rows) as u32)
        };
        let mut tiles: Vec<(u32, u32)> = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))).collect();
        tiles.sort_by_cached_key(place);
        let mut curve = Self { width, height, tiles: Vec::new(), starts: vec![0] };
        curve.tiles = tiles.into_iter().map(|(x, y)| (x * EDGE, y * EDGE)).collect();
        let mut start = 0;
        for tile in 0..curve.tiles.len() {
            let (columns, rows) = curve.sides(tile);
            start += columns.len() as u32 * rows.len() as u32;
            curve.starts.push(start);
        }
        curve
    }

    /// Width of the image, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height of the image, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Number of pixels.
    pub fn count(&self) -> u32 {
        self.width * self.height
    }

    /// Row-major index of the pixel at a place, which must be below [`Self::count`].
    pub fn pixel(&self, place: u32) -> u32 {
        let tile = self.tile_of(place);
        self.pixel_of(tile, place - self.starts[tile])
    }

    /// Row-major indices of the pixels at these places, in order. Places beyond the last are left out.
    pub fn pixels(&self, places: Range<u32>) -> Vec<u32> {
        let Range { start, end } = places.start..places.end.min(self.count());
        if start >= end {
            return Vec::new();
        }
        let in_tile = |tile: usize| {
            let (first, next) = (self.starts[tile], self.starts[tile + 1]);
            (start.max(first)..end.min(next)).map(move |place| self.pixel_of(tile, place - first))
        };
        (self.tile_of(start)..=self.tile_of(end - 1)).flat_map(in_tile).collect()
    }

    fn tile_of(&self, place: u32) -> usize {
        self.starts.partition_point(|&start| start <= place) - 1
    }

    /// Row-major index of a pixel by its place within a tile.
    fn pixel_of(&self, tile: usize, inside: u32) -> u32 {
        let (columns, rows) = self.sides(tile);
        let width = columns.len() as u32;
        (rows.start + inside / width) * self.width + columns.start + inside % width
    }

    /// Columns and rows of a tile.
    fn sides(&self, tile: usize) -> (Range<u32>, Range<u32>) {
        let (x, y) = self.tiles[tile];
        (x..(x + EDGE).min(self.width), y..(y + EDGE).min(self.height))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: [(u32, u32); 8] =
        [(1, 1), (8, 8), (9, 2), (100, 7), (7, 100), (160, 90), (1280, 720), (333, 517)];

    #[test]
    fn every_pixel_has_one_place_at_any_size() {
        for (width, height) in SIZES {
            let curve = PixelCurve::new(width, height);
            let mut all = curve.pixels(0..u32::MAX);
            assert_eq!(all.len() as u32, curve.count());
            assert!(all.iter().zip(0..).all(|(&pixel, place)| curve.pixel(place) == pixel));
            let (from, to) = (curve.count() / 3, curve.count() / 2);
            assert_eq!(curve.pixels(from..to), all[from as usize..to as usize]);
            assert!(curve.pixels(to..from).is_empty() && curve.pixels(curve.count()..u32::MAX).is_empty());
            all.sort_unstable();
            assert!(all.into_iter().eq(0..width * height), "{width} × {height}");
        }
    }

    /// The edge of a compact part of n pixels is a few times √n long. In rows, it is as long as the image is wide.
    #[test]
    fn the_outline_of_a_part_is_about_as_long_as_that_of_squares() {
        for (width, height) in [(160, 90), (1280, 720), (333, 517), (1000, 250)] {
            let curve = PixelCurve::new(width, height);
            for parts in [2, 7, 64] {
                let mut part_of = vec![0; (width * height) as usize];
                for part in 0..parts {
                    let cut = |at: u32| (u64::from(curve.count()) * u64::from(at) / u64::from(parts)) as u32;
                    curve
                        .pixels(cut(part)..cut(part + 1))
                        .into_iter()
                        .for_each(|i| part_of[i as usize] = part);
                }
                let differ = |a: u32, b: u32| u32::from(part_of[a as usize] != part_of[b as usize]);
                let borders: u32 = (0..width * height)
                    .map(|i| {
                        let right = if i % width + 1 < width { differ(i, i + 1) } else { 0 };
                        let below = if i / width + 1 < height { differ(i, i + width) } else { 0 };
                        right + below
                    })
                    .sum();
                // A grid of squares: two sides of each square are its own.
                let of_squares =
                    2.0 * f64::from(parts) * (f64::from(width * height) / f64::from(parts)).sqrt();
                let share = f64::from(borders) / of_squares;
                assert!(share < 1.8, "{width} × {height}, {parts} parts: {share}");
            }
        }
    }
}
