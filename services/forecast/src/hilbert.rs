//! The Hilbert curve: an order of the pixels in which neighbours are also neighbours in the image. Picks
//! spread evenly along it are spread evenly over an object of any shape, so smooth changes of cost add little
//! error.

/// Position of pixel (x, y) along the Hilbert curve (Hilbert 1891) over a square of 2^`order` pixels a side.
/// Each level gives two bits, and turns the quadrant so that the curve joins up.
pub(crate) fn hilbert(order: u32, mut x: u32, mut y: u32) -> u64 {
    let mut place = 0u64;
    for level in (0..order).rev() {
        let right = (x >> level) & 1;
        let upper = (y >> level) & 1;
        place = (place << 2) | u64::from((3 * right) ^ upper);
        let mask = (1u32 << level) - 1;
        x &= mask;
        y &= mask;
        if upper == 0 {
            if right == 1 {
                x ^= mask;
                y ^= mask;
            }
            std::mem::swap(&mut x, &mut y);
        }
    }
    place
}

/// The smallest order whose square holds an image of this width and height.
pub(crate) fn order_for(width: u32, height: u32) -> u32 {
    let side = width.max(height).max(1);
    u32::BITS - (side - 1).leading_zeros()
}

#[cfg(test)]
mod tests {
    use super::{hilbert, order_for};

    #[test]
    fn the_curve_visits_every_pixel_once_and_steps_to_a_neighbour() {
        let order = 4;
        let side = 1u32 << order;
        let mut pixels: Vec<(u64, i64, i64)> = (0..side * side)
            .map(|i| (hilbert(order, i % side, i / side), i64::from(i % side), i64::from(i / side)))
            .collect();
        pixels.sort_unstable();
        for (expected, pair) in pixels.windows(2).enumerate() {
            assert_eq!(pair[0].0, expected as u64);
            assert_eq!((pair[0].1 - pair[1].1).abs() + (pair[0].2 - pair[1].2).abs(), 1);
        }
    }

    #[test]
    fn the_order_is_just_large_enough() {
        assert_eq!(order_for(1, 1), 0);
        assert_eq!(order_for(2, 1), 1);
        assert_eq!(order_for(256, 256), 8);
        assert_eq!(order_for(1920, 1080), 11);
    }
}
