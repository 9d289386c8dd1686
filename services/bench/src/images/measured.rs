use super::ladder::{Cost, Rung, cost_at};
use super::picture::{Distance, Picture};
use super::quality::Quality;
use super::rendered::Rendered;
use crate::statistics::median;
use anyhow::Result;
use serde::Serialize;

#[derive(Debug, Serialize)]
pub struct Measured {
    pub bundle: String,
    pub size: u32,
    pub ambient_bounces: u32,
    pub threads: usize,
    pub repeats: u32,
    pub reference: Converged,
    pub rungs: Vec<MeasuredRung>,
    /// Savings of each cached rung over gathering at an equal error, on the same samples.
    pub cached: Vec<Saved>,
    /// Wall time on one thread over wall time on two.
    pub second_thread: Vec<SpeedUp>,
    pub peers: Vec<MeasuredPeer>,
}

#[derive(Debug, Serialize)]
pub struct Converged {
    pub flags: String,
    pub mean: f64,
    /// Flags of the gathered reference, and an upper estimate of its noise, relative to its mean.
    pub gathered: Option<Gathered>,
}

#[derive(Debug, Serialize)]
pub struct Gathered {
    pub flags: String,
    pub noise: f64,
}

#[derive(Debug, Serialize)]
pub struct MeasuredRung {
    pub flags: String,
    pub cached: bool,
    pub error: Distance,
    /// Distance from the same camera samples with gathers of very many rays.
    pub indirect_error: Option<Distance>,
    pub work: u64,
    /// Share of the work that planned and filled the cache.
    pub plan_share: f64,
    pub fill_share: f64,
    pub records: Vec<u64>,
    /// Median user and system time of rendering, without loading and building.
    pub cpu_seconds: f64,
    /// (highest − lowest) / median.
    pub cpu_spread: f64,
}

/// A cached rung compared with gathering at an equal error, on the same samples.
#[derive(Debug, Serialize)]
pub struct Saved {
    pub flags: String,
    pub error: f64,
    pub work: Option<f64>,
    pub cpu_seconds: Option<f64>,
}

#[derive(Debug, Serialize)]
pub struct SpeedUp {
    pub flags: String,
    pub ratio: f64,
    pub lowest: f64,
    pub highest: f64,
}

/// Another program's image, and its CPU time relative to ours at an equal error.
#[derive(Debug, Serialize)]
pub struct MeasuredPeer {
    pub name: String,
    pub cpu_seconds: f64,
    pub error: Distance,
    /// Distance of its converged image from ours.
    pub reference: Option<Distance>,
    pub ratio: Option<f64>,
    pub ratio_lit: Option<f64>,
    /// True if our cheapest rung is better, so that the ratio is a lower bound.
    pub bound: bool,
}

/// Summarises the renders of a rung.
pub fn summary(
    rung: &Quality,
    renders: &[Rendered],
    converged: &Picture,
    gathered: Option<&Picture>,
) -> Result<MeasuredRung> {
    let first = &renders[0];
    let mut seconds: Vec<f64> = renders.iter().map(|r| r.cpu_seconds).collect();
    seconds.sort_by(f64::total_cmp);
    let cpu_seconds = median(&seconds);
    Ok(MeasuredRung {
        flags: rung.to_string(),
        cached: rung.is_cached(),
        error: first.picture.distance(converged)?,
        indirect_error: gathered.map(|picture| first.picture.distance(picture)).transpose()?,
        work: first.work,
        plan_share: first.plan as f64 / first.work as f64,
        fill_share: first.fill as f64 / first.work as f64,
        records: first.records.clone(),
        cpu_seconds,
        cpu_spread: (seconds[seconds.len() - 1] - seconds[0]) / cpu_seconds,
    })
}

/// Compares each cached rung with gathering at its error, on the same samples.
pub fn saved(rungs: &[MeasuredRung]) -> Vec<Saved> {
    let of = |cost: fn(&MeasuredRung) -> f64, error: f64| -> Cost {
        let gathering = rungs.iter().filter(|rung| !rung.cached);
        cost_at(gathering.filter_map(|r| Some(Rung { error: r.indirect_error?.rmse, cost: cost(r) })), error)
    };
    let cached = rungs.iter().filter(|rung| rung.cached);
    cached
        .filter_map(|rung| {
            let error = rung.indirect_error?.rmse;
            let times = |cost: fn(&MeasuredRung) -> f64| match of(cost, error) {
                Cost::Is(gathering) => Some(gathering / cost(rung)),
                // The ladder of gathering does not reach this error.
                Cost::AtMost(_) | Cost::Unknown => None,
            };
            Some(Saved {
                flags: rung.flags.clone(),
                error,
                work: times(|r| r.work as f64),
                cpu_seconds: times(|r| r.cpu_seconds),
            })
        })
        .collect()
}
