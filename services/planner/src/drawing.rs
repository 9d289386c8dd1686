//! Pictures: a plan over time, and a price against deadlines. SVG, without scripts or fonts of its own.

use std::collections::BTreeMap;
use std::fmt::Write;

use crate::answers::Offer;
use crate::model::{Input, Plan};

const WIDTH: f64 = 1200.0;
const LEFT: f64 = 150.0;
const TOP: f64 = 30.0;
/// More rows than this become thinner.
const FULL_ROWS: usize = 60;

/// A plan as a Gantt chart: a row for each node that is used, a bar for each task in its job's colour, rentals behind them,
/// deadlines as lines.
pub fn gantt(input: &Input, plan: &Plan) -> String {
    let mut rows: Vec<u64> = plan.bookings.iter().map(|booking| booking.node).collect();
    rows.sort_unstable();
    rows.dedup();
    let place: BTreeMap<u64, usize> = rows.iter().copied().zip(0..).collect();
    let height =
        if rows.len() <= FULL_ROWS { 16.0 } else { (16.0 * FULL_ROWS as f64 / rows.len() as f64).max(3.0) };
    let ends = plan.bookings.iter().map(|booking| booking.end);
    let deadlines = input.jobs.iter().filter_map(|job| job.deadline);
    let last_end = ends.max().unwrap_or(input.now);
    // A deadline long after the last frame would leave the picture empty.
    let soon = last_end.saturating_add(last_end.saturating_sub(input.now) / 4);
    let until = deadlines.filter(|&deadline| deadline <= soon).fold(last_end, i64::max);
    let axis = Axis { from: input.now, until: until.max(input.now.saturating_add(1)) };
    let bottom = TOP + rows.len() as f64 * height;
    let mut svg = header(WIDTH, bottom + 30.0);
    axis.draw(&mut svg, TOP, bottom);
    let names: BTreeMap<u64, &str> = input.nodes.iter().map(|node| (node.id, node.name.as_str())).collect();
    let jobs: BTreeMap<u64, &str> = input.jobs.iter().map(|job| (job.id, job.name.as_str())).collect();
    if height >= 9.0 {
        for (row, node) in rows.iter().enumerate() {
            let y = TOP + row as f64 * height + height * 0.75;
            let name = escaped(names.get(node).copied().unwrap_or(""));
            let _ =
                writeln!(svg, "<text x=\"{:.1}\" y=\"{y:.1}\" text-anchor=\"end\">{name}</text>", LEFT - 6.0);
        }
    }
    let mut bar = |node: u64, start: i64, end: i64, inset: f64, fill: &str, title: &str| {
        let Some(&row) = place.get(&node) else { return };
        let (x, y) = (axis.x(start), TOP + row as f64 * height + inset);
        let (width, tall) = ((axis.x(end) - x).max(0.3), height - 2.0 * inset);
        let title = escaped(title);
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{tall:.2}\" fill=\"{fill}\"><title>{title}</title></rect>"
        );
    };
    for rental in &plan.rentals {
        bar(rental.node, rental.start, rental.end, 0.0, "#d8d8d8", "rented");
    }
    for booking in &plan.bookings {
        let job = jobs.get(&booking.job).copied().unwrap_or("");
        let title = format!("{job}, {}: {} to {}", booking.task, clock(booking.start), clock(booking.end));
        bar(booking.node, booking.start, booking.end, height * 0.1, &colour(booking.job), &title);
    }
    for job in input.jobs.iter().filter(|job| job.deadline.is_some_and(|deadline| deadline <= axis.until)) {
        let x = axis.x(job.deadline.unwrap_or_default());
        let name = escaped(&job.name);
        let _ = writeln!(
            svg,
            "<line x1=\"{x:.1}\" y1=\"{TOP}\" x2=\"{x:.1}\" y2=\"{bottom:.1}\" stroke=\"{}\" stroke-dasharray=\"4 3\"><title>deadline of {name}</title></line>",
            colour(job.id)
        );
    }
    svg + "</svg>\n"
}

/// A price against deadlines, with the bound below it. `money` writes an amount in micro-units.
pub fn price_curve(offers: &[Offer], money: impl Fn(i64) -> String) -> String {
    const HEIGHT: f64 = 400.0;
    let mut svg = header(WIDTH, TOP + HEIGHT + 30.0);
    let (Some(first), Some(last)) = (offers.first(), offers.last()) else { return svg + "</svg>\n" };
    let axis = Axis { from: first.deadline, until: last.deadline.max(first.deadline.saturating_add(1)) };
    axis.draw(&mut svg, TOP, TOP + HEIGHT);
    let most = offers.iter().map(|offer| offer.cost).max().unwrap_or(0).max(1);
    let y = |cost: i64| TOP + HEIGHT * (1.0 - cost as f64 / (most as f64 * 1.05));
    for (name, dashes, cost) in [
        ("price", "", (|offer: &Offer| offer.cost) as fn(&Offer) -> i64),
        ("bound", "5 4", |offer: &Offer| offer.cost_bound),
    ] {
        let points: Vec<String> =
            offers.iter().map(|o| format!("{:.1},{:.1}", axis.x(o.deadline), y(cost(o)))).collect();
        let _ = writeln!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"#1f5fa8\" stroke-width=\"2\" stroke-dasharray=\"{dashes}\"><title>{name}</title></polyline>",
            points.join(" ")
        );
    }
    for offer in [first, last] {
        let (x, y) = (axis.x(offer.deadline), y(offer.cost) - 6.0);
        let anchor = if offer.deadline == first.deadline { "start" } else { "end" };
        let _ = writeln!(
            svg,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>",
            money(offer.cost)
        );
    }
    svg + "</svg>\n"
}

struct Axis {
    from: i64,
    until: i64,
}

impl Axis {
    fn x(&self, instant: i64) -> f64 {
        let part = (i128::from(instant) - i128::from(self.from)) as f64;
        let whole = (i128::from(self.until) - i128::from(self.from)) as f64;
        LEFT + (WIDTH - LEFT - 20.0) * (part / whole).clamp(0.0, 1.0)
    }

    /// Lines at whole multiples of a round step, with their times.
    fn draw(&self, svg: &mut String, top: f64, bottom: f64) {
        const MINUTE: i64 = 60_000_000;
        let steps = [1, 5, 15, 30, 60, 120, 360, 720, 1440, 2880, 7200, 14400, 43200, 144_000, 525_600];
        let span = self.until.saturating_sub(self.from);
        let step = steps.iter().map(|minutes| minutes * MINUTE).find(|step| span / step <= 12);
        let step = step.unwrap_or(span / 10 + 1);
        let mut tick = self.from.div_euclid(step).saturating_mul(step).saturating_add(step);
        while tick <= self.until {
            let x = self.x(tick);
            let _ = writeln!(
                svg,
                "<line x1=\"{x:.1}\" y1=\"{top}\" x2=\"{x:.1}\" y2=\"{bottom:.1}\" stroke=\"#ccc\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                bottom + 16.0,
                clock(tick)
            );
            tick = tick.saturating_add(step);
            if tick == i64::MAX {
                break;
            }
        }
    }
}

fn header(width: f64, height: f64) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" font-size=\"10\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    )
}

/// Day and time, UTC, to the minute.
fn clock(instant: i64) -> String {
    jiff::Timestamp::from_microsecond(instant)
        .map_or_else(|_| String::new(), |at| at.strftime("%d %b %H:%M").to_string())
}

/// A colour that differs from those of the neighbouring numbers: hues by the golden angle.
fn colour(job: u64) -> String {
    format!("hsl({} {}% {}%)", (job % 360) * 137 % 360, 60 + job / 3 % 3 * 10, 45 + job % 3 * 8)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
