//! A running program: lines in and out, and orders.

use super::group;
use super::lines::{Line, Stream, WAITING_LINES, read_lines};
use super::messages::{Message, meaning};
use super::program::Program;
use super::supervisor::{Ended, Ends, Input, Orders, Stop, Usage, start};
use crate::door::{Ending, RendererError, Run};
use rustix::process::Pid;
use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::os::unix::process::ExitStatusExt;
use std::process::ChildStdin;
use std::sync::OnceLock;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Lines that are kept for the message of an error.
const LAST_LINES: usize = 12;

/// Time between two looks at orders while no line comes.
const LOOK: Duration = Duration::from_millis(20);

/// How long a program that closed its input or output may go on.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// What is added to a signal's number in the exit code of a sandbox.
const SIGNALS: i32 = 128;

/// The largest number of a signal.
const LAST_SIGNAL: i32 = 64;

/// Output is read for so long after the end of the program. Only a process that hides could write then.
const OUTPUT_AFTER_END: Duration = Duration::from_secs(1);

/// A program that ended well.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finished {
    /// What it and its descendants used.
    pub usage: Usage,
    /// The last lines that it printed.
    pub last_lines: Vec<String>,
}

/// A running program. It ends at the latest when this is dropped.
#[derive(Debug)]
pub struct Session {
    name: String,
    pid: Pid,
    /// Whether the program runs in a sandbox. `pid` is that of the sandbox then.
    is_inside: bool,
    /// The program's own process, once it is known.
    program: OnceLock<Pid>,
    stdin: Option<ChildStdin>,
    lines: Receiver<Line>,
    /// What it printed last, since the question began.
    last_lines: VecDeque<String>,
    /// How long it stood still since the question began.
    paused: Duration,
    orders: Orders,
    supervisor: Option<JoinHandle<std::io::Result<Ended>>>,
    known: &'static [Message],
}

impl Session {
    /// Starts a program that answers lines of its standard input. The run's limit on memory holds until
    /// [`hold_to`](Self::hold_to) sets another, that on time for each call of [`next`](Self::next)'s caller.
    ///
    /// # Errors
    /// If the program cannot be started.
    pub fn start(program: &Program, known: &'static [Message], run: &Run<'_>) -> Result<Self, RendererError> {
        Self::launch(program, known, run, Ends { input: Input::Lines, output: None })
    }

    pub(super) fn launch(
        program: &Program,
        known: &'static [Message],
        run: &Run<'_>,
        ends: Ends,
    ) -> Result<Self, RendererError> {
        let orders = Orders::default();
        orders.limit(run);
        let (streams, supervisor) = start(program, run, ends, &orders)?;
        let (sender, lines) = sync_channel(WAITING_LINES);
        let errors = sender.clone();
        let (stdout, stderr) = (streams.stdout, streams.stderr);
        if let Some(stdout) = stdout {
            std::thread::spawn(move || read_lines(stdout, Stream::Out, &sender));
        }
        std::thread::spawn(move || read_lines(stderr, Stream::Error, &errors));
        let supervisor = Some(supervisor);
        let (pid, stdin, name) = (streams.pid, streams.stdin, program.name());
        let is_inside = run.sandbox.is_some();
        let program = if is_inside { OnceLock::new() } else { OnceLock::from(pid) };
        Ok(Self {
            name,
            pid,
            is_inside,
            program,
            stdin,
            lines,
            last_lines: VecDeque::new(),
            paused: Duration::ZERO,
            orders,
            supervisor,
            known,
        })
    }

    /// The number of the program's process. `None` once it has ended.
    pub(super) fn pid(&self) -> Option<Pid> {
        if self.has_ended() {
            return None;
        }
        self.program.get().copied().or_else(|| {
            let found = group::program_inside(self.pid, &group::members(self.pid))?;
            Some(*self.program.get_or_init(|| found))
        })
    }

    /// Whether the program has ended.
    pub fn has_ended(&self) -> bool {
        self.supervisor.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Holds the program to the memory limit of this run from now on.
    pub fn hold_to(&self, run: &Run<'_>) {
        self.orders.limit(run);
    }

    /// A question begins: lines and pauses of earlier ones say nothing about it.
    pub(super) fn begin(&mut self) {
        self.last_lines.clear();
        self.paused = Duration::ZERO;
    }

    /// Sends a line, with which a question begins.
    ///
    /// # Errors
    /// If the program has ended: says how.
    pub fn send(&mut self, line: &str) -> Result<(), RendererError> {
        let sent = self.stdin.as_mut().is_some_and(|to| {
            to.write_all(line.as_bytes()).and_then(|()| to.write_all(b"\n")).and_then(|()| to.flush()).is_ok()
        });
        if !sent {
            return Err(self.failure());
        }
        self.begin();
        Ok(())
    }

    /// The next line of output. `None` after the last one: the program has ended.
    ///
    /// # Errors
    /// If the run is cancelled, or is not over `limits.time` after `since`. The program is told to end then.
    pub fn next(&mut self, since: Instant, run: &Run<'_>) -> Result<Option<Line>, RendererError> {
        let mut ended: Option<Instant> = None;
        loop {
            self.obey(since, run)?;
            match self.lines.recv_timeout(LOOK) {
                Ok(line) => {
                    self.keep(&line);
                    return Ok(Some(line));
                }
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if self.has_ended() && ended.get_or_insert_with(Instant::now).elapsed() > OUTPUT_AFTER_END {
                return Ok(None);
            }
        }
    }

    /// Lines that have come, without waiting. They go to the run's log.
    ///
    /// # Errors
    /// As [`next`](Self::next).
    pub(super) fn look(&mut self, since: Instant, run: &Run<'_>) -> Result<(), RendererError> {
        while let Ok(line) = self.lines.try_recv() {
            self.keep(&line);
            (run.log)(&line.text);
        }
        self.obey(since, run)
    }

    /// Ends the program if the run is cancelled or not over in time, and pauses it if that is wanted. Time in
    /// which it stands still does not count.
    fn obey(&mut self, since: Instant, run: &Run<'_>) -> Result<(), RendererError> {
        if let Some(pause) = run.pause.filter(|pause| pause.is_wanted()) {
            let begin = Instant::now();
            self.orders.pause.store(true, Ordering::Relaxed);
            pause.wait();
            self.orders.pause.store(false, Ordering::Relaxed);
            self.paused += begin.elapsed();
        }
        if run.is_cancelled() {
            return Err(self.stop(Stop::Cancelled));
        }
        match run.limits.time.filter(|&limit| since.elapsed().saturating_sub(self.paused) > limit) {
            Some(limit) => Err(self.stop(Stop::TimeLimit(limit))),
            None => Ok(()),
        }
    }

    fn keep(&mut self, line: &Line) {
        if self.last_lines.len() == LAST_LINES {
            self.last_lines.pop_front();
        }
        self.last_lines.push_back(line.text.clone());
    }

    /// Waits until the program ends by itself. Its lines go to the run's log and to `on_line`.
    ///
    /// # Errors
    /// As [`run`].
    pub(super) fn finish(
        mut self,
        since: Instant,
        run: &Run<'_>,
        on_line: &mut dyn FnMut(&Line),
    ) -> Result<Finished, RendererError> {
        while let Some(line) = self.next(since, run)? {
            (run.log)(&line.text);
            on_line(&line);
        }
        // Its output has ended, but it may go on, and is still held to its limits.
        while self.supervisor.as_ref().is_some_and(|thread| !thread.is_finished()) {
            self.obey(since, run)?;
            std::thread::sleep(LOOK);
        }
        let ended = self.join().ok_or_else(|| self.ended(Ending::Code(-1)))?;
        self.verdict(&ended)?;
        Ok(Finished { usage: ended.usage, last_lines: self.last_lines.iter().cloned().collect() })
    }

    /// Ends the program and says what it used.
    pub fn close(mut self) -> Usage {
        self.stdin = None;
        self.end(Stop::Closed).map(|ended| ended.usage).unwrap_or_default()
    }

    /// The error of a program that closed its input or output, and should not have. Most have ended. One that has
    /// not is ended soon.
    pub fn failure(&mut self) -> RendererError {
        let until = Instant::now() + LAST_WORDS;
        while self.supervisor.as_ref().is_some_and(|thread| !thread.is_finished()) && Instant::now() < until {
            match self.lines.recv_timeout(LOOK) {
                Ok(line) => self.keep(&line),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(LOOK),
            }
        }
        // What it said before it ended.
        while let Ok(line) = self.lines.try_recv() {
            self.keep(&line);
        }
        let goes_on = self.supervisor.as_ref().is_some_and(|thread| !thread.is_finished());
        match self.end(Stop::Closed) {
            Some(_) if goes_on => self.explained(Ending::Closed),
            Some(ended) => self.verdict(&ended).err().unwrap_or_else(|| self.ended(Ending::Code(0))),
            None => self.ended(Ending::Code(-1)),
        }
    }

    fn stop(&mut self, stop: Stop) -> RendererError {
        match self.end(stop).and_then(|ended| ended.stop) {
            Some(Stop::Memory(bytes)) => out_of_memory(bytes),
            _ => match stop {
                Stop::TimeLimit(limit) => RendererError::TimeLimit(limit),
                _ => RendererError::Cancelled,
            },
        }
    }

    fn end(&mut self, stop: Stop) -> Option<Ended> {
        self.orders.stop.lock().get_or_insert(stop);
        self.join()
    }

    /// Waits for the end. Output is read meanwhile, so that the program does not wait for a reader.
    fn join(&mut self) -> Option<Ended> {
        let supervisor = self.supervisor.take()?;
        while !supervisor.is_finished() {
            match self.lines.recv_timeout(LOOK) {
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        supervisor.join().ok()?.ok()
    }

    /// What the way in which the program ended means.
    fn verdict(&self, ended: &Ended) -> Result<(), RendererError> {
        match ended.stop {
            Some(Stop::Memory(bytes)) => return Err(out_of_memory(bytes)),
            Some(Stop::TimeLimit(limit)) => return Err(RendererError::TimeLimit(limit)),
            Some(Stop::Cancelled) => return Err(RendererError::Cancelled),
            Some(Stop::Closed) | None => {}
        }
        if ended.status.success() {
            return Ok(());
        }
        let ending = match (ended.status.code(), ended.status.signal()) {
            // A sandbox ends with the code that a shell would.
            (Some(code), _) if self.is_inside && (1..=LAST_SIGNAL).contains(&(code - SIGNALS)) => {
                Ending::Signal(code - SIGNALS)
            }
            (Some(code), _) => Ending::Code(code),
            (None, signal) => Ending::Signal(signal.unwrap_or(0)),
        };
        Err(self.explained(ending))
    }

    /// The error of such an end, or what the last lines say of it.
    fn explained(&self, ending: Ending) -> RendererError {
        let lines: Vec<String> = self.last_lines.iter().cloned().collect();
        let error = self.ended(ending);
        match meaning(&lines, self.known) {
            Some(told) => error.explained_by(told),
            None => error,
        }
    }

    fn ended(&self, ending: Ending) -> RendererError {
        let last_lines = self.last_lines.iter().cloned().collect();
        RendererError::Ended { program: self.name.clone(), ending, last_lines }
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        self.stdin = None;
        self.end(Stop::Closed);
    }
}

fn out_of_memory(bytes: u64) -> RendererError {
    RendererError::OutOfMemory(format!(
        "its processes used {} MiB, which is more than their limit",
        bytes.div_ceil(1 << 20)
    ))
}

/// Runs a program to its end. Every line goes to the run's log and to `on_line`, which can find progress in
/// it. Standard input is empty.
///
/// # Errors
/// If the program cannot be started, is stopped, exceeds a limit, or ends with anything but exit code 0.
pub fn run(
    program: &Program,
    known: &'static [Message],
    run: &Run<'_>,
    on_line: &mut dyn FnMut(&Line),
) -> Result<Finished, RendererError> {
    let since = Instant::now();
    Session::launch(program, known, run, Ends::default())?.finish(since, run, on_line)
}

/// Runs a program that reads one file and writes another. What it prints on standard error goes to the run's
/// log.
///
/// # Errors
/// As [`run`].
pub fn run_on_files(
    program: &Program,
    known: &'static [Message],
    run: &Run<'_>,
    from: File,
    to: File,
) -> Result<Finished, RendererError> {
    let since = Instant::now();
    let ends = Ends { input: Input::From(from.into()), output: Some(to.into()) };
    Session::launch(program, known, run, ends)?.finish(since, run, &mut |_| {})
}
