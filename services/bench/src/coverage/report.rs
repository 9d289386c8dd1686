use super::rows::{Coverage, Level, Point};
use crate::report::Report;
use crate::share::Share;
use forelight_terminal::table::{Align, Table};

/// Quantiles that quotes name.
const NAMED: [f64; 3] = [0.50, 0.80, 0.95];

pub fn of(report: &Coverage) -> Report {
    let head = [
        ("shots", Align::Left),
        ("level", Align::Left),
        ("quotes", Align::Right),
        ("forecasts", Align::Right),
        ("<=P50", Align::Right),
        ("<=P80", Align::Right),
        ("<=P95", Align::Right),
        ("calibrated <=P50", Align::Right),
        ("<=P80", Align::Right),
        ("<=P95", Align::Right),
    ];
    let mut table = Table::new(&head);
    for row in &report.rows {
        let first = row.level == Level::ALL[0];
        let name = if first { row.shots.clone() } else { String::new() };
        let shares = |of: fn(&Point) -> Option<Share>| {
            NAMED.map(|p| row.point(p).and_then(of).map_or("-".to_owned(), |share| share.to_string()))
        };
        table.row(
            [name, row.level.title().to_owned(), row.cases.to_string(), row.forecasts.to_string()]
                .into_iter()
                .chain(shares(|point| Some(point.formulas)))
                .chain(shares(|point| point.calibrated)),
        );
    }
    let teachers = report.rows.iter().map(|row| row.calibrated_on).max().unwrap_or(0);
    Report::default().table(table).text(format!(
            "\nShares of truths at or below the quantile, with 95 % intervals. {} pixels in {} frames of a shot were profiled. Calibrated quantiles rest on up to {teachers} quotes \
             of other shots.\n",
            report.samples, report.profile_frames
        ))
}
