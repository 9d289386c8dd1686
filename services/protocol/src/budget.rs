//! Budgets of projects, and forecasts of the cost of coming nights.

use jiff::ToSpan as _;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{JobId, Money, NodeId, Timestamp};

/// The period of a budget. A night is the 24 hours from noon of the date that it is named after.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BudgetPeriod {
    /// Renewed every night.
    Night,
    /// Renewed every calendar month, at noon of its first day.
    Month,
    /// Never renewed.
    Total,
}

impl BudgetPeriod {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            BudgetPeriod::Night => "night",
            BudgetPeriod::Month => "month",
            BudgetPeriod::Total => "total",
        }
    }

    /// First instant of the period that contains `at`, and the instant after its last one. `None` if the time
    /// zone is unknown, or a date is outside the calendar.
    pub fn bounds(self, zone: &str, at: Timestamp) -> Option<(Timestamp, Timestamp)> {
        let night = Night::of(zone, at)?;
        match self {
            BudgetPeriod::Night => Some((night.from, night.until)),
            BudgetPeriod::Month => {
                let first = night.date.first_of_month();
                let next = first.checked_add(1.month()).ok()?;
                Some((Night::on(zone, first)?.from, Night::on(zone, next)?.from))
            }
            BudgetPeriod::Total => Some((Timestamp::from_micros(i64::MIN), Timestamp::from_micros(i64::MAX))),
        }
    }
}

/// The hours from noon of a date to noon of the next: 24, or 23 or 25 when clocks change.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Night {
    /// The date on which it begins.
    pub date: Date,
    /// First instant.
    pub from: Timestamp,
    /// The instant after the last.
    pub until: Timestamp,
}

impl Night {
    /// The night that begins on `date`. `None` if the zone is unknown or the date is outside the calendar.
    pub fn on(zone: &str, date: Date) -> Option<Self> {
        let zone = TimeZone::get(zone).ok()?;
        let noon = |date: Date| {
            let at = date.at(12, 0, 0, 0).to_zoned(zone.clone()).ok()?;
            Some(Timestamp::from_micros(at.timestamp().as_microsecond()))
        };
        Some(Night { date, from: noon(date)?, until: noon(date.tomorrow().ok()?)? })
    }

    /// The night that contains `at`. `None` as in [`Self::on`].
    pub fn of(zone: &str, at: Timestamp) -> Option<Self> {
        let found = TimeZone::get(zone).ok()?;
        let instant = jiff::Timestamp::from_microsecond(at.micros()).ok()?;
        let today = Self::on(zone, found.to_datetime(instant).date())?;
        if at < today.from { Self::on(zone, today.date.yesterday().ok()?) } else { Some(today) }
    }
}

/// The action that is taken when a share of a budget is spent.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BudgetAction {
    /// Publish an event.
    Warn,
    /// Start no more tasks of the project. Running tasks finish.
    Drain,
    /// Start no more tasks of the project. Running tasks are stopped and queued again.
    Stop,
}

impl BudgetAction {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            BudgetAction::Warn => "warn",
            BudgetAction::Drain => "drain",
            BudgetAction::Stop => "stop",
        }
    }
}

/// An action, and the share of the budget at which it is taken.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BudgetThreshold {
    /// Percentage of the amount that is spent or committed, 1 to 1000.
    #[schema(minimum = 1, maximum = 1000)]
    pub percent: u32,
    /// The action.
    pub action: BudgetAction,
}

impl BudgetThreshold {
    /// Whether its share of `amount` is used. Nothing used reaches no share, even of a budget of nothing.
    pub fn is_reached(self, amount: Money, used: Money) -> bool {
        used.0 > 0 && i128::from(used.0) * 100 >= i128::from(amount.0) * i128::from(self.percent)
    }
}

/// Sets a budget. A project has one budget per period; a new one replaces it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BudgetRequest {
    /// The project: 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub project: String,
    /// The period.
    pub period: BudgetPeriod,
    /// The amount, in micro-units: 0 to 10¹⁸.
    #[schema(value_type = i64, minimum = 0, maximum = 1_000_000_000_000_000_000_i64)]
    pub amount: Money,
    /// Time zone of nights and months: its name in the IANA database.
    #[serde(default = "utc")]
    #[schema(default = "UTC")]
    pub zone: String,
    /// Actions and when they are taken, at most 10. If absent: `warn` at 80 % and `drain` at 100 %.
    #[serde(default = "BudgetRequest::usual_thresholds")]
    #[schema(max_items = 10)]
    pub thresholds: Vec<BudgetThreshold>,
}

fn utc() -> String {
    "UTC".to_owned()
}

impl BudgetRequest {
    /// The default thresholds: a warning at 80 %, and no new tasks once everything is spent or committed.
    pub fn usual_thresholds() -> Vec<BudgetThreshold> {
        vec![
            BudgetThreshold { percent: 80, action: BudgetAction::Warn },
            BudgetThreshold { percent: 100, action: BudgetAction::Drain },
        ]
    }
}

/// A budget and its present state.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Budget {
    /// The project.
    pub project: String,
    /// The period.
    pub period: BudgetPeriod,
    /// The amount.
    pub amount: Money,
    /// Time zone of nights and months.
    pub zone: String,
    /// Actions and when they are taken.
    pub thresholds: Vec<BudgetThreshold>,
    /// First instant of the present period.
    pub from: Timestamp,
    /// The instant after the last one of the present period.
    pub until: Timestamp,
    /// Amount spent in the period: the cost of all leases, running ones up to now.
    pub spent: Money,
    /// Expected further cost of the frames that are running.
    pub committed: Money,
    /// The action in force. Absent if there is none.
    pub action: Option<BudgetAction>,
    /// When it was last set.
    pub updated_at: Timestamp,
}

/// What the budget of a job's project is expected to hold back of the job, by all that is booked.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetHold {
    /// Period of the budget.
    pub period: BudgetPeriod,
    /// When so much is expected to be spent that the budget holds the project.
    pub from: Timestamp,
    /// When the next period begins. Absent for the budget of a whole project.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Timestamp>,
    /// Number of the job's frames that are booked between the two.
    pub frames: u32,
    /// By how much the budget would have to be raised for all bookings of the project in this period.
    pub missing: Money,
    /// The same in words.
    pub because: String,
}

impl BudgetHold {
    /// The end of a job whose bookings end at `planned`: what the budget holds back is done from the next period
    /// on, in as much time as it is booked for. `None` if somebody has to raise the budget.
    pub fn end(&self, planned: Timestamp) -> Option<Timestamp> {
        let held = planned.micros_since(self.from).max(0);
        Some(self.until?.plus_micros(held).max(planned))
    }
}

/// All budgets, sorted by project and period.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetList {
    /// The budgets.
    pub items: Vec<Budget>,
}

/// Which nights to forecast.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BudgetForecastRequest {
    /// Date on which the first night begins, such as 2026-03-01. If absent: the present or, before noon, the
    /// ending night.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, format = Date)]
    pub date: Option<Date>,
    /// Number of nights, 1 to 60.
    #[serde(default = "one")]
    #[schema(default = 1, minimum = 1, maximum = 60)]
    pub days: u32,
    /// Time zone: its name in the IANA database.
    #[serde(default = "utc")]
    #[schema(default = "UTC")]
    pub zone: String,
    /// Whether to list jobs: what each costs, how that changed, which are not ready in time, and which have no
    /// forecast. On a farm of thousands of jobs, these lists are long.
    #[serde(default = "yes")]
    #[schema(default = true)]
    pub by_job: bool,
    /// An answer that is so many seconds old will do, at most an hour. On a farm of thousands of jobs, a new one
    /// takes seconds.
    #[serde(default)]
    #[schema(default = 0, minimum = 0, maximum = 3600)]
    pub max_age: u32,
}

fn yes() -> bool {
    true
}

fn one() -> u32 {
    1
}

/// Quantiles of an uncertain amount.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct MoneyForecast {
    /// Median.
    pub p50: Money,
    /// 80 % quantile.
    pub p80: Money,
    /// 95 % quantile.
    pub p95: Money,
}

/// The cost of a project, a job or a class of nodes in one night.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CostLine {
    /// Name of the project, job or class of nodes.
    pub name: String,
    /// The job. Absent if the line is not for a job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_id: Option<JobId>,
    /// Amount already spent.
    pub spent: Money,
    /// Forecast for the whole night, including what is spent. Quantiles of sums, not sums of quantiles.
    pub cost: MoneyForecast,
}

/// Forecast of one night.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NightForecast {
    /// The date on which it begins.
    #[schema(value_type = String, format = Date)]
    pub date: Date,
    /// First instant.
    pub from: Timestamp,
    /// The instant after the last.
    pub until: Timestamp,
    /// Amount already spent.
    pub spent: Money,
    /// Forecast for the whole farm, including what is spent.
    pub cost: MoneyForecast,
    /// One line per project, in the order of their names.
    pub projects: Vec<CostLine>,
    /// One line per job, oldest first.
    pub jobs: Vec<CostLine>,
    /// One line per class of nodes: nodes with the same cores, speed and price.
    pub node_classes: Vec<CostLine>,
}

/// A budget compared with the forecast, for one of its periods that overlap the nights.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetOutlook {
    /// The project.
    pub project: String,
    /// The period.
    pub period: BudgetPeriod,
    /// First instant of the period.
    pub from: Timestamp,
    /// The instant after its last.
    pub until: Timestamp,
    /// Amount of the budget.
    pub amount: Money,
    /// Amount spent in the period so far.
    pub spent: Money,
    /// Forecast amount spent in the period by the end of the last night.
    pub cost: MoneyForecast,
    /// Probability that this exceeds the budget, 0 to 1.
    pub probability_over: f64,
    /// Whether that probability is above 0.2.
    pub threatened: bool,
}

/// A job that may miss its deadline.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NotReady {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// Its project.
    pub project: String,
    /// The deadline.
    pub deadline: Timestamp,
    /// Probability of missing the deadline, 0 to 1. Absent if the job has no forecast yet.
    pub probability: Option<f64>,
    /// Expected finish at P50, P80 and P95. Absent where the job would never finish, or has no forecast yet.
    pub finish: [Option<Timestamp>; 3],
    /// The reason, as one line of text.
    pub reason: String,
}

/// A change of a job's cost since the forecast of the previous night.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetChange {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// P80 of its cost in all nights, in the previous forecast. Absent if the job was not in it.
    pub before: Option<Money>,
    /// The same in this forecast. Absent if the job is not in it.
    pub after: Option<Money>,
}

/// How often forecasts of nights were right.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct NightRecord {
    /// Number of past nights that were forecast before they began.
    pub nights: u32,
    /// How many of them cost no more than P50.
    pub within_p50: u32,
    /// How many of them cost no more than P80.
    pub within_p80: u32,
    /// How many of them cost no more than P95.
    pub within_p95: u32,
}

/// Forecast of the cost of one or more nights.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetForecast {
    /// The date on which the first night begins.
    #[schema(value_type = String, format = Date)]
    pub date: Date,
    /// Number of nights.
    pub days: u32,
    /// Time zone.
    pub zone: String,
    /// When the forecast was made.
    pub made_at: Timestamp,
    /// Whether it was made before the nights began. Only such forecasts count for the track record.
    pub beforehand: bool,
    /// Number of simulated scenarios behind the quantiles.
    pub scenarios: u32,
    /// One forecast per night.
    pub nights: Vec<NightForecast>,
    /// Forecast for all nights together.
    pub cost: MoneyForecast,
    /// Budgets with periods that overlap the nights.
    pub budgets: Vec<BudgetOutlook>,
    /// Jobs with a deadline before the end of the last night that miss it in more than one scenario of five.
    pub not_ready: Vec<NotReady>,
    /// Jobs without a forecast yet. They are not included in any number here.
    pub unknown: Vec<String>,
    /// Number of these jobs. It is there without their names as well.
    #[serde(default)]
    #[schema(required)]
    pub unknown_total: u32,
    /// When the forecast was made that this one is compared with. Absent if there is none.
    pub compared_with: Option<Timestamp>,
    /// What changed since that forecast.
    pub changes: Vec<BudgetChange>,
    /// How often such forecasts were right.
    pub track_record: NightRecord,
    /// Whether any of the budgets is threatened.
    pub threatened: bool,
}

/// A period of node time that is charged to a job.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct LedgerLine {
    /// The project.
    pub project: String,
    /// The job and the node. `None` for all that deleted jobs cost in a quarter of an hour.
    pub of: Option<(JobId, NodeId)>,
    /// Price per hour at the start. For deleted jobs, four times what the quarter cost.
    pub price_per_hour: Money,
    /// First instant.
    pub from: Timestamp,
    /// The instant after the last. `None` while it is running.
    pub until: Option<Timestamp>,
}

impl LedgerLine {
    /// Cost of the part between two instants. A running line counts until the later one. A quarter of an hour
    /// of deleted jobs counts as a whole, at its beginning.
    pub fn cost_within(&self, from: Timestamp, until: Timestamp) -> Money {
        if self.of.is_none() {
            let begins_within = (from..until).contains(&self.from);
            return if begins_within { Money(self.price_per_hour.0 / 4) } else { Money(0) };
        }
        let end = self.until.unwrap_or(until).min(until);
        let start = self.from.max(from);
        self.price_per_hour.for_micros_at_hourly_rate(end.micros_since(start).max(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    #[test]
    fn a_night_goes_from_noon_to_noon_and_has_the_date_on_which_it_begins() {
        let night = Night::of("UTC", at("2026-03-02T11:59:59Z")).unwrap();
        assert_eq!((night.date.to_string(), night.from), ("2026-03-01".into(), at("2026-03-01T12:00:00Z")));
        assert_eq!(Night::of("UTC", night.until).unwrap().from, night.until);
        let berlin = Night::of("Europe/Berlin", at("2026-03-28T20:00:00Z")).unwrap();
        // Clocks go forward in this night.
        assert_eq!(berlin.until.micros_since(berlin.from), 23 * 3_600_000_000);
        assert_eq!(Night::of("Europe/Nowhere", night.from), None);
    }

    #[test]
    fn a_month_goes_from_noon_of_its_first_day_to_that_of_the_next() {
        let bounds = BudgetPeriod::Month.bounds("UTC", at("2026-03-01T11:00:00Z")).unwrap();
        assert_eq!(bounds, (at("2026-02-01T12:00:00Z"), at("2026-03-01T12:00:00Z")));
        let (from, until) = BudgetPeriod::Total.bounds("UTC", at("2026-03-01T11:00:00Z")).unwrap();
        assert!(from < at("1970-01-01T00:00:00Z") && until > at("9990-01-01T00:00:00Z"));
    }

    #[test]
    fn a_ledger_line_costs_in_each_night_what_lies_in_it() {
        let line = LedgerLine {
            project: "film".into(),
            of: Some((JobId::new(), NodeId::new())),
            price_per_hour: Money(3_600_000_000),
            from: at("2026-03-01T11:59:50Z"),
            until: None,
        };
        let (noon, later) = (at("2026-03-01T12:00:00Z"), at("2026-03-01T12:00:05Z"));
        assert_eq!(line.cost_within(at("2026-02-28T12:00:00Z"), noon), Money(10_000_000));
        assert_eq!(line.cost_within(noon, later), Money(5_000_000));
        let ended = LedgerLine { until: Some(at("2026-03-01T11:59:55Z")), ..line };
        assert_eq!(ended.cost_within(noon, later), Money(0));
    }
}
