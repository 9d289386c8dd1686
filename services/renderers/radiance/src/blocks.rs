//! The order of a frame's pixels: square blocks, in rows from the top. Rays of neighbours use the same parts
//! of the octree, and a block's cost can be told.

use forelight_renderer::door::{Common, Region};

/// Side of a block, pixels.
pub(crate) const SIDE: u32 = 8;

/// Blocks of an image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Blocks {
    width: u32,
    height: u32,
}

impl Blocks {
    pub fn new(common: &Common) -> Self {
        Self { width: common.width, height: common.height }
    }

    /// Blocks in a row.
    pub fn columns(self) -> u32 {
        self.width.div_ceil(SIDE)
    }

    /// Number of blocks.
    pub fn count(self) -> u32 {
        self.columns() * self.height.div_ceil(SIDE)
    }

    /// The block of a pixel.
    pub fn of(self, pixel: u32) -> u32 {
        pixel / self.width / SIDE * self.columns() + pixel % self.width / SIDE
    }

    /// Pixels of a block, in rows from the top.
    pub fn pixels(self, block: u32) -> Vec<u32> {
        let (x, y) = (block % self.columns() * SIDE, block / self.columns() * SIDE);
        let region = Region { x, y, width: SIDE.min(self.width - x), height: SIDE.min(self.height - y) };
        pixels_of(&region, self.width)
    }
}

/// Pixels of a region of an image of this width, in rows from the top.
pub(crate) fn pixels_of(region: &Region, width: u32) -> Vec<u32> {
    let Region { x, y, width: columns, height: rows } = *region;
    (y..y + rows).flat_map(|row| (x..x + columns).map(move |column| row * width + column)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_hold_every_pixel_once() {
        for (width, height) in [(16, 8), (17, 9), (3, 2), (1, 100)] {
            let blocks = Blocks::new(&Common { width, height, samples: 1, seed: 0 });
            for block in 0..blocks.count() {
                assert!(blocks.pixels(block).into_iter().all(|pixel| blocks.of(pixel) == block));
            }
            let mut all: Vec<u32> = (0..blocks.count()).flat_map(|block| blocks.pixels(block)).collect();
            all.sort_unstable();
            assert!(all.into_iter().eq(0..width * height), "{width} × {height}");
        }
    }
}
