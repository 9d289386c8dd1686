//! Follows a job by its events, with a progress bar for each stage.

use anyhow::{Context, Result};
use forelight_client::{Backoff, Client, EventStream};
use forelight_forecast::FIRST_FRAMES;
use forelight_protocol::{
    Event, EventId, EventKind, Job, JobId, JobState, LiveForecast, TaskId, TaskKind, Timestamp,
};
use forelight_terminal::failure::StoppedWatching;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::{seconds, with_local_times};
use indicatif::ProgressBar;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// After this time without an event, the job is read again, because a dead stream may give no sign.
const QUIET: Duration = Duration::from_secs(20);

/// Time between two reads of the job's estimate.
const BETWEEN_ESTIMATES: Duration = Duration::from_secs(1);

/// Follows a job until it ends, through lost connections and restarts of the service.
pub async fn follow(client: &Client, job: Job, bars: &Bars, interrupt: &Interrupt) -> Result<Job> {
    let id = job.id;
    let stopped = interrupt.token();
    let followed = async {
        // Some changes have no event, such as that no node takes tasks.
        let mut job = client.job(id).await.unwrap_or(job);
        let mut stages = Stages::new(bars, &job);
        let mut last: Option<EventId> = None;
        let mut failures = 0;
        while !has_stopped(&job) {
            match client.events(id, last).await {
                Ok(stream) => {
                    failures = 0;
                    last = listen(stream, last, &mut stages, client).await;
                }
                Err(error) => {
                    failures += 1;
                    let patience = Backoff { attempts: Some(30), ..Backoff::PATIENT };
                    let Some(wait) = patience.jittered(failures, None) else {
                        return Err(error)
                            .context("the connection to the service was lost while the job was followed");
                    };
                    tokio::time::sleep(wait).await;
                }
            }
            job = match client.job(id).await {
                Ok(job) => job,
                Err(error) if error.problem().is_some() => {
                    return Err(error).context("cannot follow the job");
                }
                // The service is unreachable for now: the loop connects again.
                Err(_) => continue,
            };
            stages.job(&job);
        }
        stages.finish();
        Ok(job)
    };
    tokio::select! {
        followed = followed => followed,
        () = stopped.cancelled() => {
            let again = format!("forelight submit --job {id} --follow");
            Err(StoppedWatching(format!("stopped following; job {id} goes on ({again})")).into())
        }
    }
}

/// Whether the job is over, or waits for a person to accept its quote.
fn has_stopped(job: &Job) -> bool {
    job.state.is_final() || job.state == JobState::Quoted && job.hold
}

/// Reads events until the stream ends or falls silent, or the job is booked or over. Returns the last id.
async fn listen(
    mut stream: EventStream,
    mut last: Option<EventId>,
    stages: &mut Stages,
    client: &Client,
) -> Option<EventId> {
    let mut asked = Instant::now();
    while let Ok(Some(event)) = tokio::time::timeout(QUIET, stream.next()).await {
        last = Some(event.id);
        stages.event(&event);
        // A job that is now booked shows whether its frames wait for a cache.
        if event
            .job_state
            .is_some_and(|state| state.is_final() || matches!(state, JobState::Booked | JobState::Quoted))
        {
            break;
        }
        if stages.is_behind && asked.elapsed() >= BETWEEN_ESTIMATES {
            asked = Instant::now();
            if let Ok(job) = client.job(stages.id).await {
                stages.job(&job);
            }
        }
    }
    last
}

struct Stages {
    id: JobId,
    bars: Bars,
    previews: ProgressBar,
    profiling: ProgressBar,
    /// The irradiance cache that the frames wait for, in hundredths of a part.
    cache: Option<ProgressBar>,
    /// Progress of each leased part, 0 to 1.
    parts: BTreeMap<TaskId, f64>,
    frames: ProgressBar,
    /// Frames that are being profiled, and whether they are finished.
    profiles: BTreeMap<u32, bool>,
    frames_done: u64,
    /// Whether a frame was finished since the last read of the estimate.
    is_behind: bool,
    /// The last reported reason for waiting.
    waits: Option<String>,
}

impl Stages {
    fn new(bars: &Bars, job: &Job) -> Self {
        let frames = u64::from(job.frames_total);
        let mut stages = Self {
            id: job.id,
            bars: bars.clone(),
            previews: bars.bar("previews", frames),
            profiling: bars
                .bar("profiling", frames.min(job.profile_frames.map_or(FIRST_FRAMES as u64, u64::from))),
            cache: None,
            parts: BTreeMap::new(),
            frames: bars.bar("frames", frames),
            profiles: BTreeMap::new(),
            frames_done: 0,
            is_behind: false,
            waits: None,
        };
        stages.job(job);
        stages
    }

    /// Sets the bars from the job, which takes precedence over its events.
    fn job(&mut self, job: &Job) {
        self.enter(job.state);
        self.frames_done = u64::from(job.frames_done);
        self.frames.set_position(self.frames_done);
        if let Some(live) = &job.live {
            let done = 100.0 * job.progress;
            self.frames.set_message(format!("{}, {done:.0} %, {}", job.state, expected(live)));
        }
        self.is_behind = false;
        let waits = job.waits.as_ref().map(|waits| waits.because.clone());
        if waits != self.waits {
            self.note(waits.as_deref().unwrap_or("goes on"));
            self.waits = waits;
        }
        if let Some(shared) = &job.shared_cache {
            let cache = self.cache.get_or_insert_with(|| self.bars.bar("cache", 0));
            cache.set_length(u64::from(shared.parts) * 100);
            cache.set_position((shared.progress * f64::from(shared.parts) * 100.0) as u64);
            if shared.ready {
                cache.finish();
            }
        }
    }

    fn note(&self, words: &str) {
        self.bars.note(with_local_times(words, Timestamp::now()));
    }

    fn event(&mut self, event: &Event) {
        match (event.kind, event.task_kind, event.frame) {
            (EventKind::JobState, _, _) => event.job_state.into_iter().for_each(|state| self.enter(state)),
            (EventKind::TaskProgress, Some(TaskKind::Preview), _) => {
                let all = self.previews.length().unwrap_or(0) as f64;
                self.previews.set_position((all * event.progress.unwrap_or(0.0)) as u64);
            }
            (EventKind::TaskLeased, Some(TaskKind::Profile), Some(frame)) => {
                self.profiles.entry(frame).or_insert(false);
                self.profiling
                    .set_length(self.profiling.length().unwrap_or(0).max(self.profiles.len() as u64));
            }
            (EventKind::TaskDone, Some(TaskKind::Profile), Some(frame)) => {
                self.profiles.insert(frame, true);
                self.profiling.set_position(self.profiles.values().filter(|done| **done).count() as u64);
            }
            (EventKind::TaskProgress | EventKind::TaskDone, Some(TaskKind::CacheFill), _) => {
                let done =
                    if event.kind == EventKind::TaskDone { 1.0 } else { event.progress.unwrap_or(0.0) };
                self.parts.extend(event.task_id.map(|part| (part, done)));
                if let Some(cache) = &self.cache {
                    cache.set_position((self.parts.values().sum::<f64>() * 100.0) as u64);
                }
            }
            (EventKind::TaskProgress | EventKind::TaskDone, Some(TaskKind::RenderPart), _) => {
                self.is_behind = true
            }
            (EventKind::TaskDone, Some(TaskKind::Render), Some(_)) => {
                self.frames_done += 1;
                self.is_behind = true;
                self.frames.set_position(self.frames_done);
            }
            (EventKind::JobOffForecast | EventKind::JobOnForecast, _, _) => {
                event.message.iter().for_each(|message| self.note(message));
            }
            (EventKind::TaskFailed | EventKind::LeaseExpired, Some(kind), frame) => {
                let frame = frame.map(|frame| format!(" of frame {frame}")).unwrap_or_default();
                let what = if event.kind == EventKind::TaskFailed { "failed" } else { "lost its worker" };
                let why = event.message.as_deref().map(|message| format!(": {message}")).unwrap_or_default();
                self.bars.note(format!("{kind}{frame} {what}{why}"));
            }
            (EventKind::JobPromiseAtRisk | EventKind::JobPromiseSafe, _, _) => {
                event.message.iter().for_each(|message| self.note(message));
            }
            _ => {}
        }
    }

    fn enter(&mut self, state: JobState) {
        if stage(state) >= stage(JobState::Profiling) {
            self.previews.set_position(self.previews.length().unwrap_or(0));
        }
        if stage(state) >= stage(JobState::Quoted) {
            // The job may have profiled fewer frames than the maximum.
            if !self.profiles.is_empty() {
                self.profiling.set_length(self.profiles.len() as u64);
            }
            self.profiling.set_position(self.profiling.length().unwrap_or(0));
        }
        self.frames.set_message(state.name());
    }

    fn finish(&self) {
        for bar in [&self.previews, &self.profiling, &self.frames].into_iter().chain(&self.cache) {
            bar.finish_and_clear();
        }
    }
}

fn expected(live: &LiveForecast) -> String {
    let cpu = &live.cpu_seconds;
    format!("{} of {} CPU time (P80 {})", seconds(cpu.spent), seconds(cpu.whole.p50), seconds(cpu.whole.p80))
}

/// The number of the job's stage. A failed or cancelled job may have stopped in any stage.
fn stage(state: JobState) -> u8 {
    match state {
        JobState::Failed | JobState::Cancelled | JobState::Previewing => 0,
        JobState::Profiling => 1,
        JobState::Quoted => 2,
        JobState::Booked => 3,
        JobState::Rendering => 4,
        JobState::Done => 5,
    }
}
