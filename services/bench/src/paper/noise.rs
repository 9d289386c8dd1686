//! A lower bound of the error of forecasts from a preview.

use forelight_forecast::Cost;

/// Least relative root mean square error of a frame's work, for `samples` pixels allocated to the surfaces
/// that the preview shows. Everything but the noise between neighbouring pixels of a surface counts as known.
/// The bound is Σ N_h σ_h / √n (Neyman 1934), where 2 σ_h² is the mean squared difference of two neighbours
/// of the same surface.
///
/// This noise is chance in pixels with few samples (choice of light, survival of mirror rays) and detail
/// below pixel size. The preview shows neither.
pub fn floor(ids: &[u32], width: u32, pixels: &[Cost], samples: u32, actual: f64) -> f64 {
    let width = width as usize;
    let strata = ids.iter().max().map_or(0, |&most| most as usize + 1);
    let (mut squares, mut pairs, mut sizes) = (vec![0.0; strata], vec![0u64; strata], vec![0u64; strata]);
    for (here, &id) in ids.iter().enumerate() {
        let h = id as usize;
        sizes[h] += 1;
        let right = (!(here + 1).is_multiple_of(width)).then_some(here + 1);
        for other in [right, Some(here + width)].into_iter().flatten() {
            if ids.get(other) == Some(&id) {
                squares[h] += (pixels[here].work as f64 - pixels[other].work as f64).powi(2);
                pairs[h] += 1;
            }
        }
    }
    let deviation = |h: usize| if pairs[h] == 0 { 0.0 } else { (squares[h] / (2 * pairs[h]) as f64).sqrt() };
    let sum: f64 = (0..strata).map(|h| sizes[h] as f64 * deviation(h)).sum();
    let samples = f64::from(samples).min(ids.len() as f64);
    // Finite population correction.
    let unseen = (1.0 - samples / ids.len().max(1) as f64).max(0.0);
    if actual > 0.0 && samples > 0.0 { sum * (unseen / samples).sqrt() / actual } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::floor;
    use forelight_forecast::Cost;

    fn costs(works: impl Iterator<Item = u64>) -> Vec<Cost> {
        works.map(|work| Cost { work, ..Cost::default() }).collect()
    }

    #[test]
    fn surfaces_of_their_own_even_cost_make_no_noise() {
        let ids: Vec<u32> = (0..64).map(|pixel| u32::from(pixel % 8 > 3)).collect();
        let pixels = costs(ids.iter().map(|&id| 100 + 900 * u64::from(id)));
        assert_eq!(floor(&ids, 8, &pixels, 4, 1.0), 0.0);
    }

    #[test]
    fn noise_is_the_difference_of_neighbours() {
        // A chequerboard of 100 and 300: all neighbours differ by 200, so σ = 200 / √2.
        let pixels = costs((0..64u64).map(|pixel| if (pixel % 8 + pixel / 8) % 2 == 0 { 100 } else { 300 }));
        let expected = 64.0 * (200.0 / 2f64.sqrt()) * (0.75f64 / 16.0).sqrt() / 12_800.0;
        let found = floor(&[0; 64], 8, &pixels, 16, 12_800.0);
        assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
        assert_eq!(floor(&[0; 64], 8, &pixels, 64, 12_800.0), 0.0);
        assert_eq!(floor(&[], 8, &[], 64, 0.0), 0.0);
    }
}
