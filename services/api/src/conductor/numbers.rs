//! Numbers by which the planner knows frames, and the parts of frames that are divided already.
//!
//! To the planner, a part of a divided frame is a frame of its own. Its number holds the frame in its lowest
//! 32 bits, then the part and the number of parts less one in ten bits each. A whole frame has its own number.

use forelight_planner::Task;
use forelight_protocol::FramePart;

const PART: u32 = 32;
const PARTS: u32 = 42;

/// The number of a frame, or a part of one.
pub(crate) fn number(frame: FramePart) -> i64 {
    let FramePart { frame, part, parts } = frame;
    i64::from(frame) | i64::from(part) << PART | i64::from(parts.saturating_sub(1)) << PARTS
}

/// What a task of a plan is of: a frame, or a part of one, whether it was divided before or by this plan.
/// `None` for a shared cache.
pub(crate) fn frame_part(task: Task) -> Option<FramePart> {
    match task {
        Task::Frame(number) => of_number(number),
        Task::Part { frame, part, parts } => Some(FramePart { part, parts, ..of_number(frame)? }),
        Task::SharedCache | Task::SharedCachePart { .. } => None,
    }
}

fn of_number(number: i64) -> Option<FramePart> {
    let bits = |from: u32, count: u32| u32::try_from((number >> from) & ((1 << count) - 1)).ok();
    Some(FramePart { frame: bits(0, PART)?, part: bits(PART, 10)?, parts: bits(PARTS, 10)? + 1 })
}

#[cfg(test)]
mod tests {
    use forelight_protocol::MOST_PARTS;

    use super::*;

    #[test]
    fn a_number_is_of_one_frame_or_part_alone() {
        assert_eq!(number(FramePart::from(7)), 7);
        let planned = frame_part(Task::Part { frame: 7, part: 2, parts: 3 });
        assert_eq!(planned, Some(FramePart { frame: 7, part: 2, parts: 3 }));
        for frame in [0, 7, u32::MAX] {
            for (part, parts) in [(0, 1), (0, 2), (1, 2), (MOST_PARTS - 1, MOST_PARTS)] {
                let one = FramePart { frame, part, parts };
                assert_eq!(frame_part(Task::Frame(number(one))), Some(one));
            }
        }
    }
}
