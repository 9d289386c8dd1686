//! Simulations as text.

use super::runner::{Document, Simulated};
use forelight_protocol::words::counted;
use forelight_terminal::quantities::money;
use forelight_terminal::table::{Align, Table};

pub(super) fn hours(hours: f64) -> String {
    format!("{hours:.2} h")
}

pub(super) fn text(document: &Document) -> String {
    let mut text = String::new();
    for world in &document.worlds {
        text += &format!(
            "{}: {}, {}, seed {}\n\n",
            world.name,
            counted(world.nodes, "node"),
            counted(world.jobs, "job"),
            world.chances.seed
        );
        text += &table(world).render();
        if let Some(first) = world.reports.first() {
            text += &format!(
                "\nNo schedule that keeps all deadlines costs less than {}.\n\n",
                money(first.cost_bound)
            );
        }
    }
    for finding in &document.findings {
        let verdict = if finding.reached { "reached" } else { "missed" };
        text += &format!(
            "{:.1} % {} (required: at {} {:.0} %): {verdict}\n",
            finding.found * 100.0,
            finding.what,
            if finding.at_most { "most" } else { "least" },
            finding.wanted * 100.0
        );
    }
    text
}

pub(super) fn table(world: &Simulated) -> Table {
    let mut table = Table::new(&[
        ("policy", Align::Left),
        ("pool", Align::Right),
        ("promised", Align::Right),
        ("kept", Align::Right),
        ("in time", Align::Right),
        ("median time", Align::Right),
        ("late, mean", Align::Right),
        ("late, P95", Align::Right),
        ("cost", Align::Right),
        ("of bound", Align::Right),
        ("rented", Align::Right),
        ("useful", Align::Right),
        ("busy", Align::Right),
        ("makespan", Align::Right),
        ("lost", Align::Right),
        ("plans", Align::Right),
    ]);
    let per_cent = |share: f64| format!("{:.1} %", share * 100.0);
    for report in &world.reports {
        table.row([
            report.policy.name().to_owned(),
            format!("{} %", report.pool),
            report.promised.to_string(),
            per_cent(report.kept()),
            per_cent(report.on_time()),
            hours(report.median_hours),
            format!("{:.1} h", report.mean_hours_late),
            format!("{:.1} h", report.hours_late_p95),
            money(report.cost),
            format!("{:.2}", report.over_bound()),
            format!("{:.0} h", report.rented_hours),
            per_cent(report.useful),
            per_cent(report.utilisation),
            format!("{:.0} h", report.makespan_hours),
            (report.lost + report.evicted).to_string(),
            report.plans.to_string(),
        ]);
    }
    table
}
