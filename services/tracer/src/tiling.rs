//! Square tiles of an image.

/// Edge of the square tiles into which an image is divided, pixels.
pub(crate) const TILE: u32 = 16;

/// The tiles of an image, in row-major order. Tiles at the right and lower edges may be smaller.
#[derive(Debug, Clone, Copy)]
pub struct Tiling {
    width: u32,
    height: u32,
    edge: u32,
}

impl Tiling {
    /// Tiles of at most `edge` × `edge` pixels. All arguments must be at least 1.
    pub fn new(width: u32, height: u32, edge: u32) -> Self {
        Self { width, height, edge }
    }

    /// Number of tiles.
    pub fn count(&self) -> u32 {
        self.width.div_ceil(self.edge) * self.height.div_ceil(self.edge)
    }

    /// Row-major indices of a tile's pixels, ascending.
    pub fn pixels(&self, tile: u32) -> Vec<u32> {
        let Self { width, height, edge } = *self;
        let columns = width.div_ceil(edge);
        let (x0, y0) = (tile % columns * edge, tile / columns * edge);
        let columns = x0..(x0 + edge).min(width);
        (y0..(y0 + edge).min(height)).flat_map(|y| columns.clone().map(move |x| y * width + x)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_is_in_one_tile() {
        for (width, height, edge) in [(1, 1, 16), (16, 16, 16), (17, 33, 16), (9, 2, 8), (100, 7, 3)] {
            let tiling = Tiling::new(width, height, edge);
            let tiles: Vec<Vec<u32>> = (0..tiling.count()).map(|tile| tiling.pixels(tile)).collect();
            assert!(tiles.iter().all(|tile| !tile.is_empty() && tile.len() as u32 <= edge * edge));
            let mut all = tiles.concat();
            all.sort_unstable();
            assert!(all.into_iter().eq(0..width * height), "{width} x {height} by {edge}");
        }
    }
}
