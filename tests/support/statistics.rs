//! Statistics to compare images.

use forelight_forecast::student_two_sided;

/// An estimated mean.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Estimate.
    pub mean: f64,
    /// Variance of the estimate.
    pub variance: f64,
    /// Degrees of freedom of the variance.
    pub freedom: f64,
}

/// Running mean and variance (Welford 1962).
#[derive(Debug, Clone, Copy, Default)]
pub struct Moments {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Moments {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        self.count += 1.0;
        let delta = value - self.mean;
        self.mean += delta / self.count;
        self.squares += delta * (value - self.mean);
    }

    /// The mean so far, with its variance.
    pub fn sample(&self) -> Sample {
        let freedom = self.count - 1.0;
        Sample { mean: self.mean, variance: self.squares / freedom / self.count, freedom }
    }
}

/// Two-sided p-value that two estimates have the same mean: Welch's t-test. `resolution`² is a lower bound of
/// the variance, for differences by rounding.
pub fn welch(a: Sample, b: Sample, resolution: f64) -> f64 {
    let variance = a.variance + b.variance + resolution * resolution;
    let t = (a.mean - b.mean).abs() / variance.sqrt();
    let freedom = variance.powi(2) / (a.variance.powi(2) / a.freedom + b.variance.powi(2) / b.freedom);
    student_two_sided(t, if freedom.is_finite() { freedom } else { 1e6 })
}

/// P(χ² > x): the upper regularised incomplete gamma function Q(ν/2, x/2). Uses the series below the mean,
/// and the continued fraction above (Abramowitz and Stegun 6.5.29 and 6.5.31).
pub fn chi_square_upper(x: f64, freedom: f64) -> f64 {
    let (a, x) = (freedom / 2.0, x / 2.0);
    if x <= 0.0 {
        return 1.0;
    }
    let front = (a * x.ln() - x - libm::lgamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-16 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return 1.0 - front * sum;
    }
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1e300, 1.0 / b);
    let mut fraction = d;
    for i in 1..10_000 {
        let i = f64::from(i);
        let numerator = -i * (i - a);
        b += 2.0;
        d = 1.0 / (numerator * d + b);
        c = b + numerator / c;
        fraction *= c * d;
        if (c * d - 1.0).abs() < 1e-14 {
            break;
        }
    }
    front * fraction
}

/// p-value that the counts `seen` come from `expected`, which have the same sum (Pearson 1900). Cells with
/// fewer than ten expected counts are merged.
pub fn pearson(seen: &[f64], expected: &[f64]) -> f64 {
    let (mut square, mut cells) = (0.0, 0.0);
    let mut rest = (0.0, 0.0);
    let mut add = |s: f64, e: f64| {
        square += (s - e) * (s - e) / e;
        cells += 1.0;
    };
    for (&s, &e) in seen.iter().zip(expected) {
        if e >= 10.0 {
            add(s, e);
        } else {
            rest = (rest.0 + s, rest.1 + e);
        }
    }
    if rest.1 >= 10.0 || rest.0 >= 10.0 {
        add(rest.0, rest.1.max(1e-9));
    }
    chi_square_upper(square, cells - 1.0)
}

/// P(T ≤ t) of Student's distribution.
pub fn student_below(t: f64, freedom: f64) -> f64 {
    let tail = student_two_sided(t.abs(), freedom) / 2.0;
    if t > 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chi_square_matches_tabulated_quantiles() {
        for (x, freedom, p) in
            [(3.841, 1.0, 0.05), (18.307, 10.0, 0.05), (23.209, 10.0, 0.01), (3.940, 10.0, 0.95)]
        {
            assert!((chi_square_upper(x, freedom) / p - 1.0).abs() < 2e-3, "{x}, {freedom} degrees");
        }
    }

    #[test]
    fn student_matches_tabulated_quantiles() {
        for (t, freedom, p) in
            [(12.706, 1.0, 0.05), (2.228, 10.0, 0.05), (3.169, 10.0, 0.01), (1.96, 1e6, 0.05)]
        {
            assert!((student_two_sided(t, freedom) / p - 1.0).abs() < 2e-3, "t {t}, {freedom} degrees");
        }
    }
}
