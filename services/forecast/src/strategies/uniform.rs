//! Uniform random pixels.

use crate::random::{below, hash};

/// Draws `samples` entries of `list`, or all, without replacement, by the first steps of a shuffle (Fisher,
/// Yates 1938; Durstenfeld 1964). `counters` are those of the random numbers.
pub(super) fn choose(mut list: Vec<u32>, samples: usize, counters: [u64; 3]) -> Vec<u32> {
    let samples = samples.min(list.len());
    let [seed, frame, group] = counters;
    for place in 0..samples {
        let number = hash(&[seed, frame, group, place as u64]);
        let other = place + below(number, (list.len() - place) as u64) as usize;
        list.swap(place, other);
    }
    list.truncate(samples);
    list
}

#[cfg(test)]
mod tests {
    use super::choose;

    #[test]
    fn every_entry_comes_equally_often_and_none_twice_in_one_draw() {
        let mut times = [0u32; 20];
        for seed in 0..4000 {
            let mut found = choose((0..20).collect(), 5, [seed, 0, 0]);
            found.iter().for_each(|&entry| times[entry as usize] += 1);
            found.sort_unstable();
            found.dedup();
            assert_eq!(found.len(), 5);
        }
        let chi_square: f64 = times.iter().map(|&t| (f64::from(t) - 1000.0).powi(2) / 1000.0).sum();
        assert!(chi_square < 43.8, "19 degrees of freedom, 0.1 % level: {chi_square}");
    }

    #[test]
    fn more_than_all_are_all() {
        let mut found = choose(vec![3, 1, 4], 10, [9, 9, 9]);
        found.sort_unstable();
        assert_eq!(found, [1, 3, 4]);
        assert!(choose(Vec::new(), 10, [0; 3]).is_empty());
    }
}
