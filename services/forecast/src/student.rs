//! Student's t distribution for any real number of degrees of freedom: quantiles and tails.

/// From here on the t distribution is normal to five digits; differences of log-gamma would lose more.
const NORMAL_FROM: f64 = 1.0e6;

/// The quantile at `p` of the t distribution, for 0.5 ≤ p < 1. Less than one degree of freedom counts as one.
/// Newton's method from zero never passes the root, because the distribution function is concave for t > 0.
pub(crate) fn quantile(p: f64, degrees_of_freedom: f64) -> f64 {
    let df = if degrees_of_freedom.is_nan() { 1.0 } else { degrees_of_freedom.clamp(1.0, NORMAL_FROM) };
    let log_scale =
        libm::lgamma((df + 1.0) / 2.0) - libm::lgamma(df / 2.0) - 0.5 * libm::log(df * std::f64::consts::PI);
    let mut t = 0.0f64;
    for _ in 0..100 {
        let density = libm::exp(log_scale - (df + 1.0) / 2.0 * libm::log1p(t * t / df));
        let step = (p - (1.0 - upper_tail(t, df))) / density;
        t += step;
        if step.abs() <= 1e-12 * t.abs() {
            break;
        }
    }
    t
}

/// P(|T| > t) of Student's t distribution, for t ≥ 0 and more than zero degrees of freedom ν: the regularised incomplete beta
/// function I_x(ν/2, 1/2) at x = ν / (ν + t²) (DLMF 8.17).
pub fn student_two_sided(t: f64, degrees_of_freedom: f64) -> f64 {
    let (square, df) = (t * t, degrees_of_freedom);
    incomplete_beta(df / (df + square), square / (df + square), df / 2.0, 0.5)
}

/// P(T > t), for t ≥ 0.
fn upper_tail(t: f64, df: f64) -> f64 {
    0.5 * student_two_sided(t, df)
}

/// Regularised incomplete beta function I_x(a, b), with `y` = 1 − x given without cancellation. Continued
/// fraction of DLMF 8.17.22 by the method of Lentz, on the side where it converges fast.
fn incomplete_beta(x: f64, y: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if y <= 0.0 {
        return 1.0;
    }
    let front = libm::exp(
        libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b) + a * libm::log(x) + b * libm::log(y),
    );
    if x < (a + 1.0) / (a + b + 2.0) {
        front * continued_fraction(x, a, b) / a
    } else {
        1.0 - front * continued_fraction(y, b, a) / b
    }
}

fn continued_fraction(x: f64, a: f64, b: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let away_from_zero = |v: f64| if v.abs() < TINY { TINY } else { v };
    let mut c = 1.0;
    let mut d = 1.0 / away_from_zero(1.0 - (a + b) * x / (a + 1.0));
    let mut value = d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut change = 1.0;
        for coefficient in [even, odd] {
            d = 1.0 / away_from_zero(1.0 + coefficient * d);
            c = away_from_zero(1.0 + coefficient / c);
            change = c * d;
            value *= change;
        }
        if (change - 1.0).abs() < 1e-15 {
            break;
        }
    }
    value
}

#[cfg(test)]
mod tests {
    use super::quantile;

    #[test]
    fn printed_tables_are_met() {
        for (p, df, expected) in [
            (0.95, 1.0, 6.313_751_515),
            (0.95, 2.0, 2.919_985_580),
            (0.80, 2.0, 1.060_660_172),
            (0.95, 5.0, 2.015_048_373),
            (0.80, 10.0, 0.879_057_829),
            (0.95, 30.0, 1.697_260_887),
            (0.95, f64::INFINITY, 1.644_853_627),
            (0.80, f64::INFINITY, 0.841_621_234),
            (0.50, 3.0, 0.0),
        ] {
            let found = quantile(p, df);
            let tolerance = if df.is_finite() { 1e-8 } else { 2e-6 };
            assert!((found - expected).abs() < tolerance, "t({p}, {df}) = {found}, not {expected}");
        }
    }

    #[test]
    fn the_quantile_falls_as_degrees_of_freedom_grow() {
        let values: Vec<f64> = (0..200).map(|i| quantile(0.95, 1.0 + f64::from(i) * 0.37)).collect();
        assert!(values.windows(2).all(|pair| pair[1] < pair[0]));
    }

    #[test]
    fn absurd_degrees_of_freedom_give_a_finite_answer() {
        for df in [f64::NAN, -3.0, 0.0, 1e300] {
            assert!(quantile(0.95, df).is_finite());
        }
    }
}
