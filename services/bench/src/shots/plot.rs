//! Plots cost by frame: the forecast with its band, the truth, and current practice.

use super::measured::{Frame, Measured};
use super::practice::Practice;
use forelight_plots::{self as plots, Area, Drawn, PlotError};
use forelight_protocol::Quantiles;
use forelight_terminal::quantities::count;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

const SIZE: (u32, u32) = (980, 460);
const BAND: RGBColor = RGBColor(0, 114, 178);
const FORECAST: RGBColor = RGBColor(0, 114, 178);
const TRUTH: RGBColor = RGBColor(0, 0, 0);
const THEIRS: RGBColor = RGBColor(213, 94, 0);
const GREY: RGBColor = RGBColor(215, 215, 215);

/// The plot of the first quote as SVG.
pub fn svg(shot: &Measured) -> Result<String, PlotError> {
    plots::svg(SIZE, |area| draw(area, shot))
}

/// Bounds of a central interval, from its upper quantile. Uncalibrated quantiles are symmetric about the mean
/// by factor.
fn band(work: &Quantiles, above: f64) -> [f64; 2] {
    [if above > 0.0 { work.mean * work.mean / above } else { 0.0 }, above]
}

fn draw(area: &Area<'_>, shot: &Measured) -> Drawn {
    let highest = shot.frames.iter().flat_map(|f| [f.work.actual, f.work.forecast.p95]).fold(0.0, f64::max);
    let lowest = shot.frames.iter().flat_map(|f| {
        let work = &f.work.forecast;
        [f.work.actual, band(work, work.p95)[0]]
    });
    let lowest = lowest.fold(highest, f64::min);
    let (first, last) =
        (shot.frames.first().map_or(0, |f| f.frame), shot.frames.last().map_or(0, |f| f.frame));
    let margin = ((highest - lowest) * 0.15).max(highest * 0.02).max(1.0);
    let mut chart = ChartBuilder::on(area)
        .caption(
            format!(
                "{}: {} frames of {} x {}, forecast from {}",
                shot.bundle,
                shot.frames.len(),
                shot.width,
                shot.height,
                shot.frames.iter().filter(|frame| frame.profiled).count()
            ),
            ("sans-serif", 17),
        )
        .margin(12)
        .x_label_area_size(38)
        .y_label_area_size(72)
        .build_cartesian_2d(
            f64::from(first) - 0.5..f64::from(last) + 0.5,
            (lowest - margin).max(0.0)..highest + 2.0 * margin,
        )?;
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(GREY)
        .x_desc("frame")
        .y_desc("work")
        .x_label_formatter(&|frame| format!("{frame:.0}"))
        .y_label_formatter(&|work| count(*work))
        .draw()?;
    draw_bands(&mut chart, shot)?;
    draw_curves(&mut chart, shot)?;
    let profiled = shot.frames.iter().filter(|frame| frame.profiled);
    chart
        .draw_series(
            profiled.map(|f| Circle::new((f64::from(f.frame), f.work.forecast.mean), 5, FORECAST.filled())),
        )?
        .label("profiled")
        .legend(|(x, y)| Circle::new((x + 11, y), 5, FORECAST.filled()));
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(GREY)
        .label_font(("sans-serif", 12))
        .draw()?;
    Ok(())
}

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Draws the central intervals of the frames.
fn draw_bands(chart: &mut Chart<'_, '_>, shot: &Measured) -> Drawn {
    for (name, of, opacity) in [
        ("P5 to P95", (|q: &Quantiles| q.p95) as fn(&Quantiles) -> f64, 0.15),
        ("P20 to P80", |q: &Quantiles| q.p80, 0.25),
    ] {
        let side = |edge: usize| {
            move |frame: &Frame| {
                let work = &frame.work.forecast;
                (f64::from(frame.frame), band(work, of(work))[edge])
            }
        };
        let mut outline: Vec<(f64, f64)> = shot.frames.iter().map(side(1)).collect();
        outline.extend(shot.frames.iter().rev().map(side(0)));
        let style = BAND.mix(opacity).filled();
        chart
            .draw_series([Polygon::new(outline, style)])?
            .label(name)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 22, y + 5)], style));
    }
    Ok(())
}

/// Draws the forecast, the truth, and lines between three frames.
fn draw_curves(chart: &mut Chart<'_, '_>, shot: &Measured) -> Drawn {
    let actual: Vec<f64> = shot.frames.iter().map(|frame| frame.work.actual).collect();
    let theirs = Practice::FirstMiddleLastLines.forecast(&actual);
    let line = |values: Vec<f64>| {
        shot.frames.iter().zip(values).map(|(frame, value)| (f64::from(frame.frame), value)).collect()
    };
    type Line = Vec<(f64, f64)>;
    let curves: [(&str, Line, RGBColor, u32); 3] = [
        ("lines between first, middle and last", line(theirs), THEIRS, 1),
        ("forecast", line(shot.frames.iter().map(|f| f.work.forecast.mean).collect()), FORECAST, 2),
        ("full render", line(actual), TRUTH, 2),
    ];
    for (name, points, colour, width) in curves {
        let style = colour.stroke_width(width);
        chart
            .draw_series([PathElement::new(points, style)])?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], style));
    }
    Ok(())
}
