//! `forelight status`: the state of a job.

use super::submit::images::{again, deleted, is_deleted, were_deleted};
use super::submit::report::{delivered, ended, quote};
use crate::connection::ConnectionOptions;
use crate::connection::connect;
use crate::named::{JOBS, job_id};
use anyhow::{Context, Result, bail};
use forelight_client::Client;
use forelight_protocol::{ForecastDoc, FrameSet, Job, JobState, LiveForecast, Timestamp, Verdict, Waits};
use forelight_terminal::failure::StoppedWatching;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::duration;
use forelight_terminal::output;
use forelight_terminal::quantities::{clock, probability_in_words, seconds, with_local_times};
use std::io::IsTerminal;
use std::time::Duration;

/// Show a job: progress, forecast and booking, time of completion, reason for waiting, cost so far
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight status 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data
  forelight status kitchen --watch --data farm-data
  forelight status kitchen --json --server http://farm:7878
  forelight status kitchen --watch --json --data farm-data > kitchen.jsonl

With --watch the display is updated until the job ends. The exit code is then 0 only if all frames were delivered. \
With --watch and --json, each change is printed as one line.

  forecast   CPU time as quoted, and as expected from the frames that are done
  booked     CPU time that the plan reserves for the job
  cost       price of the nodes' time so far and in total, with lost work and the quote itself")]
pub struct Args {
    /// Id or name of the job. Of several jobs with the same name, the newest is shown
    job: String,
    /// Update the display until the job ends
    #[arg(short, long)]
    watch: bool,
    /// Time between two updates with --watch, such as 5s
    #[arg(long, value_name = "DURATION", default_value = "1s", value_parser = duration)]
    interval: Duration,
    /// Print the job as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}
pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    let client = connect(&args.connection)?;
    let job = find(&client, &args.job).await?;
    if !args.watch {
        if args.json {
            return output::json(&job);
        }
        let beside = beside(&client, &job).await?;
        return output::print(&report(&job, &beside, Timestamp::now()));
    }
    let last = watch(&args, &client, job, &interrupt).await?;
    match last.state {
        JobState::Done => Ok(()),
        state => {
            let why = last.error.map_or(String::new(), |error| format!(": {error}"));
            bail!("the job {}{why}", ended(state))
        }
    }
}

async fn find(client: &Client, wanted: &str) -> Result<Job> {
    let id = match job_id(wanted)? {
        Some(id) => id,
        None => {
            let named = client.jobs_named(wanted).await.context("cannot list the jobs")?;
            named.first().ok_or_else(|| JOBS.missing(wanted, JOBS.none))?.id
        }
    };
    client.job(id).await.with_context(|| format!("cannot read job {wanted}"))
}

/// What is shown of a job and is not in it.
#[derive(Default)]
struct Beside {
    /// The quote that waits to be accepted.
    quote: Option<ForecastDoc>,
    /// Frames whose images were deleted.
    deleted: Option<FrameSet>,
}

async fn beside(client: &Client, job: &Job) -> Result<Beside> {
    let id = job.id;
    if job.state == JobState::Quoted && job.hold {
        let quote =
            client.forecast(id).await.with_context(|| format!("cannot read the quote of job {id}"))?;
        return Ok(Beside { quote: Some(quote), deleted: None });
    }
    if !job.state.is_final() || job.frames_done == 0 {
        return Ok(Beside::default());
    }
    // The images of a job are deleted together, so that two frames tell whether all have to be read.
    let unreadable = || format!("cannot read the frames of job {id}");
    for frame in [job.frames.iter().next().unwrap_or_default(), job.frames.last()] {
        if is_deleted(&client.frame(id, frame).await.with_context(unreadable)?) {
            let frames = client.frames(id).await.with_context(unreadable)?;
            return Ok(Beside { quote: None, deleted: deleted(&frames) });
        }
    }
    Ok(Beside::default())
}

async fn watch(args: &Args, client: &Client, mut job: Job, interrupt: &Interrupt) -> Result<Job> {
    let stopped = interrupt.token();
    let in_place = !args.json && std::io::stdout().is_terminal();
    let (mut shown, mut last) = (String::new(), None);
    loop {
        let beside = if args.json { Beside::default() } else { beside(client, &job).await? };
        let text = report(&job, &beside, Timestamp::now());
        if args.json && last.as_ref() != Some(&job) {
            output::json_line(&job)?;
        } else if !args.json && text != shown {
            if in_place {
                // Long lines may have wrapped, so the whole screen is cleared.
                output::clear_screen()?;
            }
            output::print(&text)?;
        }
        (shown, last) = (text, Some(job.clone()));
        if job.state.is_final() {
            return Ok(job);
        }
        tokio::select! {
            () = tokio::time::sleep(args.interval) => {}
            () = stopped.cancelled() => {
                let again = format!("forelight status {} --watch", job.id);
                let words = format!("stopped watching; job {} goes on ({again})", job.id);
                return Err(StoppedWatching(words).into());
            }
        }
        job = client.job(job.id).await.with_context(|| format!("cannot read job {}", job.id))?;
    }
}

const CELLS: usize = 40;

/// A share from 0 to 1 as a bar of `cells` characters, with per cent.
pub fn bar(share: f64, cells: usize) -> String {
    let share = share.clamp(0.0, 1.0);
    // Rounded down, so that only a finished job has a full bar.
    let full = (share * cells as f64).floor() as usize;
    format!("[{}{}] {:3.0} %", "#".repeat(full), ".".repeat(cells - full), (share * 100.0).floor())
}

fn report(job: &Job, beside: &Beside, now: Timestamp) -> String {
    let mut text = format!("{}  {}\n", bar(job.progress, CELLS), job.name);
    let mut line = |name: &str, what: String| text += &format!("{name:<10} {what}\n");
    line("job", format!("{} of project {}", job.id, job.project));
    line("state", format!("{}: {} done", job.state, delivered(job.frames_done, job.frames_total)));
    if job.state == JobState::Quoted && job.hold {
        let id = job.id;
        line(
            "waits",
            format!("for `forelight accept {id}`, which books it; `forelight cancel {id}` drops it"),
        );
    }
    if let Some(deleted) = &beside.deleted {
        line("images", format!("{}; {}", were_deleted(deleted), again(job, deleted)));
    }
    if let Some(cache) = job.shared_cache.as_ref().filter(|cache| !cache.ready && !job.state.is_final()) {
        let filled = format!("{} of {} parts filled", cache.parts_done, cache.parts);
        line("cache", format!("{}  {filled}; the frames wait for the cache", bar(cache.progress, CELLS / 2)));
    }
    if job.paused {
        let id = job.id;
        line("waits", format!("for `forelight resume {id}`: it is paused, and what is under way goes on"));
    } else if let Some(waits) = &job.waits {
        let what = if job.plan_id.is_some() { "the job begins" } else { "the first node wakes" };
        let until = waits.until.map_or(String::new(), |at| format!("; {what} at {}", clock(at, now)));
        line("waits", format!("{}{until}", waits.because.trim_start_matches("waits ")));
    }
    if let Some(hold) = &job.budget_hold {
        line("budget", hold.because.clone());
    }
    if let Some(failing) = &job.failing {
        let again =
            failing.again_at.map_or(String::new(), |at| format!("; tried again at {}", clock(at, now)));
        line("failing", format!("{}{again}", failing.words));
    }
    if let Some(by) = &job.rendered_by {
        let mixed = by.mixed.as_ref().map_or(String::new(), |words| format!(": {words}"));
        line("renderer", format!("forelight {}{mixed}", by.version));
    }
    if let Some(live) = &job.live {
        let cpu = &live.cpu_seconds;
        let (quote, whole) = (&cpu.quote, &cpu.whole);
        line(
            "forecast",
            format!("{} of CPU time (P50), {} (P80) were quoted", seconds(quote.p50), seconds(quote.p80)),
        );
        if job.state == JobState::Done {
            line("", format!("{} of CPU time was used", seconds(cpu.spent)));
        } else if live.frames_done > 0 {
            let so_far =
                format!("{} (P50), {} (P80) are expected now", seconds(whole.p50), seconds(whole.p80));
            line("", format!("{so_far}; {} are done", seconds(cpu.spent)));
        }
        line("booked", booked(job, live, now));
    }
    line("ready", ready(job, now));
    if let Some(promise) = job.promise.as_ref().filter(|_| !job.state.is_final()) {
        let word = if promise.kept { "kept" } else { "at risk" };
        let rescue = promise.rescue.as_ref().map_or(String::new(), |rescue| format!("; {}", rescue.words));
        line(
            "promise",
            format!("{word}, with a probability of {}{rescue}", probability_in_words(promise.probability)),
        );
    } else if let Some(verdict) = job.verdict.as_ref().filter(|said| said.verdict != Verdict::OnTime)
        && !job.state.is_final()
    {
        verdict.reasons.iter().for_each(|reason| line("", reason.clone()));
    }
    let cost = cost(job);
    if !cost.is_empty() {
        line("cost", cost);
    }
    if let Some(error) = &job.error {
        line("error", error.clone());
    }
    text += &beside.quote.as_ref().map_or_else(String::new, |quoted| quote(job, quoted));
    with_local_times(&text, now)
}

/// What is booked, and by how much it is exceeded. A second is no delay.
fn booked(job: &Job, live: &LiveForecast, now: Timestamp) -> String {
    let booked = &live.booked;
    let excess = live.cpu_seconds.whole.at(booked.confidence) - booked.cpu_seconds;
    let confidence = booked.confidence.name().to_uppercase();
    let mut text = format!("{} at {confidence}", seconds(booked.cpu_seconds));
    if live.cost_is_off && excess > 0.0 {
        text += &format!(": exceeded by {}", seconds(excess));
    }
    // What is held has no end, whatever is booked.
    let is_held = job.waits.as_ref().is_some_and(Waits::is_held);
    let Some(finish) = booked.finish.filter(|_| !is_held) else { return text };
    text += &format!(", ready by {}", clock(finish, now));
    let expected = job.finished_at.or(live.finish).filter(|_| live.finish_is_off);
    let late = expected.map_or(0.0, |at| at.micros_since(finish) as f64 * 1e-6);
    if late >= 1.0 {
        text += &format!(": exceeded by {}", seconds(late));
    }
    text
}

/// When the job was or will be ready, and by how much that keeps or misses its deadline.
fn ready(job: &Job, now: Timestamp) -> String {
    let (at, said) = match (job.state, job.finished_at, job.eta) {
        (JobState::Done, Some(at), _) => (at, format!("since {}", clock(at, now))),
        (state, _, _) if state.is_final() => return format!("never: the job {}", ended(state)),
        (JobState::Quoted, _, Some(at)) => (at, format!("at {} if it is accepted now", clock(at, now))),
        (_, _, Some(at)) => (at, format!("at {} by the current plan", clock(at, now))),
        (_, _, None) if job.budget_hold.as_ref().is_some_and(|hold| hold.until.is_none()) => {
            return "not before the budget is raised".to_owned();
        }
        (_, _, None) if job.plan_id.is_none() => {
            let deadline = job.deadline.map_or(String::new(), |at| format!("; wanted by {}", clock(at, now)));
            return format!("not known before the job is booked{deadline}");
        }
        (_, _, None) if job.paused => return "not known while it is paused".to_owned(),
        (_, _, None) if job.waits.as_ref().is_some_and(Waits::is_held) => {
            return "not known while a budget holds it".to_owned();
        }
        (_, _, None) => return "unknown: the current plan books nothing of the job".to_owned(),
    };
    let against = job.deadline.map_or(String::new(), |deadline| {
        let late = at.micros_since(deadline);
        let word = if late > 0 { "after" } else { "before" };
        let by = seconds(late.unsigned_abs() as f64 * 1e-6);
        // A promise says its probability itself.
        let sure = job.probability.filter(|_| job.promise.is_none());
        let sure = sure.map_or(String::new(), |sure| {
            format!("; in time with a probability of {}", probability_in_words(sure))
        });
        format!(", {by} {word} the deadline at {}{sure}", clock(deadline, now))
    });
    said + &against
}

fn cost(job: &Job) -> String {
    let so_far = if job.state.is_final() { "" } else { " so far" };
    let mut parts: Vec<String> = job.spent.iter().map(|spent| format!("{spent}{so_far}")).collect();
    if let Some(whole) = job.live.as_ref().and_then(|live| live.cost).filter(|_| !job.state.is_final()) {
        parts.push(format!("{} (P50), {} (P80) expected in all", whole.p50, whole.p80));
    }
    parts.extend(job.live.iter().filter_map(|live| live.booked.cost).map(|cost| format!("{cost} booked")));
    parts.extend(job.budget.map(|budget| format!("budget {budget}")));
    parts.join("; ")
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use forelight_protocol::{
        Booked, Confidence, LiveFigure, Money, MoneyQuantiles, PlanId, Promise, Quantiles,
        RenderSettingsRequest, SceneDigest, SceneSummary, WaitKind,
    };
    use serde_json::json;

    fn shown(job: &Job, now: Timestamp) -> String {
        report(job, &Beside::default(), now)
    }

    fn at(seconds: i64) -> Timestamp {
        let evening: Timestamp = "2026-03-01T18:00:00Z".parse().expect("an instant");
        evening.plus_micros(seconds * 1_000_000)
    }

    pub fn job() -> Job {
        let scene = SceneSummary {
            name: "a".into(),
            digest: SceneDigest([0; 32]),
            frames: 10,
            width: 8,
            height: 8,
            objects: 1,
            materials: 1,
            triangles: 2,
            frames_per_second: None,
        };
        serde_json::from_value(json!({
            "id": "0192f0c1-7a3b-7c55-8f00-0123456789ab", "name": "kitchen", "project": "film", "state": "profiling",
            "bundle": {"path": "/a"}, "scene": scene, "frames": "0-9", "settings": RenderSettingsRequest::default().complete((8, 8)),
            "samples": 16, "profile_frames": 1, "deadline": at(3600), "budget": 500_000, "confidence": "p80", "priority": 0,
            "frames_total": 10, "frames_done": 0, "progress": 0.0, "verdict": null, "plan_id": null, "eta": null, "error": null,
            "created_at": at(0), "finished_at": null,
        }))
        .expect("a job")
    }

    fn quantiles(p50: f64) -> Quantiles {
        Quantiles { mean: p50, p50, p80: p50 * 2.0, p95: p50 * 3.0 }
    }

    #[test]
    fn a_bar_is_full_only_when_all_is_done() {
        assert_eq!(bar(0.0, 4), "[....]   0 %");
        assert_eq!(bar(0.999, 4), "[###.]  99 %");
        assert_eq!(bar(1.0, 4), "[####] 100 %");
        assert_eq!(bar(f64::MAX, 4), "[####] 100 %");
    }

    #[test]
    fn a_job_that_waits_for_its_quote_says_why() {
        let because = "waits because no node takes tasks: 2 asleep".to_owned();
        let waits =
            Waits { kind: WaitKind::Calendar, because, until: Some(at(60)), behind: Vec::new(), share: None };
        let text = shown(&Job { waits: Some(waits), ..job() }, at(0));
        assert!(
            text.contains("waits      because no node takes tasks: 2 asleep; the first node wakes at "),
            "{text}"
        );
    }

    #[test]
    fn a_job_that_is_not_booked_shows_its_deadline_and_budget_and_no_forecast() {
        let text = shown(&job(), at(0));
        assert!(text.contains("not known before the job is booked; wanted by"), "{text}");
        assert!(text.contains("budget 0.50"), "{text}");
        assert!(!text.contains("forecast") && !text.contains("promise"), "{text}");
        assert!(!shown(&Job { budget: None, ..job() }, at(0)).contains("cost"));
    }

    #[test]
    fn a_job_under_way_shows_forecast_booking_promise_and_sums_below_a_cent() {
        let cpu_seconds = LiveFigure {
            quote: quantiles(100.0),
            spent: 60.0,
            remaining: quantiles(60.0),
            whole: quantiles(120.0),
            factor: 1.2,
        };
        let money = |units: i64| MoneyQuantiles {
            mean: Money(units),
            p50: Money(units),
            p80: Money(units),
            p95: Money(units),
        };
        let live = LiveForecast {
            at: at(0),
            frames_done: 5,
            work: LiveFigure::default(),
            cpu_seconds,
            cost: Some(money(4_321)),
            finish: Some(at(1800)),
            booked: Booked {
                confidence: Confidence::P80,
                cpu_seconds: 200.0,
                cost: Some(Money(3_000)),
                finish: Some(at(1700)),
            },
            cost_is_off: true,
            finish_is_off: false,
        };
        let promise =
            Promise { kept: true, probability: 0.93, finish: Some(at(1800)), since: at(0), rescue: None };
        let under_way = Job {
            state: JobState::Rendering,
            plan_id: Some(PlanId::new()),
            progress: 0.5,
            frames_done: 5,
            eta: Some(at(1800)),
            live: Some(live),
            promise: Some(promise),
            spent: Some(Money(1_234)),
            ..job()
        };
        let text = shown(&under_way, at(0));
        for said in [
            "[####################....................]  50 %  kitchen",
            "rendering: 5 of 10 frames done",
            "1 min 40 s of CPU time (P50), 3 min 20 s (P80) were quoted",
            "2 min (P50), 4 min (P80) are expected now; 60.0 s are done",
            "3 min 20 s at P80: exceeded by 40.0 s, ready by",
            "30 min before the deadline",
            "kept, with a probability of 93 %",
            "0.001234 so far; 0.004321 (P50), 0.004321 (P80) expected in all; 0.003 booked; budget 0.50",
        ] {
            assert!(text.contains(said), "{said}: {text}");
        }
        let late = Job { eta: Some(at(3660)), promise: None, probability: Some(0.004), ..under_way.clone() };
        let text = shown(&late, at(0));
        assert!(
            text.contains("60.0 s after the deadline") && text.contains("a probability of < 1 %"),
            "{text}"
        );
        let done = Job { state: JobState::Done, finished_at: Some(at(1000)), progress: 1.0, ..under_way };
        let text = shown(&done, at(0));
        assert!(text.contains("since ") && text.contains("43 min 20 s before the deadline"), "{text}");
        assert!(!text.contains("promise") && !text.contains("expected for all"), "{text}");
    }

    #[test]
    fn a_booking_is_exceeded_by_so_much_and_not_by_less_than_a_second() {
        let live = |finish: Timestamp| LiveForecast {
            at: at(0),
            frames_done: 1,
            work: LiveFigure::default(),
            cpu_seconds: LiveFigure::default(),
            cost: None,
            finish: Some(finish),
            booked: Booked { finish: Some(at(60)), ..Booked::default() },
            cost_is_off: false,
            finish_is_off: true,
        };
        let late = at(60).plus_micros(700_000);
        assert!(!booked(&job(), &live(late), at(0)).contains("exceeded"));
        assert!(booked(&job(), &live(at(63)), at(0)).ends_with(": exceeded by 3.00 s"));
        let done = Job { finished_at: Some(at(65)), ..job() };
        assert!(booked(&done, &live(at(63)), at(0)).ends_with(": exceeded by 5.00 s"));
    }

    #[test]
    fn a_job_on_hold_says_what_it_waits_for_and_one_without_images_how_to_make_them_again() {
        let held = Job { state: JobState::Quoted, hold: true, ..job() };
        let text = shown(&held, at(0));
        assert!(text.contains(&format!("waits      for `forelight accept {}`", held.id)), "{text}");
        let beside = Beside { quote: None, deleted: "0-9".parse().ok() };
        let text = report(&Job { state: JobState::Done, ..job() }, &beside, at(0));
        assert!(text.contains("images     the images of 10 frames were deleted; `forelight retry"), "{text}");
    }
}
