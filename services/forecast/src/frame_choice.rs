//! Chooses which frames of a shot to profile, by a k-median problem. More are added if the forecast is
//! uncertain and they are cheap.

use std::collections::{BTreeMap, BTreeSet};

use crate::error::ForecastError;
use crate::population::{FramePopulation, check_frames};
use crate::shot::ShotForecast;
use crate::shot_clock::ShotClock;
use crate::strata::Stratum;

/// Largest number of candidates to choose from. In a longer shot, each candidate stands for frames around it.
const MOST_CANDIDATES: usize = 256;

/// Number of sets of lights that the choice distinguishes. If there are more, frames are only distinguished
/// by how many lights shine, and the numbers beyond this limit are treated as one.
const MOST_LIGHTS: usize = 8;

/// Largest number of passes of the local search over the chosen frames.
const MOST_PASSES: usize = 8;

/// A frame can sample a stratum well if it shows at least this share of the most that any frame shows of it.
const ENOUGH_PIXELS: f64 = 0.25;

/// Distance of a stratum that no profiled frame shows, in shot lengths.
const NEVER_SEEN: f64 = 2.0;

/// Distance added for taking unit costs from a frame with other lights, in shot lengths.
const OTHER_LIGHTS: f64 = 1.0;

/// Chooses at most `at_most` frames to profile, as indices in increasing order.
///
/// In each frame, a stratum takes its unit cost from the nearest profiled frame that shows enough of it. The
/// loss is the sum of these distances, weighted by pixels times prior cost; a stratum shown by no profiled
/// frame has the largest distance. It is minimised greedily, then by moving one frame at a time (k-median
/// local search: Arya et al. 2004). Ties go to the earlier frame.
///
/// Time is the shot's own (`shot_clock`): a cut is as long as the shot, so each side of it gets frames. A
/// frame with other lights is one shot length further away.
///
/// # Errors
/// If frames are out of order, or counts and strata do not match.
pub fn choose_frames(
    strata: &[Stratum],
    frames: &[FramePopulation],
    at_most: usize,
) -> Result<Vec<usize>, ForecastError> {
    check_frames(strata, frames)?;
    if at_most >= frames.len() {
        return Ok((0..frames.len()).collect());
    }
    let cover = Cover::new(strata, frames, |h, t| f64::from(frames[t].counts[h]) * strata[h].prior_cost);
    let mut chosen: Vec<usize> = Vec::new();
    cover.add(&mut chosen, at_most);
    let mut loss = cover.distances(&chosen).loss;
    for _ in 0..MOST_PASSES {
        let before = loss;
        for moved in 0..chosen.len() {
            let others: Vec<usize> = (0..chosen.len()).filter(|&i| i != moved).map(|i| chosen[i]).collect();
            if let Some((less, best)) = cover.best(&others)
                && less < loss
            {
                chosen[moved] = best;
                loss = less;
            }
        }
        if loss >= before {
            break;
        }
    }
    let mut chosen: Vec<usize> = chosen.into_iter().map(|c| cover.frames[c].index).collect();
    chosen.sort_unstable();
    Ok(chosen)
}

/// Number of frames that are profiled before more are considered.
pub const FIRST_FRAMES: usize = 5;

/// Largest number of frames that are profiled by default.
pub const MOST_FRAMES: usize = 16;

/// Largest share of the forecast work that profiling may cost, for more frames to be profiled.
const LARGEST_SHARE: f64 = 0.01;

/// A forecast is certain enough if P95 of all work exceeds P50 by at most this share of P50.
const CERTAIN_ENOUGH: f64 = 0.02;

/// Further frames to profile after the first [`FIRST_FRAMES`], as indices in increasing order.
///
/// As many as one percent of the forecast work pays for, at most [`MOST_FRAMES`] in all. None if the forecast
/// is certain enough, or if the number of profiled frames is not [`FIRST_FRAMES`]. `spent` is the work of
/// profiling so far. They are chosen as in [`choose_frames`], weighted by forecast costs.
///
/// # Errors
/// If frames are out of order, or counts and strata do not match.
pub fn choose_more_frames(
    strata: &[Stratum],
    frames: &[FramePopulation],
    forecast: &ShotForecast,
    spent: u64,
) -> Result<Vec<usize>, ForecastError> {
    check_frames(strata, frames)?;
    let profiled: Vec<usize> = (0..frames.len()).filter(|&t| forecast.frames[t].profiled).collect();
    let work = &forecast.total.work;
    if profiled.len() != FIRST_FRAMES || work.p95 <= (1.0 + CERTAIN_ENOUGH) * work.p50 {
        return Ok(Vec::new());
    }
    // The affordable number of profiled frames in all, if each costs as much as those so far.
    let each = spent as f64 / profiled.len() as f64;
    let affordable = (LARGEST_SHARE * work.mean / each.max(1.0)) as usize;
    let cover = Cover::new(strata, frames, |h, t| {
        let stratum = &forecast.frames[t].strata[h];
        f64::from(stratum.pixels) * stratum.mean.work
    });
    let known: Vec<usize> =
        (0..cover.frames.len()).filter(|&c| profiled.contains(&cover.frames[c].index)).collect();
    let mut chosen = known.clone();
    cover.add(&mut chosen, affordable.min(MOST_FRAMES));
    let mut more: Vec<usize> = chosen[known.len()..].iter().map(|&c| cover.frames[c].index).collect();
    more.sort_unstable();
    Ok(more)
}

/// A frame that may be chosen. In a long shot it also stands for its neighbours.
struct Candidate {
    index: usize,
    /// Time on the shot's clock, scaled to 0 to 1.
    time: f64,
    lights: usize,
    /// Whether any light shines.
    is_lit: bool,
    /// Strata shown by it or by a frame that it stands for, with their weight.
    shown: Vec<(usize, f64)>,
    /// For each stratum, whether the frame shows enough of it to sample it well.
    enough: Vec<bool>,
}

impl Candidate {
    /// Distance from this frame to one that takes its unit costs from it, in shot lengths.
    fn distance_to(&self, other: &Self) -> f64 {
        let lights = match () {
            () if self.is_lit != other.is_lit => NEVER_SEEN,
            () if self.lights != other.lights => OTHER_LIGHTS,
            () => 0.0,
        };
        ((self.time - other.time).abs() + lights).min(NEVER_SEEN)
    }
}

struct Cover {
    frames: Vec<Candidate>,
}

/// Distance from every stratum of every candidate to the nearest chosen frame.
struct Distances {
    /// In the order of the candidates, and of the strata that they show.
    nearest: Vec<Vec<f64>>,
    /// The weighted sum of the distances.
    loss: f64,
}

impl Cover {
    /// `weight(h, t)` is the estimated cost of stratum h in frame t.
    fn new(strata: &[Stratum], frames: &[FramePopulation], weight: impl Fn(usize, usize) -> f64) -> Self {
        let clock = ShotClock::new(strata, frames);
        let most: Vec<u32> = (0..strata.len())
            .map(|h| frames.iter().map(|frame| frame.counts[h]).max().unwrap_or(0))
            .collect();
        let lights = light_sets(frames);
        let candidate = |stands_for: Vec<usize>| {
            let index = stands_for[stands_for.len() / 2];
            let counts = &frames[index].counts;
            let weight = |h: usize| stands_for.iter().map(|&t| weight(h, t)).sum::<f64>();
            let enough =
                |h: usize| counts[h] > 0 && f64::from(counts[h]) >= ENOUGH_PIXELS * f64::from(most[h]);
            Candidate {
                index,
                time: clock.at(index) / clock.length(),
                lights: lights[index],
                is_lit: frames[index].shining > 0,
                shown: (0..strata.len()).map(|h| (h, weight(h))).filter(|(_, w)| *w > 0.0).collect(),
                enough: (0..strata.len()).map(enough).collect(),
            }
        };
        Cover { frames: runs_of_frames(&clock, &lights).into_iter().map(candidate).collect() }
    }

    /// Greedily adds candidates to the chosen ones, until there are `until`.
    fn add(&self, chosen: &mut Vec<usize>, until: usize) {
        while chosen.len() < until.min(self.frames.len()) {
            let Some((_, best)) = self.best(chosen) else { break };
            chosen.push(best);
        }
    }

    fn distances(&self, chosen: &[usize]) -> Distances {
        let nearest = |frame: &Candidate| -> Vec<f64> {
            let to = |h: usize| {
                let seen = chosen.iter().map(|&c| &self.frames[c]).filter(|c| c.enough[h]);
                seen.map(|c| c.distance_to(frame)).fold(NEVER_SEEN, f64::min)
            };
            frame.shown.iter().map(|&(h, _)| to(h)).collect()
        };
        let nearest: Vec<Vec<f64>> = self.frames.iter().map(nearest).collect();
        let weighted = |(frame, nearest): (&Candidate, &Vec<f64>)| -> f64 {
            frame.shown.iter().zip(nearest).map(|((_, weight), distance)| weight * distance).sum()
        };
        let loss = self.frames.iter().zip(&nearest).map(weighted).sum();
        Distances { nearest, loss }
    }

    /// The candidate that reduces the loss most when added to `others`, earliest first, and the loss left.
    fn best(&self, others: &[usize]) -> Option<(f64, usize)> {
        let without = self.distances(others).nearest;
        let with = |candidate: &Candidate| -> f64 {
            let of_frame = |(frame, nearest): (&Candidate, &Vec<f64>)| -> f64 {
                let distance = candidate.distance_to(frame);
                let term = |(&(h, weight), &nearest): (&(usize, f64), &f64)| {
                    weight * if candidate.enough[h] { nearest.min(distance) } else { nearest }
                };
                frame.shown.iter().zip(nearest).map(term).sum()
            };
            self.frames.iter().zip(&without).map(of_frame).sum()
        };
        let mut best: Option<(f64, usize)> = None;
        for candidate in (0..self.frames.len()).filter(|c| !others.contains(c)) {
            let loss = with(&self.frames[candidate]);
            if best.is_none_or(|(least, _)| loss < least) {
                best = Some((loss, candidate));
            }
        }
        best
    }
}

/// The set of shining lights in each frame, as numbers from 0 in the order of first appearance.
fn light_sets(frames: &[FramePopulation]) -> Vec<usize> {
    let sets: BTreeSet<u32> = frames.iter().map(|frame| frame.lights).collect();
    let few = sets.len() <= MOST_LIGHTS;
    let mut known = Vec::new();
    let number = |frame: &FramePopulation| {
        let key = if few { frame.lights } else { frame.shining };
        let place = known.iter().position(|&lights| lights == key);
        place.unwrap_or_else(|| {
            if known.len() < MOST_LIGHTS {
                known.push(key);
            }
            known.len() - 1
        })
    };
    frames.iter().map(number).collect()
}

/// Divides the frames into runs with one candidate each: of equal length on the shot's clock, and split by
/// the set of shining lights. So anything brief that changes the picture or its light gets a run.
fn runs_of_frames(clock: &ShotClock, lights: &[usize]) -> Vec<Vec<usize>> {
    if lights.len() <= MOST_CANDIDATES {
        return (0..lights.len()).map(|t| vec![t]).collect();
    }
    let sets = lights.iter().max().map_or(1, |&most| most + 1);
    let all = MOST_CANDIDATES / sets;
    let slice = |t: usize| ((clock.at(t) / clock.length() * all as f64) as usize).min(all - 1);
    let mut runs: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
    for (t, &lights) in lights.iter().enumerate() {
        runs.entry((slice(t), lights)).or_default().push(t);
    }
    runs.into_values().collect()
}
