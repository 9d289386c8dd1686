//! The shot's own clock: faster where the picture changes faster, so that nothing is carried across a cut.

use crate::population::FramePopulation;
use crate::strata::Stratum;

/// The time of each frame, for everything that is carried over time.
///
/// The preview shows how much of the picture changes from one frame to the next:
///
/// ```text
/// D = ½ Σ_h |w_h(t) − w_h(t−1)|
/// ```
///
/// where w_h is the share of stratum h in the expected cost. D is 0 if nothing changes and 1 if everything
/// does. Things outside the view may be reflected or light it, so D is at least the share of triangles that
/// appear or vanish. If unit costs change as much as the picture, their variance grows with D². So a step
/// takes, in frames,
///
/// ```text
/// Δτ = Δn + L D² ,     n the frames' numbers, L the length of the shot
/// ```
///
/// At a cut, D is near one, so its two sides are a whole shot apart. A smooth camera move has a D of a few
/// hundredths.
#[derive(Clone, Debug)]
pub(crate) struct ShotClock {
    /// In frames: from zero, strictly increasing.
    times: Vec<f64>,
    /// The last frame's number less the first one's.
    frames: f64,
}

impl ShotClock {
    /// The clock of these frames. They must be in order and have a count for every stratum.
    pub fn new(strata: &[Stratum], frames: &[FramePopulation]) -> Self {
        let length = match frames {
            [first, .., last] => frames_between(first.number, last.number),
            _ => 0.0,
        };
        let mut time = 0.0;
        let mut times: Vec<f64> = frames.first().map(|_| time).into_iter().collect();
        times.extend(frames.windows(2).map(|pair| {
            let changed = pixel_change(strata, &pair[0].counts, &pair[1].counts)
                .max(triangle_change(&pair[0], &pair[1]));
            time += frames_between(pair[0].number, pair[1].number) + length * changed * changed;
            time
        }));
        Self { times, frames: length }
    }

    /// Time of the frame with index `t`, in frames.
    pub fn at(&self, t: usize) -> f64 {
        self.times[t]
    }

    /// Times of all frames, in frames.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Length of the shot by frame numbers: the last less the first. It is what a full cut adds to the clock.
    pub fn frames(&self) -> f64 {
        self.frames
    }

    /// Time from the first frame to the last. One for a single frame.
    pub fn length(&self) -> f64 {
        self.times.last().copied().filter(|&length| length > 0.0).unwrap_or(1.0)
    }

    /// Time between two frames, given by index.
    pub fn between(&self, one: usize, other: usize) -> f64 {
        (self.times[one] - self.times[other]).abs()
    }
}

/// Number of frames from `early` to `late`, as a float: free of overflow, and exact for any sensible shot.
fn frames_between(early: i64, late: i64) -> f64 {
    late.abs_diff(early) as f64
}

/// Share of the pixels' expected cost that is in other strata in the second frame, 0 to 1.
fn pixel_change(strata: &[Stratum], before: &[u32], after: &[u32]) -> f64 {
    let weight = |counts: &[u32], h: usize| {
        if strata[h].apart { 0.0 } else { f64::from(counts[h]) * strata[h].prior_cost }
    };
    let all = |counts: &[u32]| (0..strata.len()).map(|h| weight(counts, h)).sum::<f64>();
    let (all_before, all_after) = (all(before), all(after));
    if all_before <= 0.0 || all_after <= 0.0 {
        return f64::from(u8::from(all_before != all_after));
    }
    let moved =
        (0..strata.len()).map(|h| (weight(before, h) / all_before - weight(after, h) / all_after).abs());
    (0.5 * moved.sum::<f64>()).min(1.0)
}

/// Share of the triangles that only one of the two frames has, 0 to 1.
fn triangle_change(before: &FramePopulation, after: &FramePopulation) -> f64 {
    let (fewer, more) =
        (before.triangles.min(after.triangles) as f64, before.triangles.max(after.triangles) as f64);
    if more > 0.0 { (more - fewer) / more } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::ShotClock;
    use crate::population::FramePopulation;
    use crate::strata::Stratum;

    fn clock(counts: &[[u32; 2]]) -> ShotClock {
        let strata: Vec<Stratum> =
            (0..2).map(|i| Stratum { object: i, material: i, prior_cost: 1.0, apart: false }).collect();
        let frames: Vec<FramePopulation> = (10..)
            .zip(counts)
            .map(|(number, counts)| FramePopulation {
                number,
                counts: counts.to_vec(),
                lights: 0,
                shining: 0,
                triangles: 0,
            })
            .collect();
        ShotClock::new(&strata, &frames)
    }

    #[test]
    fn where_nothing_changes_a_frame_is_a_frame() {
        assert_eq!(clock(&[[5, 5]; 4]).times(), [0.0, 1.0, 2.0, 3.0]);
        assert_eq!((clock(&[[5, 5]]).length(), clock(&[]).length()), (1.0, 1.0));
    }

    #[test]
    fn a_cut_sets_its_sides_a_whole_shot_apart_and_a_slow_change_is_next_to_nothing() {
        let mut counts = vec![[1000, 0]; 10];
        counts.extend([[0, 1000]; 10]);
        let cut = clock(&counts);
        assert_eq!((cut.between(9, 10), cut.between(8, 9)), (1.0 + 19.0, 1.0));
        let slow: Vec<[u32; 2]> = (0..20).map(|t| [1000 - 20 * t, 20 * t]).collect();
        assert!(clock(&slow).length() < 19.2);
    }

    #[test]
    fn what_appears_where_the_camera_does_not_look_is_a_cut_as_well() {
        let frame =
            |number, triangles| FramePopulation { number, counts: vec![], lights: 0, shining: 0, triangles };
        let frames: Vec<FramePopulation> =
            (0..20).map(|n| frame(n, if (8..11).contains(&n) { 1000 } else { 10 })).collect();
        let clock = ShotClock::new(&[], &frames);
        assert_eq!((clock.between(0, 7), clock.between(8, 10)), (7.0, 2.0));
        assert!(clock.between(7, 8) > 19.0 && clock.between(10, 11) > 19.0);
    }

    #[test]
    fn frames_that_show_nothing_are_no_trouble() {
        let clock = clock(&[[0, 0], [0, 0], [3, 0]]);
        assert_eq!(clock.between(0, 1), 1.0);
        assert_eq!(clock.between(1, 2), 3.0);
    }
}
