//! Seconds per unit of work, by class of work: from kernels on a machine, and corrected by what frames took there.
//!
//! A kernel does work of several classes, W_kc, in t_k seconds. The rates r_c that explain all kernels best, each by its share, are
//!
//! ```text
//! min Σ_k ( Σ_c W_kc r_c / t_k − 1 )²  +  λ Σ_c ( r_c / r̄ − 1 )² ,      r̄ = mean of t_k / Σ_c W_kc
//! ```
//!
//! (ridge regression towards one rate for all classes; Hoerl and Kennard 1970). With a small λ a class in which the kernels say much is
//! hardly held back, and one in which they say nothing has the mean rate.
//!
//! What frames take on a machine corrects that. Let m_j be the mean over a job's frames of the logarithm of what they took over what they were
//! forecast to take there, by kernels that know nothing of the scene. Jobs differ in m_j about as much as machines do beyond what
//! kernels can see, so with a normal prior of that width around no correction the posterior mean is Σ m_j / (J + 1) of J jobs
//! (Gelman et al., *Bayesian Data Analysis*, section 2.5). A sum does not depend on the order in which the jobs were finished.

use crate::moments::sum;

/// λ.
const RIDGE: f64 = 0.03;

/// Rates stay within this factor of the mean rate.
const WIDEST: f64 = 20.0;

/// The logarithm of a frame's ratio counts as no more than this: a factor of two.
const MOST: f64 = std::f64::consts::LN_2;

/// Units of the logarithm in which it is kept.
const MILLIONTHS: f64 = 1e6;

/// Work of a kernel by class, and the seconds that it took.
pub type Timed<const CLASSES: usize> = ([f64; CLASSES], f64);

/// Seconds for a unit of work of each class; `None` without kernels that did any work in any time.
pub fn class_rates<const CLASSES: usize>(kernels: &[Timed<CLASSES>]) -> Option<[f64; CLASSES]> {
    let known: Vec<&Timed<CLASSES>> =
        kernels.iter().filter(|(work, seconds)| *seconds > 0.0 && sum(work.iter().copied()) > 0.0).collect();
    let rates = known.iter().map(|(work, seconds)| seconds / sum(work.iter().copied()));
    let mean = sum(rates) / known.len() as f64;
    if known.is_empty() {
        return None;
    }
    // In units of the mean rate: M x = b with M = Σ u uᵀ + λ, b = Σ u + λ, u_c = W_c r̄ / t.
    let rows: Vec<[f64; CLASSES]> =
        known.iter().map(|(work, seconds)| work.map(|work| work * mean / seconds)).collect();
    let mut matrix = [[0.0; CLASSES]; CLASSES];
    let mut right = [RIDGE; CLASSES];
    for i in 0..CLASSES {
        right[i] += sum(rows.iter().map(|row| row[i]));
        for j in 0..CLASSES {
            let ridge = if i == j { RIDGE } else { 0.0 };
            matrix[i][j] = sum(rows.iter().map(|row| row[i] * row[j])) + ridge;
        }
    }
    Some(solved(matrix, right).map(|x| mean * x.clamp(1.0 / WIDEST, WIDEST)))
}

/// Solves a symmetric positive definite system by elimination, which needs no pivots for these (Golub and Van Loan, section 4.2).
fn solved<const N: usize>(mut matrix: [[f64; N]; N], mut right: [f64; N]) -> [f64; N] {
    for k in 0..N {
        let (pivot, known) = (matrix[k], right[k]);
        for (row, right) in matrix.iter_mut().zip(&mut right).skip(k + 1) {
            let factor = row[k] / pivot[k];
            row.iter_mut().zip(pivot).for_each(|(entry, above)| *entry -= factor * above);
            *right -= factor * known;
        }
    }
    for i in (0..N).rev() {
        let known = sum((i + 1..N).map(|j| matrix[i][j] * right[j]));
        right[i] = (right[i] - known) / matrix[i][i];
    }
    right
}

/// The logarithm of what a frame took over what it was forecast to take, in millionths and bounded; `None` if either is nothing.
pub fn log_ratio_millionths(took: f64, forecast: f64) -> Option<i64> {
    let log = libm::log(took / forecast);
    (took > 0.0 && forecast > 0.0 && log.is_finite())
        .then(|| (log.clamp(-MOST, MOST) * MILLIONTHS).round() as i64)
}

/// By what factor a machine takes longer than its kernels say, from the sum over so many jobs of the mean of such logarithms over a
/// job's frames.
pub fn learned_factor(sum_of_means: i64, jobs: u64) -> f64 {
    libm::exp(sum_of_means as f64 / MILLIONTHS / (jobs as f64 + 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_that_kernels_were_timed_with_are_found_again() {
        let truth = [1.0e-9, 2.0e-9, 0.4e-9];
        let kernels =
            [[8.0e6, 1.0e6, 0.0], [1.0e6, 9.0e6, 1.0e6], [2.0e6, 0.0, 7.0e6], [3.0e6, 3.0e6, 3.0e6]];
        let timed: Vec<_> =
            kernels.iter().map(|work| (*work, sum(work.iter().zip(truth).map(|(w, r)| w * r)))).collect();
        let found = class_rates(&timed).unwrap();
        for (found, truth) in found.iter().zip(truth) {
            assert!((found / truth - 1.0).abs() < 0.05, "{found} {truth}");
        }
    }

    #[test]
    fn a_class_that_no_kernel_does_has_the_mean_rate_and_nothing_says_nothing() {
        let found = class_rates(&[([4.0e6, 0.0], 8.0e-3)]).unwrap();
        assert!(
            (found[0] / 2.0e-9 - 1.0).abs() < 0.01 && (found[1] / 2.0e-9 - 1.0).abs() < 0.01,
            "{found:?}"
        );
        assert_eq!(class_rates::<2>(&[]), None);
        assert_eq!(class_rates(&[([0.0, 0.0], 1.0), ([1.0, 0.0], 0.0)]), None);
    }

    #[test]
    fn jobs_correct_a_machine_by_as_much_as_they_are_many_and_none_by_more_than_its_bound() {
        assert_eq!(learned_factor(0, 0), 1.0);
        let slow = log_ratio_millionths(1.2, 1.0).unwrap();
        let one = learned_factor(slow, 1);
        let ten = learned_factor(10 * slow, 10);
        assert!((one / 1.2f64.sqrt() - 1.0).abs() < 1e-5, "{one}");
        assert!(one < ten && ten < 1.2, "{one} {ten}");
        assert_eq!(log_ratio_millionths(1e9, 1.0), log_ratio_millionths(2.0, 1.0));
        assert_eq!(log_ratio_millionths(0.0, 1.0), None);
        assert_eq!(log_ratio_millionths(1.0, 0.0), None);
    }
}
