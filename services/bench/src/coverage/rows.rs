//! Counts how often the truths of a group of shots stayed below each quantile.

use super::case::{Case, Judged, NOMINAL, Tally};
use crate::share::Share;
use forelight_forecast::Past;
use serde::Serialize;

/// What a forecast is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// An unprofiled pixel of a profiled frame.
    Pixel,
    /// The pixels of one surface in a profiled frame.
    Stratum,
    Frame,
    Shot,
}

impl Level {
    /// All levels, smallest unit first.
    pub const ALL: [Level; 4] = [Level::Pixel, Level::Stratum, Level::Frame, Level::Shot];

    /// Name in a table.
    pub const fn title(self) -> &'static str {
        match self {
            Level::Pixel => "pixel",
            Level::Stratum => "stratum",
            Level::Frame => "frame",
            Level::Shot => "shot",
        }
    }

    /// Forecasts of a case. Pixels have only a tally.
    fn of(self, case: &Case) -> &[Judged] {
        match self {
            Level::Pixel => &[],
            Level::Stratum => &case.strata,
            Level::Frame => &case.frames,
            Level::Shot => &case.shot,
        }
    }
}

#[derive(Debug, Serialize)]
pub struct Coverage {
    pub samples: u32,
    pub profile_frames: u32,
    pub rows: Vec<Row>,
}

/// Forecasts of one level of one kind of shots.
#[derive(Debug, Serialize)]
pub struct Row {
    pub shots: String,
    pub level: Level,
    pub cases: usize,
    /// Number of different shots. Quotes of one shot are not independent.
    pub independent: usize,
    pub forecasts: usize,
    /// Number of quotes that calibrated the quantiles.
    pub calibrated_on: usize,
    pub points: Vec<Point>,
}

#[derive(Debug, Clone, Copy, Serialize)]
pub struct Point {
    /// Nominal share of truths at or below the quantile.
    pub nominal: f64,
    /// Observed share, for uncalibrated quantiles.
    pub formulas: Share,
    /// Observed share, for quantiles calibrated on other cases. Absent if these were too few.
    pub calibrated: Option<Share>,
}

impl Row {
    pub fn point(&self, nominal: f64) -> Option<&Point> {
        self.points.iter().find(|point| point.nominal == nominal)
    }
}

/// Cases of one shot, or of one scene at one quality.
pub struct Group {
    /// True if it calibrates others of its kind; false if it is judged.
    pub calibrates: bool,
    pub family: String,
    pub cases: Vec<Case>,
}

/// Row of a level of the judged groups, calibrated on the teachers.
pub fn row(shots: &str, level: Level, judged: &[&Group], teachers: &[&Group]) -> Row {
    let mut past = Past::default();
    for case in teachers.iter().flat_map(|group| &group.cases) {
        past.push(level.of(case).iter().filter_map(Judged::residual).collect());
    }
    if level == Level::Pixel {
        return row_of_pixels(shots, judged);
    }
    // By group, the share of forecasts that held.
    let held = |holds: &dyn Fn(&Judged) -> bool| -> Vec<f64> {
        let share = |group: &&Group| {
            let all = || group.cases.iter().flat_map(|case| level.of(case));
            let count = all().count();
            (count > 0).then(|| all().filter(|judged| holds(judged)).count() as f64 / count as f64)
        };
        judged.iter().filter_map(share).collect()
    };
    let point = |&nominal: &f64| {
        let limit = past.quantile(nominal);
        let below = |judged: &Judged, limit: f64| judged.residual().is_none_or(|z| z <= limit);
        Point {
            nominal,
            formulas: Share::of(&held(&|judged| judged.actual <= judged.forecast.at(nominal))),
            calibrated: limit.map(|limit| Share::of(&held(&|judged| below(judged, limit)))),
        }
    };
    let forecasts = |group: &&Group| group.cases.iter().map(|case| level.of(case).len()).sum::<usize>();
    Row {
        shots: shots.to_owned(),
        level,
        cases: judged.iter().map(|group| group.cases.len()).sum(),
        independent: judged.len(),
        forecasts: judged.iter().map(forecasts).sum(),
        calibrated_on: past.jobs(),
        points: NOMINAL.iter().map(point).collect(),
    }
}

fn row_of_pixels(shots: &str, judged: &[&Group]) -> Row {
    let pixels = |group: &Group| group.cases.iter().map(|case| case.pixels.pixels).sum::<u64>();
    let point = |(place, &nominal): (usize, &f64)| {
        let sum = |group: &Group, of: &dyn Fn(&Tally) -> u64| -> u64 {
            group.cases.iter().map(|case| of(&case.pixels)).sum()
        };
        let share = |group: &&Group| {
            let promised = sum(group, &|tally| tally.promised[place]);
            (promised > 0).then(|| sum(group, &|tally| tally.held[place]) as f64 / promised as f64)
        };
        let shares: Vec<f64> = judged.iter().filter_map(share).collect();
        Point { nominal, formulas: Share::of(&shares), calibrated: None }
    };
    Row {
        shots: shots.to_owned(),
        level: Level::Pixel,
        cases: judged.iter().map(|group| group.cases.len()).sum(),
        independent: judged.len(),
        forecasts: judged.iter().map(|group| pixels(group) as usize).sum(),
        calibrated_on: 0,
        points: NOMINAL.iter().enumerate().map(point).collect(),
    }
}
