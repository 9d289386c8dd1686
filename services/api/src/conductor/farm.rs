//! The farm as planner input. Nodes, jobs and projects are numbered by their place in a list.

use std::collections::{BTreeMap, BTreeSet};

use forelight_planner::{self as planner, FixedBooking, Interval};
use forelight_protocol::{
    Budget, CacheQuote, Division, FramePart, Job, JobId, Money, Node, NodeId, PlanId, Quantiles, Timestamp,
};
use forelight_quote::JobForecast;
use forelight_quote::division::{Parts, most_in_passes, overhead_seconds, parts};
use forelight_quote::living::is_news;
use forelight_quote::serial_time::SerialTime;
use forelight_store::{
    FarmFrame, FarmJob, HALF_LIFE, Opening, ProjectUse, Projected, Projection, Store, StoreError, Wanted,
    free_time_of, opening, project,
};

use super::bookable::bookable;
use super::demands::{Demands, OfNodes};
use super::numbers::number;
use super::quantities::{confidence, speed, times, total, units};

pub(super) const MOST_NODES: u32 = 10_000;

/// Calendars reach this far beyond the last deadline: eight weeks, in microseconds.
const BEYOND: i64 = 56 * 86_400_000_000;

/// Deadlines further away than a year (in microseconds) do not extend the calendars, since that would slow
/// every plan.
const FURTHEST: i64 = 366 * 86_400_000_000;

/// Input of a plan. The newest plan and the events since are read first, so the store notices if either
/// changes.
#[derive(Clone, Debug)]
pub(crate) struct Snapshot {
    pub now: Timestamp,
    pub parent: Option<PlanId>,
    pub wanted: Wanted,
    pub nodes: Vec<Node>,
    pub jobs: Vec<FarmJob>,
    pub projects: Vec<ProjectUse>,
    pub budgets: Vec<Budget>,
    /// Expected course of all bookings that are not done.
    pub projected: Projection,
}

impl Snapshot {
    pub async fn read(store: &Store, now: Timestamp) -> Result<Self, StoreError> {
        let snapshot = Self::with_all_nodes(store, now).await?;
        let nodes = bookable(snapshot.nodes, now, store.up_since());
        Ok(Self { nodes, ..snapshot })
    }

    pub async fn with_all_nodes(store: &Store, now: Timestamp) -> Result<Self, StoreError> {
        let wanted = store.wanted_plan().await?;
        let parent = store.newest_plan().await?;
        let nodes = store.nodes(None, MOST_NODES).await?;
        let jobs = store.farm_jobs(now).await?;
        let projects = store.projects(now).await?;
        let budgets = store.budgets(now).await?;
        let projected = project(&store.open_bookings().await?, &store.open_cache_parts().await?, now);
        Ok(Self { now, parent, wanted, nodes, jobs, projects, budgets, projected })
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Farm {
    pub input: planner::Input,
    /// Expected bookings of waiting frames: same order, none before its booking, each as long as now
    /// expected.
    pub standing: Vec<planner::Booking>,
    /// The same bookings as in the plans so far.
    pub booked: Vec<planner::Booking>,
    pub nodes: Vec<Node>,
    pub jobs: Vec<Asked>,
    pub budgets: Vec<Budget>,
}

#[derive(Clone, Debug)]
pub(crate) struct Asked {
    pub job: Job,
    /// Factor on its forecast, now and in the plan before.
    pub factor: f64,
    pub factor_before: f64,
    /// How long its frames keep a node beyond their CPU time.
    pub serial_time: SerialTime,
    pub under_way: Option<i64>,
    /// Probability that the frames under way are done by its deadline, given how long they have run and how
    /// far they are. 1 without a deadline.
    pub under_way_in_time: f64,
    /// Its cost so far, with the expected cost of running tasks, in micro-units; see [`FarmJob::spent`].
    pub spent: i64,
    /// Whether a budget holds it back, or it is paused. Its tasks are not handed out, so it takes time from
    /// nobody: plans take its bookings for free time, and it is planned behind all others.
    pub held: bool,
    /// Version of its terms, see [`FarmJob::terms`].
    pub terms: i64,
    /// Whether they were changed since its newest plan, so that it is placed anew.
    pub has_new_terms: bool,
    pub begun: BTreeSet<FramePart>,
}

impl Asked {
    pub fn is_promised(&self) -> bool {
        let on_time = self
            .job
            .verdict
            .as_ref()
            .is_some_and(|verdict| verdict.verdict == forelight_protocol::Verdict::OnTime);
        self.job.deadline.is_some() && (self.job.promise.is_some() || on_time)
    }

    /// End of the job, if a plan ends its waiting frames at `planned`.
    pub fn finish(&self, planned: Option<i64>) -> Option<i64> {
        planned.map(|planned| self.under_way.map_or(planned, |end| end.max(planned)))
    }

    /// Whether the plan has to keep its deadline. The deadline of a job that is held does not bind.
    pub fn binds(&self) -> bool {
        self.is_promised() && !self.held
    }

    /// Whether that end keeps the deadline. Without a deadline, whether there is an end.
    pub fn is_kept(&self, finish: Option<i64>) -> bool {
        finish.is_some_and(|finish| self.job.deadline.is_none_or(|deadline| finish <= deadline.micros()))
    }
}

impl Farm {
    pub fn new(snapshot: &Snapshot) -> Self {
        let now = snapshot.now;
        let index: BTreeMap<NodeId, u64> = snapshot.nodes.iter().map(|node| node.id).zip(0..).collect();
        let projects: BTreeMap<&str, u64> =
            snapshot.projects.iter().map(|project| project.name.as_str()).zip(0..).collect();
        let mut places: BTreeMap<JobId, u64> = BTreeMap::new();
        let mut under_way_of: BTreeMap<JobId, Vec<&Projected>> = BTreeMap::new();
        for frame in snapshot.projected.frames.iter().filter(|frame| frame.under_way) {
            under_way_of.entry(frame.booking.job_id).or_default().push(frame);
        }
        let mut demands = Demands::default();
        let (mut asked, mut jobs) = (Vec::new(), Vec::new());
        for farm_job in &snapshot.jobs {
            let Some(forecast) = &farm_job.forecast else { continue };
            let place = asked.len() as u64;
            let class = demands.class(farm_job, forecast);
            places.insert(farm_job.job.id, place);
            let factor = learned(farm_job);
            let under_way = under_way_of.remove(&farm_job.job.id).unwrap_or_default();
            let one = of_job(farm_job, &under_way, factor, now);
            let project = projects.get(farm_job.job.project.as_str()).copied();
            let release = snapshot.projected.cache_full_at(farm_job.job.id).unwrap_or(now);
            jobs.push(planner_job(farm_job, forecast, &one, (place, class), project, release));
            asked.push(one);
        }
        let spare = spare_work(snapshot, &jobs);
        let deadlines = snapshot.jobs.iter().filter_map(|job| job.job.deadline);
        let last = deadlines.max().unwrap_or(now).clamp(now, now.plus_micros(FURTHEST));
        let horizon = last.plus_micros(BEYOND);
        let nodes = snapshot.nodes.iter().zip(0..);
        let serial = demands.serial_times();
        let input = planner::Input {
            now: now.micros(),
            nodes: nodes
                .map(|(node, id)| planner_node(node, id, (now, horizon), (&demands, &serial), spare))
                .collect(),
            fixed: under_way(snapshot, &index, &places),
            projects: snapshot
                .projects
                .iter()
                .zip(0..)
                .map(|(project, id)| planner_project(project, id))
                .collect(),
            half_life: HALF_LIFE,
            jobs,
            ..planner::Input::default()
        };
        let standing = standing(&input, &snapshot.projected.frames, &index, &places, &asked);
        let booked = booked(&snapshot.projected.frames, &index, &places);
        let (nodes, budgets) = (snapshot.nodes.clone(), snapshot.budgets.clone());
        Self { input, standing, booked, nodes, jobs: asked, budgets }
    }

    pub fn place(&self, job: JobId) -> Option<usize> {
        self.jobs.iter().position(|asked| asked.job.id == job)
    }

    /// The whole farm. Standing bookings move only to keep a deadline.
    pub fn with_standing(&self, standing: &[planner::Booking]) -> planner::Input {
        planner::Input { movable: standing.to_vec(), ..self.input.clone() }
    }

    /// The job alone, around the bookings of all others.
    pub fn around(&self, job: usize, standing: &[planner::Booking]) -> planner::Input {
        let own = job as u64;
        let mut input = planner::Input { movable: Vec::new(), ..self.input.clone() };
        input.fixed.extend(standing.iter().filter(|booking| booking.job != own).map(|booking| {
            FixedBooking {
                node: booking.node,
                start: booking.start,
                end: booking.end,
                job: Some(booking.job),
            }
        }));
        input.jobs.retain(|other| other.id == own);
        input
    }
}

/// A job whose frames under way are these.
fn of_job(farm_job: &FarmJob, under_way: &[&Projected], factor: f64, now: Timestamp) -> Asked {
    let deadline = farm_job.job.deadline;
    let chances = under_way.iter().filter_map(|frame| frame.chance(deadline?, now));
    let begun = farm_job.frames.iter().filter(|frame| !frame.waits);
    Asked {
        job: farm_job.job.clone(),
        factor,
        factor_before: farm_job.factor,
        serial_time: farm_job.serial_time,
        under_way: under_way.iter().map(|frame| frame.end.micros()).max(),
        under_way_in_time: chances.product(),
        spent: farm_job.spent.micro_units(),
        held: farm_job.held,
        terms: farm_job.terms,
        has_new_terms: farm_job.has_new_terms,
        begun: begun.map(|frame| frame.frame).collect(),
    }
}

/// Factor on a job's forecast. It is that of the estimate if that has changed enough, else the previous one.
fn learned(farm_job: &FarmJob) -> f64 {
    let found = farm_job.job.live.as_ref().map_or(1.0, |live| live.cpu_seconds.factor);
    if is_news(found, farm_job.factor) { found } else { farm_job.factor }
}

fn planner_job(
    farm_job: &FarmJob,
    forecast: &JobForecast,
    asked: &Asked,
    (id, class): (u64, u32),
    project: Option<u64>,
    release: Timestamp,
) -> planner::Job {
    let job = &farm_job.job;
    let factor = asked.factor;
    // The shared cache of a booked job stands. That of a new job is planned with its frames.
    let is_new = job.plan_id.is_none();
    let parts = farm_job.frames.iter().filter(|each| each.frame.parts > 1).count();
    let overhead = overhead_seconds(forecast);
    let of_parts = parts as f64 * overhead;
    let (width, height) = job.settings.size().unwrap_or((1, 1));
    let most_parts = forecast.most_parts.min(width.saturating_mul(height));
    let most_parts = match forecast.chosen_spp {
        None => most_parts,
        // Its samples go where they help, so it is rendered in passes.
        Some(_) => most_parts.min(most_in_passes(job.division, u64::from(width) * u64::from(height))),
    };
    planner::Job {
        id,
        class,
        shared_cache: forecast.cache.as_ref().filter(|_| is_new).and_then(|cache| shared_cache(cache, class)),
        name: job.name.clone(),
        project,
        release: release.micros(),
        deadline: job.deadline.map(Timestamp::micros).filter(|_| !asked.held),
        priority: if asked.held { i32::MIN } else { job.priority },
        weight: job.weight,
        confidence: confidence(job.confidence),
        total: total(&times(&forecast.total.cpu_seconds, factor).plus(&Quantiles::known(of_parts))),
        frames: farm_job
            .frames
            .iter()
            .map(|each| planner_frame(each, factor, overhead, (job.division, most_parts)))
            .collect(),
        part_overhead: units(overhead),
        done: farm_job.frames.iter().filter(|each| !each.waits).map(|each| number(each.frame)).collect(),
        budget: job.budget.map(|budget| budget.micro_units().saturating_sub(asked.spent)),
    }
}

fn planner_node(
    node: &Node,
    id: u64,
    (now, horizon): (Timestamp, Timestamp),
    (demands, serial): (&Demands, &OfNodes),
    spare: u64,
) -> planner::Node {
    const SECOND: i64 = 1_000_000;
    let seconds = |seconds: u32| i64::from(seconds) * SECOND;
    let awake = matches!(opening(node, now), Opening::Awake(_));
    let mut found = planner::Node {
        id,
        name: node.name.clone(),
        speed: speed(node),
        price_per_hour: node.price_per_hour.micro_units(),
        billing_step: seconds(node.terms.billing_step_seconds),
        minimum_booking: seconds(node.terms.minimum_booking_seconds),
        setup: seconds(node.terms.setup_seconds),
        power: if awake { planner::Power::On } else { planner::Power::Standby },
        available_from: now.micros(),
        speeds: demands.speeds(node),
        serial: serial.on(node.cores),
        ..planner::Node::default()
    };
    // Tasks that might outlast the window are not handed out, so the plan ends the window earlier: by what the work
    // takes that is slowest here.
    let classes = std::iter::once(0).chain(found.speeds.keys().copied());
    let spare = classes.filter_map(|class| found.time_of(spare, class)).max().unwrap_or(0);
    found.calendar = free_time_of(node, now, horizon)
        .into_iter()
        .map(|open| Interval {
            start: open.start,
            end: open.end.map(|end| end.saturating_sub(spare.min((end - open.start) / 4))),
        })
        .collect();
    found
}

/// Largest excess of a waiting frame's P95 over its booking.
fn spare_work(snapshot: &Snapshot, jobs: &[planner::Job]) -> u64 {
    let asked = snapshot.jobs.iter().filter(|job| job.forecast.is_some());
    let mut most = 0;
    for (farm_job, job) in asked.zip(jobs) {
        let bought: BTreeMap<i64, u64> = job.open_work().collect();
        let factor = learned(farm_job);
        for frame in &farm_job.frames {
            if let Some(bought) = bought.get(&number(frame.frame)) {
                most = most.max(units(frame.p95 * frame.share * factor).saturating_sub(*bought));
            }
        }
    }
    most
}

pub(crate) fn planner_project(project: &ProjectUse, id: u64) -> planner::Project {
    planner::Project {
        id,
        name: project.name.clone(),
        share: project.share,
        usage: project.used.iter().map(|&(at, time)| planner::Usage { at: at.micros(), time }).collect(),
    }
}

fn shared_cache(cache: &CacheQuote, class: u32) -> Option<planner::SharedCache> {
    let shared = cache.shared_cache.as_ref()?;
    let work = units(shared.cpu_seconds.p50).max(1);
    Some(planner::SharedCache { class, work, parts: shared.parts })
}

fn under_way(
    snapshot: &Snapshot,
    nodes: &BTreeMap<NodeId, u64>,
    jobs: &BTreeMap<JobId, u64>,
) -> Vec<FixedBooking> {
    let held = |job: JobId| snapshot.jobs.iter().any(|other| other.job.id == job && other.held);
    let parts = snapshot.projected.cache_parts.iter();
    let parts = parts.filter(|part| part.under_way || !held(part.booking.job_id)).filter_map(|part| {
        let node = *nodes.get(&part.node_id)?;
        let (start, end) = (part.start.micros(), part.end.micros());
        let job = jobs.get(&part.booking.job_id).copied();
        Some(FixedBooking { node, start, end: end.max(start), job })
    });
    snapshot
        .projected
        .frames
        .iter()
        .filter(|frame| frame.under_way)
        .filter_map(|frame| {
            let node = *nodes.get(&frame.node_id)?;
            let (start, end) = (frame.start.micros(), frame.end.micros());
            let job = jobs.get(&frame.booking.job_id).copied();
            Some(FixedBooking { node, start, end: end.max(start), job })
        })
        .chain(parts)
        .collect()
}

/// Expected bookings of waiting frames of jobs that are not held. Each starts no earlier than booked and
/// than the previous one's end, in the same order, and lasts as long as its node now needs.
fn standing(
    input: &planner::Input,
    projected: &[Projected],
    nodes: &BTreeMap<NodeId, u64>,
    jobs: &BTreeMap<JobId, u64>,
    asked: &[Asked],
) -> Vec<planner::Booking> {
    let work: Vec<BTreeMap<i64, u64>> = input.jobs.iter().map(|job| job.open_work().collect()).collect();
    let mut free_from: BTreeMap<u64, i64> = BTreeMap::new();
    for fixed in &input.fixed {
        let free = free_from.entry(fixed.node).or_insert(input.now);
        *free = (*free).max(fixed.end);
    }
    let mut standing = Vec::new();
    for frame in projected.iter().filter(|frame| !frame.under_way) {
        let Some((&node, &job)) = nodes.get(&frame.node_id).zip(jobs.get(&frame.booking.job_id)) else {
            continue;
        };
        if asked[job as usize].held {
            continue;
        }
        let number = number(frame.booking.frame_part());
        let duration = work[job as usize]
            .get(&number)
            .and_then(|&work| input.nodes[node as usize].duration(work, input.jobs[job as usize].class));
        let Some(duration) = duration else { continue };
        let free = free_from.entry(node).or_insert(input.now);
        let start = frame.booking.start.micros().max(*free).max(input.jobs[job as usize].release);
        let end = start.saturating_add(duration);
        *free = end;
        standing.push(planner::Booking { start, node, job, task: planner::Task::Frame(number), end });
    }
    standing
}

fn booked(
    projected: &[Projected],
    nodes: &BTreeMap<NodeId, u64>,
    jobs: &BTreeMap<JobId, u64>,
) -> Vec<planner::Booking> {
    let waiting = projected.iter().filter(|frame| !frame.under_way);
    waiting
        .filter_map(|frame| {
            let (&node, &job) = nodes.get(&frame.node_id).zip(jobs.get(&frame.booking.job_id))?;
            let task = planner::Task::Frame(number(frame.booking.frame_part()));
            let (start, end) = (frame.booking.start.micros(), frame.booking.end.micros());
            Some(planner::Booking { start, node, job, task, end })
        })
        .collect()
}

/// A frame, or a part of one, as the planner knows it. A frame that no worker has had may still be divided, as
/// its job asks for, into at most so many parts. `overhead` is what each part pays for itself, in CPU seconds.
fn planner_frame(
    each: &FarmFrame,
    factor: f64,
    overhead: f64,
    (asked, most_parts): (Division, u32),
) -> planner::Frame {
    let (p50, p80) = (each.p50 * each.share, each.p80 * each.share);
    let own = if each.frame.parts > 1 { overhead } else { 0.0 };
    let mut frame = frame(number(each.frame), p50 * factor + own, p80 * factor + own);
    frame.part_of = (each.frame.parts > 1).then_some(i64::from(each.frame.frame));
    if !each.untouched {
        return frame;
    }
    let division = match parts(asked, each.p50 * factor, overhead, most_parts) {
        Parts::UpTo(0 | 1) | Parts::Exactly(0 | 1) => planner::Division::Whole,
        Parts::UpTo(most) => planner::Division::UpTo(most),
        Parts::Exactly(parts) => planner::Division::Into(parts),
    };
    planner::Frame { division, ..frame }
}

pub(crate) fn frame(number: i64, p50: f64, p80: f64) -> planner::Frame {
    planner::Frame {
        number,
        work: units(p50).max(1),
        work_p80: units(p80).max(1),
        ..planner::Frame::default()
    }
}

/// Micro-units, including what is already spent.
pub(crate) fn with_spent(cost: i64, asked: &Asked) -> Money {
    Money(cost.saturating_add(asked.spent))
}
