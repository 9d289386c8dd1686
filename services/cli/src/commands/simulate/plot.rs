//! A simulation as a plot: utilisation over time, and cost against jobs in time.

use forelight_plots::{self as plots, Area, Drawn, PlotError};
use forelight_simulator::{PolicyKind, Report};
use plotters::prelude::*;

const WIDTH: u32 = 1100;
const HEIGHT: u32 = 340;
const GREY: RGBColor = RGBColor(90, 90, 90);

fn colour(policy: PolicyKind) -> RGBColor {
    match policy {
        PolicyKind::Planned => RGBColor(31, 95, 168),
        PolicyKind::Deadline => RGBColor(190, 60, 40),
        PolicyKind::ThreeFrames => RGBColor(200, 140, 30),
        PolicyKind::FairShare => RGBColor(130, 80, 160),
        PolicyKind::Fifo => RGBColor(40, 130, 70),
    }
}

/// Two plots for each world, one below the other.
pub fn svg(worlds: &[(&str, &[Report])]) -> Result<String, PlotError> {
    let size = (WIDTH, HEIGHT * 2 * worlds.len().max(1) as u32);
    plots::svg(size, |area| draw(area, worlds))
}

fn draw(area: &Area<'_>, worlds: &[(&str, &[Report])]) -> Drawn {
    let parts = area.split_evenly((worlds.len().max(1), 1));
    for ((name, reports), part) in worlds.iter().zip(parts) {
        let halves = part.split_evenly((2, 1));
        utilisation(&halves[0], name, reports)?;
        cost(&halves[1], reports)?;
    }
    Ok(())
}

/// Utilisation of each policy, with its largest pool only, since the pools of one policy look alike here.
fn utilisation(area: &Area<'_>, name: &str, reports: &[Report]) -> Drawn {
    let shown: Vec<&Report> = PolicyKind::ALL
        .into_iter()
        .filter_map(|kind| reports.iter().filter(|r| r.policy == kind).max_by_key(|r| r.pool))
        .collect();
    let days = shown.iter().map(|report| report.makespan_hours).fold(1.0, f64::max) / 24.0;
    let mut chart = ChartBuilder::on(area)
        .caption(format!("Share of the open nodes at work: {name}"), ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(36)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..days, 0.0..1.0)?;
    chart
        .configure_mesh()
        .x_desc("days")
        .y_label_formatter(&|share: &f64| format!("{:.0} %", share * 100.0))
        .light_line_style(TRANSPARENT)
        .bold_line_style(GREY.mix(0.18))
        .axis_style(GREY)
        .draw()?;
    for report in shown {
        let style =
            colour(report.policy).stroke_width(if report.policy == PolicyKind::Planned { 2 } else { 1 });
        let line = report.curve.iter().map(|&(hours, share)| (hours / 24.0, share));
        chart
            .draw_series(LineSeries::new(line, style))?
            .label(report.policy.name())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.9))
        .border_style(GREY.mix(0.5))
        .draw()?;
    Ok(())
}

fn cost(area: &Area<'_>, reports: &[Report]) -> Drawn {
    let most =
        reports.iter().map(Report::over_bound).filter(|value| value.is_finite()).fold(1.2, f64::max) * 1.1;
    let least = reports.iter().map(Report::on_time).fold(1.0, f64::min);
    let low = (least - 0.05).max(0.0);
    let mut chart = ChartBuilder::on(area)
        .caption("Jobs in time, against cost over what nobody can cost less than", ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..most, low..1.0 + (1.0 - low) * 0.06)?;
    chart
        .configure_mesh()
        .x_desc("cost over bound")
        .y_label_formatter(&|share: &f64| format!("{:.1} %", share * 100.0))
        .light_line_style(TRANSPARENT)
        .bold_line_style(GREY.mix(0.18))
        .axis_style(GREY)
        .draw()?;
    let bound = [(1.0, low), (1.0, 1.0)];
    chart.draw_series([PathElement::new(bound, GREY.mix(0.6))])?;
    for kind in PolicyKind::ALL {
        let own: Vec<&Report> = reports.iter().filter(|report| report.policy == kind).collect();
        if own.is_empty() {
            continue;
        }
        let fill = colour(kind).filled();
        chart
            .draw_series(
                own.iter().map(|report| Circle::new((report.over_bound(), report.on_time()), 5, fill)),
            )?
            .label(kind.name())
            .legend(move |(x, y)| Circle::new((x + 11, y), 5, fill));
        // A policy that was tried with several pools has their shares beside its points.
        if own.len() > 1 {
            let font = ("sans-serif", 12).into_font().color(&colour(kind));
            chart.draw_series(own.iter().map(|report| {
                Text::new(format!("{} %", report.pool), (report.over_bound(), report.on_time()), font.clone())
            }))?;
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE.mix(0.9))
        .border_style(GREY.mix(0.5))
        .draw()?;
    Ok(())
}
