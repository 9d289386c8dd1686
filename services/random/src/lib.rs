//! SplitMix64 (Steele, Lea, Flood 2014, "Fast splittable pseudorandom number generators"). A seed gives the
//! same numbers on every machine.

/// The increment of the state of a sequence: 2⁶⁴ divided by the golden ratio.
pub const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// The finaliser of SplitMix64: every input bit affects every output bit.
#[inline]
pub const fn mix(mut word: u64) -> u64 {
    word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ (word >> 31)
}

/// Hashes a word. The result is the first number of the sequence that the word seeds.
#[inline]
pub const fn hash(word: u64) -> u64 {
    mix(word.wrapping_add(STEP))
}

/// A sequence of random numbers.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// Starts the sequence of a seed.
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns the next 64 random bits.
    #[inline]
    pub const fn number(&mut self) -> u64 {
        let number = hash(self.0);
        self.0 = self.0.wrapping_add(STEP);
        number
    }

    /// Returns a number in `0..end`, or 0 if `end` is 0.
    pub const fn below(&mut self, end: u64) -> u64 {
        self.number() % if end == 0 { 1 } else { end }
    }

    /// Returns an index in `0..count`, or 0 if `count` is 0.
    pub const fn index(&mut self, count: usize) -> usize {
        self.below(count as u64) as usize
    }

    /// Returns a number uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.number() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a number uniform in (0, 1), whose logarithm is finite.
    pub fn open_uniform(&mut self) -> f64 {
        ((self.number() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::{Random, hash};

    #[test]
    fn the_sequence_is_that_of_the_reference_implementation() {
        // Vigna's splitmix64.c with the state 1234567.
        let mut random = Random::new(1_234_567);
        let numbers: [u64; 3] = std::array::from_fn(|_| random.number());
        assert_eq!(
            numbers,
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]
        );
        assert_eq!(hash(1_234_567), numbers[0]);
    }

    #[test]
    fn numbers_stay_in_their_ranges() {
        let mut random = Random::new(5);
        assert!((0..1000).all(|_| random.below(7) < 7 && random.index(3) < 3));
        assert!((0..1000).all(|_| (0.0..1.0).contains(&random.uniform())));
        assert!((0..1000).all(|_| (1e-17..=1.0).contains(&random.open_uniform())));
        assert_eq!((random.below(0), random.index(0)), (0, 0));
    }
}
