//! The processes of a run, by `/proc`.

use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open, pidfd_send_signal};
use std::fs;

/// A process.
#[derive(Debug, Clone, Copy)]
pub(super) struct Member {
    pub pid: Pid,
    /// Its parent.
    parent: Option<Pid>,
    /// CPU time of it and of the descendants that it waited for, nanoseconds.
    pub cpu_nanos: u64,
    /// Resident memory that no other process shares, bytes.
    private: u64,
    /// Resident memory that other processes may share, bytes.
    shared: u64,
}

/// Living processes of the group, and their descendants in other groups: a shell's `timeout` makes one, for example.
pub(super) fn members(group: Pid) -> Vec<Member> {
    let all = pids().filter_map(process);
    let (mut inside, mut others): (Vec<Process>, Vec<Process>) =
        all.partition(|process| process.group == Some(group));
    let mut known = 0;
    while known < inside.len() {
        let parents = inside[known..].iter().map(|process| Some(process.pid)).collect::<Vec<_>>();
        known = inside.len();
        let (children, rest) = others.into_iter().partition(|process| parents.contains(&process.parent));
        inside.extend::<Vec<Process>>(children);
        others = rest;
    }
    inside.into_iter().filter_map(Process::measured).collect()
}

/// Sends a signal to the living processes of the group, and to their descendants in other groups.
pub(super) fn signal_all(group: Pid, signal: Signal) {
    for member in members(group) {
        // It may have ended by itself.
        let _ = kill_process(member.pid, signal);
    }
}

/// Of the members of a group that is a sandbox, the program. The first process is the sandbox itself.
pub(super) fn program_inside(sandbox: Pid, members: &[Member]) -> Option<Pid> {
    members.iter().find(|member| member.parent == Some(sandbox)).map(|member| member.pid)
}

/// Asks what runs in a sandbox to end.
pub(super) fn ask_inside(sandbox: Pid) {
    for member in members(sandbox).iter().filter(|member| member.pid != sandbox) {
        // The program is the first process of its namespace, to which signals do nothing by default.
        let is_first = member.parent == Some(sandbox);
        let signal =
            if is_first && has_default(member.pid, Signal::TERM) { Signal::KILL } else { Signal::TERM };
        // It may have ended by itself.
        let _ = kill_process(member.pid, signal);
    }
}

/// Whether the process neither catches nor ignores the signal: proc_pid_status(5).
fn has_default(pid: Pid, signal: Signal) -> bool {
    let status = fs::read_to_string(format!("/proc/{}/status", pid.as_raw_nonzero())).unwrap_or_default();
    let is_in = |mask: &str| {
        let mask = status.lines().find_map(|line| line.strip_prefix(mask)?.strip_prefix(':'));
        let bits = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
        bits >> (signal.as_raw() - 1) & 1 == 1
    };
    !is_in("SigCgt") && !is_in("SigIgn")
}

/// A process whose memory is not known.
struct Process {
    pid: Pid,
    parent: Option<Pid>,
    group: Option<Pid>,
    cpu_nanos: u64,
}

/// The process, if it lives.
fn process(pid: Pid) -> Option<Process> {
    let stat = fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_nonzero())).ok()?;
    // The name in parentheses may hold anything, so fields are counted from its end: proc_pid_stat(5).
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    if matches!(*fields.first()?, "Z" | "X") {
        return None;
    }
    let number = |index: usize| fields.get(index).and_then(|field| field.parse::<u64>().ok());
    let pid_in = |index: usize| Pid::from_raw(i32::try_from(number(index)?).ok()?);
    let ticks: u64 = (11..15).filter_map(number).sum();
    let cpu_nanos = ticks * (1_000_000_000 / rustix::param::clock_ticks_per_second().max(1));
    Some(Process { pid, parent: pid_in(1), group: pid_in(2), cpu_nanos })
}

impl Process {
    /// The process with its memory, if it still lives.
    fn measured(self) -> Option<Member> {
        let Self { pid, parent, cpu_nanos, .. } = self;
        let statm = fs::read_to_string(format!("/proc/{}/statm", pid.as_raw_nonzero())).ok()?;
        let mut pages = statm.split_whitespace().skip(1).map_while(|field| field.parse::<u64>().ok());
        let (resident, shared) = (pages.next()?, pages.next()?);
        let page = rustix::param::page_size() as u64;
        let private = resident.saturating_sub(shared) * page;
        Some(Member { pid, parent, cpu_nanos, private, shared: shared * page })
    }
}

/// The process, if it lives.
pub(super) fn member(pid: Pid) -> Option<Member> {
    process(pid)?.measured()
}

/// Resident memory of processes together. What they may share counts once, as much as the largest has of it.
pub(super) fn memory_bytes(members: &[Member]) -> u64 {
    let shared = members.iter().map(|m| m.shared).max().unwrap_or(0);
    members.iter().map(|m| m.private).sum::<u64>() + shared
}

/// Living processes whose environment holds this line, such as `NAME=value`, wherever they are.
pub(super) fn marked(mark: &str) -> Vec<Member> {
    pids().filter(|&pid| is_marked(pid, mark)).filter_map(member).collect()
}

fn is_marked(pid: Pid, mark: &str) -> bool {
    fs::read(format!("/proc/{}/environ", pid.as_raw_nonzero()))
        .is_ok_and(|environment| environment.split(|&byte| byte == 0).any(|line| line == mark.as_bytes()))
}

/// Living processes whose environment has this name, with its value.
pub(super) fn all_marked(name: &str) -> Vec<(Pid, String)> {
    let value = |pid: Pid| {
        let environment = fs::read(format!("/proc/{}/environ", pid.as_raw_nonzero())).ok()?;
        let mut lines = environment.split(|&byte| byte == 0).filter_map(|line| str::from_utf8(line).ok());
        let value = lines.find_map(|line| line.strip_prefix(name)?.strip_prefix('='))?.to_owned();
        Some((pid, value))
    };
    pids().filter_map(value).collect()
}

/// Whether a program of the name of this one is among the ancestors of a process.
pub(super) fn is_below_namesake(pid: Pid) -> bool {
    let name = |of: &str| fs::read_to_string(format!("/proc/{of}/comm")).ok();
    let own = name("self");
    let parent_of = |pid: &Pid| process(*pid)?.parent;
    std::iter::successors(parent_of(&pid), parent_of)
        .any(|ancestor| own.is_some() && name(&ancestor.as_raw_nonzero().to_string()) == own)
}

/// Kills the process if it still has the mark. The descriptor keeps the number from naming another process.
pub(super) fn kill_marked(pid: Pid, mark: &str) {
    if let Ok(process) = pidfd_open(pid, PidfdFlags::empty())
        && is_marked(pid, mark)
    {
        // It may have ended by itself.
        let _ = pidfd_send_signal(&process, Signal::KILL);
    }
}

fn pids() -> impl Iterator<Item = Pid> {
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| Pid::from_raw(entry.file_name().to_str()?.parse().ok()?))
}
