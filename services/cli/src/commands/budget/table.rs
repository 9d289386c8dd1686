//! A forecast of nights as text and as comma-separated values.

use forelight_protocol::{
    Budget, BudgetForecast, BudgetOutlook, CostLine, Money, MoneyForecast, NightForecast, NotReady, Timestamp,
};
use forelight_terminal::quantities::money;
use forelight_terminal::table::{Align, Table};

const AMOUNTS: [(&str, Align); 4] =
    [("spent", Align::Right), ("P50", Align::Right), ("P80", Align::Right), ("P95", Align::Right)];

fn amounts(spent: Money, cost: &MoneyForecast) -> [String; 4] {
    [spent, cost.p50, cost.p80, cost.p95].map(|amount| money(amount.0))
}

/// Day and time in a time zone. An unknown zone counts as UTC.
pub(super) fn clock(at: Timestamp, zone: &str) -> String {
    let instant = jiff::Timestamp::from_microsecond(at.micros()).unwrap_or_default();
    let zone = jiff::tz::TimeZone::get(zone).unwrap_or(jiff::tz::TimeZone::UTC);
    instant.to_zoned(zone).strftime("%d %b %H:%M").to_string()
}

pub(super) fn chance(probability: f64) -> String {
    format!("{:.0} %", probability * 100.0)
}

/// Such as `night from 01 Mar 12:00`.
pub(super) fn period(budget: &BudgetOutlook, zone: &str) -> String {
    match budget.period {
        forelight_protocol::BudgetPeriod::Total => "in all".to_owned(),
        other => format!("{} from {}", other.name(), clock(budget.from, zone)),
    }
}

/// When a job is expected to be ready at P50, P80 and P95. A hyphen stands for an unknown time.
pub(super) fn expected(job: &NotReady, zone: &str) -> [String; 3] {
    job.finish.map(|at| at.map_or_else(|| "-".to_owned(), |at| clock(at, zone)))
}

pub(super) fn text(found: &BudgetForecast) -> String {
    let mut text = String::new();
    let mut head = vec![("night", Align::Left), ("", Align::Left)];
    head.extend(AMOUNTS);
    let mut table = Table::new(&head);
    for night in &found.nights {
        let first = [night.date.to_string(), String::new()];
        table.row(first.into_iter().chain(amounts(night.spent, &night.cost)));
        for (lines, what) in parts(night) {
            for line in lines {
                let name = [String::new(), format!("{what} {}", line.name)];
                table.row(name.into_iter().chain(amounts(line.spent, &line.cost)));
            }
        }
    }
    if found.nights.len() > 1 {
        table.footer();
        let spent = found.nights.iter().fold(0i64, |sum, night| sum.saturating_add(night.spent.0));
        table.row(["all".to_owned(), String::new()].into_iter().chain(amounts(Money(spent), &found.cost)));
    }
    text += &table.render();
    if !found.budgets.is_empty() {
        let mut head = vec![("budget", Align::Left), ("for", Align::Left), ("amount", Align::Right)];
        head.extend(AMOUNTS);
        head.extend([("exceeded", Align::Right), ("", Align::Left)]);
        let mut table = Table::new(&head);
        for budget in &found.budgets {
            let first =
                [budget.project.clone(), period(budget, &found.zone), money(budget.amount.0)].into_iter();
            let word = if budget.threatened { "threatened" } else { "" };
            let last = [chance(budget.probability_over), word.to_owned()];
            table.row(first.chain(amounts(budget.spent, &budget.cost)).chain(last));
        }
        text += &format!("\n{}", table.render());
    }
    if !found.not_ready.is_empty() {
        let mut table = Table::new(&[
            ("not ready", Align::Left),
            ("wanted", Align::Left),
            ("late", Align::Right),
            ("expected P50", Align::Left),
            ("P80", Align::Left),
            ("P95", Align::Left),
            ("", Align::Left),
        ]);
        for job in &found.not_ready {
            let late = job.probability.map_or_else(|| "?".to_owned(), chance);
            let first = [job.name.clone(), clock(job.deadline, &found.zone), late].into_iter();
            table.row(first.chain(expected(job, &found.zone)).chain([job.reason.clone()]));
        }
        text += &format!("\n{}", table.render());
    }
    if !found.unknown.is_empty() {
        text += &format!("\nnot forecast yet, and not counted above: {}\n", found.unknown.join(", "));
    }
    if let Some(at) = found.compared_with {
        text += &format!("\nchanged since the forecast of {}:", clock(at, &found.zone));
        text += if found.changes.is_empty() { " nothing\n" } else { "\n" };
        for change in &found.changes {
            let amount =
                |amount: Option<Money>| amount.map_or_else(|| "-".to_owned(), |amount| money(amount.0));
            text +=
                &format!("  {}: {} to {} (P80)\n", change.name, amount(change.before), amount(change.after));
        }
    }
    text + &format!("\n{}\n", record(found))
}

/// The track record of past forecasts in a sentence.
pub(super) fn record(found: &BudgetForecast) -> String {
    let record = &found.track_record;
    if record.nights == 0 {
        return "There is no track record yet: no night with a forecast has ended.".to_owned();
    }
    format!(
        "Of {} past nights with a forecast, {} cost at most the P50, {} at most the P80, {} at most the P95.",
        record.nights, record.within_p50, record.within_p80, record.within_p95
    )
}

/// The parts of a night's cost: three lists, each with its name.
pub(super) fn parts(night: &NightForecast) -> [(&[CostLine], &'static str); 3] {
    [(&night.projects, "project"), (&night.jobs, "job"), (&night.node_classes, "nodes:")]
}

pub(super) fn budgets(budgets: &[Budget]) -> String {
    let mut table = Table::new(&[
        ("project", Align::Left),
        ("per", Align::Left),
        ("amount", Align::Right),
        ("spent", Align::Right),
        ("committed", Align::Right),
        ("actions", Align::Left),
        ("in force", Align::Left),
    ]);
    for budget in budgets {
        let actions: Vec<String> = budget
            .thresholds
            .iter()
            .map(|threshold| format!("{} at {} %", threshold.action.name(), threshold.percent))
            .collect();
        table.row([
            budget.project.clone(),
            budget.period.name().to_owned(),
            money(budget.amount.0),
            money(budget.spent.0),
            money(budget.committed.0),
            actions.join(", "),
            budget.action.map_or("", |action| action.name()).to_owned(),
        ]);
    }
    table.render()
}

/// The amounts by night in micro-units, as comma-separated values (RFC 4180).
pub(super) fn csv(found: &BudgetForecast) -> String {
    let mut text = "night,what,name,job_id,spent,p50,p80,p95\r\n".to_owned();
    let mut row =
        |night: &NightForecast, what: &str, name: &str, job: &str, spent: Money, cost: &MoneyForecast| {
            let MoneyForecast { p50, p80, p95 } = cost;
            text += &format!(
                "{},{what},{},{job},{},{},{},{}\r\n",
                night.date,
                quoted(name),
                spent.0,
                p50.0,
                p80.0,
                p95.0
            );
        };
    for night in &found.nights {
        row(night, "farm", "", "", night.spent, &night.cost);
        for (lines, what) in parts(night) {
            for line in lines {
                let job = line.job_id.map(|id| id.to_string()).unwrap_or_default();
                row(night, what.trim_end_matches(':'), &line.name, &job, line.spent, &line.cost);
            }
        }
    }
    text
}

/// Adds quotes if needed. An apostrophe in front keeps spreadsheets from reading a formula.
fn quoted(field: &str) -> String {
    let safe = if field.starts_with(['=', '+', '-', '@', '\t', '\r']) {
        format!("'{field}")
    } else {
        field.to_owned()
    };
    if safe.contains([',', '"', '\n', '\r']) { format!("\"{}\"", safe.replace('"', "\"\"")) } else { safe }
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn fields_cannot_break_out_of_their_cell_nor_become_formulas() {
        assert_eq!(quoted("plain"), "plain");
        assert_eq!(quoted("a,\"b\""), "\"a,\"\"b\"\"\"");
        assert_eq!(quoted("=1+1"), "'=1+1");
    }
}
