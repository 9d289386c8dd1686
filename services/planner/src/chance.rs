//! Stateless random numbers. Each is a hash of a seed and of indices that say what it is for, so the order of
//! draws does not matter.

use forelight_random::{STEP, hash, mix};

/// 64 random bits for this seed and these indices, mixed in one by one with SplitMix64.
pub fn bits(seed: u64, indices: &[u64]) -> u64 {
    let mixed = |word: u64, &index: &u64| mix(word ^ hash(index.wrapping_mul(STEP)));
    indices.iter().fold(hash(seed), mixed)
}

/// Uniform in the open interval (0, 1).
pub fn uniform(seed: u64, indices: &[u64]) -> f64 {
    ((bits(seed, indices) >> 12) as f64 + 0.5) / (1u64 << 52) as f64
}

/// Standard normal, by Box and Muller (1958). Uses `libm`, so that every machine draws the same numbers.
pub fn normal(seed: u64, indices: &[u64]) -> f64 {
    let first = uniform(seed, indices);
    let second = uniform(!seed, indices);
    libm::sqrt(-2.0 * libm::log(first)) * libm::cos(std::f64::consts::TAU * second)
}

/// A uniform integer from `low` to `high`, both included.
pub fn between(seed: u64, indices: &[u64], low: i64, high: i64) -> i64 {
    let count = i128::from(high) - i128::from(low) + 1;
    let offset = (i128::from(bits(seed, indices)) * count.max(1)) >> 64;
    // At most `high`.
    i64::try_from(i128::from(low) + offset).unwrap_or(high)
}

#[cfg(test)]
mod tests {
    use super::{between, normal, uniform};

    #[test]
    fn draws_have_the_moments_that_they_should_have() {
        let count = 20_000u64;
        let mean = |draw: &dyn Fn(u64) -> f64| (0..count).map(draw).sum::<f64>() / count as f64;
        assert!((mean(&|i| uniform(1, &[i])) - 0.5).abs() < 0.01);
        assert!(mean(&|i| normal(1, &[i, 7])).abs() < 0.03);
        assert!((mean(&|i| normal(2, &[7, i]).powi(2)) - 1.0).abs() < 0.05);
        assert!((mean(&|i| normal(2, &[7, i]) * normal(2, &[7, i + 1]))).abs() < 0.03);
        assert!((mean(&|i| between(3, &[i], -3, 3) as f64)).abs() < 0.06);
        assert!((0..1000).all(|i| (-3..=3).contains(&between(3, &[i], -3, 3))));
    }
}
