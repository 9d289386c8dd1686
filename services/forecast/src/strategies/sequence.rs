//! Halton and Hammersley points after Wong, Luk and Heng 1997, "Sampling with Hammersley and Halton points".

use super::image::Image;

/// Φ_b(k): the digits of `k` in the given base, mirrored at the point. From 0 up to, but not including, 1.
fn radical_inverse(base: u32, mut k: u32) -> f64 {
    let (mut inverse, mut digit) = (0.0, 1.0);
    while k > 0 {
        digit /= f64::from(base);
        inverse += digit * f64::from(k % base);
        k /= base;
    }
    inverse
}

/// The paper's strategy 3: points (Φ₂(k), Φ₇(k)).
pub(super) fn halton(image: Image, samples: u32, shift: [f64; 2]) -> Vec<u32> {
    place(image, (0..samples).map(|k| [radical_inverse(2, k), radical_inverse(7, k)]), shift)
}

/// The paper's strategy 4: points (k / n, Φ₂(k)).
pub(super) fn hammersley(image: Image, samples: u32, shift: [f64; 2]) -> Vec<u32> {
    let points = (0..samples).map(|k| [f64::from(k) / f64::from(samples), radical_inverse(2, k)]);
    place(image, points, shift)
}

/// The pixels that contain these points of the unit square, shifted by `shift` modulo 1 (Cranley, Patterson
/// 1976). A pixel that is taken is replaced by the next free one in row order.
fn place(image: Image, points: impl Iterator<Item = [f64; 2]>, shift: [f64; 2]) -> Vec<u32> {
    let pixels = image.pixels();
    let mut free = NextFree { next: (0..pixels).collect() };
    let at = |length: u32, value: f64| ((value.fract() * f64::from(length)) as u32).min(length - 1);
    points
        .take(pixels as usize)
        .map(|[x, y]| {
            let pixel = at(image.height, y + shift[1]) * image.width + at(image.width, x + shift[0]);
            free.take(pixel)
        })
        .collect()
}

/// The next free place: a forest whose roots are free (path halving, Tarjan and van Leeuwen 1984).
struct NextFree {
    next: Vec<u32>,
}

impl NextFree {
    /// Takes the first free place from `place` on. There must be one.
    fn take(&mut self, place: u32) -> u32 {
        let mut at = place as usize;
        while self.next[at] as usize != at {
            self.next[at] = self.next[self.next[at] as usize];
            at = self.next[at] as usize;
        }
        let after = (at + 1) % self.next.len();
        // The last free place has no other to point to. This is never followed, because then nothing is free.
        self.next[at] = after as u32;
        at as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_mirrored() {
        assert_eq!(radical_inverse(2, 6), 0.375);
        assert_eq!(radical_inverse(7, 1), 1.0 / 7.0);
        assert!((radical_inverse(7, 8) - (1.0 / 7.0 + 1.0 / 49.0)).abs() < 1e-15);
        assert_eq!(radical_inverse(2, 0), 0.0);
    }

    #[test]
    fn hammersleys_points_have_one_in_every_column_and_every_row_of_a_matching_grid() {
        let image = Image { width: 256, height: 256 };
        let found = hammersley(image, 256, [0.0; 2]);
        for coordinate in [|p: &u32| p % 256, |p: &u32| p / 256] {
            let mut along: Vec<u32> = found.iter().map(coordinate).collect();
            along.sort_unstable();
            assert!(along.into_iter().eq(0..256));
        }
    }

    #[test]
    fn haltons_points_fill_the_boxes_of_their_bases_evenly() {
        // A box of 4 columns and 7 rows: 28 successive points fall into its cells once each.
        let image = Image { width: 4, height: 7 };
        let mut found = halton(image, 28, [0.0; 2]);
        found.sort_unstable();
        assert!(found.into_iter().eq(0..28), "no point had to move on");
    }

    #[test]
    fn as_many_points_as_pixels_are_every_pixel_once() {
        for (width, height) in [(1, 1), (5, 3), (32, 32)] {
            let image = Image { width, height };
            for mut found in
                [halton(image, width * height, [0.3, 0.9]), hammersley(image, width * height, [0.3, 0.9])]
            {
                found.sort_unstable();
                assert!(found.into_iter().eq(0..width * height));
            }
        }
    }
}
