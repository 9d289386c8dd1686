//! How an image settles, as it shows itself.
//!
//! How the variance of a pixel falls with its samples is guessed from a profile: few pixels, with fewer samples than the image has by now.
//! From n to m samples the mean of a pixel moves by V(n) − V(m) in the mean square, for the later mean has the earlier one's samples in
//! it. So all pixels together show how far that guess is off where the image has come to. Tiles that were given many samples are others than
//! those with few (edges of lamps, what shines), and show it apart.

use super::allot::Zone;
use super::law::powers_of_pixel;
use super::survey::Seen;
use crate::interval::Part;
use crate::moments::sum;

/// The guess is thought to be off by this factor at most, either way.
const MOST_OFF: f64 = 4.0;
/// Tiles of equally many samples are believed like so many of all tiles.
const ALL_COUNT: f64 = 4.0;

/// How far the variances of tiles are off that were guessed.
#[derive(Clone, Debug)]
pub(super) struct Settling {
    /// Of tiles with less than 2, 4, 8 … samples, where these say enough of themselves.
    octaves: Vec<Option<Octave>>,
    /// Of all tiles.
    all: Octave,
    /// The octave of each tile.
    of_tiles: Vec<usize>,
}

/// Of tiles with about equally many samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Octave {
    /// Their variance in units of what was guessed.
    pub off: f64,
    /// How sure that is, as a share of it.
    pub doubt: Part,
}

/// What a tile's pixels moved by, and what they were thought to; sums of squares.
#[derive(Clone, Copy)]
struct Moved {
    is: f64,
    guess: f64,
}

impl Settling {
    /// Of tiles that were guessed to be such zones and have so many samples in the mean.
    pub fn new(tiles: &[Vec<Seen>], zones: &[Zone], samples: &[f64]) -> Self {
        let of_tiles: Vec<usize> = samples.iter().map(|n| (n.max(1.0) as u32).ilog2() as usize).collect();
        let moved: Vec<Moved> = tiles.iter().zip(zones).map(|(tile, zone)| Moved::of(tile, zone)).collect();
        let known = |octave: Option<usize>| -> Vec<Moved> {
            let is_of = |of: &usize| octave.is_none_or(|octave| octave == *of);
            let pairs = moved.iter().zip(&of_tiles);
            pairs.filter(|(moved, of)| moved.guess > 0.0 && is_of(of)).map(|(moved, _)| *moved).collect()
        };
        let all = Octave::of_all(&known(None));
        let count = of_tiles.iter().max().map_or(0, |most| most + 1);
        let octaves = (0..count).map(|octave| all.corrected(&known(Some(octave)))).collect();
        Self { octaves, all, of_tiles }
    }

    /// What there is to say of each tile.
    pub fn of_tiles(&self) -> impl Iterator<Item = &Octave> {
        self.of_tiles.iter().map(|&of| self.octaves[of].as_ref().unwrap_or(&self.all))
    }

    /// How sure the sum of the tiles' errors is of that.
    pub fn doubts(&self, errors: &[f64]) -> Vec<Part> {
        // Those that say nothing of themselves are off together.
        let mut sums = vec![0.0; self.octaves.len()];
        let mut of_all = 0.0;
        for (&of, error) in self.of_tiles.iter().zip(errors) {
            *(if self.octaves[of].is_some() { &mut sums[of] } else { &mut of_all }) += error;
        }
        let part = |octave: &Octave, error: f64| Part {
            variance: octave.doubt.variance * error * error,
            ..octave.doubt
        };
        let own = self.octaves.iter().zip(sums).filter_map(|(octave, sum)| Some(part(octave.as_ref()?, sum)));
        own.chain([part(&self.all, of_all)]).collect()
    }

    /// The same as if all of it were sure.
    pub fn undoubted(mut self) -> Self {
        let octaves = self.octaves.iter_mut().flatten();
        octaves.chain([&mut self.all]).for_each(|octave| octave.doubt = SURE);
        self
    }
}

/// Nothing speaks against it.
const SURE: Part = Part { variance: 0.0, degrees_of_freedom: f64::INFINITY };

impl Moved {
    fn of(tile: &[Seen], zone: &Zone) -> Self {
        let guess = |pixel: &Seen, before: u32| {
            let [then, now] = [before, pixel.samples].map(powers_of_pixel);
            sum((0..2).map(|k| zone.variance[k] * (then[k] - now[k])))
        };
        let known = || tile.iter().filter_map(|pixel| Some((pixel, pixel.grown?)));
        Self {
            is: sum(known().map(|(_, (_, square))| square)),
            guess: sum(known().map(|(pixel, (before, _))| guess(pixel, before))),
        }
    }
}

impl Octave {
    /// What these tiles say together: a ratio of sums, and its variance as a share of its square.
    fn of_all(tiles: &[Moved]) -> Self {
        let [is, guess] = [sum(tiles.iter().map(|tile| tile.is)), sum(tiles.iter().map(|tile| tile.guess))];
        if tiles.len() < 2 || is <= 0.0 || !(is / guess).is_finite() {
            return Self { off: 1.0, doubt: SURE };
        }
        let off = is / guess;
        let rest = |tile: &Moved| (tile.is - off * tile.guess) * (tile.is - off * tile.guess);
        let freedom = (tiles.len() - 1) as f64;
        let variance = sum(tiles.iter().map(rest)) / (is * is) * (tiles.len() as f64 / freedom);
        let doubt = Part { variance, degrees_of_freedom: freedom };
        Self { off: off.clamp(1.0 / MOST_OFF, MOST_OFF), doubt }
    }

    /// What some of the tiles that this is of say of themselves: a few of them are believed a little. Nothing, if they show nothing.
    fn corrected(&self, some: &[Moved]) -> Option<Self> {
        let own = Self::of_all(some);
        if own.doubt == SURE {
            return None;
        }
        let count = some.len() as f64;
        let believed = count / (count + ALL_COUNT);
        let off = believed * own.off + (1.0 - believed) * self.off;
        let variance = own.doubt.variance * believed * (own.off / off) * (own.off / off);
        Some(Self { off, doubt: Part { variance, ..own.doubt } })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tiles of 64 pixels that went from two samples to four and moved by `factor` times what was guessed.
    fn tile(factor: f64) -> Vec<Seen> {
        let guess = 3.0 * (1.0 / 8f64.sqrt() - 1.0 / 8.0) + (1.0 / 2.0 - 1.0 / 4.0);
        let pixel = |i: usize| Seen {
            samples: 4,
            brightness: 2.0,
            variance: None,
            cost: 8.0,
            profiled: [3.0, 1.0],
            grown: (!i.is_multiple_of(3)).then_some((2, factor * guess * [0.8, 1.2][i % 2])),
        };
        (0..64).map(pixel).collect()
    }

    fn settling(tiles: &[Vec<Seen>], samples: &[f64]) -> Settling {
        let zone = Zone { pixels: 64.0, variance: [3.0, 1.0], cost: 2.0 };
        Settling::new(tiles, &vec![zone; tiles.len()], samples)
    }

    #[test]
    fn what_the_last_samples_changed_says_how_variance_falls() {
        for (factor, taken) in [(1.0, 1.0), (1.7, 1.7), (0.6, 0.6), (9.0, MOST_OFF)] {
            let found = settling(&vec![tile(factor); 20], &[4.0; 20]);
            let octave = found.of_tiles().next().unwrap();
            assert!((octave.off / taken - 1.0).abs() < 0.02, "{factor}: {found:?}");
            assert!(octave.doubt.variance < 1e-3 && octave.doubt.degrees_of_freedom == 19.0);
        }
        // Where nothing is known the guess stands.
        for tiles in [vec![], vec![tile(2.0)], vec![tile(0.0); 9]] {
            let found = settling(&tiles, &vec![4.0; tiles.len()]);
            assert!(found.of_tiles().all(|octave| *octave == Octave { off: 1.0, doubt: SURE }));
        }
    }

    #[test]
    fn tiles_of_many_samples_speak_for_themselves_where_they_are_many() {
        let tiles: Vec<Vec<Seen>> = [vec![tile(1.0); 40], vec![tile(3.0); 12], vec![tile(4.0); 1]].concat();
        let samples: Vec<f64> = [vec![5.0; 40], vec![70.0; 12], vec![300.0; 1]].concat();
        let found = settling(&tiles, &samples);
        let offs: Vec<f64> = found.of_tiles().map(|octave| octave.off).collect();
        let all = (40.0 + 36.0 + 4.0) / 53.0;
        assert!(offs[0] < 1.06 && offs[45] > 2.6 && offs[45] < 3.0, "{offs:?}");
        assert!((offs[52] - all).abs() < 0.05, "one tile alone is as all are: {offs:?}");
    }

    #[test]
    fn tiles_that_do_not_agree_leave_it_unsure() {
        let split = [vec![tile(6.0); 4], vec![tile(1.0); 16]].concat();
        let found = settling(&split, &[4.0; 20]);
        let of = |found: &Settling| crate::interval::together(&found.doubts(&[2.0; 20])).variance / 1600.0;
        assert!(of(&found) > 0.02, "{found:?}");
        assert_eq!(of(&found.undoubted()), 0.0);
    }
}
