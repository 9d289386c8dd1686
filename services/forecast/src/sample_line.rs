//! The cost of one frame as a line in its samples: cost = fixed + slope · samples.
//!
//! Renderers that cannot say what single pixels cost are asked for a frame at few samples. The fixed part is
//! what does not depend on samples: synchronising the scene, building the tree, writing. A renderer that cannot
//! render fewer samples is asked for fewer pixels: "samples" are pixels of the image then.

use crate::moments::sum;

/// The measured cost of a frame at some number of samples. With zero samples, it is the fixed cost alone,
/// where a renderer knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleCost {
    /// Number of samples per pixel, or of pixels.
    pub samples: u32,
    /// CPU time, nanoseconds.
    pub cpu_nanos: u64,
}

/// Rounds of reweighting. The weights settle after a few.
const ROUNDS: usize = 20;

/// Residuals beyond so many standard deviations count less (Huber 1964): 95 % as good as least squares where
/// errors are normal, and not moved by a single measurement beside other work.
const HUBER: f64 = 1.345;

/// Relative standard deviation of repeated measurements where nothing else is known.
const PRIOR_NOISE: f64 = 0.03;

/// Weight of that prior, as degrees of freedom.
const PRIOR_FREEDOM: f64 = 3.0;

/// A fitted line, in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SampleLine {
    pub fixed: f64,
    pub slope: f64,
    /// Covariance of (fixed, slope) for a relative noise of one: variance of fixed, covariance, variance of
    /// slope.
    covariance: [f64; 3],
    /// Sum of squared relative residuals, with Huber's weights.
    squares: f64,
    /// Measurements beyond the two that a line needs.
    freedom: f64,
    /// Most samples that were measured.
    most: u32,
}

/// Relative noise of a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Noise {
    pub variance: f64,
    pub degrees_of_freedom: f64,
}

impl SampleLine {
    /// Fits a line. Errors are in proportion to the cost, so each measurement has the weight 1 / cost². Both
    /// coefficients are at least zero. `None` with fewer than two different numbers of samples.
    pub fn fit(costs: &[SampleCost]) -> Option<Self> {
        let points: Vec<(f64, f64)> =
            costs.iter().map(|c| (f64::from(c.samples), (c.cpu_nanos as f64).max(1.0))).collect();
        let most = costs.iter().map(|c| c.samples).max()?;
        if costs.iter().all(|c| c.samples == most) {
            return None;
        }
        let freedom = (points.len() - 2) as f64;
        let mut trust = vec![1.0; points.len()];
        let mut line = (0.0, 0.0);
        let mut covariance = [0.0; 3];
        for _ in 0..ROUNDS {
            (line, covariance) = weighted(&points, &trust);
            if freedom == 0.0 {
                break;
            }
            let residuals: Vec<f64> = points.iter().map(|&point| residual(line, point)).collect();
            let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
            sizes.sort_by(f64::total_cmp);
            // The median of n residuals, of which two are spent on the line, as a standard deviation.
            let scale = 1.4826 * sizes[(sizes.len() + 2) / 2];
            trust = trust_of(&residuals, scale);
        }
        let squares =
            sum(points.iter().zip(&trust).map(|(&point, trust)| trust * residual(line, point).powi(2)));
        Some(Self { fixed: line.0, slope: line.1, covariance, squares, freedom, most })
    }

    /// The cost at `samples`, nanoseconds.
    pub fn at(&self, samples: u32) -> f64 {
        self.fixed + self.slope * f64::from(samples)
    }

    /// Squared relative error of the cost at `samples`, for this noise of single measurements.
    pub fn relative_variance(&self, samples: u32, noise: Noise) -> f64 {
        let (n, [fixed, both, slope]) = (f64::from(samples), self.covariance);
        let cost = self.at(samples).max(1.0);
        noise.variance * (fixed + 2.0 * n * both + n * n * slope).max(0.0) / (cost * cost)
    }

    /// How far `samples` is beyond what was measured: the logarithm of their ratio, at least zero.
    pub fn reach(&self, samples: u32) -> f64 {
        libm::log(f64::from(samples.max(1)) / f64::from(self.most.max(1))).max(0.0)
    }
}

impl Noise {
    /// Pooled over frames: two measurements of a frame determine its line and leave nothing to judge it by,
    /// so the others' residuals do. A prior of 3 % has the weight of three more residuals.
    pub fn pooled(lines: &[SampleLine]) -> Self {
        let squares = sum(lines.iter().map(|line| line.squares));
        let freedom = sum(lines.iter().map(|line| line.freedom));
        let degrees_of_freedom = PRIOR_FREEDOM + freedom;
        let variance = (PRIOR_FREEDOM * PRIOR_NOISE * PRIOR_NOISE + squares) / degrees_of_freedom;
        Self { variance, degrees_of_freedom }
    }
}

fn residual((fixed, slope): (f64, f64), (samples, cost): (f64, f64)) -> f64 {
    (cost - fixed - slope * samples) / cost
}

fn trust_of(residuals: &[f64], scale: f64) -> Vec<f64> {
    let limit = HUBER * scale;
    residuals.iter().map(|r| if r.abs() <= limit || limit <= 0.0 { 1.0 } else { limit / r.abs() }).collect()
}

/// Weighted least squares with both coefficients at least zero.
fn weighted(points: &[(f64, f64)], trust: &[f64]) -> ((f64, f64), [f64; 3]) {
    let weights: Vec<f64> = points.iter().zip(trust).map(|(&(_, cost), t)| t / (cost * cost)).collect();
    let moment = |of: &dyn Fn(f64, f64) -> f64| {
        sum(points.iter().zip(&weights).map(|(&(samples, cost), weight)| weight * of(samples, cost)))
    };
    let (one, n, nn) = (moment(&|_, _| 1.0), moment(&|n, _| n), moment(&|n, _| n * n));
    let (y, ny) = (moment(&|_, y| y), moment(&|n, y| n * y));
    let determinant = one * nn - n * n;
    let fixed = (nn * y - n * ny) / determinant;
    let slope = (one * ny - n * y) / determinant;
    if fixed < 0.0 {
        return ((0.0, ny / nn), [0.0, 0.0, 1.0 / nn]);
    }
    if slope < 0.0 {
        return ((y / one, 0.0), [1.0 / one, 0.0, 0.0]);
    }
    ((fixed, slope), [nn / determinant, -n / determinant, one / determinant])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(costs: &[(u32, u64)]) -> SampleLine {
        let costs: Vec<SampleCost> =
            costs.iter().map(|&(samples, cpu_nanos)| SampleCost { samples, cpu_nanos }).collect();
        SampleLine::fit(&costs).unwrap()
    }

    #[test]
    fn two_measurements_determine_the_line() {
        let found = line(&[(1, 350_000), (8, 1_050_000)]);
        assert!((found.at(64) - 6_650_000.0).abs() < 1e-3);
        assert!((found.fixed - 250_000.0).abs() < 1e-3 && found.freedom == 0.0);
        assert_eq!(SampleLine::fit(&[SampleCost { samples: 4, cpu_nanos: 9 }; 3]), None);
    }

    #[test]
    fn a_known_fixed_cost_is_a_measurement_of_no_samples() {
        let found = line(&[(0, 200_000), (4, 1_000_000)]);
        assert!((found.at(64) - 13_000_000.0).abs() < 1e-3);
    }

    #[test]
    fn one_measurement_beside_other_work_hardly_moves_the_line() {
        let exact = |n: u32| 100_000 + 200_000 * u64::from(n);
        let mut costs: Vec<(u32, u64)> = [1, 2, 4, 8, 8, 16, 16].map(|n| (n, exact(n))).to_vec();
        costs[3].1 = costs[3].1 * 3 / 2;
        let error = line(&costs).at(64) / exact(64) as f64 - 1.0;
        assert!(error.abs() < 0.01, "{error}");
    }

    #[test]
    fn coefficients_are_never_negative() {
        assert_eq!(line(&[(1, 100), (8, 1000)]).fixed, 0.0);
        assert_eq!(line(&[(1, 1000), (8, 900)]).slope, 0.0);
    }

    #[test]
    fn noise_is_pooled_over_frames_with_a_prior() {
        let exact = line(&[(1, 300), (8, 1000)]);
        let prior = Noise::pooled(&[exact, exact]);
        assert!((prior.variance - PRIOR_NOISE * PRIOR_NOISE).abs() < 1e-15);
        let noisy = line(&[(1, 1000), (2, 2600), (4, 3600), (8, 8800), (16, 14000)]);
        let pooled = Noise::pooled(&[exact, noisy]);
        assert!(pooled.variance > prior.variance && pooled.degrees_of_freedom == 6.0);
        assert!(exact.relative_variance(64, pooled) > exact.relative_variance(8, pooled));
    }
}
