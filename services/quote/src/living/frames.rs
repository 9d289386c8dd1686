//! Frames of a job as input of an estimate.

use forelight_forecast::{Band, Known, LiveFrame};
use forelight_protocol::Quantiles;

/// Cost of a frame: work, or CPU time.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FrameCost {
    /// Its quote.
    pub quote: Quantiles,
    /// Its true cost. `None` until it is finished.
    pub actual: Option<f64>,
    /// Cost of its finished pixels. `None` if its worker has not reported it.
    pub part: Option<f64>,
}

impl FrameCost {
    fn known(&self, share: Option<f64>) -> Known {
        match (self.actual, share, self.part) {
            (Some(cost), ..) => Known::All(cost),
            (None, Some(share), Some(cost)) if share > 0.0 => Known::Part { share, cost },
            _ => Known::Nothing,
        }
    }

    fn band(&self) -> Band {
        let Quantiles { mean, p50, p80, p95 } = self.quote;
        Band { mean, p50, p80, p95 }
    }
}

/// State of a frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FrameState {
    /// Its number.
    pub number: u32,
    /// Time on the shot's own clock. `None` if the job was quoted without one.
    pub clock: Option<f64>,
    /// Share of its pixels that is finished, 0 to 1. `None` if no worker has reported it.
    pub share: Option<f64>,
    /// Count of operations.
    pub work: FrameCost,
    /// CPU seconds on a node of speed 1.
    pub cpu_seconds: FrameCost,
}

/// Frames of a job.
#[derive(Clone, PartialEq, Debug)]
pub struct Frames {
    pub(super) work: Vec<LiveFrame>,
    pub(super) cpu_seconds: Vec<LiveFrame>,
    /// Finished frames.
    pub done: u32,
    /// True if all frames are finished.
    pub all_done: bool,
    /// Unfinished share of the quoted CPU time. Finished pixels count as finished.
    pub share_left: f64,
}

impl Frames {
    /// Frames of a job, ascending. `lights` has a number for each frame; frames with equal numbers have the
    /// same lights. Frames beyond its end have 0.
    pub fn new(states: &[FrameState], lights: &[u32]) -> Self {
        let first = states.first().map_or(0, |state| state.number);
        let mut frames = Self {
            work: Vec::with_capacity(states.len()),
            cpu_seconds: Vec::with_capacity(states.len()),
            done: 0,
            all_done: false,
            share_left: 0.0,
        };
        let (mut all, mut left) = (0.0, 0.0);
        for (place, state) in states.iter().enumerate() {
            let lights = lights.get(place).copied().unwrap_or_default();
            let time = state.clock.unwrap_or_else(|| f64::from(state.number) - f64::from(first));
            let live = |cost: &FrameCost| LiveFrame {
                time,
                lights,
                quote: cost.band(),
                known: cost.known(state.share),
            };
            let cpu = live(&state.cpu_seconds);
            frames.work.push(live(&state.work));
            frames.cpu_seconds.push(cpu);
            frames.done += u32::from(matches!(cpu.known, Known::All(_)));
            all += cpu.quote.mean;
            left += cpu.quote.mean
                * match cpu.known {
                    Known::Nothing => 1.0,
                    Known::Part { share, .. } => 1.0 - share,
                    Known::All(_) => 0.0,
                };
        }
        frames.all_done = frames.done as usize == states.len();
        frames.share_left = if all > 0.0 { left / all } else { 0.0 };
        frames
    }

    /// Number of frames.
    pub fn count(&self) -> usize {
        self.cpu_seconds.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(number: u32, mean: f64, actual: Option<f64>, part: Option<(f64, f64)>) -> FrameState {
        let cost = FrameCost { quote: Quantiles::known(mean), actual, part: part.map(|(_, cost)| cost) };
        FrameState { number, clock: None, share: part.map(|(share, _)| share), work: cost, cpu_seconds: cost }
    }

    #[test]
    fn finished_pixels_count_by_their_share_of_the_quoted_time() {
        let frames = Frames::new(
            &[
                state(7, 1.0, Some(2.0), None),
                state(8, 1.0, None, Some((0.25, 1.0))),
                state(9, 2.0, None, None),
            ],
            &[3, 3],
        );
        assert_eq!((frames.done, frames.all_done, frames.count()), (1, false, 3));
        assert_eq!(frames.share_left, 2.75 / 4.0);
        let seen: Vec<_> = frames.cpu_seconds.iter().map(|it| (it.time, it.lights, it.known)).collect();
        let part = Known::Part { share: 0.25, cost: 1.0 };
        assert_eq!(seen, [(0.0, 3, Known::All(2.0)), (1.0, 3, part), (2.0, 0, Known::Nothing)]);
    }
}
