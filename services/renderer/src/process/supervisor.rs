//! The thread that starts a program, measures it, holds it to its limits, ends it and reaps it.

use super::group::{self, Member};
use super::program::Program;
use crate::door::{RendererError, Run};
use parking_lot::Mutex;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{
    Pid, PidfdFlags, Resource, Rlimit, Signal, kill_process_group, pidfd_open,
    set_parent_process_death_signal, setrlimit, setsid,
};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use wait4::Wait4 as _;

/// The variable that marks the processes of a run.
pub(super) const MARK: &str = "FORELIGHT_PROCESS";

/// Time between two looks at orders and at the memory of the program itself.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 20_000_000 };

/// Of so many looks, one is at the memory of the whole group: that reads all of `/proc`.
const WHOLE_GROUP: u32 = 8;

/// Rounds of killing what left the group. A process that forks while it is killed needs several.
const ROUNDS: usize = 100;

/// What a program and its descendants used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// CPU time, nanoseconds. Descendants count that were waited for, or that lived when the program ended.
    pub cpu_nanos: u64,
    /// Largest resident memory, bytes: of the largest process, or of all together as sampled.
    pub peak_memory_bytes: u64,
}

/// Why a program was told to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stop {
    /// It is not needed any more.
    Closed,
    Cancelled,
    TimeLimit(Duration),
    /// It used so many bytes.
    Memory(u64),
}

/// How a program ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ended {
    pub status: ExitStatus,
    pub usage: Usage,
    pub stop: Option<Stop>,
}

/// The ends of a program's streams.
pub(super) struct Streams {
    /// The program, which is not reaped while its supervisor runs.
    pub pid: Pid,
    /// `None` unless the program reads lines.
    pub stdin: Option<ChildStdin>,
    /// `None` if it writes elsewhere.
    pub stdout: Option<ChildStdout>,
    pub stderr: ChildStderr,
}

/// What a program reads.
#[derive(Debug, Default)]
pub(super) enum Input {
    /// Nothing.
    #[default]
    Empty,
    /// Lines that are sent to it.
    Lines,
    /// A file or pipe.
    From(OwnedFd),
}

/// Where a program reads and writes.
#[derive(Debug, Default)]
pub(super) struct Ends {
    pub input: Input,
    /// A file or pipe for its standard output. `None`: its lines are read.
    pub output: Option<OwnedFd>,
}

/// Orders to the supervisor.
#[derive(Debug, Clone, Default)]
pub(super) struct Orders {
    /// Why the program must end. The first reason counts.
    pub stop: Arc<Mutex<Option<Stop>>>,
    /// Limit on its resident memory, bytes. It may change while the program runs. 0: none.
    pub memory_bytes: Arc<AtomicU64>,
    /// Whether it should stand still.
    pub pause: Arc<AtomicBool>,
}

impl Orders {
    /// Sets the memory limit of this run.
    pub fn limit(&self, run: &Run<'_>) {
        self.memory_bytes.store(run.limits.memory_bytes.unwrap_or(0), Ordering::Relaxed);
    }
}

/// Starts a program on a thread of its own. That thread lives as long as the program, because the program is
/// killed when the thread that started it ends (`PR_SET_PDEATHSIG`). So it does not outlive this process.
pub(super) fn start(
    program: &Program,
    run: &Run<'_>,
    ends: Ends,
    orders: &Orders,
) -> Result<(Streams, JoinHandle<io::Result<Ended>>), RendererError> {
    let command = run.sandbox.map_or_else(|| program.command(), |sandbox| sandbox.command(program));
    let (orders, grace, is_inside) = (orders.clone(), run.limits.grace, run.sandbox.is_some());
    let (started, starting) = sync_channel(1);
    let path = program.path().to_owned();
    let thread = std::thread::Builder::new()
        .name("supervisor".to_owned())
        .spawn(move || supervise(command, ends, &Watch { orders, grace, is_inside }, &started))
        .map_err(RendererError::io(&path))?;
    match starting.recv() {
        Ok(Ok(streams)) => Ok((streams, thread)),
        Ok(Err(error)) => Err(RendererError::Io { path, source: error }),
        Err(_) => Err(RendererError::Io { path, source: io::Error::other("the supervisor ended") }),
    }
}

fn supervise(
    command: Command,
    ends: Ends,
    watch: &Watch,
    started: &SyncSender<io::Result<Streams>>,
) -> io::Result<Ended> {
    let mark = mark();
    let (mut child, pidfd) = match spawn(command, ends, &mark) {
        Ok(spawned) => spawned,
        Err(error) => {
            let kind = error.kind();
            // The receiver waits for exactly this.
            let _ = started.send(Err(error));
            return Err(kind.into());
        }
    };
    let group = Pid::from_child(&child);
    if let Some(stderr) = child.stderr.take() {
        let (stdin, stdout) = (child.stdin.take(), child.stdout.take());
        // The receiver waits for exactly this.
        let _ = started.send(Ok(Streams { pid: group, stdin, stdout, stderr }));
    }
    let peak = watch.until_its_end(&pidfd, group);

    // The program has ended and is not reaped yet, so its number still names its group.
    let mut left: Vec<Member> = group::members(group);
    // There may be none.
    let _ = kill_process_group(group, Signal::KILL);
    let full_mark = format!("{MARK}={mark}");
    for _ in 0..ROUNDS {
        let marked = group::marked(&full_mark);
        if marked.is_empty() {
            break;
        }
        for member in marked {
            if left.iter().all(|known| known.pid != member.pid) {
                left.push(member);
            }
            group::kill_marked(member.pid, &full_mark);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let used = child.wait4()?;
    let own = u64::try_from((used.rusage.utime + used.rusage.stime).as_nanos()).unwrap_or(u64::MAX);
    let usage = Usage {
        cpu_nanos: own + left.iter().map(|m| m.cpu_nanos).sum::<u64>(),
        peak_memory_bytes: used.rusage.maxrss.max(peak),
    };
    Ok(Ended { status: used.status, usage, stop: *watch.orders.stop.lock() })
}

/// A mark that no other run on this machine has.
fn mark() -> String {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let since_boot = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    format!("{}-{}{:09}-{number}", std::process::id(), since_boot.tv_sec, since_boot.tv_nsec)
}

/// Starts the command, which holds this process's copies of the ends, and drops them then.
fn spawn(mut command: Command, ends: Ends, mark: &str) -> io::Result<(Child, OwnedFd)> {
    let parent = rustix::process::getpid();
    let stdin = match ends.input {
        Input::Empty => Stdio::null(),
        Input::Lines => Stdio::piped(),
        Input::From(end) => end.into(),
    };
    command
        .env(MARK, mark)
        .stdin(stdin)
        .stdout(ends.output.map_or_else(Stdio::piped, Stdio::from))
        .stderr(Stdio::piped());
    let in_child = move || {
        // A group of its own, and no terminal: a program could write commands into that of this process.
        setsid()?;
        setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) })?;
        set_parent_process_death_signal(Some(Signal::KILL))?;
        // The parent may have died before the line above.
        if rustix::process::getppid() != Some(parent) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        Ok(())
    };
    // SAFETY: between fork and exec only async-signal-safe functions may be called. The closure makes four
    // system calls and allocates nothing: an error is a number.
    unsafe { command.pre_exec(in_child) };
    let child = command.spawn()?;
    match pidfd_open(Pid::from_child(&child), PidfdFlags::empty()) {
        Ok(pidfd) => Ok((child, pidfd)),
        Err(error) => {
            // Not reaped yet, so the number is its own.
            let _ = kill_process_group(Pid::from_child(&child), Signal::KILL);
            child.wait4()?;
            Err(error.into())
        }
    }
}

/// How a program is watched.
struct Watch {
    orders: Orders,
    grace: Duration,
    is_inside: bool,
}

impl Watch {
    /// Waits until the program ends, carries out orders, and returns the most memory that was seen.
    fn until_its_end(&self, pidfd: &OwnedFd, group: Pid) -> u64 {
        let Self { orders, grace, is_inside } = self;
        let mut peak = 0;
        let mut program = (!is_inside).then_some(group);
        let mut asked: Option<Instant> = None;
        let mut stands_still = false;
        for look in 0u32.. {
            let mut ready = [PollFd::new(pidfd, PollFlags::IN)];
            if poll(&mut ready, Some(&LOOK)).is_ok_and(|count| count > 0) {
                break;
            }
            let members = if look.is_multiple_of(WHOLE_GROUP) {
                let all = group::members(group);
                program = program.or_else(|| group::program_inside(group, &all));
                all
            } else {
                program.and_then(group::member).into_iter().collect()
            };
            let memory = group::memory_bytes(&members);
            peak = peak.max(memory);
            let limit = orders.memory_bytes.load(Ordering::Relaxed);
            let mut stop = orders.stop.lock();
            if limit > 0 && memory > limit && stop.is_none() {
                *stop = Some(Stop::Memory(memory));
            }
            // A program that stands still would not hear that it is asked to end.
            let pause = orders.pause.load(Ordering::Relaxed) && stop.is_none();
            if pause != stands_still {
                group::signal_all(group, if pause { Signal::STOP } else { Signal::CONT });
                stands_still = pause;
            }
            let Some(reason) = *stop else { continue };
            // A program that uses too much memory is not asked: it might use more meanwhile.
            let at_once = matches!(reason, Stop::Memory(_));
            let signal = match asked {
                None if !at_once => Some(Signal::TERM),
                Some(since) if !at_once && since.elapsed() < *grace => None,
                _ => Some(Signal::KILL),
            };
            asked.get_or_insert_with(Instant::now);
            match signal {
                // A sandbox would end at once, and take the program with it.
                Some(Signal::TERM) if *is_inside => group::ask_inside(group),
                // The program is not reaped, so this is its group, and it exists.
                Some(signal) => drop(kill_process_group(group, signal)),
                None => {}
            }
        }
        peak
    }
}
