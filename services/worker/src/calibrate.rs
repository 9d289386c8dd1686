//! How fast this machine is, by class of work.
//!
//! A fixed set of kernels is traced: small scenes that are built in code, so that every machine does exactly the same operations. Each is
//! mostly of one class of work (see `kernels`). They are timed in rounds, one after the other within each, so that whatever
//! else the machine does meanwhile meets them all; the median of a kernel's rounds counts. What they took together says how long a unit
//! of each class takes (`forelight_forecast::class_rates`).

mod kernels;

use crate::classes::by_class;
use crate::render::seconds;
use forelight_forecast::{Timed, class_rates};
use forelight_protocol::{ByClass, KernelTime, NodeCalibration};
use forelight_tracer::Totals;
use kernels::{Kernel, REFERENCE};

/// Work units per CPU second of the reference core.
pub const REFERENCE_RATE: f64 = 1e9;

/// Times that every kernel is traced.
const ROUNDS: usize = 7;

/// Measures one core, on the calling thread; a few seconds. `done` is told the kernels that were traced so far, and all.
pub fn calibrate(done: &dyn Fn(usize, usize)) -> NodeCalibration {
    let kernels = kernels::all();
    let mut times = vec![Vec::with_capacity(ROUNDS); kernels.len()];
    let mut traced = 0;
    // The first round only fetches what is needed.
    for round in 0..=ROUNDS {
        for (kernel, times) in kernels.iter().zip(&mut times) {
            let nanos = kernel.run();
            if round > 0 {
                times.push(nanos);
            }
            traced += 1;
            done(traced, (ROUNDS + 1) * kernels.len());
        }
    }
    let kernels: Vec<KernelTime> =
        kernels.iter().zip(times).map(|(kernel, times)| kernel.time(median(times))).collect();
    let timed: Vec<Timed<6>> = kernels
        .iter()
        .map(|kernel| (kernel.work.to_array().map(|work| work as f64), seconds(kernel.cpu_nanos)))
        .collect();
    // Every kernel does some work, which takes some time.
    let rates = class_rates(&timed).unwrap_or([1.0 / REFERENCE_RATE; 6]);
    let picos = |rate: f64| ((rate * 1e12).round() as u64).max(1);
    NodeCalibration { picos_per_work: ByClass::from_array(rates.map(picos)), kernels }
}

/// The speed of one core against the reference, by the kernel that is most like a frame: for work whose classes are not known.
pub fn node_speed(calibration: &NodeCalibration) -> f64 {
    let kernel = calibration.kernels.iter().find(|kernel| kernel.name == REFERENCE);
    let rate = |kernel: &KernelTime| kernel.work.total() as f64 / seconds(kernel.cpu_nanos.max(1));
    let speed = kernel.map_or(1.0, |kernel| rate(kernel) / REFERENCE_RATE);
    // The service takes speeds of this range; three digits are more than a measurement of this length can say.
    (speed.clamp(0.001, 1000.0) * 1000.0).round() / 1000.0
}

impl Kernel {
    /// Nanoseconds that it took this time.
    fn run(&self) -> u64 {
        Totals::of(self.tracer.profile(&self.pixels).iter()).cpu_nanos
    }

    fn time(&self, cpu_nanos: u64) -> KernelTime {
        // In all rounds it did the same.
        let work = self.tracer.work_by_class().0.map(|work| work / (ROUNDS as u64 + 1));
        let triangles = self.tracer.frame().geometry.triangles.len();
        KernelTime { name: self.name.to_owned(), work: by_class(work, triangles), cpu_nanos }
    }
}

fn median(mut times: Vec<u64>) -> u64 {
    times.sort_unstable();
    times.get(times.len() / 2).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kernel_does_the_same_work_every_time_and_each_class_is_most_of_some_kernel() {
        let kernels = kernels::all();
        let work = || -> Vec<ByClass> {
            kernels
                .iter()
                .map(|kernel| {
                    let before = kernel.tracer.work_by_class().0;
                    kernel.run();
                    let after = kernel.tracer.work_by_class().0;
                    let triangles = kernel.tracer.frame().geometry.triangles.len();
                    by_class(std::array::from_fn(|class| after[class] - before[class]), triangles)
                })
                .collect()
        };
        let (first, second) = (work(), work());
        assert_eq!(first, second);
        let share = |class: usize| {
            first.iter().map(|work| work.to_array()[class] as f64 / work.total() as f64).fold(0.0, f64::max)
        };
        // What comes with every ray cannot be had without what the ray does.
        let least = [0.4, 0.5, 0.6, 0.4, 0.5, 0.1];
        for (class, least) in least.into_iter().enumerate() {
            assert!(share(class) > least, "{}: {:.2} of {first:?}", ByClass::NAMES[class], share(class));
        }
    }

    #[test]
    fn a_calibration_explains_its_own_kernels() {
        let calibration = calibrate(&|_, _| ());
        calibration.check().unwrap();
        for kernel in &calibration.kernels {
            let ratio = calibration.seconds(&kernel.work) / seconds(kernel.cpu_nanos);
            assert!((0.7..1.4).contains(&ratio), "{}: {ratio}", kernel.name);
        }
        assert!(node_speed(&calibration) > 0.001);
    }
}
