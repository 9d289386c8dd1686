//! What jobs ask of nodes, and how fast nodes do it. Pure.

use std::collections::BTreeMap;
use std::sync::Arc;

use forelight_protocol::{ByClass, Needs, Node};
use forelight_quote::JobForecast;
use forelight_quote::serial_time::SerialTime;
use forelight_store::FarmJob;
use indexmap::IndexSet;

use super::farm::units;

/// The class of work that a planner's node does at its general speed.
const GENERAL: u32 = 0;

/// The demands of jobs, each once. Otherwise thousands of jobs and thousands of nodes would be looked at pair
/// by pair.
#[derive(Default)]
pub(super) struct Demands {
    needs: IndexSet<Needs>,
    /// The places here, from 1, are the classes of work of the plan.
    list: IndexSet<Demand>,
}

#[derive(PartialEq, Eq, Hash)]
struct Demand {
    /// The place of what the job needs, if not every node will do.
    needs: Option<usize>,
    /// The work by class.
    work: Option<[u64; ByClass::CLASSES]>,
    serial: SerialShare,
}

/// Serial time of frames per CPU second at speed 1, in steps, so that many jobs share a demand. 0: none.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
struct SerialShare {
    one_core: u16,
    many_cores: u16,
}

impl SerialShare {
    /// The share of step 1: little, even on a node of a hundred cores.
    const LEAST: f64 = 1e-4;
    const STEP: f64 = 1.05;

    /// `frame_cpu` is the mean CPU time of a frame at speed 1, in seconds.
    fn new(serial: SerialTime, frame_cpu: f64) -> Self {
        let step = |micros: i64| {
            let share = micros as f64 * 1e-6 / frame_cpu;
            // Saturating: no frames, or such that take no CPU time, are beyond all steps.
            if micros <= 0 || share < Self::LEAST {
                0
            } else {
                ((share / Self::LEAST).log(Self::STEP) + 1.5) as u16
            }
        };
        Self { one_core: step(serial.one_core), many_cores: step(serial.many_cores) }
    }

    /// The speed of a node of this speed, all cores together, at frames with serial time.
    fn slowed(self, speed: f64, cores: u32) -> f64 {
        match if cores > 1 { self.many_cores } else { self.one_core } {
            0 => speed,
            step => speed / (1.0 + speed * Self::LEAST * Self::STEP.powf(f64::from(step) - 1.0)),
        }
    }
}

impl Demands {
    /// The class of work, in the plan, of a job.
    pub fn class(&mut self, farm_job: &FarmJob, forecast: &JobForecast) -> u32 {
        let needs = farm_job.job.needs().map(|needs| self.needs.insert_full(needs).0);
        let work = forecast.work_by_class.map(ByClass::to_array);
        let frames = usize::try_from(farm_job.job.frames_total).unwrap_or(usize::MAX);
        let serial =
            SerialShare::new(farm_job.serial_time, forecast.mean_of_frames(frames) * farm_job.factor);
        let (place, _) = self.list.insert_full(Demand { needs, work, serial });
        u32::try_from(place + 1).unwrap_or(GENERAL)
    }

    /// Speeds of a node for the classes that it does not do at its general speed. 0 if it lacks what they need.
    pub fn speeds(&self, node: &Node) -> Arc<BTreeMap<u32, u64>> {
        let has: Vec<bool> = self.needs.iter().map(|needs| node.has(needs)).collect();
        let speed = |&Demand { needs, work, serial }: &Demand| {
            if needs.is_some_and(|needs| !has[needs]) {
                return Some(0);
            }
            let work = work.map(ByClass::from_array);
            if serial == SerialShare::default() && node.corrected_speed(work.as_ref()).is_none() {
                return None;
            }
            let speed = node.speed_for(work.as_ref()) * f64::from(node.cores);
            Some(units(serial.slowed(speed, node.cores)).max(1))
        };
        let classes = (GENERAL + 1..).zip(&self.list);
        Arc::new(classes.filter_map(|(class, demand)| Some((class, speed(demand)?))).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame of so many CPU seconds takes so many seconds on a node of this speed, all cores together.
    fn takes(cpu: f64, serial: f64, (speed, cores): (f64, u32)) -> f64 {
        let micros = (serial * 1e6) as i64;
        let share = SerialShare::new(SerialTime { one_core: 0, many_cores: micros }, cpu);
        cpu / share.slowed(speed, cores)
    }

    #[test]
    fn serial_time_is_added_to_the_time_of_a_frame_whatever_the_cores() {
        for (speed, cores) in [(2.0, 2), (8.0, 16), (64.0, 64)] {
            for serial in [0.5, 20.0, 3600.0] {
                let expected = 100.0 / speed + serial;
                let found = takes(100.0, serial, (speed, cores));
                assert!(
                    (found / expected - 1.0).abs() < 0.03,
                    "{serial} s, {cores} cores: {found}, {expected}"
                );
            }
        }
        assert_eq!(takes(100.0, 20.0, (1.0, 1)), 100.0, "that of nodes with one core is another");
        assert_eq!(takes(100.0, 0.0, (8.0, 16)), 12.5);
        assert_eq!(takes(1e6, 0.5, (8.0, 16)), 125_000.0, "so little is none");
    }

    #[test]
    fn frames_without_cpu_time_are_slow_and_not_for_ever() {
        let share = SerialShare::new(SerialTime { one_core: 1, many_cores: 1 }, 0.0);
        let speed = share.slowed(8.0, 16);
        assert!((0.0..1e-6).contains(&speed), "{speed}");
        assert_eq!(SerialShare::new(SerialTime::default(), 0.0), SerialShare::default());
    }
}
