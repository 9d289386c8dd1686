//! A forecast of nights as an HTML page: one file without scripts or outside resources.

use super::table::{chance, clock, expected, parts, period, record};
use forelight_protocol::{BudgetForecast, Money, MoneyForecast};
use forelight_terminal::quantities::money;
use std::fmt::Write as _;

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}\
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}\
table{border-collapse:collapse;width:100%}th,td{padding:.3rem .6rem;text-align:right;border-bottom:1px solid #ddd}\
th:first-child,td:first-child,.text{text-align:left}th{font-weight:600;border-bottom:2px solid #888}\
tr.part td:first-child{padding-left:1.8rem;color:#555}.bad{color:#a02010;font-weight:600}.good{color:#207040}\
.bar{position:relative;height:.9rem;background:#eee;min-width:12rem}.bar i{position:absolute;top:0;bottom:0;display:block}\
.spent{background:#555}.p50{background:#1f5fa8}.p80{background:#7aa5d6}.p95{background:#c3d7ee}\
.limit{background:#a02010;width:2px}small{color:#666}\
@media(prefers-color-scheme:dark){body{color:#ddd;background:#1a1a1a}th,td{border-color:#444}.bar{background:#333}tr.part td:first-child,small{color:#aaa}}";

pub(super) fn html(found: &BudgetForecast) -> String {
    let title = match found.days {
        1 => format!("The night of {}", found.date),
        days => format!("{days} nights from {}", found.date),
    };
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{title}</title><style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
    );
    let verdict = if found.threatened {
        "<span class=\"bad\">A budget is threatened.</span>"
    } else if found.budgets.is_empty() {
        "No budget is set."
    } else {
        "<span class=\"good\">All budgets hold.</span>"
    };
    let _ = writeln!(
        page,
        "<p>P50: {}. P80: <b>{}</b>. {verdict}<br>\
         <small>Made {} ({}), from {} scenarios. {}</small></p>",
        money(found.cost.p50.0),
        money(found.cost.p80.0),
        clock(found.made_at, &found.zone),
        escaped(&found.zone),
        found.scenarios,
        record(found),
    );
    budgets(&mut page, found);
    nights(&mut page, found);
    not_ready(&mut page, found);
    changes(&mut page, found);
    page + "</body></html>\n"
}

fn budgets(page: &mut String, found: &BudgetForecast) {
    if found.budgets.is_empty() {
        return;
    }
    page.push_str("<h2>Budgets</h2>\n<table><tr><th>Project<th class=\"text\">For<th>Amount<th>Spent<th>P50<th>P80<th>P95<th>Exceeded<th>\n");
    for budget in &found.budgets {
        let class = if budget.threatened { " class=\"bad\"" } else { "" };
        let _ = writeln!(
            page,
            "<tr><td>{}<td class=\"text\">{}<td>{}{}<td{class}>{}<td>{}",
            escaped(&budget.project),
            escaped(&period(budget, &found.zone)),
            money(budget.amount.0),
            cells(budget.spent, &budget.cost),
            chance(budget.probability_over),
            bar(budget.spent, &budget.cost, Some(budget.amount), budget.amount.max(budget.cost.p95)),
        );
    }
    page.push_str(
        "</table>\n<p><small>Dark: spent. Then P50, P80, P95. The red line is the budget.</small></p>\n",
    );
}

fn nights(page: &mut String, found: &BudgetForecast) {
    let most = found.nights.iter().map(|night| night.cost.p95).max().unwrap_or_default();
    page.push_str("<h2>Nights</h2>\n<table><tr><th>Night<th>Spent<th>P50<th>P80<th>P95<th>\n");
    for night in &found.nights {
        let _ = writeln!(
            page,
            "<tr><td><b>{}</b>{}<td>{}",
            night.date,
            cells(night.spent, &night.cost),
            bar(night.spent, &night.cost, None, most)
        );
        for (lines, what) in parts(night) {
            for line in lines {
                let _ = writeln!(
                    page,
                    "<tr class=\"part\"><td>{what} {}{}<td>{}",
                    escaped(&line.name),
                    cells(line.spent, &line.cost),
                    bar(line.spent, &line.cost, None, most)
                );
            }
        }
    }
    page.push_str("</table>\n<p><small>The quantiles of the parts do not add up to the quantile of the whole.</small></p>\n");
}

fn not_ready(page: &mut String, found: &BudgetForecast) {
    if !found.not_ready.is_empty() {
        page.push_str("<h2>Not ready</h2>\n<table><tr><th>Job<th class=\"text\">Wanted<th>Late<th class=\"text\">Expected, P50<th class=\"text\">P80<th class=\"text\">P95<th class=\"text\">Why\n");
        for job in &found.not_ready {
            let [p50, p80, p95] = expected(job, &found.zone);
            let _ = writeln!(
                page,
                "<tr><td>{}<td class=\"text\">{}<td class=\"bad\">{}<td class=\"text\">{p50}<td class=\"text\">{p80}<td class=\"text\">{p95}<td class=\"text\">{}",
                escaped(&job.name),
                clock(job.deadline, &found.zone),
                job.probability.map_or_else(|| "?".to_owned(), chance),
                escaped(&job.reason),
            );
        }
        page.push_str("</table>\n");
    }
    if !found.unknown.is_empty() {
        let names: Vec<String> = found.unknown.iter().map(|name| escaped(name)).collect();
        let _ = writeln!(page, "<p>Not forecast yet, and not counted above: {}.</p>", names.join(", "));
    }
}

fn changes(page: &mut String, found: &BudgetForecast) {
    let Some(at) = found.compared_with else { return };
    let _ = writeln!(page, "<h2>Changed since {}</h2>", clock(at, &found.zone));
    if found.changes.is_empty() {
        page.push_str("<p>Nothing.</p>\n");
        return;
    }
    page.push_str("<table><tr><th>Job<th>Then, P80<th>Now, P80\n");
    for change in &found.changes {
        let amount = |amount: Option<Money>| amount.map_or_else(|| "-".to_owned(), |amount| money(amount.0));
        let _ = writeln!(
            page,
            "<tr><td>{}<td>{}<td>{}",
            escaped(&change.name),
            amount(change.before),
            amount(change.after)
        );
    }
    page.push_str("</table>\n");
}

fn cells(spent: Money, cost: &MoneyForecast) -> String {
    [spent, cost.p50, cost.p80, cost.p95].iter().map(|amount| format!("<td>{}", money(amount.0))).collect()
}

/// Spent, P50, P80 and P95 as a bar. `most` is its whole length.
fn bar(spent: Money, cost: &MoneyForecast, limit: Option<Money>, most: Money) -> String {
    let share = |amount: Money| 100.0 * amount.0 as f64 / most.0.max(1) as f64;
    let piece = |class: &str, amount: Money| {
        format!("<i class=\"{class}\" style=\"left:0;width:{:.1}%\"></i>", share(amount))
    };
    let mut bar = "<div class=\"bar\">".to_owned();
    // The longest first, since the others are drawn over it.
    for (class, amount) in [("p95", cost.p95), ("p80", cost.p80), ("p50", cost.p50), ("spent", spent)] {
        bar += &piece(class, amount);
    }
    if let Some(limit) = limit {
        bar += &format!("<i class=\"limit\" style=\"left:{:.1}%\"></i>", share(limit));
    }
    bar + "</div>"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
        .replace('\'', "&#39;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::{BudgetOutlook, BudgetPeriod, NightRecord, Timestamp};

    #[test]
    fn a_name_cannot_become_markup_and_the_page_needs_nothing_from_elsewhere() {
        let at = Timestamp::from_micros(1_772_400_000_000_000);
        let found = BudgetForecast {
            date: "2026-03-01".parse().unwrap(),
            days: 1,
            zone: "UTC".into(),
            made_at: at,
            beforehand: true,
            scenarios: 1,
            nights: Vec::new(),
            cost: MoneyForecast::default(),
            budgets: vec![BudgetOutlook {
                project: "<script>alert(1)</script>".into(),
                period: BudgetPeriod::Night,
                from: at,
                until: at,
                amount: Money(0),
                spent: Money(0),
                cost: MoneyForecast::default(),
                probability_over: 0.0,
                threatened: false,
            }],
            not_ready: Vec::new(),
            unknown: vec!["a & b".into()],
            unknown_total: 1,
            compared_with: None,
            changes: Vec::new(),
            track_record: NightRecord::default(),
            threatened: false,
        };
        let page = html(&found);
        assert!(!page.contains("<script") && page.contains("&lt;script&gt;") && page.contains("a &amp; b"));
        assert!(!page.contains("http") && !page.contains("src=") && !page.contains("@import"));
    }
}
