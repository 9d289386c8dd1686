//! How often jobs of a renderer cost at most the quantiles of their quotes, as a farm would see it: every job calibrates
//! the quotes after it.

use super::Case;
use crate::share::Share;
use forelight_forecast::{Correction, Past, residual};
use forelight_terminal::table::{Align, Table};
use std::collections::BTreeMap;

/// A job that is done.
struct Job {
    /// Whether it cost at most P80 and P95 of its quote.
    held: [bool; 2],
    /// Error of the quote, in its spreads.
    residual: Option<f64>,
}

/// Jobs by renderer, in the order in which they ended: shots in turn, seed by seed.
fn jobs(cases: &[Case]) -> BTreeMap<String, Vec<Job>> {
    let mut all: BTreeMap<String, Vec<Job>> = BTreeMap::new();
    for seed in 0..cases.first().map_or(0, |case| case.seeds.len()) {
        for case in cases {
            let trial = &case.seeds[seed];
            let actual: f64 = trial.rendered.iter().sum();
            let quoted = trial.cpu_seconds;
            all.entry(case.renderer.to_string()).or_default().push(Job {
                held: [quoted.p80, quoted.p95].map(|quantile| actual <= quantile),
                residual: residual(quoted.mean, trial.spread, actual),
            });
        }
    }
    all
}

/// Whether each job that had enough jobs before it cost at most P80 and P95, calibrated by these.
fn calibrated(jobs: &[Job]) -> Vec<[bool; 2]> {
    let mut past = Past::default();
    let mut held = Vec::new();
    for job in jobs {
        let Some(z) = job.residual else { continue };
        if let Some(Correction { p80, p95, .. }) = past.correction() {
            held.push([p80, p95].map(|limit| z <= limit));
        }
        past.push(vec![z]);
    }
    held
}

/// The shares of P80 and P95, with their intervals.
fn shares(held: &[[bool; 2]]) -> [String; 2] {
    [0, 1].map(|quantile| {
        let of_jobs: Vec<f64> = held.iter().map(|held| f64::from(u8::from(held[quantile]))).collect();
        if of_jobs.is_empty() { "-".to_owned() } else { Share::of(&of_jobs).to_string() }
    })
}

/// A row for each renderer.
pub fn table(cases: &[Case]) -> Table {
    let mut table = Table::new(&[
        ("renderer", Align::Left),
        ("jobs", Align::Right),
        ("<=P80", Align::Right),
        ("<=P95", Align::Right),
        ("calibrated", Align::Right),
        ("<=P80 then", Align::Right),
        ("<=P95 then", Align::Right),
    ]);
    for (renderer, jobs) in jobs(cases) {
        let quoted: Vec<[bool; 2]> = jobs.iter().map(|job| job.held).collect();
        let calibrated = calibrated(&jobs);
        let counts = [jobs.len(), calibrated.len()].map(|count| count.to_string());
        let [all, after] = counts;
        let [p80, p95] = shares(&quoted);
        let [calibrated_p80, calibrated_p95] = shares(&calibrated);
        table.row([renderer, all, p80, p95, after, calibrated_p80, calibrated_p95]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_is_judged_by_the_jobs_before_it() {
        let job = |z: f64| Job { held: [z <= 0.8, z <= 1.6], residual: Some(z) };
        // Quotes that are too low by five spreads and a little more or less.
        let jobs: Vec<Job> = (0..400).map(|i| job(5.0 + f64::from(i * 7 % 20) / 20.0)).collect();
        let after = calibrated(&jobs);
        // Nineteen jobs give the first P95.
        assert_eq!(after.len(), 381);
        assert!(jobs.iter().all(|job| job.held == [false; 2]));
        let share = |quantile: usize| after.iter().filter(|held| held[quantile]).count() as f64 / 381.0;
        assert!((share(0) - 0.8).abs() < 0.06, "{}", share(0));
        assert!((share(1) - 0.95).abs() < 0.03 || share(1) == 1.0, "{}", share(1));
        assert_eq!(shares(&[]), ["-", "-"]);
    }
}
