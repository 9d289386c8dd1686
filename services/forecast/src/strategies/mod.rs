//! The seven strategies that the paper compares (its section 4), and two of ours, behind one door.
//!
//! A strategy says which pixels of a frame are profiled, and how what they cost is expanded to all pixels:
//!
//! | strategy | pixels | expansion | its own variance |
//! | --- | --- | --- | --- |
//! | [`Strategy::RegularGrid`] | the centre of every cell | flat mean | differences of neighbouring cells |
//! | [`Strategy::Jittered`] | any pixel of every cell | flat mean | differences of neighbouring cells |
//! | [`Strategy::Halton`] | Halton's points, bases 2 and 7 | flat mean | none known |
//! | [`Strategy::Hammersley`] | Hammersley's points, base 2 | flat mean | none known |
//! | [`Strategy::Random`] | any pixels | flat mean | that of a simple random sample |
//! | [`Strategy::RandomArea`] | the same | by the area that is nearest to each | none known |
//! | [`Strategy::PaperSnapshot`] | one for every object and material, the rest by size | by object and material | by stratum |
//! | [`Strategy::Systematic`] | every so many-th along objects and materials, by expected cost | by expected cost | differences of neighbours along the order |
//! | [`Strategy::Snapshot`] | [`FrameDesign`]'s | by groups of objects and materials | by group, with a tail allowance |
//!
//! The first six are *blind*: they know no preview, and to them a frame is one stratum. Where no variance is known, that of a simple
//! random sample of as many pixels stands in; it is too large for points that are spread evenly.
//!
//! Grid, Halton and Hammersley leave nothing to chance. With seed 0 they are the paper's; with other seeds the same points are
//! moved by a random vector, and around at the border (of the cell, and of the image), so that it can be seen how much of an
//! error is luck.
//!
//! | file | family |
//! | --- | --- |
//! | `cells` | grid, jittered |
//! | `sequence` | Halton, Hammersley |
//! | `uniform` | random |
//! | `snapshot` | the paper's Snapshot |
//! | `systematic` | every so many-th pixel of an order |

mod cells;
mod sequence;
mod snapshot;
mod systematic;
mod uniform;

use serde::{Deserialize, Serialize};

use crate::choose::{FrameDesign, Pick, count_pixels};
use crate::cost::{Cost, Observation};
use crate::error::ForecastError;
use crate::estimate::{FrameEstimate, FrameFit, estimate_fit};
use crate::expansion::Expansion;
use crate::interval::Calibration;
use crate::nearest::nearest;
use crate::random::hash;
use crate::strata::Stratum;

/// A way to choose pixels and to expand what they cost; see the module's table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Strategy {
    /// The paper's strategy 1.
    RegularGrid,
    /// The paper's strategy 2.
    Jittered,
    /// The paper's strategy 3.
    Halton,
    /// The paper's strategy 4.
    Hammersley,
    /// The paper's strategy 5.
    Random,
    /// The paper's strategy 6.
    RandomArea,
    /// The paper's strategy 7, as it states it.
    #[serde(rename = "snapshot-paper")]
    PaperSnapshot,
    /// By the preview, but in one pass and without strata of single objects: one order of all pixels, sampled systematically.
    #[serde(rename = "snapshot-systematic")]
    Systematic,
    /// Ours: what this crate's documentation describes.
    Snapshot,
}

impl Strategy {
    /// All of them, in the paper's order.
    pub const ALL: [Strategy; 9] = [
        Strategy::RegularGrid,
        Strategy::Jittered,
        Strategy::Halton,
        Strategy::Hammersley,
        Strategy::Random,
        Strategy::RandomArea,
        Strategy::PaperSnapshot,
        Strategy::Systematic,
        Strategy::Snapshot,
    ];

    /// Its name on a command line and in documents; the same as serde's.
    pub const fn name(self) -> &'static str {
        match self {
            Strategy::RegularGrid => "regular-grid",
            Strategy::Jittered => "jittered",
            Strategy::Halton => "halton",
            Strategy::Hammersley => "hammersley",
            Strategy::Random => "random",
            Strategy::RandomArea => "random-area",
            Strategy::PaperSnapshot => "snapshot-paper",
            Strategy::Systematic => "snapshot-systematic",
            Strategy::Snapshot => "snapshot",
        }
    }

    /// Its name in a table.
    pub const fn title(self) -> &'static str {
        match self {
            Strategy::RegularGrid => "Regular grid",
            Strategy::Jittered => "Jittered",
            Strategy::Halton => "Halton",
            Strategy::Hammersley => "Hammersley",
            Strategy::Random => "Random, average",
            Strategy::RandomArea => "Random, area weighted",
            Strategy::PaperSnapshot => "Snapshot, the paper's",
            Strategy::Systematic => "Snapshot, systematic",
            Strategy::Snapshot => "Snapshot, ours",
        }
    }

    /// What it does, in a line.
    pub const fn summary(self) -> &'static str {
        match self {
            Strategy::RegularGrid => "The centre of every cell of a grid; mean cost times pixels",
            Strategy::Jittered => "A random pixel of every cell of a grid; mean cost times pixels",
            Strategy::Halton => "Halton's points, bases 2 and 7; mean cost times pixels",
            Strategy::Hammersley => "Hammersley's points, base 2; mean cost times pixels",
            Strategy::Random => "Random pixels; mean cost times pixels",
            Strategy::RandomArea => "Random pixels; each counts for the area that is nearest to it",
            Strategy::PaperSnapshot => {
                "By the ID preview as the paper states it: a pixel for every object and material, the rest by size"
            }
            Strategy::Systematic => {
                "By the ID preview in one pass: every so many-th pixel along materials and objects, more where cost is expected"
            }
            Strategy::Snapshot => {
                "By what the ID preview shows: strata of object and material, in two phases"
            }
        }
    }

    /// Whether it knows nothing of the preview.
    pub const fn is_blind(self) -> bool {
        !matches!(self, Strategy::PaperSnapshot | Strategy::Systematic | Strategy::Snapshot)
    }

    /// Whether the variance of its estimates is its own, and not that of a simple random sample in its place.
    pub const fn knows_its_variance(self) -> bool {
        !matches!(self, Strategy::Halton | Strategy::Hammersley | Strategy::RandomArea)
    }

    /// What it distinguishes of the strata that a preview can show (and that do not stand apart).
    pub fn strata(self, strata: &[Stratum]) -> Vec<Stratum> {
        match self {
            Strategy::PaperSnapshot | Strategy::Snapshot => strata.to_vec(),
            Strategy::Systematic => systematic::classes(strata).0,
            _ => vec![Stratum::background(1.0)],
        }
    }

    /// Pixels of what it distinguishes, from the pixels of all strata.
    pub fn counts(self, strata: &[Stratum], counts: &[u32]) -> Vec<u32> {
        match self {
            Strategy::PaperSnapshot | Strategy::Snapshot => counts.to_vec(),
            Strategy::Systematic => {
                let (classes, of) = systematic::classes(strata);
                let mut sums = vec![0u32; classes.len()];
                of.iter().zip(counts).for_each(|(&class, &n)| sums[class as usize] += n);
                sums
            }
            _ => vec![counts.iter().fold(0, |sum, &n| sum.saturating_add(n))],
        }
    }

    /// The pixels of a frame that it profiles, `samples` of them at most (a grid may have a few less); the arguments are those of
    /// [`FrameDesign::new`].
    ///
    /// # Errors
    /// As of [`FrameDesign::new`].
    pub fn design(
        self,
        strata: &[Stratum],
        stratum_ids: &[u32],
        width: u32,
        samples: u32,
        seed: u64,
        frame: i64,
    ) -> Result<Design, ForecastError> {
        let counts = count_pixels(strata, stratum_ids, width, frame)?;
        let image = Image { width, height: stratum_ids.len() as u32 / width };
        let samples = samples.min(image.pixels());
        let counters = [seed, frame.cast_unsigned()];
        let chance = |axis: u64| if seed == 0 { 0 } else { hash(&[seed, counters[1], axis]) };
        let of_cell = || [0, 1].map(|axis| (chance(axis) >> 32) as u32);
        // Numbers of 53 bits, which an f64 holds exactly.
        let of_image = || [0, 1].map(|axis| (chance(axis) >> 11) as f64 / (1u64 << 53) as f64);
        let anywhere =
            || uniform::choose((0..image.pixels()).collect(), samples as usize, [seed, counters[1], 0]);
        let by_preview =
            |picks, expansion| Design { strata: strata.to_vec(), counts: counts.clone(), picks, expansion };
        let (pixels, expansion) = match self {
            Strategy::RegularGrid => (cells::regular(image, samples, of_cell()), Expansion::Neighbours),
            Strategy::Jittered => (cells::jittered(image, samples, counters), Expansion::Neighbours),
            Strategy::Halton => (sequence::halton(image, samples, of_image()), Expansion::Flat),
            Strategy::Hammersley => (sequence::hammersley(image, samples, of_image()), Expansion::Flat),
            Strategy::Random => (anywhere(), Expansion::Flat),
            Strategy::RandomArea => {
                let pixels = anywhere();
                let mut areas = vec![0u32; pixels.len()];
                let nearest = nearest(width, stratum_ids.len(), &pixels);
                nearest.into_iter().for_each(|index| areas[index as usize] += 1);
                (pixels, Expansion::Areas(areas))
            }
            Strategy::PaperSnapshot => {
                let picks = snapshot::as_stated(&counts, stratum_ids, samples, counters);
                return Ok(by_preview(Picks::Known(picks), Expansion::EachStratum));
            }
            Strategy::Systematic => {
                let picks = systematic::picks(strata, &counts, stratum_ids, image, samples, counters);
                return Ok(Design {
                    strata: self.strata(strata),
                    counts: self.counts(strata, &counts),
                    picks: Picks::Known(picks),
                    expansion: Expansion::Neighbours,
                });
            }
            Strategy::Snapshot => {
                let design = FrameDesign::new(strata, stratum_ids, width, samples, seed, frame)?;
                return Ok(by_preview(Picks::TwoPhases(Box::new(design)), Expansion::Groups));
            }
        };
        let picks = pixels.into_iter().map(|pixel| Pick { pixel, stratum: 0 }).collect();
        Ok(Design {
            strata: self.strata(strata),
            counts: self.counts(strata, &counts),
            picks: Picks::Known(picks),
            expansion,
        })
    }
}

/// Width and height of an image, pixels.
#[derive(Clone, Copy, Debug)]
struct Image {
    width: u32,
    height: u32,
}

impl Image {
    fn pixels(self) -> u32 {
        self.width * self.height
    }
}

/// Which pixels of a frame a [`Strategy`] profiles, and what it makes of them.
///
/// Observations are in the order of the picks, those of the first phase before those of the second.
#[derive(Clone, Debug)]
pub struct Design {
    strata: Vec<Stratum>,
    counts: Vec<u32>,
    picks: Picks,
    expansion: Expansion,
}

#[derive(Clone, Debug)]
enum Picks {
    Known(Vec<Pick>),
    TwoPhases(Box<FrameDesign>),
}

impl Design {
    /// What the strategy distinguishes: [`Strategy::strata`] of those that it was made for. The picks' strata are these.
    pub fn strata(&self) -> &[Stratum] {
        &self.strata
    }

    /// Pixels of each of them.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// How the observations stand for all pixels.
    pub fn expansion(&self) -> &Expansion {
        &self.expansion
    }

    /// The pixels to profile first; most strategies know all of them.
    pub fn first_phase(&self) -> Vec<Pick> {
        match &self.picks {
            Picks::Known(picks) => picks.clone(),
            Picks::TwoPhases(design) => design.first_phase(),
        }
    }

    /// The other pixels, once it is known what the first ones cost.
    ///
    /// # Errors
    /// If an observation names an unknown stratum.
    pub fn second_phase(&self, first: &[Observation]) -> Result<Vec<Pick>, ForecastError> {
        match &self.picks {
            Picks::Known(_) => Ok(Vec::new()),
            Picks::TwoPhases(design) => design.second_phase(first),
        }
    }

    /// Both phases, on pixels whose costs are known: the picks, and what was observed at them.
    ///
    /// # Errors
    /// As of [`Self::second_phase`].
    pub fn profile(
        &self,
        cost: impl Fn(u32) -> Cost,
    ) -> Result<(Vec<Pick>, Vec<Observation>), ForecastError> {
        let observe = |pick: &Pick| Observation { stratum: pick.stratum, cost: cost(pick.pixel) };
        let mut picks = self.first_phase();
        let mut observations: Vec<Observation> = picks.iter().map(observe).collect();
        let second = self.second_phase(&observations)?;
        observations.extend(second.iter().map(observe));
        picks.extend(second);
        Ok((picks, observations))
    }

    /// What all observations together say of the frame.
    ///
    /// # Errors
    /// As of [`crate::estimate`]; and if the observations are not those of all picks.
    pub fn estimate(
        &self,
        observations: &[Observation],
        calibration: Calibration,
    ) -> Result<FrameEstimate, ForecastError> {
        let fit = FrameFit::new(&self.strata, 0, &self.counts, observations, &self.expansion)?;
        Ok(estimate_fit(fit, observations.len(), calibration))
    }
}

#[cfg(test)]
mod tests {
    use super::Strategy;

    #[test]
    fn names_are_those_of_the_documents() {
        for strategy in Strategy::ALL {
            let written = serde_json::to_string(&strategy).expect("a name");
            assert_eq!(written, format!("{:?}", strategy.name()));
        }
    }
}
