//! Plots the error against the number of profiled pixels, both logarithmic.

use super::study::{Curve, CurvePoint};
use forelight_forecast::Strategy;
use forelight_plots::{self as plots, Area, Drawn, PlotError};
use forelight_terminal::quantities::seconds;
use plotters::prelude::*;

const PANEL: (u32, u32) = (520, 460);

const COLUMNS: usize = 2;

/// Draws the panels from their titles and curves.
pub fn draw(panels: &[(&str, Vec<&Curve>)]) -> Result<String, PlotError> {
    let rows = panels.len().div_ceil(COLUMNS).max(1);
    plots::svg((PANEL.0 * COLUMNS as u32, PANEL.1 * rows as u32), |root| {
        for (area, (title, curves)) in root.split_evenly((rows, COLUMNS)).iter().zip(panels) {
            panel(area, title, curves)?;
        }
        Ok(())
    })
}

fn panel(area: &Area<'_>, title: &str, curves: &[&Curve]) -> Drawn {
    let points = || curves.iter().flat_map(|curve| curve.points());
    let range = |values: &mut dyn Iterator<Item = f64>| {
        values.filter(|v| *v > 0.0).fold((f64::INFINITY, 0.0f64), |(low, high), v| (low.min(v), high.max(v)))
    };
    let (fewest, most) = range(&mut points().map(|point| point.0));
    let (least, greatest) = range(&mut points().map(|point| point.1));
    if fewest > most || least > greatest {
        // All errors are zero and have no logarithm.
        area.titled(&format!("{title}: no errors"), ("sans-serif", 15))?;
        return Ok(());
    }
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 15))
        .margin(12)
        .x_label_area_size(38)
        .y_label_area_size(52)
        .build_cartesian_2d(
            (fewest * 0.9..most * 1.6).log_scale(),
            (least * 70.0..greatest * 140.0).log_scale(),
        )?;
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(RGBColor(215, 215, 215))
        .x_desc("profiled pixels")
        .y_desc("root mean square error of work, %")
        .x_label_formatter(&|samples| format!("{samples:.0}"))
        .y_label_formatter(&|percent| format!("{percent}"))
        .draw()?;
    // Error of a simple random sample.
    let random = curves.iter().find(|curve| curve.strategy == Strategy::Random);
    if let Some((samples, error)) = random.and_then(|curve| curve.points().next()) {
        let root = [fewest, most].map(|n| (n, 100.0 * error * (samples / n).sqrt()));
        chart.draw_series(LineSeries::new(root, RGBColor(190, 190, 190).stroke_width(1)))?;
    }
    for curve in curves {
        let (colour, width) = style(curve.strategy);
        let line = || curve.points().filter(|point| point.1 > 0.0).map(|(n, error)| (n, 100.0 * error));
        let stroke = colour.stroke_width(width);
        chart
            .draw_series(LineSeries::new(line(), stroke))?
            .label(curve.strategy.title())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], stroke));
        chart.draw_series(line().map(|point| Circle::new(point, 1 + width, colour.filled())))?;
        if curve.strategy == Strategy::Snapshot {
            // Profiling time of our strategy.
            let font = ("sans-serif", 11).into_font().color(&colour);
            let label = |point: &CurvePoint| {
                let at = (point.pixels as f64, 100.0 * point.error.root_mean_square);
                EmptyElement::at(at) + Text::new(short(point.cpu_seconds), (4, -14), font.clone())
            };
            let seen = curve.points.iter().filter(|point| point.error.root_mean_square > 0.0);
            chart.draw_series(seen.map(label))?;
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .background_style(WHITE.mix(0.85))
        .border_style(RGBColor(215, 215, 215))
        .label_font(("sans-serif", 12))
        .draw()?;
    Ok(())
}

/// A short form of a time. Most are far below a second.
fn short(time: f64) -> String {
    if time < 1.0 { format!("{:.1} ms", time * 1e3) } else { seconds(time) }
}

/// Colour and width of a strategy's line: thin for blind ones, thickest for ours. The colours suit
/// colour-blind readers (Okabe, Ito 2008).
fn style(strategy: Strategy) -> (RGBColor, u32) {
    match strategy {
        Strategy::RegularGrid => (RGBColor(86, 180, 233), 1),
        Strategy::Jittered => (RGBColor(0, 114, 178), 1),
        Strategy::Halton => (RGBColor(0, 158, 115), 1),
        Strategy::Hammersley => (RGBColor(204, 121, 167), 1),
        Strategy::Random => (RGBColor(120, 120, 120), 1),
        Strategy::RandomArea => (RGBColor(230, 159, 0), 1),
        Strategy::PaperSnapshot => (RGBColor(0, 0, 0), 2),
        Strategy::Systematic => (RGBColor(140, 60, 160), 2),
        _ => (RGBColor(213, 94, 0), 3),
    }
}
