//! The cost of one frame as a power of its size: cost = fixed + slope · pixelsᵖ.
//!
//! A smaller image of a frame is not cheaper in proportion where a renderer adapts to what it sees. Edges
//! grow with the side of an image and not with its area, so a renderer that adds samples at edges has a power
//! below one. Three sizes of a frame determine the power. Other frames of the shot share it.

use crate::sample_line::SampleCost;

/// Powers from edges alone to a little more than the area.
const LEAST: f64 = 0.4;
const MOST: f64 = 1.25;

/// Halvings of the interval of powers. They leave 10⁻⁹ of it.
const HALVINGS: usize = 30;

/// The power of the pixels in which costs are lines: the mean over the frames that were measured at three
/// sizes at least. One if no frame tells it.
pub fn size_power(frames: &[&[SampleCost]]) -> f64 {
    let powers: Vec<f64> = frames.iter().filter_map(|costs| power(costs)).collect();
    if powers.is_empty() { 1.0 } else { crate::moments::sum(powers.iter().copied()) / powers.len() as f64 }
}

/// Measured costs at other amounts, in which they are a line that ends at the `whole` frame:
/// whole · (pixels / whole)ᵖ.
pub fn straightened(costs: &[SampleCost], whole: u32, power: f64) -> Vec<SampleCost> {
    let straight = |cost: &SampleCost| {
        let share = f64::from(cost.samples) / f64::from(whole.max(1));
        SampleCost { samples: (f64::from(whole) * libm::pow(share, power)).round() as u32, ..*cost }
    };
    costs.iter().map(straight).collect()
}

/// The power of one frame, from the costs at its three largest sizes. `None` if there are fewer, or larger
/// images do not cost more.
fn power(costs: &[SampleCost]) -> Option<f64> {
    let mut costs = costs.to_vec();
    costs.sort_by_key(|cost| std::cmp::Reverse(cost.samples));
    costs.dedup_by_key(|cost| cost.samples);
    let [large, middle, small, ..] = costs[..] else { return None };
    let more = |a: SampleCost, b: SampleCost| {
        a.cpu_nanos.checked_sub(b.cpu_nanos).filter(|&more| more > 0).map(|more| more as f64)
    };
    let measured = more(large, middle)? / more(middle, small)?;
    let size = |cost: SampleCost| f64::from(cost.samples) / f64::from(large.samples);
    // Grows with the power.
    let ratio = |power: f64| {
        let of = |cost| libm::pow(size(cost), power);
        (1.0 - of(middle)) / (of(middle) - of(small))
    };
    let (mut low, mut high) = (LEAST, MOST);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if ratio(middle) < measured { low = middle } else { high = middle }
    }
    Some(0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn costs(power: f64, sizes: &[u32]) -> Vec<SampleCost> {
        let cost = |&pixels: &u32| 1e7 + 1e5 * libm::pow(f64::from(pixels), power);
        sizes.iter().map(|pixels| SampleCost { samples: *pixels, cpu_nanos: cost(pixels) as u64 }).collect()
    }

    #[test]
    fn three_sizes_determine_the_power() {
        for true_power in [0.5, 0.8, 1.0, 1.1] {
            let found = size_power(&[&costs(true_power, &[900, 3600, 14_400])]);
            assert!((found - true_power).abs() < 1e-3, "{found} for {true_power}");
        }
    }

    #[test]
    fn the_power_straightens_costs_to_a_line() {
        let straight = straightened(&costs(0.7, &[0, 900, 14_400, 57_600]), 57_600, 0.7);
        let [fixed, small, _, whole] = straight[..] else { panic!() };
        assert_eq!((fixed.samples, whole.samples), (0, 57_600));
        let slope = (small.cpu_nanos - fixed.cpu_nanos) as f64 / f64::from(small.samples);
        let expected = fixed.cpu_nanos as f64 + slope * f64::from(whole.samples);
        assert!((expected / whole.cpu_nanos as f64 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn frames_without_a_power_leave_costs_alone() {
        assert_eq!(size_power(&[&costs(0.7, &[900, 3600])]), 1.0);
        let flat = [(900, 5), (3600, 5), (14_400, 4)];
        let flat = flat.map(|(samples, cpu_nanos)| SampleCost { samples, cpu_nanos });
        assert_eq!(size_power(&[&flat]), 1.0);
        let measured = costs(1.0, &[900, 3600]);
        assert_eq!(straightened(&measured, 57_600, 1.0), measured);
    }
}
