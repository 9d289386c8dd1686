//! Programs that a killed process left behind.

use super::group;
use super::supervisor::MARK;
use rustix::process::Pid;

/// Ends what foreign programs of a process that was killed left running, and says how many processes that were.
///
/// The programs themselves die with the process that started them. What these started, such as the children of a
/// shell script, does not.
pub fn end_orphans() -> usize {
    let mut ended = 0;
    for (pid, mark) in group::all_marked(MARK) {
        if is_orphan(pid, &mark) {
            group::kill_marked(pid, &format!("{MARK}={mark}"));
            ended += 1;
        }
    }
    ended
}

/// Whether the process that the mark names is gone. In a container, it has another number there than here: what
/// runs below a program of our name is left to that.
fn is_orphan(pid: Pid, mark: &str) -> bool {
    let started_by = mark.split_once('-').and_then(|(number, _)| Pid::from_raw(number.parse().ok()?));
    started_by.is_some_and(|number| group::member(number).is_none()) && !group::is_below_namesake(pid)
}
