//! How fast this machine is, by class of work.
//!
//! A fixed set of kernels is run: small scenes built in code, so that every machine does the same operations.
//! Each is mostly of one class of work (see `kernels`). They are timed in rounds, so that other load on the
//! machine meets all of them. The shortest round of a kernel counts: other load can only lengthen a round,
//! often for seconds (Chen and Revels, *Robust benchmarking in noisy environments*, 2016). From all kernels
//! follows the time per unit of each class (`forelight_forecast::class_rates`).

mod kernels;

use crate::render::seconds;
use forelight_forecast::{Timed, class_rates};
use forelight_protocol::{ByClass, KernelTime, NodeCalibration};
use kernels::REFERENCE;

/// Work units per CPU second of the reference core.
pub const REFERENCE_RATE: f64 = 1e9;

/// Increase this when kernels or their evaluation change. Older calibrations are then repeated.
pub const CALIBRATION_VERSION: u32 = 5;

/// Seconds per unit of work of each class on the reference core, in the order of [`ByClass::NAMES`]. A
/// least-squares fit of relative errors to whole frames of eight scenes, each with direct light, one bounce,
/// and one bounce from a cache. Its error is 4 % (root mean square), and at most 9 %.
const REFERENCE_RATES: [f64; ByClass::CLASSES] =
    [0.94e-9, 1.31e-9, 2.0e-9, 0.65e-9, 1.37e-9, 1.0e-9, 0.66e-9];

/// Default number of rounds, about four seconds.
pub const ROUNDS: usize = 16;

/// Measures one core, on the calling thread, after a round to warm up. `done` receives runs so far, and all.
pub fn calibrate(rounds: usize, done: &dyn Fn(usize, usize)) -> NodeCalibration {
    let kernels = kernels::all();
    let mut times = vec![
        KernelTime { name: String::new(), work: ByClass::default(), cpu_nanos: u64::MAX };
        kernels.len()
    ];
    let runs = (rounds.max(1) + 1) * kernels.len();
    for run in 0..runs {
        let (kernel, time) = (&kernels[run % kernels.len()], &mut times[run % kernels.len()]);
        let (work, nanos) = kernel.run();
        if run >= kernels.len() {
            *time = KernelTime { name: kernel.name.to_owned(), work, cpu_nanos: nanos.min(time.cpu_nanos) };
        }
        done(run + 1, runs);
    }
    let timed: Vec<Timed<{ ByClass::CLASSES }>> = kernels
        .iter()
        .zip(&times)
        .map(|(kernel, time)| {
            (time.work.to_array().map(|work| kernel.beyond * work as f64), seconds(time.cpu_nanos))
        })
        .collect();
    // Every kernel has work and takes time.
    let rates = class_rates(&timed, &REFERENCE_RATES).unwrap_or(REFERENCE_RATES);
    let picos = |rate: f64| ((rate * 1e12).round() as u64).max(1);
    NodeCalibration { picos_per_work: ByClass::from_array(rates.map(picos)), kernels: times }
}

/// Speed of one core relative to the reference, by the kernel most like a frame. For work of unknown classes.
pub fn node_speed(calibration: &NodeCalibration) -> f64 {
    let kernel = calibration.kernels.iter().find(|kernel| kernel.name == REFERENCE);
    let rate = |kernel: &KernelTime| kernel.work.total() as f64 / seconds(kernel.cpu_nanos.max(1));
    let speed = kernel.map_or(1.0, |kernel| rate(kernel) / REFERENCE_RATE);
    // The range that the service accepts, to three digits, which is all that the measurement supports.
    (speed.clamp(0.001, 1000.0) * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kernel_does_the_same_work_every_time_and_each_class_is_most_of_some_kernel() {
        let kernels = kernels::all();
        let work = || -> Vec<ByClass> { kernels.iter().map(|kernel| kernel.run().0).collect() };
        let (first, second) = (work(), work());
        assert_eq!(first, second);
        let share = |class: usize| {
            first.iter().map(|work| work.to_array()[class] as f64 / work.total() as f64).fold(0.0, f64::max)
        };
        // Classes that come with every ray cannot be isolated from the ray's own work.
        let least = [0.4, 0.45, 0.5, 0.4, 0.5, 0.1, 0.9];
        for (class, least) in least.into_iter().enumerate() {
            assert!(share(class) > least, "{}: {:.2} of {first:?}", ByClass::NAMES[class], share(class));
        }
    }

    #[test]
    fn a_calibration_explains_its_own_kernels() {
        let calibration = calibrate(5, &|_, _| ());
        calibration.check().unwrap();
        for (kernel, time) in kernels::all().iter().zip(&calibration.kernels) {
            assert_eq!(kernel.name, time.name);
            let ratio = kernel.beyond * calibration.seconds(&time.work) / seconds(time.cpu_nanos);
            assert!((0.7..1.4).contains(&ratio), "{}: {ratio}", kernel.name);
        }
        assert!(node_speed(&calibration) > 0.001);
    }
}
