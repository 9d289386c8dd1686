//! Which frames of a shot to profile.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::clock::ShotClock;
use crate::error::ForecastError;
use crate::shot::ShotForecast;
use crate::strata::{Stratum, check};

/// What the preview saw in one frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FramePopulation {
    /// The frame's number, which is also its time. Numbers increase strictly from frame to frame, with or
    /// without gaps.
    pub number: i64,
    /// Pixels of each stratum, N_h.
    pub counts: Vec<u32>,
    /// Which lights shine, as a number that frames with the same ones share. What a surface costs depends on them, and no preview
    /// shows it.
    pub lights: u32,
    /// How many of them: what costs something under one light is more like what it costs under another than like what it costs in the dark.
    pub shining: u32,
    /// Triangles of the frame, seen or not: what it takes to build a tree over them. 0 if nobody counted.
    pub triangles: u64,
}

/// Checks frames and counts against the strata.
pub(crate) fn check_frames(strata: &[Stratum], frames: &[FramePopulation]) -> Result<(), ForecastError> {
    for frame in frames {
        check(strata, frame.number, &frame.counts)?;
    }
    match frames.windows(2).find(|pair| pair[0].number >= pair[1].number) {
        Some(pair) => Err(ForecastError::FrameOrder { frame: pair[1].number }),
        None => Ok(()),
    }
}

/// At most so many frames can be chosen; in a longer shot each stands for those around it.
const MOST_CANDIDATES: usize = 256;

/// So many sets of lights are told apart when frames are chosen. Of more, only by how many lights shine, and what is left are one.
const MOST_LIGHTS: usize = 8;

/// Passes over the chosen frames in which each may move to a better place.
const MOST_PASSES: usize = 8;

/// In a frame that shows less than this part of the most that any frame shows of a stratum, the stratum is
/// too small to be sampled well.
const ENOUGH_PIXELS: f64 = 0.25;

/// Cost of having a stratum in no profiled frame, in shot lengths; being a whole shot away costs one.
const NEVER_SEEN: f64 = 2.0;

/// Cost of taking a unit cost from a frame in which other lights shine, in shot lengths.
const OTHER_LIGHTS: f64 = 1.0;

/// Chooses at most `at_most` frames to profile, as indices in increasing order.
///
/// A stratum in a frame must take its unit cost from the nearest profiled frame that shows enough of it; that
/// is the worse the further away the frame is, and worst if there is none. The sum over all frames and
/// strata, weighted by pixels times prior cost, is made small greedily, frame by frame, and then by moving
/// one frame at a time as long as that helps (the k-median problem; Arya et al. 2004, local search). Equal
/// sums are settled for the earlier frame, so the choice is a function of the previews alone. Frames come out
/// spread over time, drawn to where strata that matter appear. Time is the shot's own (`clock`), in which a cut is as long as the
/// shot: so each side of it gets frames of its own. A frame in which other lights shine is a shot's length further away.
/// [`choose_more_frames`] adds to them once they have been profiled.
///
/// # Errors
/// If frames are out of order, or counts and strata do not fit together.
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

/// So many frames are profiled before it is seen whether more pay.
pub const FIRST_FRAMES: usize = 5;

/// No more frames are profiled than this unless somebody asks for more.
pub const MOST_FRAMES: usize = 16;

/// What profiling may take, as a part of the work that is forecast, for more frames to be profiled.
const LARGEST_SHARE: f64 = 0.01;

/// A forecast is sure enough if the work of all frames is at most this far above its median with a probability of 95 %, relative.
const SURE: f64 = 0.02;

/// Whether more frames than the [`FIRST_FRAMES`] should be profiled, and which, as indices in increasing order: as many as can be paid with a
/// hundredth of the work that is forecast, and at most [`MOST_FRAMES`] in all. Nothing if the forecast is sure enough, or if others than so
/// many were profiled: so it is asked once. `spent` is the work that profiling these took.
///
/// They are chosen as the first ones were ([`choose_frames`]), but weighted by what strata were found to cost, and beside those that
/// are profiled already.
///
/// # Errors
/// If frames are out of order, or counts and strata do not fit together.
pub fn choose_more_frames(
    strata: &[Stratum],
    frames: &[FramePopulation],
    forecast: &ShotForecast,
    spent: u64,
) -> Result<Vec<usize>, ForecastError> {
    check_frames(strata, frames)?;
    let profiled: Vec<usize> = (0..frames.len()).filter(|&t| forecast.frames[t].profiled).collect();
    let work = &forecast.total.work;
    if profiled.len() != FIRST_FRAMES || work.p95 <= (1.0 + SURE) * work.p50 {
        return Ok(Vec::new());
    }
    // As many as would take the same share each; all of them are paid by what is forecast.
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

/// A frame that may be chosen, and stands for its neighbours in a long shot.
struct Candidate {
    index: usize,
    /// Time from 0 to 1.
    time: f64,
    lights: usize,
    /// Whether any light shines.
    is_lit: bool,
    /// Strata shown by it or a frame that it stands for, with their weight.
    shown: Vec<(usize, f64)>,
    /// Whether it shows enough of a stratum for it to be sampled.
    enough: Vec<bool>,
}

impl Candidate {
    /// How far it is, in shot lengths, from this frame to one that takes its unit costs from it.
    fn away(&self, other: &Self) -> f64 {
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

/// How far it is from every stratum of every candidate to the nearest chosen frame.
struct Distances {
    /// In the order of the candidates and of the strata that they show.
    nearest: Vec<Vec<f64>>,
    /// Their weighted sum.
    loss: f64,
}

impl Cover {
    /// `weight` is what a stratum is thought to cost in a frame.
    fn new(strata: &[Stratum], frames: &[FramePopulation], weight: impl Fn(usize, usize) -> f64) -> Self {
        let clock = ShotClock::new(strata, frames);
        let most: Vec<u32> = (0..strata.len())
            .map(|h| frames.iter().map(|frame| frame.counts[h]).max().unwrap_or(0))
            .collect();
        let lights = told_apart(frames);
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
        Cover { frames: slices(&clock, &lights).into_iter().map(candidate).collect() }
    }

    /// Adds to the chosen candidates one by one, until so many are.
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
                seen.map(|c| c.away(frame)).fold(NEVER_SEEN, f64::min)
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

    /// The least loss that one more candidate leaves beside `others`, and the candidate; the earliest among equals.
    fn best(&self, others: &[usize]) -> Option<(f64, usize)> {
        let without = self.distances(others).nearest;
        let with = |candidate: &Candidate| -> f64 {
            let of_frame = |(frame, nearest): (&Candidate, &Vec<f64>)| -> f64 {
                let distance = candidate.away(frame);
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

/// Which lights shine in each frame, in numbers from 0 by first appearance.
fn told_apart(frames: &[FramePopulation]) -> Vec<usize> {
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

/// The frames in runs of equal length on the shot's clock, each split by which lights shine, so that what is there for a few frames of
/// a long shot only, and changes the picture or its light, is in a run of its own. Of a shot that is not too long each frame is a run.
fn slices(clock: &ShotClock, lights: &[usize]) -> Vec<Vec<usize>> {
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
