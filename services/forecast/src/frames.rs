//! Which frames of a shot to profile.

use serde::{Deserialize, Serialize};

use crate::error::ForecastError;
use crate::strata::{Stratum, check};

/// What the preview saw in one frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FramePopulation {
    /// The frame's number, which is also its time. Numbers increase strictly from frame to frame, with or
    /// without gaps.
    pub number: i64,
    /// Pixels of each stratum, N_h.
    pub counts: Vec<u32>,
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

/// Frames from `early` to `late` as a number that neither overflows nor rounds for any sensible shot.
pub(crate) fn apart(early: i64, late: i64) -> f64 {
    late.abs_diff(early) as f64
}

/// At most this many frames, evenly spaced, stand for a longer shot.
const MOST_CANDIDATES: usize = 256;

/// Passes over the chosen frames in which each may move to a better place.
const MOST_PASSES: usize = 8;

/// In a frame that shows less than this part of the most that any frame shows of a stratum, the stratum is
/// too small to be sampled well.
const ENOUGH_PIXELS: f64 = 0.25;

/// Cost of having a stratum in no profiled frame, in shot lengths; being a whole shot away costs one.
const NEVER_SEEN: f64 = 2.0;

/// Chooses at most `at_most` frames to profile, as indices in increasing order.
///
/// A stratum in a frame must take its unit cost from the nearest profiled frame that shows enough of it; that
/// is the worse the further away the frame is, and worst if there is none. The sum over all frames and
/// strata, weighted by pixels times prior cost, is made small greedily, frame by frame, and then by moving
/// one frame at a time as long as that helps (the k-median problem; Arya et al. 2004, local search). Equal
/// sums are settled for the earlier frame, so the choice is a function of the previews alone. Frames come out
/// spread over time, drawn to where strata that matter appear.
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
    let cover = Cover::new(strata, frames);
    let mut chosen: Vec<usize> = Vec::new();
    while chosen.len() < at_most.min(cover.frames.len()) {
        let free = (0..cover.frames.len()).filter(|c| !chosen.contains(c));
        let Some(best) = cover.best(free, &chosen) else { break };
        chosen.push(best);
    }
    for _ in 0..MOST_PASSES {
        let before = cover.loss(&chosen);
        for moved in 0..chosen.len() {
            let others: Vec<usize> = (0..chosen.len()).filter(|&i| i != moved).map(|i| chosen[i]).collect();
            let free = (0..cover.frames.len()).filter(|c| !others.contains(c));
            if let Some(best) = cover.best(free, &others)
                && cover.loss(&with(&others, best)) < cover.loss(&chosen)
            {
                chosen[moved] = best;
            }
        }
        if cover.loss(&chosen) >= before {
            break;
        }
    }
    let mut chosen: Vec<usize> = chosen.into_iter().map(|c| cover.frames[c].index).collect();
    chosen.sort_unstable();
    Ok(chosen)
}

fn with(others: &[usize], one: usize) -> Vec<usize> {
    others.iter().copied().chain([one]).collect()
}

/// A frame that may be chosen, and stands for its neighbours in a long shot.
struct Candidate {
    index: usize,
    /// Time from 0 to 1.
    time: f64,
    /// Strata shown, with their weight and whether there is enough of them to sample.
    shown: Vec<(usize, f64, bool)>,
}

struct Cover {
    frames: Vec<Candidate>,
    strata: usize,
}

impl Cover {
    fn new(strata: &[Stratum], frames: &[FramePopulation]) -> Self {
        let stride = frames.len().div_ceil(MOST_CANDIDATES).max(1);
        let (first, last) = (frames[0].number, frames[frames.len() - 1].number);
        let span = apart(first, last).max(1.0);
        let most: Vec<u32> = (0..strata.len())
            .map(|h| frames.iter().map(|frame| frame.counts[h]).max().unwrap_or(0))
            .collect();
        let candidate = |index: usize| {
            let frame = &frames[index];
            let shown = (0..strata.len()).filter(|&h| frame.counts[h] > 0).map(|h| {
                let pixels = f64::from(frame.counts[h]);
                (h, pixels * strata[h].prior_cost, pixels >= ENOUGH_PIXELS * f64::from(most[h]))
            });
            Candidate { index, time: apart(first, frame.number) / span, shown: shown.collect() }
        };
        Cover {
            frames: (stride / 2..frames.len()).step_by(stride).map(candidate).collect(),
            strata: strata.len(),
        }
    }

    /// The candidate that leaves the least loss beside `others`; the earliest among equals.
    fn best(&self, candidates: impl Iterator<Item = usize>, others: &[usize]) -> Option<usize> {
        let mut best: Option<(f64, usize)> = None;
        for candidate in candidates {
            let loss = self.loss(&with(others, candidate));
            if best.is_none_or(|(least, _)| loss < least) {
                best = Some((loss, candidate));
            }
        }
        best.map(|(_, candidate)| candidate)
    }

    /// Weighted distance in time from every stratum in every frame to the nearest chosen frame with enough of
    /// it.
    fn loss(&self, chosen: &[usize]) -> f64 {
        let mut times: Vec<Vec<f64>> = vec![Vec::new(); self.strata];
        for &c in chosen {
            let frame = &self.frames[c];
            frame.shown.iter().filter(|(.., enough)| *enough).for_each(|&(h, ..)| times[h].push(frame.time));
        }
        let mut loss = 0.0;
        for frame in &self.frames {
            for &(h, weight, _) in &frame.shown {
                let nearest =
                    times[h].iter().map(|time| (time - frame.time).abs()).fold(NEVER_SEEN, f64::min);
                loss += weight * nearest;
            }
        }
        loss
    }
}
