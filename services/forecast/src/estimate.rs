//! Estimates the cost of one frame from its profiled pixels: the stratified expansion estimator, with
//! Satterthwaite's degrees of freedom. Groups with fewer than two samples borrow from related ones.

use serde::{Deserialize, Serialize};

use crate::cost::{COLUMNS, Costs, Observation, Quantity, Row};
use crate::error::ForecastError;
use crate::expansion::Expansion;
use crate::interval::{Calibration, Part, combined, quantity};
use crate::moments::{Moments, sum};
use crate::strata::{Group, Grouping, Stratum, check};

/// Coefficient of variation within groups, assumed where no group has the two samples that would show one.
const PRIOR_VARIATION: f64 = 1.0;

/// Least coefficient of variation between strata of one material, since a few samples may agree by chance.
pub(crate) const BORROWED_VARIATION: f64 = 0.5;

/// Degrees of freedom of a borrowed variance.
pub(crate) const BORROWED_FREEDOM: f64 = 2.0;

/// Estimate of one stratum in one frame, for cost maps and tables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StratumEstimate {
    /// Number of pixels that show the stratum.
    pub pixels: u32,
    /// Number of them that were profiled in this frame.
    pub samples: u32,
    /// Whether the unit cost comes from other strata, because this one has no samples here.
    pub borrowed: bool,
    /// Mean cost of one pixel. The sum of pixels times mean over strata is the estimate of the frame.
    pub mean: Costs<f64>,
}

/// Estimated cost of all pixels of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameEstimate {
    /// Totals over all pixels.
    pub total: Costs<Quantity>,
    /// One entry per stratum.
    pub strata: Vec<StratumEstimate>,
    /// Number of profiled pixels.
    pub samples: u64,
    /// Number of groups that borrow mean or variance: fewer than two samples, and not all pixels profiled.
    pub borrowed: usize,
    /// Whether the factor on the interval was measured on past jobs.
    pub calibrated: bool,
}

/// Estimates the cost of a frame from its profiled pixels.
///
/// The estimator is Ŷ = Σ N_g ȳ_g over groups g of strata, with the variance Σ N_g² (1 − n_g/N_g) s_g² / n_g
/// (Cochran 1977, sections 5.3 and 5.4). `counts[h]` is the number of pixels of stratum h. Groups with fewer
/// than two samples borrow from their material, or else from all; see [`FrameEstimate::borrowed`]. If every
/// pixel was profiled, the total is exact.
///
/// # Errors
/// [`ForecastError::NoSamples`] if the frame has pixels but none was profiled, or has cache records
/// ([`Stratum::apart`]) but none was measured. Other errors if counts, strata and observations do not match.
pub fn estimate(
    strata: &[Stratum],
    counts: &[u32],
    observations: &[Observation],
    calibration: Calibration,
) -> Result<FrameEstimate, ForecastError> {
    let fit = FrameFit::new(strata, 0, counts, observations, &Expansion::Groups)?;
    Ok(estimate_fit(fit, observations.len(), calibration))
}

/// The estimate of a frame from its fit. `observations` is the number of observations behind the fit.
pub(crate) fn estimate_fit(fit: FrameFit, observations: usize, calibration: Calibration) -> FrameEstimate {
    let total = std::array::from_fn(|column| {
        let mut uncertainty = Uncertainty::default();
        fit.groups.iter().for_each(|group| uncertainty.add(group, group.pixels as f64, column));
        quantity(fit.total(column), uncertainty.combined(), calibration)
    });
    FrameEstimate {
        total: Costs::from(total),
        borrowed: fit.groups.iter().filter(|group| group.borrowed).count(),
        strata: fit.strata,
        samples: observations as u64,
        calibrated: calibration.calibrated,
    }
}

/// The estimate of a frame, in the form that other frames use.
#[derive(Clone, Debug)]
pub(crate) struct FrameFit {
    pub groups: Vec<GroupFit>,
    pub group_of: Vec<Option<usize>>,
    pub strata: Vec<StratumEstimate>,
    /// Mean cost of one pixel of each stratum.
    pub means: Vec<Row>,
}

/// Estimated mean cost of the pixels of a group of strata.
#[derive(Clone, Debug)]
pub(crate) struct GroupFit {
    pub pixels: u64,
    pub borrowed: bool,
    /// Whether it consists of cache records rather than pixels ([`Stratum::apart`]).
    apart: bool,
    mean: Row,
    /// The total, kept beside the mean so that a complete sample gives an exact total.
    total: Row,
    /// Variance of the mean.
    variance: Row,
    degrees_of_freedom: f64,
    /// How much the mean would rise by one more pixel that costs as much as the most expensive sample.
    influence: Row,
}

impl GroupFit {
    /// The cost of each of its pixels, if all samples cost exactly the same. `None` otherwise.
    pub fn constant(&self, column: usize) -> Option<f64> {
        let is_constant = self.variance[column] == 0.0 && self.influence[column] == 0.0;
        is_constant.then_some(self.mean[column])
    }

    /// Whether it consists of cache records rather than pixels.
    pub const fn is_apart(&self) -> bool {
        self.apart
    }
}

/// Collects the sampling error of a total of group means.
///
/// The *tail allowance* covers rare expensive pixels that the sample may have missed. It adds the squared
/// influence of the most influential sample to the variance. Where costs are similar, this is negligible.
#[derive(Clone, Debug, Default)]
pub(crate) struct Uncertainty {
    parts: Vec<Part>,
    influence: f64,
}

impl Uncertainty {
    /// Adds a group whose mean enters the total `weight` times.
    pub fn add(&mut self, group: &GroupFit, weight: f64, column: usize) {
        self.parts.push(Part {
            variance: weight * weight * group.variance[column],
            degrees_of_freedom: group.degrees_of_freedom,
        });
        self.influence = self.influence.max(weight * group.influence[column]);
    }

    /// Adds a part of the variance that has another cause.
    pub fn add_part(&mut self, part: Part) {
        self.parts.push(part);
    }

    /// The variance of the total, with its tail allowance.
    pub fn combined(mut self) -> Part {
        self.parts
            .push(Part { variance: self.influence * self.influence, degrees_of_freedom: f64::INFINITY });
        combined(&self.parts)
    }
}

impl FrameFit {
    pub fn new(
        strata: &[Stratum],
        frame: i64,
        counts: &[u32],
        observations: &[Observation],
        expansion: &Expansion,
    ) -> Result<Self, ForecastError> {
        check(strata, frame, counts)?;
        let mut moments = vec![Moments::default(); strata.len()];
        for observation in observations {
            let stratum = observation.stratum;
            moments
                .get_mut(stratum as usize)
                .ok_or(ForecastError::UnknownStratum { stratum, strata: strata.len() })?
                .push(&observation.cost);
        }
        for (stratum, (moments, &pixels)) in moments.iter().zip(counts).enumerate() {
            let (samples, pixels) = (moments.count, u64::from(pixels));
            if samples > pixels {
                return Err(ForecastError::MoreSamplesThanPixels { stratum, samples, pixels });
            }
        }
        // Measured cache records do not count as samples of the groups of pixels.
        let of_pixels = moments.iter().zip(strata).filter(|(_, stratum)| !stratum.apart);
        let samples = of_pixels.map(|(moments, _)| moments.count).sum();
        let grouping = match expansion {
            Expansion::Groups => Grouping::new(strata, counts, samples),
            Expansion::EachStratum | Expansion::Neighbours => Grouping::of_each(strata, counts),
            Expansion::Flat | Expansion::Areas(_) => Grouping::new(strata, counts, 1),
        };
        let mut joined = vec![Moments::default(); grouping.groups.len()];
        for (h, moments) in moments.iter().enumerate() {
            if let Some(group) = grouping.of[h] {
                joined[group].merge(moments);
            }
        }
        // Pixels borrow only from pixels, records only from records. So each kind that exists needs a sample.
        let sampled =
            |apart| grouping.groups.iter().zip(&joined).any(|(g, m)| g.apart == apart && m.count > 0);
        if grouping.groups.iter().any(|group| !sampled(group.apart)) {
            return Err(ForecastError::NoSamples);
        }
        let mut groups: Vec<GroupFit> =
            (0..joined.len()).map(|group| fit_group(&grouping, &joined, group)).collect();
        if *expansion != Expansion::Groups {
            let of_pixels = || observations.iter().filter(|o| !strata[o.stratum as usize].apart);
            let total = expansion.total_by_areas(pixels_of(&groups), of_pixels())?;
            let variances = expansion.successive_variances(strata.len(), observations);
            // Pixels do not borrow from records.
            let alike: Vec<Moments> = joined
                .iter()
                .zip(&groups)
                .filter(|(_, fit)| !fit.apart)
                .map(|(own, _)| own.clone())
                .collect();
            for (g, (fit, own)) in groups.iter_mut().zip(&joined).enumerate().filter(|(_, (f, _))| !f.apart) {
                // With successive differences, every stratum is a group of its own.
                let stratum = grouping.of.iter().position(|of| *of == Some(g));
                let variance = stratum.and_then(|h| variances.get(h).copied().flatten());
                fit.apply_expansion(own, &alike, total.filter(|_| expansion.is_one_group()), variance);
            }
        }
        let means = unit_costs(counts, &moments, &grouping, &groups);
        let strata = (0..strata.len())
            .map(|h| StratumEstimate {
                pixels: counts[h],
                // The cast is safe: it was checked that there are at most `pixels` samples.
                samples: moments[h].count as u32,
                borrowed: counts[h] > 0 && moments[h].count == 0,
                mean: Costs::from(means[h]),
            })
            .collect();
        Ok(FrameFit { groups, group_of: grouping.of, strata, means })
    }

    /// Estimated total over all pixels and cache records.
    pub fn total(&self, column: usize) -> f64 {
        sum(self.groups.iter().map(|group| group.total[column]))
    }

    /// Estimated mean over pixels only. Zero if there are none.
    pub fn mean_of_pixels(&self, column: usize) -> f64 {
        let of_pixels = self.groups.iter().filter(|group| !group.apart);
        sum(of_pixels.map(|group| group.total[column])) / (pixels_of(&self.groups) as f64).max(1.0)
    }
}

/// Number of pixels of all groups, without cache records.
fn pixels_of(groups: &[GroupFit]) -> u64 {
    groups.iter().filter(|group| !group.apart).map(|group| group.pixels).sum()
}

impl GroupFit {
    /// Turns a group's fit into that of an expansion other than [`Expansion::Groups`], without tail allowance
    /// or shrinking. `total` and `variance` replace the totals and the variance of one observation, where
    /// given. `alike` are the groups to borrow from.
    fn apply_expansion(
        &mut self,
        own: &Moments,
        alike: &[Moments],
        total: Option<Row>,
        variance: Option<Row>,
    ) {
        self.influence = [0.0; COLUMNS];
        let size = self.pixels as f64;
        let unseen = 1.0 - own.count as f64 / size;
        if own.count == self.pixels {
            return;
        }
        for column in 0..COLUMNS {
            if own.count < 2
                && let Some(pool) = Pool::new(alike.iter(), column)
            {
                let (mean, variance) = match own.count {
                    0 => (pool.mean, pool.between + pool.within / pool.samples),
                    count => (own.mean(column), pool.within / count as f64),
                };
                (self.mean[column], self.variance[column]) = (mean, unseen * variance);
                self.total[column] = size * mean;
            }
            if let Some(variance) = variance {
                self.variance[column] = unseen * variance[column] / own.count as f64;
            }
            if let Some(total) = total {
                self.total[column] = total[column];
                self.mean[column] = total[column] / size;
            }
        }
    }
}

fn fit_group(grouping: &Grouping, joined: &[Moments], group: usize) -> GroupFit {
    let own = &joined[group];
    let pixels = grouping.groups[group].pixels;
    let size = pixels as f64;
    let Group { material, apart, .. } = grouping.groups[group];
    let of_its_kind = || (0..joined.len()).filter(|&g| grouping.groups[g].apart == apart);
    let mut fit = GroupFit {
        pixels,
        borrowed: own.count < 2 && own.count < pixels,
        apart,
        mean: [0.0; COLUMNS],
        total: [0.0; COLUMNS],
        variance: [0.0; COLUMNS],
        degrees_of_freedom: if own.count >= 2 { (own.count - 1) as f64 } else { BORROWED_FREEDOM },
        influence: [0.0; COLUMNS],
    };
    for column in 0..COLUMNS {
        let unseen = 1.0 - own.count as f64 / size;
        (fit.mean[column], fit.variance[column]) = match own.variance(column) {
            Some(variance) => (own.mean(column), unseen * variance / own.count as f64),
            None if own.count == pixels => (own.mean(column), 0.0),
            None => {
                let alike = of_its_kind()
                    .filter(|&g| material.is_some() && grouping.groups[g].material == material)
                    .map(|g| &joined[g]);
                let all = of_its_kind().map(|g| &joined[g]);
                let pool = Pool::new(alike, column).or_else(|| Pool::new(all, column));
                pool.map_or((0.0, 0.0), |pool| pool.shrink(own, column))
            }
        };
        if own.count > 0 {
            fit.influence[column] = unseen * own.reach(column) / own.count as f64;
        }
        fit.total[column] = if own.count == pixels { own.sum(column) } else { size * fit.mean[column] };
    }
    fit
}

/// Mean cost of a pixel of each stratum. In a joined group it is the stratum's own mean, shrunk towards the
/// group's, and scaled so that the strata add up to the group's total.
fn unit_costs(counts: &[u32], moments: &[Moments], grouping: &Grouping, groups: &[GroupFit]) -> Vec<Row> {
    let mut means = vec![[0.0; COLUMNS]; counts.len()];
    for (g, group) in groups.iter().enumerate() {
        let members: Vec<usize> = (0..counts.len()).filter(|&h| grouping.of[h] == Some(g)).collect();
        let columns: [Vec<f64>; COLUMNS] = std::array::from_fn(|column| {
            let pool = Pool::new(members.iter().map(|&h| &moments[h]), column);
            let drawn: Vec<f64> = members
                .iter()
                .map(|&h| match &pool {
                    Some(pool) if moments[h].count < u64::from(counts[h]) => {
                        pool.shrink(&moments[h], column).0
                    }
                    Some(_) => moments[h].mean(column),
                    None => 0.0,
                })
                .collect();
            let expanded = sum(members.iter().zip(&drawn).map(|(&h, mean)| f64::from(counts[h]) * mean));
            if expanded > 0.0 {
                drawn.into_iter().map(|mean| mean * (group.total[column] / expanded)).collect()
            } else {
                vec![group.mean[column]; members.len()]
            }
        });
        for (place, &h) in members.iter().enumerate() {
            means[h] = std::array::from_fn(|column| columns[column][place]);
        }
    }
    means
}

/// Strata or groups that others can borrow from. A one-way analysis of variance with random effects.
struct Pool {
    mean: f64,
    samples: f64,
    within: f64,
    between: f64,
}

impl Pool {
    /// `None` if no member has a sample.
    fn new<'a>(members: impl Iterator<Item = &'a Moments>, column: usize) -> Option<Self> {
        let members: Vec<&Moments> = members.filter(|m| m.count > 0).collect();
        let count = |m: &Moments| m.count as f64;
        let samples: f64 = members.iter().map(|m| count(m)).sum();
        if members.is_empty() {
            return None;
        }
        let mean = sum(members.iter().map(|m| m.sum(column))) / samples;
        let freedom = samples - members.len() as f64;
        let within = if freedom > 0.0 {
            sum(members.iter().map(|m| m.deviations(column))) / freedom
        } else {
            (PRIOR_VARIATION * mean) * (PRIOR_VARIATION * mean)
        };
        // Method of moments: E[Σ n (ȳ − ȳ..)²] = (k − 1) σ² + (n. − Σ n² / n.) τ².
        let scatter =
            sum(members.iter().map(|m| count(m) * (m.mean(column) - mean) * (m.mean(column) - mean)));
        let effective = samples - sum(members.iter().map(|m| count(m) * count(m))) / samples;
        let moment =
            if effective > 0.0 { (scatter - (members.len() - 1) as f64 * within) / effective } else { 0.0 };
        let least = (BORROWED_VARIATION * mean) * (BORROWED_VARIATION * mean);
        Some(Pool { mean, samples, within, between: moment.max(least) })
    }

    /// The mean of a member shrunk towards the pool's, and its variance (Fay, Herriot 1979). The own mean has
    /// the weight λ = τ² / (τ² + σ² / n). With m samples in the pool, the variance is λ σ² / n + (1 − λ)² σ²
    /// / m; without own samples, τ² + σ² / m.
    fn shrink(&self, own: &Moments, column: usize) -> (f64, f64) {
        let of_pool = self.within / self.samples;
        if own.count == 0 {
            return (self.mean, self.between + of_pool);
        }
        let of_own = self.within / own.count as f64;
        let trust = if of_own > 0.0 { self.between / (self.between + of_own) } else { 1.0 };
        let mean = trust * own.mean(column) + (1.0 - trust) * self.mean;
        (mean, trust * of_own + (1.0 - trust) * (1.0 - trust) * of_pool)
    }
}
