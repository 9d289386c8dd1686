//! Current practice of farms: render some frames, and extrapolate from them.

use serde::Serialize;

/// A way to extrapolate from some full frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Practice {
    /// The middle frame, times the number of frames.
    OneFrame,
    /// The mean of the first, the middle and the last frame, times the number of frames.
    FirstMiddleLast,
    /// Straight lines between the same three frames.
    FirstMiddleLastLines,
    /// Straight lines between every tenth frame.
    EveryTenth,
}

impl Practice {
    pub const ALL: [Practice; 4] =
        [Practice::OneFrame, Practice::FirstMiddleLast, Practice::FirstMiddleLastLines, Practice::EveryTenth];

    /// Name in a table.
    pub const fn title(self) -> &'static str {
        match self {
            Practice::OneFrame => "one frame times all",
            Practice::FirstMiddleLast => "first, middle, last: mean",
            Practice::FirstMiddleLastLines => "first, middle, last: lines",
            Practice::EveryTenth => "every tenth frame: lines",
        }
    }

    /// Indices of the rendered frames of a shot, ascending and distinct.
    pub fn rendered(self, frames: usize) -> Vec<usize> {
        let Some(last) = frames.checked_sub(1) else { return Vec::new() };
        let mut places = match self {
            Practice::OneFrame => vec![last / 2],
            Practice::FirstMiddleLast | Practice::FirstMiddleLastLines => vec![0, last / 2, last],
            Practice::EveryTenth => (0..frames).step_by(10).collect(),
        };
        places.dedup();
        places
    }

    /// Forecast of every frame, from `actual` costs of the rendered ones.
    pub fn forecast(self, actual: &[f64]) -> Vec<f64> {
        let rendered = self.rendered(actual.len());
        match self {
            Practice::OneFrame | Practice::FirstMiddleLast => {
                let mean =
                    rendered.iter().map(|&t| actual[t]).sum::<f64>() / (rendered.len() as f64).max(1.0);
                vec![mean; actual.len()]
            }
            Practice::FirstMiddleLastLines | Practice::EveryTenth => {
                (0..actual.len()).map(|t| on_line(&rendered, actual, t)).collect()
            }
        }
    }
}

/// Linear interpolation at `t` between the known indices around it. Constant beyond the last.
fn on_line(known: &[usize], actual: &[f64], t: usize) -> f64 {
    let after = known.partition_point(|&place| place < t);
    match (after.checked_sub(1).map(|before| known[before]), known.get(after)) {
        (_, Some(&here)) if here == t => actual[t],
        (Some(before), Some(&after)) => {
            let share = (t - before) as f64 / (after - before) as f64;
            actual[before] + share * (actual[after] - actual[before])
        }
        (Some(end), None) => actual[end],
        (None, Some(&end)) => actual[end],
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::Practice;

    #[test]
    fn a_shot_along_a_line_is_known_from_its_ends_and_from_the_middle() {
        let actual: Vec<f64> = (0..49).map(|t| 100.0 + f64::from(t)).collect();
        assert_eq!(Practice::FirstMiddleLastLines.forecast(&actual), actual);
        let sum = |practice: Practice| practice.forecast(&actual).iter().sum::<f64>();
        assert_eq!(sum(Practice::OneFrame), 49.0 * 124.0);
        assert_eq!(sum(Practice::FirstMiddleLast), 49.0 * 124.0);
        let tenth = Practice::EveryTenth.forecast(&actual);
        assert_eq!(tenth[..41], actual[..41]);
        assert!(
            tenth[41..].iter().all(|&cost| cost == 140.0),
            "beyond the last rendered frame nothing is known"
        );
    }

    #[test]
    fn shots_of_none_one_and_two_frames_are_no_trouble() {
        for practice in Practice::ALL {
            assert!(practice.rendered(0).is_empty() && practice.forecast(&[]).is_empty());
            assert_eq!(practice.rendered(1), [0]);
            assert_eq!(practice.forecast(&[7.0]), [7.0]);
            assert_eq!(practice.forecast(&[7.0, 9.0]).len(), 2);
        }
        assert_eq!(Practice::FirstMiddleLast.rendered(2), [0, 1]);
    }
}
