//! Into how many parts a frame may be divided, and what each part has.

use forelight_protocol::{
    Division, FixedCosts, MOST_PARTS, PartCount, ProcessCosts, SampleRange, SampleShare,
};

use crate::job_forecast::JobForecast;

/// No frame is divided into parts shorter than this, unless somebody asks for it: CPU seconds.
const LEAST_PART_SECONDS: f64 = 60.0;

/// What a part pays for itself is at most this share of it, unless somebody asks for more parts.
const MOST_OVERHEAD: f64 = 0.02;

/// How many parts a frame gets.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Parts {
    /// As many as help the plan, up to this number. 1: the frame is rendered as a whole.
    UpTo(u32),
    /// Exactly as many.
    Exactly(u32),
}

/// What every part of a frame pays for itself, in CPU seconds at speed 1: opening the scene, setting up the
/// frame, building acceleration structures, writing its file.
pub fn overhead_seconds(forecast: &JobForecast) -> f64 {
    let ProcessCosts { load, build } = forecast.once.unwrap_or_default();
    let FixedCosts { load: setup, build: own_build, write, .. } = forecast.fixed.unwrap_or_default();
    let nanos =
        [load, build, setup, own_build, write].iter().map(|cost| cost.cpu_nanos).fold(0, u64::saturating_add);
    nanos as f64 * 1e-9
}

/// How many parts a frame of so many CPU seconds gets. `most` is what its renderer allows.
pub fn parts(asked: Division, frame_seconds: f64, overhead_seconds: f64, most: u32) -> Parts {
    let most = most.clamp(1, MOST_PARTS);
    match asked {
        Division::Whole => Parts::UpTo(1),
        Division::Into(PartCount(parts)) => Parts::Exactly(parts.clamp(1, most)),
        Division::Auto => {
            // The conversion saturates, and what is no number is 0.
            Parts::UpTo(((frame_seconds / least_part(overhead_seconds)) as u32).clamp(1, most))
        }
    }
}

/// Pixels of a part of a pass: at 700 bytes each, its file has less than 1 GiB.
const MOST_PIXELS_OF_PASS: u64 = 1_500_000;

/// Most parts of a frame of so many pixels that is rendered in passes. 1 if the number of parts that is asked
/// for would make their files too large: the frame is rendered as a whole.
pub fn most_in_passes(asked: Division, pixels: u64) -> u32 {
    let fewest = match asked {
        Division::Whole => 1,
        // A plan may choose any number.
        Division::Auto => 2,
        Division::Into(PartCount(parts)) => u64::from(parts),
    };
    if pixels <= fewest * MOST_PIXELS_OF_PASS { MOST_PARTS } else { 1 }
}

/// Into how many parts the rest of a part is divided that takes longer than forecast, so that idle nodes
/// help. `rest` is how long it would take. 1: it is not divided.
pub fn parts_of_rest(rest_seconds: f64, overhead_seconds: f64, idle_nodes: u32) -> u32 {
    ((rest_seconds / least_part(overhead_seconds)) as u32)
        .clamp(1, idle_nodes.saturating_add(1).min(MOST_PARTS))
}

/// Seconds of the shortest part that pays.
fn least_part(overhead_seconds: f64) -> f64 {
    LEAST_PART_SECONDS.max(overhead_seconds / MOST_OVERHEAD)
}

/// The samples of each part of a frame that has `samples` in every pixel, after those that are finished. They
/// differ by at most one in number, and there are no more of them than samples.
pub fn sample_ranges(samples: u32, finished: &[SampleShare], parts: u32) -> Vec<SampleRange> {
    let first = finished_samples(finished).min(samples);
    let left = u64::from(samples - first);
    let parts = u64::from(parts).min(left);
    // At most `samples`.
    let end = |part: u64| first + (left * part / parts) as u32;
    (0..parts).map(|part| SampleRange { offset: end(part), count: end(part + 1) - end(part) }).collect()
}

/// Number of samples up to the last that is finished.
pub(crate) fn finished_samples(finished: &[SampleShare]) -> u32 {
    finished.iter().map(|share| share.offset.saturating_add(share.count)).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use forelight_protocol::ArtifactHash;

    use super::*;

    #[test]
    fn ranges_cover_the_samples_that_are_left_once() {
        let share = |offset, count| SampleShare { offset, count, cpu_nanos: 1, hash: ArtifactHash([0; 32]) };
        for (samples, finished, parts) in [
            (64, vec![], 7),
            (64, vec![share(0, 1), share(1, 3)], 8),
            (5, vec![share(0, 2)], 8),
            (1, vec![], 1),
        ] {
            let ranges = sample_ranges(samples, &finished, parts);
            let mut next = finished_samples(&finished);
            for range in &ranges {
                assert_eq!(range.offset, next);
                assert!(range.count > 0);
                next += range.count;
            }
            assert_eq!(next, samples);
            assert!(ranges.len() <= parts as usize);
            let counts = ranges.iter().map(|range| range.count);
            assert!(counts.clone().max() <= counts.min().map(|least| least + 1));
        }
        assert!(sample_ranges(4, &[share(0, 4)], 3).is_empty());
    }

    #[test]
    fn long_frames_are_divided_where_a_part_costs_much_more_than_what_it_pays_for_itself() {
        let auto = |seconds, overhead| parts(Division::Auto, seconds, overhead, MOST_PARTS);
        assert_eq!(auto(100.0, 0.1), Parts::UpTo(1));
        assert_eq!(auto(144_000.0, 0.1), Parts::UpTo(MOST_PARTS));
        assert_eq!(auto(3_600.0, 0.1), Parts::UpTo(60));
        assert_eq!(auto(3_600.0, 6.0), Parts::UpTo(12));
        assert_eq!(auto(f64::NAN, 0.0), Parts::UpTo(1));
        assert_eq!(parts(Division::Whole, 1e9, 0.0, MOST_PARTS), Parts::UpTo(1));
        assert_eq!(parts(Division::Into(PartCount(8)), 1.0, 1.0, MOST_PARTS), Parts::Exactly(8));
        assert_eq!(parts(Division::Into(PartCount(8)), 1.0, 1.0, 3), Parts::Exactly(3));
    }

    #[test]
    fn frames_in_passes_are_divided_if_the_files_of_their_parts_are_small_enough() {
        assert_eq!(most_in_passes(Division::Auto, 1920 * 1080), MOST_PARTS);
        assert_eq!(most_in_passes(Division::Auto, 3840 * 2160), 1);
        assert_eq!(most_in_passes(Division::Into(PartCount(5)), 3840 * 2160), 1);
        assert_eq!(most_in_passes(Division::Into(PartCount(6)), 3840 * 2160), MOST_PARTS);
        assert_eq!(most_in_passes(Division::Whole, 64), MOST_PARTS);
    }

    #[test]
    fn the_rest_of_a_part_is_divided_while_nodes_are_idle_and_pieces_are_worth_it() {
        assert_eq!(parts_of_rest(3_600.0, 0.1, 3), 4);
        assert_eq!(parts_of_rest(3_600.0, 0.1, 0), 1);
        assert_eq!(parts_of_rest(119.0, 0.1, 9), 1);
        assert_eq!(parts_of_rest(130.0, 0.1, 9), 2);
        assert_eq!(parts_of_rest(3_600.0, 36.0, 9), 2);
        assert_eq!(parts_of_rest(f64::NAN, 0.1, 9), 1);
        assert_eq!(parts_of_rest(1e12, 0.1, u32::MAX), MOST_PARTS);
    }
}
