//! What finished frames and jobs teach: how far quotes are off, and how fast nodes really are.

use std::collections::BTreeMap;

use forelight_forecast::{Experience, Past, log_ratio_millionths};
use forelight_protocol::{ForecastTotals, JobId, RenderStats};

/// Most frames of a job that are learnt from, evenly spaced. Frames of one job share its errors, so more of
/// them add next to nothing.
const MOST_FRAMES: usize = 100;

/// The frame number that stands for all frames of a job together.
pub(crate) const ALL_FRAMES: i64 = -1;

/// Whether the forecast at this place in a job's list of `count` is learnt from. That of all frames always
/// is.
pub(crate) fn is_learnt_from(frame: i64, place: usize, count: usize) -> bool {
    let stride = count.div_ceil(MOST_FRAMES).max(1);
    frame == ALL_FRAMES || place % stride == stride / 2
}

/// How far a job's forecast of one frame, or of all, was off: residuals in units of its own spread.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Residuals {
    pub job: JobId,
    /// The frame's number, or [`ALL_FRAMES`].
    pub frame: i64,
    pub work: Option<f64>,
    pub cpu: Option<f64>,
}

/// What past jobs teach.
pub(crate) fn experience(residuals: impl IntoIterator<Item = Residuals>) -> Experience {
    let mut experience = Experience::default();
    let mut frames: BTreeMap<JobId, [Vec<f64>; 2]> = BTreeMap::new();
    for Residuals { job, frame, work, cpu } in residuals {
        if frame == ALL_FRAMES {
            let learn = |past: &mut Past, residual: Option<f64>| past.push(residual.into_iter().collect());
            learn(&mut experience.job_work, work);
            learn(&mut experience.job_cpu, cpu);
        } else {
            let own = frames.entry(job).or_default();
            own.iter_mut().zip([work, cpu]).for_each(|(own, residual)| own.extend(residual));
        }
    }
    for [work, cpu] in frames.into_values() {
        experience.frame_work.push(work);
        experience.frame_cpu.push(cpu);
    }
    experience
}

/// Whether a frame says how fast its node is. One that took pixels over from its profile does not: their
/// seconds were spent on another node.
pub(crate) fn is_lesson(stats: &RenderStats) -> bool {
    stats.reused_work == 0
}

/// The logarithm, in millionths, of a frame's CPU seconds over those that its node's calibration predicts.
/// `speed` is the calibrated speed for the frame's classes of work. `None` if either took no time.
pub(crate) fn lesson_of_frame(stats: &RenderStats, speed: f64, quote: &ForecastTotals) -> Option<i64> {
    // For the work that the frame really was, so that only time is judged.
    let at_speed_one = quote.cpu_seconds.mean / quote.work.mean * stats.work as f64;
    log_ratio_millionths(stats.cpu_seconds, at_speed_one / speed)
}

/// By how much the mean of a job's lessons moved when its newest, number `frames`, made their sum `sum`.
/// Whole numbers, so that what is learnt does not depend on the order in which frames are finished.
pub(crate) fn moved_mean(frames: i64, sum: i64, newest: i64) -> i64 {
    let before = if frames == 1 { 0 } else { (sum - newest) / (frames - 1) };
    sum / frames - before
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_job_is_learnt_from_at_even_steps_and_always_as_a_whole() {
        assert!((0..100).all(|place| is_learnt_from(7, place, 100)));
        let learnt: Vec<usize> = (0..1000).filter(|&place| is_learnt_from(7, place, 1000)).collect();
        assert_eq!((learnt.len(), learnt[0], learnt[1]), (100, 5, 15));
        assert!(is_learnt_from(ALL_FRAMES, 0, 1000));
    }

    #[test]
    fn each_job_is_one_witness_however_many_its_frames() {
        let job = JobId::new();
        let of = |frame, work, cpu| Residuals { job, frame, work, cpu };
        let found = experience([
            of(ALL_FRAMES, Some(0.5), None),
            of(0, Some(1.0), Some(2.0)),
            of(1, None, Some(3.0)),
        ]);
        assert_eq!((found.job_work.jobs(), found.job_cpu.jobs()), (1, 0));
        assert_eq!((found.frame_work.jobs(), found.frame_cpu.jobs()), (1, 1));
    }

    #[test]
    fn the_mean_moves_by_whole_millionths_and_ends_where_the_sum_says() {
        let lessons = [100_000, 50_001, -3];
        let (mut sum, mut mean) = (0, 0);
        for (frames, lesson) in (1..).zip(lessons) {
            sum += lesson;
            mean += moved_mean(frames, sum, lesson);
        }
        assert_eq!(mean, lessons.iter().sum::<i64>() / 3);
    }
}
