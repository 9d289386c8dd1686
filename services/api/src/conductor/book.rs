//! From a forecast to bookings.

use std::collections::BTreeMap;

use forelight_planner as planner;
use forelight_protocol::{
    AccuracyRung, FrameForecast, Job, JobId, JobState, Money, Node, NodeSeconds, PlanReason, Quantiles,
    Timestamp, Verdict,
};
use forelight_quote::serial_time::SerialTime;
use forelight_quote::{JobForecast, Quote, QuoteBasis, mean_price, mean_serial_price};
use forelight_store::{FarmFrame, FarmJob, NewPartBooking, NewPlan, NewSharedCache, Store, StoreError};

use super::bookable::bookable;
use super::farm::{Farm, MOST_NODES, Snapshot};
use super::held_quotes::{foreseen, logged};
use super::qualities::qualities;
use super::settle::{Settled, Unsettled, settle};
use super::{AdvanceError, Conductor, compute};

impl Conductor {
    /// Keeps the quote of a job on hold, and what would become of it if it were accepted now.
    pub(super) async fn keep_quote(
        &self,
        job: &Job,
        forecast: &Quote,
        basis: Option<&QuoteBasis>,
    ) -> Result<(), AdvanceError> {
        let now = self.clock.now();
        let mut snapshot = Snapshot::read(&self.store, now).await?;
        let mut kept = forecast.job.clone();
        let (with_terms, spent) =
            (self.store.job_with_terms(job.id).await?, self.store.spent_on(job.id, now).await?);
        let serial = serial_time(&self.store, &with_terms.0, &kept).await?;
        price(&mut kept, forecast, &snapshot.nodes, serial);
        kept.cpu_seconds_on = on_calibrated(&kept, &snapshot.nodes);
        snapshot.jobs.push(fresh(with_terms, &kept, &forecast.frames, (spent, serial)));
        let foreseen = logged(foreseen(snapshot, vec![job.id]).await).pop();
        let outlook = foreseen.map(|(_, outlook)| outlook).unwrap_or_default();
        self.store.keep_quote(job.id, (&kept, &outlook), &forecast.frames, basis, now).await?;
        tracing::info!(job = %job.id, "quoted");
        Ok(())
    }

    /// Plans the farm with the job, verifies and keeps the plan. `rungs` are other qualities of the job.
    pub(super) async fn book(
        &self,
        job: &Job,
        forecast: &Quote,
        basis: Option<&QuoteBasis>,
        rungs: &[AccuracyRung],
    ) -> Result<(), AdvanceError> {
        let now = self.clock.now();
        let (job, terms) = self.store.job_with_terms(job.id).await?;
        let mut snapshot = Snapshot::read(&self.store, now).await?;
        let nodes = snapshot.nodes.clone();
        let (parent, wanted) = (snapshot.parent, snapshot.wanted.clone());
        let mut kept = forecast.job.clone();
        // A quote that was accepted keeps its prices.
        let is_accepted = job.state == JobState::Quoted;
        let serial = serial_time(&self.store, &job, &kept).await?;
        if !is_accepted {
            price(&mut kept, forecast, &nodes, serial);
        }
        let spent = self.store.spent_on(job.id, now).await?;
        snapshot.jobs.push(fresh((job.clone(), terms), &kept, &forecast.frames, (spent, serial)));
        let (id, rungs) = (job.id, rungs.to_vec());
        let settled = compute(move || {
            let farm = Farm::new(&snapshot);
            let place = farm
                .place(id)
                .ok_or_else(|| AdvanceError::Hopeless("the plan has no verdict on the job".to_owned()))?;
            Ok(settle(&farm, Some(place)).and_then(|mut settled| {
                add_qualities(&mut settled, &farm, place, &rungs)?;
                Ok(settled)
            }))
        })
        .await?;
        let Settled { plan, jobs, outlooks, finish } = self.passed(settled)?;
        let of_cache = plan.bookings.iter().filter(|booking| booking.task.is_shared_cache());
        let shared_cache =
            match (&forecast.shared_cache, kept.cache.as_ref().and_then(|cache| cache.shared_cache.as_ref()))
            {
                (Some(built), Some(line)) => Some(NewSharedCache {
                    cache: built.cache,
                    parts: line.parts,
                    bookings: of_cache.map(|booking| own_part(booking, &nodes)).collect::<Result<_, _>>()?,
                }),
                _ => None,
            };
        let verdict =
            jobs.iter().find(|planned| planned.verdict.job_id == id).map(|planned| &planned.verdict);
        let word = verdict.map_or("", |verdict| verdict.verdict.name());
        tracing::info!(job = %id, verdict = word, jobs = jobs.len(), "planned");
        let reason = PlanReason::JobForecast;
        let new = NewPlan { parent, reason, wanted, jobs, outlooks, finish, shared_cache };
        if !is_accepted {
            kept.cpu_seconds_on = on_calibrated(&kept, &nodes);
        }
        let plan = self.store.book(job.id, &kept, &forecast.frames, basis, &new, now).await?;
        self.note_plan();
        tracing::info!(job = %job.id, %plan, "booked");
        Ok(())
    }

    pub(super) async fn nodes_for_plans(&self, now: Timestamp) -> Result<Vec<Node>, AdvanceError> {
        Ok(bookable(self.store.nodes(None, MOST_NODES).await?, now, self.store.up_since()))
    }

    /// The plan if the verifier accepts it, else why there is none.
    pub(super) fn passed(&self, settled: Result<Settled, Unsettled>) -> Result<Settled, AdvanceError> {
        settled.map_err(|unsettled| match unsettled {
            Unsettled::Refused(violations) => {
                self.metrics.plans_refused.add(1);
                refused(&violations)
            }
            Unsettled::Failed(error) => error,
        })
    }
}

/// A job that has a quote and no plan, in the form of the jobs that have one. `None` without a quote.
pub(crate) async fn quoted(store: &Store, job: JobId, now: Timestamp) -> Result<Option<FarmJob>, StoreError> {
    let with_terms = store.job_with_terms(job).await?;
    let Some((kept, frames)) = store.kept_quote(job).await? else { return Ok(None) };
    let spent = store.spent_on(job, now).await?;
    let serial = serial_time(store, &with_terms.0, &kept).await?;
    Ok(Some(fresh(with_terms, &kept, &frames, (spent, serial))))
}

/// What the last jobs of its renderer teach of a job's frames.
async fn serial_time(store: &Store, job: &Job, kept: &JobForecast) -> Result<SerialTime, StoreError> {
    let renderer = job.renderer.as_ref().map(|renderer| renderer.name.as_str());
    store.expected_serial_time(renderer, kept.mean_of_frames(job.frames_total as usize)).await
}

/// A job that gets its first plan, in the form of the jobs that have one.
fn fresh(
    (job, terms): (Job, i64),
    kept: &JobForecast,
    frames: &[FrameForecast],
    (spent, serial_time): (Money, SerialTime),
) -> FarmJob {
    let held = job.paused;
    FarmJob {
        job,
        forecast: Some(kept.clone()),
        frames: frames
            .iter()
            .map(|each| FarmFrame {
                frame: each.frame.into(),
                share: 1.0,
                p50: each.cpu_seconds.p50,
                p80: each.cpu_seconds.p80,
                p95: each.cpu_seconds.p95,
                waits: true,
                untouched: true,
            })
            .collect(),
        spent,
        factor: 1.0,
        serial_time,
        held,
        terms,
        has_new_terms: false,
    }
}

/// Adds the best quality that fits as a way out, for a job that does not fit as requested.
fn add_qualities(
    settled: &mut Settled,
    farm: &Farm,
    place: usize,
    rungs: &[AccuracyRung],
) -> Result<(), AdvanceError> {
    let id = farm.jobs[place].job.id;
    let Some(planned) = settled.jobs.iter_mut().find(|planned| planned.verdict.job_id == id) else {
        return Ok(());
    };
    // Where the project's budget lacks money, no quality of the job helps.
    let lacks_money = settled.outlooks.iter().any(|(job, it)| *job == id && it.budget_hold.is_some());
    if planned.verdict.verdict == Verdict::OnTime || lacks_money {
        return Ok(());
    }
    for offer in qualities(farm, place, &settled.plan.bookings, rungs) {
        let Some(best) = offer?.way_out(&planned.verdict, farm.jobs[place].spent) else { continue };
        planned.verdict.ways_out.push(best);
        planned.verdict.ways_out.sort_by_key(|way| way.added_cost);
        planned.verdict.ways_out.truncate(3);
        break;
    }
    Ok(())
}

/// Why the verifier rejects a plan, in one line. It becomes the job's error.
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

/// CPU seconds of the job on calibrated nodes: each name once, the first ones by name.
fn on_calibrated(forecast: &JobForecast, nodes: &[Node]) -> Vec<NodeSeconds> {
    let work = forecast.work_by_class.as_ref();
    let speeds = nodes.iter().filter_map(|node| Some((&node.name, node.corrected_speed(work)?)));
    let by_name: BTreeMap<&String, f64> = speeds.collect();
    let seconds =
        |(name, speed): (&String, f64)| NodeSeconds::new(name.clone(), speed, &forecast.total.cpu_seconds);
    by_name.into_iter().take(NodeSeconds::MOST).map(seconds).collect()
}

fn own_part(booking: &planner::Booking, nodes: &[Node]) -> Result<NewPartBooking, AdvanceError> {
    let part = match booking.task {
        planner::Task::SharedCachePart { part, .. } => part,
        _ => 0,
    };
    match usize::try_from(booking.node).ok().and_then(|at| nodes.get(at)) {
        Some(node) => Ok(NewPartBooking {
            part,
            node: node.id,
            start: Timestamp::from_micros(booking.start),
            end: Timestamp::from_micros(booking.end),
        }),
        None => Err(AdvanceError::Hopeless("the plan books a cache part on an unknown node".to_owned())),
    }
}

/// Fills in the parts of a shared cache and all amounts of money, at the nodes' mean price for a CPU second
/// at speed 1.
fn price(kept: &mut JobForecast, forecast: &Quote, nodes: &[Node], serial: SerialTime) {
    let mean_price = mean_price(nodes, kept.work_by_class.as_ref());
    let cost = |cpu_seconds: &Quantiles| mean_price.map(|price| cpu_seconds.in_money(price));
    if let Some(cache) = &mut kept.cache {
        for price in std::iter::once(&mut cache.private_price).chain(&mut cache.shared_price) {
            price.cost = cost(&Quantiles::known(price.cpu_seconds)).map(|cost| cost.mean);
        }
        if let Some(shared) = &mut cache.shared_cache {
            shared.cost = cost(&shared.cpu_seconds);
            shared.parts = forecast.shared_cache.as_ref().map_or(1, |plan| plan.parts(nodes.len()));
        }
    }
    let of_serial_time =
        Money((mean_serial_price(nodes, serial) * forecast.frames.len() as f64).round() as i64);
    kept.cost = cost(&kept.total.cpu_seconds.plus(&kept.shared_cache_seconds()))
        .map(|cost| cost.plus(of_serial_time));
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_planner::Interval;

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
