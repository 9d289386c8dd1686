//! Budgets of projects, and what the nights to come will cost.

use jiff::ToSpan as _;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{JobId, Money, NodeId, Timestamp};

/// What a budget is for. A night is the 24 hours from noon of the date that it is named by.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BudgetPeriod {
    /// Every night anew.
    Night,
    /// Every calendar month anew, from noon of its first day.
    Month,
    /// Once and for all.
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

    /// First instant of the period that holds this one, and the instant after its last. None if the time zone is not known or the
    /// calendar ends.
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

/// The 24 hours (23 or 25 where clocks change) from noon of a date to noon of the next.
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
    /// The night that begins on a date.
    pub fn on(zone: &str, date: Date) -> Option<Self> {
        let zone = TimeZone::get(zone).ok()?;
        let noon = |date: Date| {
            let at = date.at(12, 0, 0, 0).to_zoned(zone.clone()).ok()?;
            Some(Timestamp::from_micros(at.timestamp().as_microsecond()))
        };
        Some(Night { date, from: noon(date)?, until: noon(date.tomorrow().ok()?)? })
    }

    /// The night that holds an instant.
    pub fn of(zone: &str, at: Timestamp) -> Option<Self> {
        let found = TimeZone::get(zone).ok()?;
        let instant = jiff::Timestamp::from_microsecond(at.micros()).ok()?;
        let today = Self::on(zone, found.to_datetime(instant).date())?;
        if at < today.from { Self::on(zone, today.date.yesterday().ok()?) } else { Some(today) }
    }
}

/// What happens when so much of a budget is spent.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BudgetAction {
    /// An event says so.
    Warn,
    /// What runs is finished; nothing of the project is handed out any more.
    Drain,
    /// What runs is stopped and goes back, and nothing is handed out any more.
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

/// An action, and when it is taken.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BudgetThreshold {
    /// Per cent of the amount that are spent or committed, 1 to 1000.
    #[schema(minimum = 1, maximum = 1000)]
    pub percent: u32,
    /// What is done then.
    pub action: BudgetAction,
}

/// A budget to be set. A project has one of each period; setting it again replaces it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BudgetRequest {
    /// The project: 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200)]
    pub project: String,
    /// For which time.
    pub period: BudgetPeriod,
    /// How much, micro-units.
    pub amount: Money,
    /// Time zone of nights and months, by its name in the IANA database.
    #[serde(default = "utc")]
    #[schema(default = "UTC")]
    pub zone: String,
    /// What happens when, at most 10; an empty list: nothing. Absent: a warning at 80 %, and at 100 % nothing new is begun (`drain`).
    #[serde(default = "BudgetRequest::usual_thresholds")]
    #[schema(max_items = 10)]
    pub thresholds: Vec<BudgetThreshold>,
}

fn utc() -> String {
    "UTC".to_owned()
}

impl BudgetRequest {
    /// What happens unless something else is asked for: a warning at 80 %, and nothing new is started once all is spent or committed.
    pub fn usual_thresholds() -> Vec<BudgetThreshold> {
        vec![
            BudgetThreshold { percent: 80, action: BudgetAction::Warn },
            BudgetThreshold { percent: 100, action: BudgetAction::Drain },
        ]
    }
}

/// A budget and how it stands.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Budget {
    /// The project.
    pub project: String,
    /// For which time.
    pub period: BudgetPeriod,
    /// How much.
    pub amount: Money,
    /// Time zone of nights and months.
    pub zone: String,
    /// What happens when.
    pub thresholds: Vec<BudgetThreshold>,
    /// First instant of the period under way.
    pub from: Timestamp,
    /// The instant after its last.
    pub until: Timestamp,
    /// The ledger of the period: what leases cost, those that run up to now.
    pub spent: Money,
    /// What the frames that run are still expected to cost.
    pub committed: Money,
    /// The action in force.
    pub action: Option<BudgetAction>,
    /// When it was set last.
    pub updated_at: Timestamp,
}

/// All budgets, by project and period.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetList {
    /// The budgets.
    pub items: Vec<Budget>,
}

/// What nights are asked about.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BudgetForecastRequest {
    /// The date on which the first night begins, such as 2026-03-01; absent: the night under way or, before noon of the zone, the one that ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, format = Date)]
    pub date: Option<Date>,
    /// How many nights, 1 to 60.
    #[serde(default = "one")]
    #[schema(default = 1, minimum = 1, maximum = 60)]
    pub days: u32,
    /// Time zone, by its name in the IANA database.
    #[serde(default = "utc")]
    #[schema(default = "UTC")]
    pub zone: String,
}

fn one() -> u32 {
    1
}

/// An amount that is not known yet: it stays below these with probability 50, 80 and 95 %.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct MoneyForecast {
    /// Median.
    pub p50: Money,
    /// 80 % quantile.
    pub p80: Money,
    /// 95 % quantile.
    pub p95: Money,
}

/// What something will cost in a night.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CostLine {
    /// Name of the project, job or node class.
    pub name: String,
    /// The job, if it is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_id: Option<JobId>,
    /// What was spent already.
    pub spent: Money,
    /// All of the night, with what was spent. Quantiles of the sum: not sums of quantiles.
    pub cost: MoneyForecast,
}

/// One night.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NightForecast {
    /// The date on which it begins.
    #[schema(value_type = String, format = Date)]
    pub date: Date,
    /// First instant.
    pub from: Timestamp,
    /// The instant after the last.
    pub until: Timestamp,
    /// What was spent already.
    pub spent: Money,
    /// The whole farm, with what was spent.
    pub cost: MoneyForecast,
    /// By project, by name.
    pub projects: Vec<CostLine>,
    /// By job, oldest first.
    pub jobs: Vec<CostLine>,
    /// By class of nodes: those with the same cores, speed and price.
    pub node_classes: Vec<CostLine>,
}

/// A budget against the forecast, for one of its periods that the nights touch.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetOutlook {
    /// The project.
    pub project: String,
    /// For which time.
    pub period: BudgetPeriod,
    /// First instant of the period.
    pub from: Timestamp,
    /// The instant after its last.
    pub until: Timestamp,
    /// How much there is.
    pub amount: Money,
    /// What was spent in the period.
    pub spent: Money,
    /// What will be spent in it by the end of the last night.
    pub cost: MoneyForecast,
    /// Probability that it is more than there is, 0 to 1.
    pub probability_over: f64,
    /// That is more likely than one in five.
    pub threatened: bool,
}

/// A job that may not be ready.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NotReady {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// Its project.
    pub project: String,
    /// When it is wanted.
    pub deadline: Timestamp,
    /// Probability of being late, 0 to 1; absent if it is not forecast yet.
    pub probability: Option<f64>,
    /// When it is expected, at P50, P80 and P95; absent where it never is, or not forecast yet.
    pub finish: [Option<Timestamp>; 3],
    /// Why, in a line.
    pub reason: String,
}

/// What is different from the night before's forecast, for a job.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetChange {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// What it was to cost at P80 in all nights asked about; absent if it was not there.
    pub before: Option<Money>,
    /// What it is to cost now; absent if it is not there any more.
    pub after: Option<Money>,
}

/// How often forecasts of nights were right.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct NightRecord {
    /// Nights that are over and were forecast before they began.
    pub nights: u32,
    /// Those that cost no more than the P50.
    pub within_p50: u32,
    /// … the P80.
    pub within_p80: u32,
    /// … the P95.
    pub within_p95: u32,
}

/// What tonight and the nights after it will cost.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetForecast {
    /// The date on which the first night begins.
    #[schema(value_type = String, format = Date)]
    pub date: Date,
    /// How many nights.
    pub days: u32,
    /// Time zone.
    pub zone: String,
    /// When this was worked out.
    pub made_at: Timestamp,
    /// The nights had not begun then: this counts for the track record.
    pub beforehand: bool,
    /// Scenarios that the quantiles rest on.
    pub scenarios: u32,
    /// The nights.
    pub nights: Vec<NightForecast>,
    /// All of them together.
    pub cost: MoneyForecast,
    /// Budgets that they touch.
    pub budgets: Vec<BudgetOutlook>,
    /// Jobs with a deadline up to the last night's end that are late in more than one scenario in five.
    pub not_ready: Vec<NotReady>,
    /// Jobs that are not forecast yet: they are in no number here.
    pub unknown: Vec<String>,
    /// When the forecast was made that changes are seen against.
    pub compared_with: Option<Timestamp>,
    /// What changed since.
    pub changes: Vec<BudgetChange>,
    /// How often such forecasts were right.
    pub track_record: NightRecord,
    /// Any of the budgets is threatened.
    pub threatened: bool,
}

/// A stretch of node time that was paid for, or is.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct LedgerLine {
    /// The project.
    pub project: String,
    /// The job.
    pub job_id: JobId,
    /// The node.
    pub node_id: NodeId,
    /// Price at the time.
    pub price_per_hour: Money,
    /// First instant.
    pub from: Timestamp,
    /// The instant after the last; none: it goes on.
    pub until: Option<Timestamp>,
}

impl LedgerLine {
    /// What the part of it between two instants cost, if it went on to the later one.
    pub fn cost_within(&self, from: Timestamp, until: Timestamp) -> Money {
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
        // Clocks go forward.
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
            job_id: JobId::new(),
            node_id: NodeId::new(),
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
