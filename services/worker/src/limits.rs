//! Limits of a task. A task that exceeds one is stopped with an error that names the limit.

use forelight_protocol::{TaskLimit, TaskLimits};
use forelight_renderer::resident_bytes;
use forelight_renderer::{Control, ExecuteError};
use std::time::{Duration, Instant};

/// Time between two checks.
const LOOK: Duration = Duration::from_millis(100);

/// Returns an error once the task of `control` exceeds a limit. Paused time does not count, nor does what the
/// process had in memory `before` the task: other scenes, and tasks of other workers. What these add later does
/// count: the system tells the memory of a process, not of a task.
pub(crate) async fn gone_beyond(limits: TaskLimits, before: u64, control: &Control) -> ExecuteError {
    if limits.are_none() {
        return std::future::pending().await;
    }
    let mut worked = Duration::ZERO;
    let mut last = Instant::now();
    loop {
        tokio::time::sleep(LOOK.min(limits.wall_ms.map_or(LOOK, Duration::from_millis))).await;
        let now = Instant::now();
        if !control.stands_still() {
            worked += now - last;
        }
        last = now;
        if let Some(error) = beyond(limits, worked, resident_bytes().saturating_sub(before)) {
            return error;
        }
    }
}

/// The error of a task that exceeds a limit, given its working time and the memory that it added, in bytes.
fn beyond(limits: TaskLimits, worked: Duration, memory: u64) -> Option<ExecuteError> {
    let mebibytes = |bytes: u64| bytes.div_ceil(1 << 20);
    if let Some(limit) = limits.wall_ms.filter(|&limit| worked.as_millis() > u128::from(limit)) {
        let message = format!(
            "the task exceeded its time limit of {} s (limits.wall_ms = {limit}); raise it or lower the quality",
            limit as f64 / 1000.0
        );
        return Some(ExecuteError::Limit(TaskLimit::WallTime, message));
    }
    let limit = limits.memory_bytes.filter(|&limit| memory > limit)?;
    let message = format!(
        "the task exceeded its memory limit of {} MiB (limits.memory_bytes = {limit}): the worker grew by {} MiB",
        mebibytes(limit),
        mebibytes(memory)
    );
    Some(ExecuteError::Limit(TaskLimit::Memory, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_limit_ends_a_task_and_is_named_with_its_value() {
        let limits = TaskLimits { memory_bytes: Some(64 << 20), wall_ms: Some(1500) };
        let time = |millis, memory| beyond(limits, Duration::from_millis(millis), memory);
        assert_eq!(time(1500, 64 << 20), None);
        let Some(ExecuteError::Limit(TaskLimit::WallTime, text)) = time(1501, 0) else { panic!() };
        assert!(text.contains("1.5 s") && text.contains("wall_ms = 1500"), "{text}");
        let Some(ExecuteError::Limit(TaskLimit::Memory, text)) = time(0, (64 << 20) + 1) else { panic!() };
        assert!(text.contains("64 MiB") && text.contains("65 MiB"), "{text}");
        assert_eq!(beyond(TaskLimits::default(), Duration::MAX, u64::MAX), None);
    }
}
