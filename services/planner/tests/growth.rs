//! The time of a plan as the farm grows, measured by what is looked at and not by a clock.

use forelight_planner::{plan_and_count, verify};
use forelight_simulator::reference::{Size, studio, studio_with_parts};

/// Gaps, places and numbers that a plan looks at, for so many frames on a farm that grows with them.
fn looks(frames: u64, divided: bool) -> f64 {
    let size = Size { jobs: frames / 500, frames, nodes: frames / 40, ..Size::default() };
    let input = if divided { studio_with_parts(size, 1) } else { studio(size, 1) };
    let (found, looks) = plan_and_count(&input).expect("a plan");
    assert_eq!(verify(&input, &found), Ok(()));
    assert!(found.jobs.iter().all(|entry| entry.verdict.is_kept()), "{frames} frames: all jobs are in time");
    looks as f64
}

/// Asserts that the looks grow at most like n log n between two numbers of frames.
fn grows_at_most_like_n_log_n(few: (u64, f64), many: (u64, f64)) {
    let n_log_n = |frames: u64| frames as f64 * (frames as f64).ln();
    let (grown, allowed) = (many.1 / few.1, n_log_n(many.0) / n_log_n(few.0));
    assert!(grown <= allowed, "from {} to {} frames: {grown:.1} times, not {allowed:.1}", few.0, many.0);
}

#[test]
fn what_a_plan_looks_at_grows_at_most_like_n_log_n_up_to_a_million_frames() {
    let counted = [10_000, 100_000, 1_000_000].map(|frames| (frames, looks(frames, false)));
    counted.windows(2).for_each(|pair| grows_at_most_like_n_log_n(pair[0], pair[1]));
    assert!(counted[0].1 > 1e6, "{counted:?}: the looks are counted");
}

#[test]
fn the_same_holds_where_frames_are_divided() {
    let counted = [10_000, 100_000].map(|frames| (frames, looks(frames, true)));
    grows_at_most_like_n_log_n(counted[0], counted[1]);
}
