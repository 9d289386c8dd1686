//! From a forecast to bookings.

use std::collections::BTreeMap;

use forelight_planner::{self as planner, FixedBooking, Interval};
use forelight_protocol::{
    ByClass, CacheQuote, Confidence, Job, JobVerdict, Money, MoneyQuantiles, Node, NodeId, NodeSeconds,
    PlanReason, Quantiles, SeedBooking, Timestamp, Verdict,
};
use forelight_store::{
    JobForecast, NewBooking, NewPlan, NewSeed, NewSeedBooking, Projected, QuoteBasis, project,
};

use super::estimate::Forecast;
use super::{AdvanceError, Conductor, compute};

/// Nodes that a plan looks at.
const MOST_NODES: u32 = 10_000;

/// The planner counts work in whole units, of which a node does so many a second; ours are nanoseconds of a core of speed 1.
const PER_SECOND: f64 = 1e9;

/// The planner's class of work like the job's: every plan is made for one job.
const CLASS: u32 = 1;

/// A node that was not heard of for this long is not booked: five minutes, in microseconds. Longer than a worker takes to
/// be started again, and much shorter than a night.
const SILENCE: i64 = 300_000_000;

/// How long a part of an irradiance cache that should be filled already is still given: a second, in microseconds.
const OVERDUE: i64 = 1_000_000;

impl Conductor {
    /// Plans the job around everything that is booked already, has the plan verified, and keeps forecast, plan and bookings.
    pub(super) async fn book(
        &self,
        job: &Job,
        forecast: &Forecast,
        basis: Option<&QuoteBasis>,
    ) -> Result<(), AdvanceError> {
        let now = self.clock.now();
        // The parent before the bookings: should another plan come in between, the store refuses this one.
        let parent = self.store.newest_plan().await?;
        let nodes = self.nodes_for_plans(now).await?;
        let taken = project(&self.store.open_bookings().await?, now);
        let seeds = self.store.open_seed_bookings().await?;
        let mut kept = forecast.job.clone();
        price(&mut kept, forecast, &nodes);
        let input = planner_input(job, &kept, forecast, &nodes, (&taken, &seeds), now);
        let plan = compute(move || {
            let plan = planner::plan(&input)
                .map_err(|error| AdvanceError::Hopeless(format!("no plan could be made: {error}")))?;
            Ok(planner::verify(&input, &plan).map(|()| plan))
        })
        .await?;
        let plan = plan.map_err(|violations| {
            self.metrics.plans_refused.add(1);
            refused(&violations)
        })?;
        let Some(found) = plan.jobs.first() else {
            return Err(AdvanceError::Hopeless("the plan says nothing of the job".to_owned()));
        };
        let of_frames = plan.bookings.iter().filter(|booking| !booking.task.is_seed());
        let of_seed = plan.bookings.iter().filter(|booking| booking.task.is_seed());
        let seed = match (&forecast.seed, kept.cache.as_ref().and_then(|cache| cache.seed.as_ref())) {
            (Some(seed), Some(line)) => Some(NewSeed {
                cache: seed.cache,
                parts: line.parts,
                bookings: of_seed.map(|booking| own_part(booking, &nodes)).collect::<Result<_, _>>()?,
            }),
            _ => None,
        };
        let new = NewPlan {
            parent,
            reason: PlanReason::JobForecast,
            verdict: verdict(job, found, &nodes),
            bookings: of_frames.map(|booking| own_booking(booking, &nodes)).collect::<Result<_, _>>()?,
            seed,
        };
        kept.cpu_seconds_on = on_calibrated(&kept, &nodes);
        let plan = self.store.book(job.id, &kept, &forecast.frames, basis, &new, now).await?;
        self.metrics.plans_stored.add(1);
        tracing::info!(job = %job.id, %plan, verdict = new.verdict.verdict.name(), "booked");
        Ok(())
    }
}

impl Conductor {
    /// Nodes that take work and were heard of lately.
    pub(super) async fn nodes_for_plans(&self, now: Timestamp) -> Result<Vec<Node>, AdvanceError> {
        let mut nodes = self.store.nodes(None, MOST_NODES).await?;
        nodes.retain(|node| node.takes_tasks() && now.micros_since(node.last_seen_at) <= SILENCE);
        Ok(nodes)
    }
}

/// Why a plan that the verifier does not pass is not kept, in one line that becomes the job's error.
fn refused(violations: &[planner::Violation]) -> AdvanceError {
    const SHOWN: usize = 3;
    let mut broken: Vec<String> = violations.iter().take(SHOWN).map(ToString::to_string).collect();
    if violations.len() > SHOWN {
        broken.push(format!("and {} more", violations.len() - SHOWN));
    }
    AdvanceError::Hopeless(format!(
        "the verifier refused the plan, and nothing is booked: {}",
        broken.join("; ")
    ))
}

/// The planner's view: nodes and jobs are numbers there, ours by their place in a list.
fn planner_input(
    job: &Job,
    kept: &JobForecast,
    forecast: &Forecast,
    nodes: &[Node],
    (taken, seeds): (&[Projected], &[SeedBooking]),
    now: Timestamp,
) -> planner::Input {
    let index: BTreeMap<NodeId, u64> = nodes.iter().map(|node| node.id).zip(0..).collect();
    planner::Input {
        now: now.micros(),
        nodes: nodes
            .iter()
            .zip(0..)
            .map(|(node, id)| planner::Node {
                id,
                name: node.name.clone(),
                speed: speed(node),
                speeds: own_speeds(node, forecast.job.work_by_class.as_ref()),
                price_per_hour: node.price_per_hour.micro_units(),
                available_from: now.micros(),
                calendar: vec![Interval { start: now.micros(), end: None }],
                ..planner::Node::default()
            })
            .collect(),
        fixed: taken
            .iter()
            .filter_map(|frame| {
                let node = *index.get(&frame.node_id)?;
                let (start, end) = (frame.start.micros(), frame.end.micros());
                Some(FixedBooking { node, start, end, ..FixedBooking::default() })
            })
            .chain(seeds.iter().filter_map(|part| {
                let node = *index.get(&part.node_id)?;
                // One that should be filled by now is about to be.
                let end = part.end.max(now.plus_micros(OVERDUE)).micros();
                Some(FixedBooking { node, start: part.start.micros(), end, ..FixedBooking::default() })
            }))
            .collect(),
        jobs: vec![planner::Job {
            id: 0,
            class: CLASS,
            release: now.micros(),
            deadline: job.deadline.map(Timestamp::micros),
            priority: job.priority,
            confidence: confidence(job.confidence),
            total: total(&forecast.job.total.cpu_seconds),
            seed: kept.cache.as_ref().and_then(seed),
            frames: forecast
                .frames
                .iter()
                .map(|each| frame(each.frame, each.cpu_seconds.p50, each.cpu_seconds.p80))
                .collect(),
            budget: job.budget.map(Money::micro_units),
            ..planner::Job::default()
        }],
        ..planner::Input::default()
    }
}

/// A confidence in the planner's words.
pub(crate) fn confidence(confidence: Confidence) -> planner::Confidence {
    match confidence {
        Confidence::P50 => planner::Confidence::P50,
        Confidence::P80 => planner::Confidence::P80,
        Confidence::P95 => planner::Confidence::P95,
    }
}

/// CPU seconds of all frames as the planner's work.
pub(crate) fn total(cpu_seconds: &Quantiles) -> planner::WorkTotal {
    let Quantiles { p50, p80, p95, .. } = *cpu_seconds;
    // At least one unit, so that no booking is empty however little a frame takes.
    let [p50, p80, p95] = [p50, p80, p95].map(|seconds| units(seconds).max(1));
    // Rounding must not make a quantile fall below a lower one.
    planner::WorkTotal { p50, p80: p80.max(p50), p95: p95.max(p80).max(p50) }
}

/// CPU seconds of a frame, median and P80, as the planner's work.
pub(crate) fn frame(number: u32, p50: f64, p80: f64) -> planner::Frame {
    planner::Frame { number: i64::from(number), work: units(p50).max(1), work_p80: units(p80).max(1) }
}

/// What a node does a second of work like the job's, where it is calibrated for its classes.
fn own_speeds(node: &Node, work: Option<&ByClass>) -> BTreeMap<u32, u64> {
    let speed = node.corrected_speed(work);
    speed.map(|speed| (CLASS, units(speed * f64::from(node.cores)).max(1))).into_iter().collect()
}

/// CPU seconds of the job on calibrated nodes, each name once and the first ones by name.
fn on_calibrated(forecast: &JobForecast, nodes: &[Node]) -> Vec<NodeSeconds> {
    let work = forecast.work_by_class.as_ref();
    let speeds = nodes.iter().filter_map(|node| Some((&node.name, node.corrected_speed(work)?)));
    let by_name: BTreeMap<&String, f64> = speeds.collect();
    let seconds =
        |(name, speed): (&String, f64)| NodeSeconds::new(name.clone(), speed, &forecast.total.cpu_seconds);
    by_name.into_iter().take(NodeSeconds::MOST).map(seconds).collect()
}

/// The irradiance cache that the frames share and wait for, as the planner's work.
fn seed(cache: &CacheQuote) -> Option<planner::Seed> {
    let seed = cache.seed.as_ref()?;
    Some(planner::Seed { class: CLASS, work: units(seed.cpu_seconds.p50).max(1), parts: seed.parts })
}

/// What a node does a second, in the planner's unit of work.
pub(crate) fn speed(node: &Node) -> u64 {
    units(seconds_per_second(node)).max(1)
}

/// Seconds of a core of speed 1 that the node does in a second, with all its cores.
fn seconds_per_second(node: &Node) -> f64 {
    node.speed * f64::from(node.cores)
}

/// Seconds in the planner's unit of work; saturates at the ends of the range, as float to integer does.
fn units(seconds: f64) -> u64 {
    (seconds * PER_SECOND).round() as u64
}

fn own_part(booking: &planner::Booking, nodes: &[Node]) -> Result<NewSeedBooking, AdvanceError> {
    let part = match booking.task {
        planner::Task::SeedPart { part, .. } => part,
        _ => 0,
    };
    match usize::try_from(booking.node).ok().and_then(|at| nodes.get(at)) {
        Some(node) => Ok(NewSeedBooking {
            part,
            node: node.id,
            start: Timestamp::from_micros(booking.start),
            end: Timestamp::from_micros(booking.end),
        }),
        None => Err(AdvanceError::Hopeless("the plan books a part on a node that there is not".to_owned())),
    }
}

fn own_booking(booking: &planner::Booking, nodes: &[Node]) -> Result<NewBooking, AdvanceError> {
    let node = usize::try_from(booking.node).ok().and_then(|at| nodes.get(at));
    let frame = booking.task.frame().and_then(|frame| u32::try_from(frame).ok());
    match (node, frame) {
        (Some(node), Some(frame)) => Ok(NewBooking {
            frame,
            node: node.id,
            start: Timestamp::from_micros(booking.start),
            end: Timestamp::from_micros(booking.end),
        }),
        _ => Err(AdvanceError::Hopeless("the plan books a node or a frame that there is not".to_owned())),
    }
}

/// The plan's word on the job, in the words of the API.
fn verdict(job: &Job, found: &planner::JobPlan, nodes: &[Node]) -> JobVerdict {
    let time = Timestamp::from_micros;
    let mut reasons = Vec::new();
    let over_budget = found.within_budget == Some(false);
    let (verdict, finish) = match &found.verdict {
        planner::Verdict::Feasible { finish, slack } => {
            reasons.push(format!("{} before the deadline", duration(*slack)));
            (if over_budget { Verdict::OverBudget } else { Verdict::OnTime }, Some(*finish))
        }
        planner::Verdict::NoDeadline { finish } => {
            (if over_budget { Verdict::OverBudget } else { Verdict::OnTime }, Some(*finish))
        }
        planner::Verdict::Late { finish, by, unavoidable } => {
            reasons.push(format!("{} after the deadline", duration(*by)));
            reasons.push(match (unavoidable, found.bound.earliest_finish()) {
                (true, Some(bound)) => format!(
                    "no plan can be in time: with all {} nodes to itself it ends at {} at the earliest",
                    nodes.len(),
                    time(bound)
                ),
                _ => "what is booked already stands in the way".to_owned(),
            });
            (Verdict::Late, Some(*finish))
        }
        planner::Verdict::Unplaced { frames, .. } => {
            reasons.push(if nodes.is_empty() {
                "there is no node that takes work".to_owned()
            } else {
                format!("{} frames fit into no free time of any node", frames.len())
            });
            (Verdict::Impossible, None)
        }
    };
    if over_budget && let Some(budget) = job.budget {
        reasons.push(format!(
            "{} micro-units above the budget",
            found.cost.saturating_sub(budget.micro_units())
        ));
    }
    JobVerdict {
        job_id: job.id,
        verdict,
        confidence: job.confidence,
        finish: finish.map(time),
        cost: finish.map(|_| Money(found.cost)),
        reasons,
    }
}

/// A length of time for people, from microseconds.
fn duration(micros: i64) -> String {
    let seconds = micros / 1_000_000;
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, seconds) => format!("{seconds} s"),
        (0, minutes, seconds) => format!("{minutes} min {seconds} s"),
        (hours, minutes, _) => format!("{hours} h {minutes} min"),
    }
}

/// Micro-units for a second of a core of speed 1, on average over the nodes; `None` without nodes.
pub(super) fn mean_price(nodes: &[Node]) -> Option<f64> {
    let price = |node: &Node| node.price_per_hour.micro_units() as f64 / 3600.0 / seconds_per_second(node);
    (!nodes.is_empty()).then(|| nodes.iter().map(price).sum::<f64>() / nodes.len() as f64)
}

/// Fills in what depends on the farm: into how many parts a shared cache is split, and everything in money, at the mean price that the nodes ask
/// for a second of a core of speed 1.
fn price(kept: &mut JobForecast, forecast: &Forecast, nodes: &[Node]) {
    let mean_price = mean_price(nodes);
    let money = |seconds: f64| mean_price.map(|price| Money((seconds * price).round() as i64));
    let cost = |cpu_seconds: &Quantiles| {
        let Quantiles { mean, p50, p80, p95 } = *cpu_seconds;
        Some(MoneyQuantiles { mean: money(mean)?, p50: money(p50)?, p80: money(p80)?, p95: money(p95)? })
    };
    let mut all = kept.total.cpu_seconds;
    if let Some(cache) = &mut kept.cache {
        for price in std::iter::once(&mut cache.private_price).chain(&mut cache.shared_price) {
            price.cost = money(price.cpu_seconds);
        }
        if let Some(seed) = &mut cache.seed {
            seed.cost = cost(&seed.cpu_seconds);
            seed.parts = forecast.seed.as_ref().map_or(1, |plan| plan.parts(nodes.len()));
            // The same measurements are behind both: what one is off, the other is.
            let Quantiles { mean, p50, p80, p95 } = seed.cpu_seconds;
            all = Quantiles {
                mean: all.mean + mean,
                p50: all.p50 + p50,
                p80: all.p80 + p80,
                p95: all.p95 + p95,
            };
        }
    }
    kept.cost = cost(&all);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One node, and a job of six frames.
    fn input() -> planner::Input {
        let frame = |number| planner::Frame { number, work: 1_000_000, ..planner::Frame::default() };
        planner::Input {
            nodes: vec![planner::Node {
                id: 0,
                name: "a".to_owned(),
                speed: 1_000_000,
                calendar: vec![Interval { start: 0, end: None }],
                ..planner::Node::default()
            }],
            jobs: vec![planner::Job {
                confidence: planner::Confidence::P50,
                total: planner::WorkTotal { p50: 6_000_000, p80: 6_000_000, p95: 6_000_000 },
                frames: (0..6).map(frame).collect(),
                ..planner::Job::default()
            }],
            ..planner::Input::default()
        }
    }

    #[test]
    fn a_refused_plan_says_who_refused_it_and_why_in_one_line_of_bounded_length() {
        let input = input();
        let mut plan = planner::plan(&input).unwrap();
        planner::verify(&input, &plan).unwrap();
        plan.bookings.iter_mut().for_each(|booking| booking.start = 0);
        let violations = planner::verify(&input, &plan).unwrap_err();
        assert!(violations.len() > 3, "{violations:?}");
        let error = refused(&violations).to_string();
        assert!(
            error.starts_with("the verifier refused the plan, and nothing is booked: job 0, frame "),
            "{error}"
        );
        assert!(
            error.ends_with(&format!("; and {} more", violations.len() - 3)) && !error.contains('\n'),
            "{error}"
        );
        assert!(refused(&violations[..1]).to_string().ends_with(&violations[0].to_string()));
    }
}
