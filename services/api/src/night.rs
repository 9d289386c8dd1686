//! What tonight and the nights after it will cost.
//!
//! The open bookings are projected from now on, and carried out in many scenarios: the frames of a job share the part of their
//! forecast's error that does not average out (`forelight_planner::scenarios`). Every scenario is paid for, night by night, and quantiles
//! are those of the sums; quantiles of parts do not add up, and are not added.
//!
//! Random numbers are hashes of scenario, job and frame: two runs of the same farm at the same instant say the same.

use std::collections::BTreeMap;

use forelight_planner::{self as planner, Interval};
use forelight_protocol::{
    Budget, BudgetChange, BudgetForecast, BudgetForecastRequest, BudgetOutlook, CostLine, JobId, LedgerLine,
    Money, MoneyForecast, Night, NightForecast, NightRecord, Node, NodeId, NotReady, Timestamp,
};
use forelight_store::{KeptNight, OpenJob, Projected, Store, StoreError, project};

/// Most nights that are looked at.
pub const MOST_NIGHTS: u32 = 60;
/// Nodes that are looked at.
const MOST_NODES: u32 = 10_000;
/// Scenarios, fewer on farms with so many bookings that it would take long.
const SCENARIOS: usize = 2000;
const MOST_DRAWS: usize = 4_000_000;
/// Past nights that the track record looks at.
const REMEMBERED: u32 = 400;
/// A budget or deadline is threatened if it is missed more often than this.
const THREATENED: f64 = 0.2;

/// Why a forecast cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum NightError {
    /// A field of the request that cannot be.
    #[error("{reason}")]
    Invalid {
        /// JSON pointer to it.
        pointer: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The database.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The planner.
    #[error("what is booked cannot be carried out: {0}")]
    Bookings(#[from] planner::InputError),
}

/// Works the forecast out, and keeps it as what was said of its first night. Asked again for the same night, it is kept in the same place until
/// the middle of the night, and not at all after it: what is held against the night is what was known before.
pub async fn budget_forecast(
    store: &Store,
    request: &BudgetForecastRequest,
    now: Timestamp,
) -> Result<BudgetForecast, NightError> {
    let nights = nights(request, now)?;
    let (Some(first), Some(last)) = (nights.first(), nights.last()) else {
        return Err(NightError::Invalid { pointer: "/days", reason: "there is no night".to_owned() });
    };
    let budgets = store.budgets(now).await?;
    let nodes = store.nodes(None, MOST_NODES).await?;
    let jobs = store.open_jobs().await?;
    let projected = project(&store.open_bookings().await?, now);
    // Budgets of a month or for good began before tonight.
    let begins = budgets.iter().filter_map(|budget| budget.period.bounds(&budget.zone, first.from));
    let since = begins.map(|(from, _)| from).chain([first.from]).min().unwrap_or(first.from);
    let ledger = store.ledger(since, now).await?;
    let past = store.budget_forecasts_before(&request.zone, first.from, REMEMBERED).await?;
    let track_record = track_record(store, &past, now).await?;
    let zone = request.zone.clone();
    let made = Making { now, zone, nights: nights.clone(), nodes, jobs, ledger, budgets };
    let worked_out = tokio::task::spawn_blocking(move || made.work_out(&projected)).await;
    let mut forecast = match worked_out {
        Ok(forecast) => forecast?,
        Err(error) => std::panic::resume_unwind(error.into_panic()),
    };
    forecast.track_record = track_record;
    if let Some(before) = past.first() {
        forecast.compared_with = Some(before.forecast.made_at);
        forecast.changes = changes(&before.forecast, &forecast);
    }
    let kept = KeptNight { from: first.from, until: first.until, forecast: forecast.clone() };
    if now < last.until {
        store.keep_budget_forecast(&kept).await?;
    }
    Ok(forecast)
}

fn nights(request: &BudgetForecastRequest, now: Timestamp) -> Result<Vec<Night>, NightError> {
    let invalid = |pointer, reason: String| NightError::Invalid { pointer, reason };
    if !(1..=MOST_NIGHTS).contains(&request.days) {
        return Err(invalid("/days", format!("1 to {MOST_NIGHTS} nights can be forecast")));
    }
    let tonight = Night::of(&request.zone, now).ok_or_else(|| {
        invalid(
            "/zone",
            format!("there is no time zone {:?}", request.zone.chars().take(100).collect::<String>()),
        )
    })?;
    let beyond = || invalid("/date", "the date is beyond the calendar".to_owned());
    let mut nights = Vec::new();
    let mut date = request.date.unwrap_or(tonight.date);
    for _ in 0..request.days {
        nights.push(Night::on(&request.zone, date).ok_or_else(beyond)?);
        date = date.tomorrow().map_err(|_| beyond())?;
    }
    if nights.last().is_some_and(|last| last.until <= now) {
        return Err(invalid("/date", "these nights are over".to_owned()));
    }
    Ok(nights)
}

/// How often what was said beforehand of nights that are over was right.
async fn track_record(store: &Store, past: &[KeptNight], now: Timestamp) -> Result<NightRecord, StoreError> {
    let mut record = NightRecord::default();
    for night in past.iter().filter(|night| night.until <= now && night.forecast.beforehand) {
        let Some(said) = night.forecast.nights.first() else { continue };
        let lines = store.ledger(night.from, night.until).await?;
        let cost = sum(lines.iter().map(|line| line.cost_within(night.from, night.until)));
        record.nights += 1;
        record.within_p50 += u32::from(cost <= said.cost.p50);
        record.within_p80 += u32::from(cost <= said.cost.p80);
        record.within_p95 += u32::from(cost <= said.cost.p95);
    }
    Ok(record)
}

/// By job, what all nights were to cost at P80 and are now.
fn changes(before: &BudgetForecast, after: &BudgetForecast) -> Vec<BudgetChange> {
    let all = |forecast: &BudgetForecast| {
        let mut jobs: BTreeMap<JobId, (String, i64)> = BTreeMap::new();
        for line in forecast.nights.iter().flat_map(|night| &night.jobs) {
            let Some(job) = line.job_id else { continue };
            let entry = jobs.entry(job).or_insert_with(|| (line.name.clone(), 0));
            entry.1 = entry.1.saturating_add(line.cost.p80.0);
        }
        jobs
    };
    let (before, mut after) = (all(before), all(after));
    let mut changes: Vec<BudgetChange> = Vec::new();
    for (job_id, (name, cost)) in before {
        let now = after.remove(&job_id).map(|(_, cost)| Money(cost));
        if now != Some(Money(cost)) {
            changes.push(BudgetChange { job_id, name, before: Some(Money(cost)), after: now });
        }
    }
    let new = after.into_iter();
    changes.extend(new.map(|(job_id, (name, cost))| BudgetChange {
        job_id,
        name,
        before: None,
        after: Some(Money(cost)),
    }));
    changes
}

/// Everything that the forecast rests on.
struct Making {
    now: Timestamp,
    zone: String,
    nights: Vec<Night>,
    nodes: Vec<Node>,
    jobs: Vec<OpenJob>,
    ledger: Vec<LedgerLine>,
    budgets: Vec<Budget>,
}

/// What costs are added up by.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
enum Group {
    Farm,
    Project(String),
    Job(JobId),
    Class(String),
}

/// Sums by night and group: of what was spent, and of what is to come, scenario by scenario.
struct Sums {
    groups: Vec<Group>,
    /// Groups of each open job and of each node, by their places.
    of_jobs: Vec<[usize; 2]>,
    of_nodes: Vec<usize>,
    /// By night and group.
    spent: Vec<Vec<i64>>,
    to_come: Vec<Vec<Vec<i64>>>,
    /// All nights together.
    all: Vec<i64>,
}

/// A period of a budget that the nights touch.
struct Period<'a> {
    budget: &'a Budget,
    from: Timestamp,
    until: Timestamp,
    spent: i64,
    to_come: Vec<i64>,
}

impl Making {
    fn work_out(&self, projected: &[Projected]) -> Result<BudgetForecast, NightError> {
        let (input, plan) = self.as_planned(projected);
        let scenarios = (MOST_DRAWS / plan.bookings.len().max(1)).clamp(200, SCENARIOS);
        let mut sums = self.sums(scenarios);
        let mut periods = self.periods(scenarios);
        let mut ends: Vec<Vec<i64>> = vec![vec![i64::MIN; scenarios]; self.jobs.len()];
        let count = u32::try_from(scenarios).unwrap_or(u32::MAX);
        planner::scenarios(&input, &plan, count, SEED, |scenario, stretches| {
            let scenario = scenario as usize;
            for stretch in stretches {
                let (job, node) = (stretch.job as usize, stretch.node as usize);
                ends[job][scenario] = ends[job][scenario].max(stretch.end);
                let paid = Paid {
                    price: self.nodes[node].price_per_hour,
                    from: Timestamp::from_micros(stretch.start),
                    until: Timestamp::from_micros(stretch.end),
                };
                let [project, own] = sums.of_jobs[job];
                for (index, night) in self.nights.iter().enumerate() {
                    let cost = paid.within(night.from, night.until);
                    if cost > 0 {
                        for group in [0, project, own, sums.of_nodes[node]] {
                            add(&mut sums.to_come[index][group], scenarios, scenario, cost);
                        }
                        sums.all[scenario] = sums.all[scenario].saturating_add(cost);
                    }
                }
                for period in
                    periods.iter_mut().filter(|period| period.budget.project == self.jobs[job].job.project)
                {
                    let cost = paid.within(period.from, self.horizon(period.until));
                    add(&mut period.to_come, scenarios, scenario, cost);
                }
            }
        })?;
        sums.to_come.iter_mut().flatten().for_each(|draws| draws.sort_unstable());
        sums.all.sort_unstable();
        ends.iter_mut().for_each(|ends| ends.sort_unstable());
        let spent = sums.spent.iter().fold(0i64, |sum, night| sum.saturating_add(night[0]));
        let budgets: Vec<BudgetOutlook> = periods.into_iter().map(outlook).collect();
        let middle = |night: &Night| night.from.plus_micros(night.until.micros_since(night.from) / 2);
        Ok(BudgetForecast {
            date: self.nights[0].date,
            days: u32::try_from(self.nights.len()).unwrap_or(u32::MAX),
            zone: self.zone.clone(),
            made_at: self.now,
            beforehand: self.now < middle(&self.nights[0]),
            scenarios: count,
            nights: (0..self.nights.len()).map(|index| self.night(index, &sums)).collect(),
            cost: quantiles(&sums.all, spent),
            threatened: budgets.iter().any(|budget| budget.threatened),
            budgets,
            not_ready: self
                .jobs
                .iter()
                .zip(&ends)
                .filter_map(|(job, ends)| self.not_ready(job, ends))
                .collect(),
            unknown: self
                .jobs
                .iter()
                .filter(|job| job.forecast.is_none())
                .map(|job| job.job.name.clone())
                .collect(),
            compared_with: None,
            changes: Vec::new(),
            track_record: NightRecord::default(),
        })
    }

    /// All groups that there are, and what they spent.
    fn sums(&self, scenarios: usize) -> Sums {
        let nodes: BTreeMap<NodeId, &Node> = self.nodes.iter().map(|node| (node.id, node)).collect();
        let of_line = |line: &LedgerLine| {
            let class =
                nodes.get(&line.node_id).map_or_else(|| "nodes that are gone".to_owned(), |node| class(node));
            [Group::Farm, Group::Project(line.project.clone()), Group::Job(line.job_id), Group::Class(class)]
        };
        let mut groups: Vec<Group> = vec![Group::Farm];
        groups.extend(
            self.jobs
                .iter()
                .flat_map(|open| [Group::Project(open.job.project.clone()), Group::Job(open.job.id)]),
        );
        groups.extend(self.nodes.iter().map(|node| Group::Class(class(node))));
        groups.extend(self.ledger.iter().flat_map(of_line));
        groups.sort_unstable();
        groups.dedup();
        // Every group is in the list; the farm is the first.
        let place = |group: Group| groups.binary_search(&group).unwrap_or(0);
        let mut spent = vec![vec![0i64; groups.len()]; self.nights.len()];
        for line in &self.ledger {
            for (night, spent) in self.nights.iter().zip(&mut spent) {
                let cost = line.cost_within(night.from, night.until.min(self.now)).0;
                if cost > 0 {
                    for group in of_line(line) {
                        let sum = &mut spent[place(group)];
                        *sum = sum.saturating_add(cost);
                    }
                }
            }
        }
        let of_job = |open: &OpenJob| {
            [place(Group::Project(open.job.project.clone())), place(Group::Job(open.job.id))]
        };
        Sums {
            of_jobs: self.jobs.iter().map(of_job).collect(),
            of_nodes: self.nodes.iter().map(|node| place(Group::Class(class(node)))).collect(),
            to_come: vec![vec![Vec::new(); groups.len()]; self.nights.len()],
            all: vec![0; scenarios],
            spent,
            groups,
        }
    }

    /// Each budget's periods from the first night's begin to the last one's end.
    fn periods(&self, scenarios: usize) -> Vec<Period<'_>> {
        let Some(last) = self.nights.last() else { return Vec::new() };
        let mut periods = Vec::new();
        for budget in &self.budgets {
            let mut at = self.nights[0].from;
            while at < last.until
                && let Some((from, until)) = budget.period.bounds(&budget.zone, at)
            {
                let of_project = self.ledger.iter().filter(|line| line.project == budget.project);
                let spent = sum(of_project.map(|line| line.cost_within(from, until.min(self.now))));
                periods.push(Period { budget, from, until, spent: spent.0, to_come: vec![0; scenarios] });
                at = until;
            }
        }
        periods
    }

    /// Nodes and jobs as the planner has them, by their place in the lists; and the projected bookings of jobs that are not held back.
    fn as_planned(&self, projected: &[Projected]) -> (planner::Input, planner::Plan) {
        let now = self.now.micros();
        let nodes: BTreeMap<NodeId, u64> = self.nodes.iter().map(|node| node.id).zip(0..).collect();
        let jobs: BTreeMap<JobId, u64> = self.jobs.iter().map(|open| open.job.id).zip(0..).collect();
        let input = planner::Input {
            now,
            nodes: self
                .nodes
                .iter()
                .zip(0..)
                .map(|(node, id)| planner::Node {
                    id,
                    speed: crate::conductor::farm::speed(node),
                    price_per_hour: node.price_per_hour.micro_units(),
                    available_from: now,
                    calendar: vec![Interval { start: now, end: None }],
                    ..planner::Node::default()
                })
                .collect(),
            jobs: self.jobs.iter().zip(0..).map(|(open, id)| job(open, id, now)).collect(),
            ..planner::Input::default()
        };
        let mut bookings: Vec<planner::Booking> = projected
            .iter()
            .filter_map(|frame| {
                let (&job, &node) = jobs.get(&frame.booking.job_id).zip(nodes.get(&frame.node_id))?;
                if self.jobs[job as usize].held && !frame.under_way {
                    return None;
                }
                Some(planner::Booking {
                    start: frame.start.micros().max(now),
                    node,
                    job,
                    task: planner::Task::Frame(i64::from(frame.booking.frame)),
                    end: frame.end.micros(),
                })
            })
            .collect();
        bookings.sort_unstable();
        (input, planner::Plan { bookings, ..planner::Plan::default() })
    }

    fn night(&self, index: usize, sums: &Sums) -> NightForecast {
        let night = &self.nights[index];
        let line = |name: String, job_id: Option<JobId>, group: usize| {
            let spent = sums.spent[index][group];
            CostLine {
                name,
                job_id,
                spent: Money(spent),
                cost: quantiles(&sums.to_come[index][group], spent),
            }
        };
        let (mut projects, mut jobs, mut node_classes) = (Vec::new(), Vec::new(), Vec::new());
        for (place, group) in sums.groups.iter().enumerate() {
            if sums.spent[index][place] == 0 && sums.to_come[index][place].is_empty() {
                continue;
            }
            match group {
                Group::Farm => {}
                Group::Project(name) => projects.push(line(name.clone(), None, place)),
                Group::Job(id) => {
                    let open = self.jobs.iter().find(|open| open.job.id == *id);
                    // Of jobs that are done, only the cost is left.
                    let name = open.map_or_else(|| id.to_string(), |open| open.job.name.clone());
                    jobs.push(line(name, Some(*id), place));
                }
                Group::Class(name) => node_classes.push(line(name.clone(), None, place)),
            }
        }
        let farm = line(String::new(), None, 0);
        NightForecast {
            date: night.date,
            from: night.from,
            until: night.until,
            spent: farm.spent,
            cost: farm.cost,
            projects,
            jobs,
            node_classes,
        }
    }

    /// Until when a period is looked at.
    fn horizon(&self, until: Timestamp) -> Timestamp {
        self.nights.last().map_or(until, |last| last.until.min(until))
    }

    fn not_ready(&self, open: &OpenJob, ends: &[i64]) -> Option<NotReady> {
        let job = &open.job;
        let horizon = self.nights.last()?.until;
        let deadline = job.deadline.filter(|&deadline| deadline <= horizon)?;
        let known = open.forecast.is_some();
        let late = ends.iter().filter(|&&end| end > deadline.micros()).count();
        let never = open.held || job.deadline.is_some_and(|deadline| deadline <= self.now);
        let probability = if never { 1.0 } else { late as f64 / ends.len().max(1) as f64 };
        if known && probability <= THREATENED {
            return None;
        }
        let finish = |per_cent| {
            let end = at(ends, per_cent).filter(|_| known && !open.held)?;
            (end > i64::MIN && end < i64::MAX).then(|| Timestamp::from_micros(end))
        };
        let reason = if !known {
            "it is not forecast yet"
        } else if open.held {
            "its project's budget is used up"
        } else if deadline <= self.now {
            "its deadline has passed"
        } else {
            "what is booked takes longer"
        };
        Some(NotReady {
            job_id: job.id,
            name: job.name.clone(),
            project: job.project.clone(),
            deadline,
            probability: known.then_some(probability),
            finish: [finish(50), finish(80), finish(95)],
            reason: reason.to_owned(),
        })
    }
}

/// Paid time to come.
struct Paid {
    price: Money,
    from: Timestamp,
    until: Timestamp,
}

impl Paid {
    /// What the part of it between two instants costs.
    fn within(&self, from: Timestamp, until: Timestamp) -> i64 {
        let time = self.until.min(until).micros_since(self.from.max(from));
        self.price.for_micros_at_hourly_rate(time.max(0)).0
    }
}

/// Adds to a scenario's sum; sums are there once there is something to add.
fn add(sums: &mut Vec<i64>, scenarios: usize, scenario: usize, cost: i64) {
    sums.resize(scenarios, 0);
    sums[scenario] = sums[scenario].saturating_add(cost);
}

/// A budget's period against what it will have cost by the end of the nights.
fn outlook(period: Period) -> BudgetOutlook {
    let Period { budget, from, until, spent, mut to_come } = period;
    to_come.sort_unstable();
    let over = to_come.iter().filter(|&&sum| sum.saturating_add(spent) > budget.amount.0).count();
    let probability_over = over as f64 / to_come.len().max(1) as f64;
    BudgetOutlook {
        project: budget.project.clone(),
        period: budget.period,
        from,
        until,
        amount: budget.amount,
        spent: Money(spent),
        cost: quantiles(&to_come, spent),
        probability_over,
        threatened: probability_over > THREATENED,
    }
}

/// Seed of the scenarios: constant, so that forecasts differ only if the farm does.
const SEED: u64 = 0x6e69_6768_7473;

fn job(open: &OpenJob, id: u64, now: i64) -> planner::Job {
    let total = open.forecast.as_ref().map(|forecast| forecast.total.cpu_seconds);
    planner::Job {
        id,
        name: open.job.name.clone(),
        release: now,
        deadline: open.job.deadline.map(Timestamp::micros),
        confidence: crate::conductor::farm::confidence(open.job.confidence),
        total: total.map_or_else(planner::WorkTotal::default, |total| crate::conductor::farm::total(&total)),
        frames: open
            .frames
            .iter()
            .map(|&(number, p50, p80)| crate::conductor::farm::frame(number, p50, p80))
            .collect(),
        ..planner::Job::default()
    }
}

/// Nodes of the same cores, speed and price are a class.
fn class(node: &Node) -> String {
    let price = node.price_per_hour.0 as f64 / 1e6;
    format!("{} cores of speed {} at {price:.2} an hour", node.cores, node.speed)
}

fn sum(amounts: impl Iterator<Item = Money>) -> Money {
    Money(amounts.fold(0i64, |sum, amount| sum.saturating_add(amount.0)))
}

/// The least of the sorted values that so many per cent do not exceed.
fn at(sorted: &[i64], per_cent: usize) -> Option<i64> {
    sorted.get((sorted.len() * per_cent).div_ceil(100).saturating_sub(1)).copied()
}

fn quantiles(sorted: &[i64], spent: i64) -> MoneyForecast {
    let value = |per_cent| Money(spent.saturating_add(at(sorted, per_cent).unwrap_or(0)));
    MoneyForecast { p50: value(50), p80: value(80), p95: value(95) }
}
