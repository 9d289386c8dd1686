//! The interface between the agent and task execution: a task in, a result and its files out.

use crate::door::Pause;
use bytes::Bytes;
use forelight_kept::TemporaryFolder;
use forelight_protocol::{
    FinishedPixels, LOG_LINES, LogLevel, LogLine, Spent, TaskLimit, TaskLimits, TaskResult, TaskSpec,
    Timestamp,
};
use parking_lot::{Condvar, Mutex};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

/// A task with its inputs on this machine.
#[derive(Debug, Clone)]
pub struct Assignment {
    /// What to do.
    pub spec: TaskSpec,
    /// Path of the bundle. Empty for videos.
    pub bundle: PathBuf,
    /// The profile to take over pixels from, if the task names one.
    pub profile: Option<Bytes>,
    /// The irradiance caches that the task names, in its order.
    pub caches: Vec<Bytes>,
    /// The number of samples of each pixel that the task names.
    pub samples: Option<Bytes>,
    /// Pixels of the frame's parts that the task names, in its order.
    pub parts: Vec<Bytes>,
    /// Finished shares of the samples that the task names, in its order.
    pub shares: Vec<Bytes>,
    /// Folder of the images that the task shows, named by [`picture_name`].
    pub pictures: Option<Arc<TemporaryFolder>>,
    /// Tiles that an earlier worker finished before it was lost.
    pub checkpoint: Option<Bytes>,
    /// Limits on the task.
    pub limits: TaskLimits,
    /// Threads that the task may use.
    pub threads: u32,
}

impl Assignment {
    /// A task that takes nothing over, without limits, on one thread.
    pub fn new(spec: TaskSpec, bundle: PathBuf) -> Self {
        Self {
            spec,
            bundle,
            profile: None,
            caches: Vec::new(),
            samples: None,
            parts: Vec::new(),
            shares: Vec::new(),
            pictures: None,
            checkpoint: None,
            limits: TaskLimits::default(),
            threads: 1,
        }
    }
}

/// Share of a video's progress that fetching its pictures counts for.
pub const FETCHED: f64 = 0.5;

/// Name of a picture in the folder of its task, by its place.
pub fn picture_name(place: usize) -> String {
    format!("{place:06}.png")
}

/// Result of a task.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Names artefacts by their hash.
    pub result: TaskResult,
    /// Contents of these artefacts.
    pub artifacts: Vec<Bytes>,
}

/// Why a task has no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ExecuteError {
    /// The task was told to stop.
    #[error("stopped")]
    Cancelled,
    /// The task cannot succeed on any worker.
    #[error("{0}")]
    Permanent(String),
    /// A file that the task needs is gone: its bundle, or something that it takes over.
    #[error("{0}")]
    Input(String),
    /// The task failed on this attempt. Another one may succeed.
    #[error("{0}")]
    Transient(String),
    /// The task exceeded one of its limits.
    #[error("{1}")]
    Limit(TaskLimit, String),
}

/// Progress, orders and log of a task, shared between its threads and the connection to the service.
#[derive(Debug, Default)]
pub struct Control {
    progress: AtomicU64,
    cancelled: AtomicBool,
    pause: Mutex<bool>,
    resumed: Condvar,
    /// Threads that are paused.
    standing: AtomicUsize,
    log: Mutex<Book>,
    checkpoint_interval: Duration,
    checkpoint: Mutex<Option<Bytes>>,
    pixels: Mutex<Option<FinishedPixels>>,
    before_pixels: Mutex<Spent>,
    /// Into how many parts the rest is to be divided. 0: it is not.
    divide_rest: AtomicU32,
}

/// Log lines of one attempt at a task.
#[derive(Debug, Default)]
struct Book {
    /// Lines that the service has not acknowledged.
    unsent: VecDeque<LogLine>,
    /// Number of the next line.
    next: u32,
}

impl Control {
    /// Most lines in one message.
    pub const LINES_AT_ONCE: usize = 100;

    /// For a task that should offer checkpoints at this interval.
    pub fn with_checkpoints(interval: Duration) -> Self {
        Self { checkpoint_interval: interval, ..Self::default() }
    }

    /// How often checkpoints are wanted.
    pub fn checkpoint_interval(&self) -> Duration {
        self.checkpoint_interval
    }

    /// Offers all parts that are finished so far. Replaces an earlier offer that was not taken.
    pub fn offer_checkpoint(&self, bytes: Bytes) {
        *self.checkpoint.lock() = Some(bytes);
    }

    /// Takes the checkpoint that was offered since the last call.
    pub fn take_checkpoint(&self) -> Option<Bytes> {
        self.checkpoint.lock().take()
    }

    /// Has the pixels that are not begun left to others, in so many parts.
    pub fn divide_rest(&self, parts: u32) {
        self.divide_rest.store(parts, Ordering::Relaxed);
    }

    /// Into how many parts the pixels are to be divided that are not begun, if others are to render them.
    pub fn rest_in_parts(&self) -> Option<u32> {
        Some(self.divide_rest.load(Ordering::Relaxed)).filter(|&parts| parts > 1)
    }

    /// Adds finished pixels and their cost. The first call sets the number of all pixels.
    pub fn finished_pixels(&self, finished: FinishedPixels) {
        let mut pixels = self.pixels.lock();
        let FinishedPixels { done, all, work, cpu_nanos } = pixels.unwrap_or_default();
        *pixels = Some(FinishedPixels {
            done: done + finished.done,
            all: all.max(finished.all),
            work: work + finished.work,
            cpu_nanos: cpu_nanos + finished.cpu_nanos,
        });
    }

    /// Sets the cost of the frame before its first pixel: its irradiance cache.
    pub fn spent_before_pixels(&self, spent: Spent) {
        *self.before_pixels.lock() = spent;
    }

    /// How much of the frame is finished. `None` for other tasks.
    ///
    /// With F the cost before pixels, and P the cost of all pixels as the finished ones suggest, the frame is
    /// (F + P done / all) / (F + P) finished. The result is that share of all pixels.
    pub fn pixels(&self) -> Option<FinishedPixels> {
        let finished = (*self.pixels.lock())?;
        let before = *self.before_pixels.lock();
        let FinishedPixels { done, all, work, cpu_nanos } = finished;
        if before.work == 0 || done == 0 {
            return Some(finished);
        }
        let so_far = (before.work + work) as f64;
        let whole = before.work as f64 + work as f64 * all as f64 / done as f64;
        let share = (so_far / whole).min(1.0);
        Some(FinishedPixels {
            done: ((share * all as f64).round() as u64).clamp(done, all),
            all,
            work: before.work + work,
            cpu_nanos: before.cpu_nanos + cpu_nanos,
        })
    }

    /// Reports progress, 0 to 1. Blocks while the task is paused, so every thread should call it often.
    pub fn set_progress(&self, fraction: f64) {
        self.note_progress(fraction);
        self.wait();
    }

    /// Reports progress, 0 to 1, without standing still.
    pub fn note_progress(&self, fraction: f64) {
        let fraction = if fraction.is_finite() { fraction.clamp(0.0, 1.0) } else { 0.0 };
        self.progress.store(fraction.to_bits(), Ordering::Relaxed);
    }

    /// Progress, 0 to 1.
    pub fn progress(&self) -> f64 {
        f64::from_bits(self.progress.load(Ordering::Relaxed))
    }

    /// Pauses or resumes the work.
    pub fn pause(&self, pause: bool) {
        *self.pause.lock() = pause;
        self.resumed.notify_all();
    }

    /// Whether the work is paused: at least one thread is, and the others will be at their next report.
    pub fn stands_still(&self) -> bool {
        self.standing.load(Ordering::Relaxed) > 0
    }

    /// Tells the work to stop.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
        // Under the lock, so that no thread misses this between its check and its wait.
        drop(self.pause.lock());
        self.resumed.notify_all();
    }

    /// Whether the work was told to stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// The flag to stop, as renderers take it.
    pub fn cancelled(&self) -> &AtomicBool {
        &self.cancelled
    }

    /// Adds a line to the task's log, for the next renewal. Lines beyond the limit are dropped.
    pub fn log(&self, level: LogLevel, text: impl Into<String>) {
        let text = text.into();
        let mut book = self.log.lock();
        let number = book.next;
        // Errors explain how a task ended, so one place is always left for them.
        let (level, text) = match LOG_LINES - number.min(LOG_LINES) {
            0 => return,
            1 if level != LogLevel::Error => return,
            2 if level != LogLevel::Error => {
                (LogLevel::Warn, "log limit reached: further lines are dropped".to_owned())
            }
            _ => (level, text),
        };
        book.next += 1;
        book.unsent.push_back(LogLine { number, at: Timestamp::now(), level, text }.cleaned());
    }

    /// The next lines to send.
    pub fn unsent(&self) -> Vec<LogLine> {
        self.log.lock().unsent.iter().take(Self::LINES_AT_ONCE).cloned().collect()
    }

    /// Marks these lines as received by the service.
    pub fn sent(&self, lines: &[LogLine]) {
        let Some(last) = lines.last() else { return };
        self.log.lock().unsent.retain(|line| line.number > last.number);
    }
}

impl Pause for Control {
    fn is_wanted(&self) -> bool {
        *self.pause.lock()
    }

    fn wait(&self) {
        let mut pause = self.pause.lock();
        if *pause && !self.is_cancelled() {
            self.standing.fetch_add(1, Ordering::Relaxed);
            while *pause && !self.is_cancelled() {
                self.resumed.wait(&mut pause);
            }
            self.standing.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// Executes tasks. Runs on a thread pool of its own, and checks `control` often.
pub trait Execute: Send + Sync + 'static {
    /// Executes one task.
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_that_is_paused_stands_still_until_it_goes_on_or_is_stopped() {
        for stop in [false, true] {
            let control = Arc::new(Control::default());
            control.pause(true);
            let working = {
                let control = control.clone();
                std::thread::spawn(move || control.set_progress(0.5))
            };
            while !control.stands_still() {
                std::thread::yield_now();
            }
            assert_eq!(control.progress(), 0.5);
            assert!(!working.is_finished());
            if stop {
                control.cancel()
            } else {
                control.pause(false)
            }
            working.join().unwrap();
            assert!(!control.stands_still());
        }
    }

    #[test]
    fn a_frame_whose_cache_is_filled_is_as_far_as_its_pixels_say_that_the_cache_is_of_it() {
        let control = Control::default();
        assert_eq!(control.pixels(), None);
        control.spent_before_pixels(Spent { work: 300, cpu_nanos: 600 });
        let finished = |done, work| FinishedPixels { done, all: 100, work, cpu_nanos: 2 * work };
        control.finished_pixels(finished(0, 0));
        assert_eq!(control.pixels(), Some(finished(0, 0)), "nothing is known of its pixels");
        control.finished_pixels(finished(10, 10));
        // Its pixels will cost 100 in all, and the frame 400: 310 of that are done.
        assert_eq!(control.pixels(), Some(finished(78, 310)));
        control.finished_pixels(finished(90, 100));
        assert_eq!(control.pixels(), Some(finished(100, 410)));
    }

    #[test]
    fn lines_are_sent_until_they_are_acknowledged_and_there_is_always_room_for_the_last_error() {
        let control = Control::default();
        for number in 0..2 * LOG_LINES {
            control.log(LogLevel::Info, format!("line {number}"));
        }
        control.log(LogLevel::Error, "the end");
        let first = control.unsent();
        assert_eq!((first.len(), first[0].number), (100, 0));
        assert_eq!(control.unsent(), first, "not acknowledged");
        let mut all = Vec::new();
        loop {
            let lines = control.unsent();
            if lines.is_empty() {
                break;
            }
            control.sent(&lines);
            all.extend(lines);
        }
        assert_eq!(all.len(), LOG_LINES as usize);
        assert!(all.iter().map(|line| line.number).eq(0..LOG_LINES));
        let [.., more, end] = all.as_slice() else { panic!() };
        assert_eq!((more.level, end.text.as_str()), (LogLevel::Warn, "the end"));
    }
}
