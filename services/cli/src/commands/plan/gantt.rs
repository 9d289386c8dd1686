//! A plan as a Gantt chart.

use std::collections::BTreeMap;

use anyhow::Result;
use forelight_planner::{Input, Plan};
use forelight_plots::{Area, Drawn, clock, svg, time_ticks};
use plotters::element::DashedPathElement;
use plotters::prelude::*;

const WIDTH: u32 = 1200;
const LEFT: u32 = 150;
const RIGHT: u32 = 20;
const TOP: u32 = 10;
const BOTTOM: u32 = 30;
/// Height of a row, pixels. Rows are thinner if there are more than [`FULL_ROWS`].
const ROW: f64 = 16.0;
const FULL_ROWS: usize = 60;
/// Units of the vertical axis per row.
const TENTHS: i32 = 10;
/// Height of a row below which nodes are not named, pixels.
const LEAST_NAMED: f64 = 9.0;
/// Number of jobs above which the legend is left out.
const MOST_EXPLAINED: usize = 48;
/// Width and height of a legend entry, pixels.
const ENTRY: (u32, u32) = (190, 16);
const GREY: RGBColor = RGBColor(190, 190, 190);
const RENTED: RGBColor = RGBColor(216, 216, 216);

/// Draws a row per node in use: bars are tasks in their job's colour, grey rentals, dashed lines deadlines.
pub fn gantt(input: &Input, plan: &Plan) -> Result<String> {
    let chart = Chart::new(input, plan);
    let columns = (WIDTH - LEFT) / ENTRY.0;
    let explained = if chart.jobs.len() <= MOST_EXPLAINED { chart.jobs.len() as u32 } else { 0 };
    let height = TOP + (chart.nodes.len() as f64 * chart.row).ceil() as u32 + BOTTOM;
    let size = (WIDTH, height + explained.div_ceil(columns) * ENTRY.1);
    Ok(svg(size, |area| {
        let (upper, lower) = area.split_vertically(height);
        chart.draw(&upper)?;
        chart.explain(&lower, explained as usize, columns as usize)
    })?)
}

struct Chart<'a> {
    plan: &'a Plan,
    nodes: Vec<(u64, &'a str)>,
    /// Id, name, and the deadline if it is within the chart.
    jobs: Vec<(u64, &'a str, Option<i64>)>,
    row: f64,
    from: i64,
    until: i64,
}

impl<'a> Chart<'a> {
    fn new(input: &'a Input, plan: &'a Plan) -> Self {
        let names: BTreeMap<u64, &str> =
            input.nodes.iter().map(|node| (node.id, node.name.as_str())).collect();
        let used: BTreeMap<u64, &str> = plan
            .bookings
            .iter()
            .map(|booking| (booking.node, names.get(&booking.node).copied().unwrap_or("")))
            .collect();
        let last_end = plan.bookings.iter().map(|booking| booking.end).max().unwrap_or(input.now);
        // A deadline long after the last frame would leave most of the picture empty.
        let soon = last_end.saturating_add(last_end.saturating_sub(input.now) / 4);
        let deadlines = input.jobs.iter().filter_map(|job| job.deadline).filter(|&deadline| deadline <= soon);
        let until = deadlines.fold(last_end, i64::max).max(input.now.saturating_add(1));
        let jobs = input.jobs.iter().map(|job| {
            let deadline = job.deadline.filter(|&deadline| deadline <= until);
            (job.id, job.name.as_str(), deadline)
        });
        let rows = used.len().max(1);
        Chart {
            plan,
            nodes: used.into_iter().collect(),
            jobs: jobs.collect(),
            row: (ROW * FULL_ROWS as f64 / rows as f64).clamp(3.0, ROW),
            from: input.now,
            until,
        }
    }

    fn draw(&self, area: &Area<'_>) -> Drawn {
        let rows = self.nodes.len().max(1) as i32 * TENTHS;
        let named = if self.row >= LEAST_NAMED { self.nodes.len() } else { 0 };
        let middles = (0..named as i32).map(|row| row * TENTHS + TENTHS / 2).collect();
        let ticks = time_ticks(self.from, self.until);
        let mut chart = ChartBuilder::on(area)
            .margin_top(TOP)
            .margin_right(RIGHT)
            .x_label_area_size(BOTTOM)
            .y_label_area_size(LEFT)
            .build_cartesian_2d(
                (self.from..self.until).with_key_points(ticks),
                (rows..0).with_key_points(middles),
            )?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .bold_line_style(GREY.mix(0.7))
            .axis_style(GREY)
            .set_all_tick_mark_size(2)
            .label_style(("sans-serif", 11))
            .x_label_formatter(&|instant| clock(*instant))
            .y_label_formatter(&|row| {
                self.nodes.get((*row / TENTHS) as usize).map_or("", |node| node.1).to_owned()
            })
            .draw()?;
        // Bars are at least a pixel wide.
        let least = self.until.saturating_sub(self.from) / i64::from(WIDTH - LEFT - RIGHT);
        let bar = |node: u64, start: i64, end: i64, inset: i32, colour: ShapeStyle| {
            let row = self.nodes.binary_search_by_key(&node, |&(id, _)| id).ok()? as i32 * TENTHS;
            let end = end.max(start.saturating_add(least));
            Some(Rectangle::new([(start, row + inset), (end, row + TENTHS - inset)], colour))
        };
        let rentals = self.plan.rentals.iter();
        chart.draw_series(rentals.filter_map(|r| bar(r.node, r.start, r.end, 0, RENTED.filled())))?;
        let bookings = self.plan.bookings.iter();
        chart.draw_series(bookings.filter_map(|b| bar(b.node, b.start, b.end, 1, colour(b.job).filled())))?;
        for &(job, _, deadline) in &self.jobs {
            let line = deadline
                .map(|at| DashedPathElement::new([(at, 0), (at, rows)], 4, 3, colour(job).stroke_width(1)));
            chart.draw_series(line)?;
        }
        Ok(())
    }

    /// Draws the legend of the first `count` jobs, in columns.
    fn explain(&self, area: &Area<'_>, count: usize, columns: usize) -> Drawn {
        for (place, &(job, name, _)) in self.jobs.iter().take(count).enumerate() {
            let x = (LEFT + (place % columns) as u32 * ENTRY.0) as i32;
            let y = ((place / columns) as u32 * ENTRY.1) as i32;
            area.draw(&Rectangle::new([(x, y + 2), (x + 10, y + 12)], colour(job).filled()))?;
            let name: String = name.chars().take(28).collect();
            area.draw(&Text::new(name, (x + 15, y + 2), ("sans-serif", 11)))?;
        }
        Ok(())
    }
}

/// Hues by the golden angle, so that neighbouring jobs differ.
fn colour(job: u64) -> HSLColor {
    let hue = (job % 360) * 137 % 360;
    let saturation = 60 + job / 3 % 3 * 10;
    let lightness = 45 + job % 3 * 8;
    HSLColor(hue as f64 / 360.0, saturation as f64 / 100.0, lightness as f64 / 100.0)
}

#[cfg(test)]
mod tests {
    use super::gantt;
    use forelight_planner::{Frame, Input, Interval, Job, Node, WorkTotal, plan};

    #[test]
    fn a_plan_is_drawn_with_its_names_rentals_bars_and_deadlines() {
        let node = Node {
            id: 3,
            name: "desk".into(),
            speed: 1,
            price_per_hour: 1_000_000,
            calendar: vec![Interval { start: 0, end: None }],
            ..Node::default()
        };
        let frame = |number| Frame { number, work: 3600, work_p80: 3600, ..Frame::default() };
        let job = Job {
            name: "<a & b>".into(),
            deadline: Some(9_000_000_000),
            total: WorkTotal { p50: 7200, p80: 7200, p95: 7200 },
            frames: vec![frame(0), frame(1)],
            ..Job::default()
        };
        let input = Input { nodes: vec![node], jobs: vec![job], ..Input::default() };
        let svg = gantt(&input, &plan(&input).unwrap()).unwrap();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let texts: Vec<&str> = document.descendants().filter_map(|node| node.text()).map(str::trim).collect();
        assert!(texts.contains(&"desk") && texts.contains(&"<a & b>"), "{texts:?}");
        // The background, a rental, two frames, and the legend.
        assert_eq!(svg.matches("<rect").count(), 1 + 1 + 2 + 1, "{svg}");
        let nothing = Input { nodes: Vec::new(), jobs: Vec::new(), ..input };
        assert!(gantt(&nothing, &plan(&nothing).unwrap()).is_ok());
    }
}
