//! A running program that answers bytes with bytes, such as rays with values.

use super::messages::Message;
use super::program::Program;
use super::session::{Finished, Session};
use super::supervisor::{Ends, Input};
use crate::door::{RendererError, Run};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fs;
use std::io::{ErrorKind, PipeReader, PipeWriter, Read, Write, pipe};
use std::time::{Duration, Instant};

/// Most bytes of a question: what a pipe holds, so that a question never waits for the program.
pub const MOST_BYTES: usize = 1 << 16;

/// Time between two looks at orders while no answer comes.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 20_000_000 };

/// Looks at a process until it waits for input, and time between two of them.
const LOOKS_AT_STATE: usize = 2000;
const BETWEEN_LOOKS: Duration = Duration::from_micros(5);

/// A running program that reads questions and writes answers, both in bytes. It ends at the latest when this
/// is dropped.
#[derive(Debug)]
pub struct Exchange {
    session: Session,
    to: PipeWriter,
    from: PipeReader,
}

impl Exchange {
    /// Starts a program. The run's limit on memory holds for all of its life, that on time for each question.
    ///
    /// # Errors
    /// If the program cannot be started.
    pub fn start(program: &Program, known: &'static [Message], run: &Run<'_>) -> Result<Self, RendererError> {
        let io = || RendererError::io(program.path());
        let (its_input, to) = pipe().map_err(io())?;
        let (from, its_output) = pipe().map_err(io())?;
        let ends = Ends { input: Input::From(its_input.into()), output: Some(its_output.into()) };
        let session = Session::launch(program, known, run, ends)?;
        Ok(Self { session, to, from })
    }

    /// Sends a question of at most [`MOST_BYTES`], and hands the answer to `take` as it comes, until that
    /// returns true.
    ///
    /// # Errors
    /// If the question is too long, the program ends, or the run is stopped.
    pub fn ask(
        &mut self,
        question: &[u8],
        run: &Run<'_>,
        take: &mut dyn FnMut(&[u8]) -> Result<bool, RendererError>,
    ) -> Result<(), RendererError> {
        if question.len() > MOST_BYTES {
            let reason = format!("a question of {} bytes; the most are {MOST_BYTES}", question.len());
            return Err(RendererError::Failed(reason));
        }
        let since = Instant::now();
        if self.to.write_all(question).is_err() {
            return Err(self.session.failure());
        }
        self.session.begin();
        let mut buffer = [0; 1 << 16];
        loop {
            self.session.look(since, run)?;
            let mut ready = [PollFd::new(&self.from, PollFlags::IN)];
            if !poll(&mut ready, Some(&LOOK)).is_ok_and(|count| count > 0) {
                continue;
            }
            match self.from.read(&mut buffer) {
                Ok(0) => return Err(self.session.failure()),
                Ok(length) => {
                    if take(&buffer[..length])? {
                        return Ok(());
                    }
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return Err(self.session.failure()),
            }
        }
    }

    /// CPU time of the program's first thread since its start, nanoseconds, once it waits for a question.
    /// `None` if the system does not say.
    pub fn cpu_nanos(&self) -> Option<u64> {
        let id = self.session.pid()?.as_raw_nonzero();
        for _ in 0..LOOKS_AT_STATE {
            // The name in parentheses may hold anything: proc_pid_stat(5).
            let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
            if stat.rsplit_once(") ")?.1.starts_with('S') {
                break;
            }
            std::thread::sleep(BETWEEN_LOOKS);
        }
        let times = fs::read_to_string(format!("/proc/{id}/schedstat")).ok()?;
        times.split_whitespace().next()?.parse().ok()
    }

    /// Ends the input, and waits until the program ends by itself.
    ///
    /// # Errors
    /// If it ends with anything but exit code 0, or the run is stopped.
    pub fn finish(self, run: &Run<'_>) -> Result<Finished, RendererError> {
        let Self { session, to, from } = self;
        drop(to);
        let finished = session.finish(Instant::now(), run, &mut |_| {});
        drop(from);
        finished
    }
}
