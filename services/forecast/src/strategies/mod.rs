//! Strategies of profiling a frame: the seven of the paper (Gillibrand et al. 2006, section 4), and two more.
//!
//! A strategy decides which pixels of a frame are profiled, and how their costs are expanded to all pixels:
//!
//! | strategy | pixels | expansion | variance |
//! | --- | --- | --- | --- |
//! | `RegularGrid` | centre of every cell | overall mean | neighbouring cells |
//! | `Jittered` | random pixel of every cell | overall mean | neighbouring cells |
//! | `Halton` | Halton points, bases 2 and 7 | overall mean | not known |
//! | `Hammersley` | Hammersley points, base 2 | overall mean | not known |
//! | `Random` | random pixels | overall mean | simple random sample |
//! | `RandomArea` | random pixels | by nearest area | not known |
//! | `PaperSnapshot` | one per stratum, the rest by size | by stratum | by stratum |
//! | `Systematic` | every k-th of an order | by expected cost | neighbours in the order |
//! | `Snapshot` | those of [`FrameDesign`] | by groups of strata | by group, with a tail |
//!
//! The first six are *blind*: they do not use the preview. Variances by neighbours use differences of
//! successive observations. Where the variance is not known, that of a simple random sample takes its place,
//! which is too large.
//!
//! Grid, Halton and Hammersley points are deterministic: with seed 0 they are the paper's, other seeds shift
//! all points by a random vector. This measures the part of an error that is due to chance.

mod cells;
mod classes;
mod image;
mod paper_snapshot;
mod sequence;
mod systematic;
mod uniform;

use serde::{Deserialize, Serialize};

use crate::cost::{Cost, Observation};
use crate::error::ForecastError;
use crate::estimate::{FrameEstimate, FrameFit, estimate_fit};
use crate::expansion::Expansion;
use crate::frame_design::{FrameDesign, Pick, count_pixels};
use crate::interval::Calibration;
use crate::nearest::nearest;
use crate::random::hash;
use crate::strata::Stratum;
pub use classes::Classes;
use image::Image;

/// Which pixels are profiled, and how their costs are expanded. See the table of the module.
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
    /// The paper's strategy 7, as the paper states it.
    #[serde(rename = "snapshot-paper")]
    PaperSnapshot,
    /// A systematic sample along one order of all pixels: one phase, no strata of single objects.
    #[serde(rename = "snapshot-systematic")]
    Systematic,
    /// Our own, as described in the documentation of this crate.
    Snapshot,
}

impl Strategy {
    /// All strategies, in the paper's order.
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

    /// Its name on the command line and in documents. The same as in serde.
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

    /// Its name in tables.
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

    /// What it does, in one line.
    pub const fn summary(self) -> &'static str {
        match self {
            Strategy::RegularGrid => "The centre of every cell of a grid; mean cost times pixels",
            Strategy::Jittered => "A random pixel of every cell of a grid; mean cost times pixels",
            Strategy::Halton => "Halton points with bases 2 and 7; mean cost times pixels",
            Strategy::Hammersley => "Hammersley points with base 2; mean cost times pixels",
            Strategy::Random => "Random pixels; mean cost times pixels",
            Strategy::RandomArea => "Random pixels; the cost of each times the area nearest to it",
            Strategy::PaperSnapshot => {
                "The paper's use of the ID preview: one pixel per object and material, the rest by size"
            }
            Strategy::Systematic => {
                "One phase: every k-th pixel of an order by material and object, denser where high cost is expected"
            }
            Strategy::Snapshot => {
                "Two phases: strata of object and material from the ID preview, then by measured cost"
            }
        }
    }

    /// Whether it does not use the preview.
    pub const fn is_blind(self) -> bool {
        !matches!(self, Strategy::PaperSnapshot | Strategy::Systematic | Strategy::Snapshot)
    }

    /// Whether its estimates have a variance of their own, rather than that of a simple random sample.
    pub const fn knows_its_variance(self) -> bool {
        !matches!(self, Strategy::Halton | Strategy::Hammersley | Strategy::RandomArea)
    }

    /// The design for one frame: at most `samples` pixels; a grid may have a few less. Arguments and errors
    /// as for [`FrameDesign::new`].
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
        // Numbers of 53 bits, which are exact in an f64.
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
                let picks = paper_snapshot::picks(&counts, stratum_ids, samples, counters);
                return Ok(by_preview(Picks::Known(picks), Expansion::EachStratum));
            }
            Strategy::Systematic => {
                let picks = systematic::picks(strata, &counts, stratum_ids, image, samples, counters);
                let classes = self.classes(strata);
                return Ok(Design {
                    counts: classes.counts(&counts),
                    strata: classes.strata,
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
        let classes = self.classes(strata);
        Ok(Design {
            counts: classes.counts(&counts),
            strata: classes.strata,
            picks: Picks::Known(picks),
            expansion,
        })
    }
}

/// Pixels that a [`Strategy`] profiles, and their expansion. Observations must be in the order of the picks.
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
    /// The strata that the strategy distinguishes (see [`Strategy::classes`]). Picks refer to these.
    pub fn strata(&self) -> &[Stratum] {
        &self.strata
    }

    /// Number of pixels of each of these strata.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// How the observations are expanded to all pixels.
    pub fn expansion(&self) -> &Expansion {
        &self.expansion
    }

    /// The pixels to profile first. For most strategies these are all.
    pub fn first_phase(&self) -> Vec<Pick> {
        match &self.picks {
            Picks::Known(picks) => picks.clone(),
            Picks::TwoPhases(design) => design.first_phase(),
        }
    }

    /// The remaining pixels, given the costs of the first. Fails if an observation names an unknown stratum.
    pub fn second_phase(&self, first: &[Observation]) -> Result<Vec<Pick>, ForecastError> {
        match &self.picks {
            Picks::Known(_) => Ok(Vec::new()),
            Picks::TwoPhases(design) => design.second_phase(first),
        }
    }

    /// Runs both phases on a frame with known pixel costs. Returns the picks and their observations. Errors
    /// as for [`Self::second_phase`].
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

    /// Estimates the frame. Errors as for [`crate::estimate()`], and if observations are missing.
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
