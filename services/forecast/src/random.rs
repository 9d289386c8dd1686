//! Counter-based random numbers: pure functions of the counters, repeatable in any order.

/// 2^64 divided by the golden ratio: the step of the Kronecker sequence and the increment of SplitMix64.
pub(crate) use forelight_random::STEP as GOLDEN_STEP;
use forelight_random::mix;

/// One uniform 64-bit number for these counters. Numbers for different counters are independent.
pub(crate) fn hash(counters: &[u64]) -> u64 {
    counters.iter().fold(GOLDEN_STEP, |state, &counter| {
        mix(state.wrapping_add(GOLDEN_STEP) ^ mix(counter ^ GOLDEN_STEP))
    })
}

/// A number below `limit` from a uniform 64-bit one, with a bias of `limit` / 2⁶⁴. 0 for a limit of 0.
pub(crate) fn below(number: u64, limit: u64) -> u64 {
    ((u128::from(number) * u128::from(limit)) >> 64) as u64
}

#[cfg(test)]
mod tests {
    use super::hash;

    #[test]
    fn every_counter_and_its_place_matters() {
        assert_ne!(hash(&[1, 2]), hash(&[2, 1]));
        assert_ne!(hash(&[0]), hash(&[0, 0]));
        assert_eq!(hash(&[7, 8, 9]), hash(&[7, 8, 9]));
    }

    #[test]
    fn numbers_fill_sixteen_bins_evenly() {
        let mut bins = [0u32; 16];
        for i in 0..16_000 {
            bins[(hash(&[42, i]) >> 60) as usize] += 1;
        }
        let chi_square: f64 = bins.iter().map(|&b| (f64::from(b) - 1000.0).powi(2) / 1000.0).sum();
        assert!(chi_square < 37.7, "15 degrees of freedom, 0.1 % level: {chi_square}");
    }
}
