//! Seconds per unit of work on a machine, by class of work: measured by kernels, corrected by rendered
//! frames.
//!
//! A kernel k does work W_kc of several classes in t_k seconds. On the reference machine, a unit of class c
//! takes p_c seconds, and Σ_c W_kc p_c is the time of the kernel there. The rates of another machine are r_c
//! = m p_c x_c:
//!
//! ```text
//! min Σ_k ( Σ_c W_kc m p_c x_c / t_k − 1 )²  +  λ Σ_c ( x_c − 1 )² ,      m = mean of t_k / Σ_c W_kc p_c
//! ```
//!
//! This is ridge regression towards the proportions of the reference (Hoerl and Kennard 1970). A class with
//! much kernel work is hardly shrunk; one without gets the rate m p_c. Errors in the division into classes
//! cancel between two machines.
//!
//! Rendered frames correct these rates. Let m_j be the mean, over the frames of job j, of ln(time taken /
//! time by the rates). Jobs differ in m_j about as much as machines do beyond their kernels. So with a normal
//! prior of that width around zero, the posterior mean is Σ m_j / (J + 1) (Gelman et al., *Bayesian Data
//! Analysis*, section 2.5), in any order of jobs.

use crate::moments::sum;

/// λ: the kernels' error over the machines' variance by class, about (8 % / 15 %)².
const RIDGE: f64 = 0.3;

/// Bound on the factors x_c, in both directions.
const MAX_PROPORTION: f64 = 20.0;

/// Bound on the absolute logarithm of a frame's ratio: a factor of two.
const MAX_LOG_RATIO: f64 = std::f64::consts::LN_2;

/// Logarithms are stored in millionths.
const MILLIONTHS: f64 = 1e6;

/// Work of a kernel by class, and the seconds that it took.
pub type Timed<const CLASSES: usize> = ([f64; CLASSES], f64);

/// Seconds per unit of work of each class, all positive. `reference` are those of the reference machine.
/// `None` if no kernel did any work in a positive time.
pub fn class_rates<const CLASSES: usize>(
    kernels: &[Timed<CLASSES>],
    reference: &[f64; CLASSES],
) -> Option<[f64; CLASSES]> {
    let there = |work: &[f64; CLASSES]| -> [f64; CLASSES] {
        std::array::from_fn(|class| work[class] * reference[class])
    };
    let known: Vec<Timed<CLASSES>> = kernels
        .iter()
        .map(|(work, seconds)| (there(work), *seconds))
        .filter(|(work, seconds)| *seconds > 0.0 && sum(work.iter().copied()) > 0.0)
        .collect();
    let factors = known.iter().map(|(work, seconds)| seconds / sum(work.iter().copied()));
    let mean = sum(factors) / known.len() as f64;
    if known.is_empty() {
        return None;
    }
    // M x = b with M = Σ u uᵀ + λ, b = Σ u + λ, u_c = W_c p_c m / t.
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
    let proportions = solved(matrix, right);
    Some(std::array::from_fn(|class| {
        mean * reference[class] * proportions[class].clamp(1.0 / MAX_PROPORTION, MAX_PROPORTION)
    }))
}

/// Solves a symmetric positive definite system. No pivoting is needed (Golub and Van Loan, section 4.2).
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

/// ln(took / forecast) of a frame, bounded and in millionths. `None` unless both are positive.
pub fn log_ratio_millionths(took: f64, forecast: f64) -> Option<i64> {
    let log = libm::log(took / forecast);
    (took > 0.0 && forecast > 0.0 && log.is_finite())
        .then(|| (log.clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO) * MILLIONTHS).round() as i64)
}

/// Factor by which a machine is slower than its kernels say. `sum_of_means` sums, over `jobs` jobs, the mean
/// of [`log_ratio_millionths`] over the job's frames.
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
        let off = |reference: [f64; 3]| {
            let found = class_rates(&timed, &reference).unwrap();
            found.iter().zip(truth).map(|(found, truth)| (found / truth - 1.0).abs()).fold(0.0, f64::max)
        };
        assert!(
            off(truth.map(|rate| 3.0 * rate)) < 1e-12,
            "one factor for all classes is found to the last digit"
        );
        // The proportions are off by a quarter. Less than half of that is left.
        assert!(off([0.9e-9, 2.2e-9, 0.5e-9]) < 0.12, "{}", off([0.9e-9, 2.2e-9, 0.5e-9]));
        assert!(off([1.0e-9; 3]) < 0.3, "{}", off([1.0e-9; 3]));
    }

    #[test]
    fn a_class_that_no_kernel_does_is_in_proportion_and_nothing_says_nothing() {
        let found = class_rates(&[([4.0e6, 0.0], 8.0e-3)], &[1.0e-9, 3.0e-9]).unwrap();
        assert!(
            (found[0] / 2.0e-9 - 1.0).abs() < 0.01 && (found[1] / 6.0e-9 - 1.0).abs() < 0.01,
            "{found:?}"
        );
        let reference = [1.0e-9; 2];
        assert_eq!(class_rates(&[], &reference), None);
        assert_eq!(class_rates(&[([0.0, 0.0], 1.0), ([1.0, 0.0], 0.0)], &reference), None);
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
