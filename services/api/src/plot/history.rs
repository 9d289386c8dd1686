//! A job's estimate over time, as a picture.

use forelight_plots::{Area, Drawn, PlotError, svg};
use forelight_protocol::{ForecastHistory, HistoryPoint, JobState, Timestamp};
use plotters::prelude::*;

use super::chart::{CALIBRATED, Chart, FORMULAS, GREY, SIZE, legend};

/// Draws two charts. Left: the expected cost as frames finished, with the booked and the final cost. Right:
/// the expected end.
pub(crate) fn forecast_history(history: &ForecastHistory) -> Result<String, PlotError> {
    svg(SIZE, |area| {
        let (left, right) = area.split_horizontally(SIZE.0 as i32 * 55 / 100);
        cost(&left, history)?;
        finish(&right, history)
    })
}

fn level(
    chart: &mut Chart<'_, '_>,
    (from, to): (f64, f64),
    height: f64,
    style: ShapeStyle,
    name: String,
) -> Drawn {
    chart
        .draw_series([PathElement::new([(from, height), (to, height)], style)])?
        .label(name)
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
    Ok(())
}

fn cost(area: &Area<'_>, history: &ForecastHistory) -> Drawn {
    let ForecastHistory { points, now, frames_total, state, .. } = history;
    let frames = f64::from(*frames_total).max(1.0);
    // Finished pixels move the estimate while frames are running: points of the same number of frames.
    let at = |point: &HistoryPoint| f64::from(point.frames_done);
    let highest = points.iter().map(|point| point.cpu_seconds.p95).fold(now.booked.cpu_seconds, f64::max);
    let top = if highest > 0.0 { 1.08 * highest } else { 1.0 };
    let mut chart = ChartBuilder::on(area)
        .caption("What the job will have cost", ("sans-serif", 17))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..frames, 0.0..top)?;
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(GREY)
        .x_desc(format!("frames finished, of {frames_total}"))
        .y_desc("CPU seconds on a node of speed 1")
        .x_label_formatter(&|frames| format!("{frames:.0}"))
        .draw()?;
    let band = |low: fn(&HistoryPoint) -> f64, high: fn(&HistoryPoint) -> f64| -> Vec<(f64, f64)> {
        let up = points.iter().map(|point| (at(point), high(point)));
        up.chain(points.iter().rev().map(|point| (at(point), low(point)))).collect()
    };
    for (name, area, shade) in [
        ("P80 to P95", band(|point| point.cpu_seconds.p80, |point| point.cpu_seconds.p95), 0.14),
        ("P50 to P80", band(|point| point.cpu_seconds.p50, |point| point.cpu_seconds.p80), 0.30),
    ] {
        let style = CALIBRATED.mix(shade).filled();
        chart
            .draw_series([Polygon::new(area, style)])?
            .label(name)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 20, y + 5)], style));
    }
    let line = |of: fn(&HistoryPoint) -> f64| points.iter().map(move |point| (at(point), of(point)));
    for (name, points, style) in [
        ("P50", line(|point| point.cpu_seconds.p50), CALIBRATED.stroke_width(2)),
        ("finished so far", line(|point| point.cpu_spent), BLACK.mix(0.6).stroke_width(1)),
    ] {
        chart
            .draw_series(LineSeries::new(points, style))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
    }
    let confidence = now.booked.confidence.name().to_uppercase();
    let booked = format!("booked, at {confidence}");
    level(&mut chart, (0.0, frames), now.booked.cpu_seconds, FORMULAS.stroke_width(2), booked)?;
    if *state == JobState::Done {
        let truth = now.cpu_seconds.whole.p50;
        level(&mut chart, (0.0, frames), truth, BLACK.stroke_width(2), "the truth".to_owned())?;
    }
    legend(&mut chart, SeriesLabelPosition::LowerRight)?;
    Ok(())
}

fn finish(area: &Area<'_>, history: &ForecastHistory) -> Drawn {
    let ForecastHistory { points, now, .. } = history;
    let begin = points.first().map_or(now.at, |point| point.at);
    let minutes = |at: Timestamp| at.micros_since(begin) as f64 / 60e6;
    let booked = now.booked.finish.map(minutes);
    let ends: Vec<(f64, f64)> =
        points.iter().filter_map(|point| Some((minutes(point.at), minutes(point.finish?)))).collect();
    let latest = ends.iter().map(|&(_, end)| end).chain(booked).fold(minutes(now.at), f64::max).max(0.01);
    let earliest = ends.iter().map(|&(_, end)| end).chain(booked).fold(0.0, f64::min);
    let last = minutes(now.at).max(0.3 * latest);
    let mut chart = ChartBuilder::on(area)
        .caption("When it will be done", ("sans-serif", 17))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..last, earliest..1.08 * latest)?;
    let label = |value: &f64| if latest < 5.0 { format!("{value:.1}") } else { format!("{value:.0}") };
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(GREY)
        .x_desc(format!("minutes since the quote of {begin}"))
        .y_desc("expected end, minutes since the quote")
        .x_label_formatter(&label)
        .y_label_formatter(&label)
        .draw()?;
    chart
        .draw_series([PathElement::new([(0.0, 0.0), (last, last)], BLACK.mix(0.4))])?
        .label("now")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 20, y)], BLACK.mix(0.4)));
    if let Some(booked) = booked {
        level(&mut chart, (0.0, last), booked, FORMULAS.stroke_width(2), "booked".to_owned())?;
    }
    let style = CALIBRATED.stroke_width(2);
    let confidence = now.booked.confidence.name().to_uppercase();
    chart
        .draw_series(LineSeries::new(ends, style))?
        .label(format!("expected, at {confidence}"))
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
    legend(&mut chart, SeriesLabelPosition::LowerRight)?;
    Ok(())
}
