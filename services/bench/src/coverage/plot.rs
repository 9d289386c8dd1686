//! The reliability diagram: observed over nominal shares of truths below a quantile.

use super::rows::{Coverage, Level, Row};
use crate::share::Share;
use forelight_plots::{self as plots, Area, Drawn, PlotError};
use plotters::prelude::*;

const PANEL: (u32, u32) = (420, 440);
const FORMULAS: RGBColor = RGBColor(213, 94, 0);
const CALIBRATED: RGBColor = RGBColor(0, 114, 178);
const GREY: RGBColor = RGBColor(215, 215, 215);

/// One row of panels for each kind of shots, with a panel for each level.
pub fn svg(report: &Coverage) -> Result<String, PlotError> {
    let columns = Level::ALL.len();
    let lines = report.rows.len().div_ceil(columns).max(1);
    plots::svg((PANEL.0 * columns as u32, PANEL.1 * lines as u32), |root| {
        for (area, row) in root.split_evenly((lines, columns)).iter().zip(&report.rows) {
            panel(area, row)?;
        }
        Ok(())
    })
}

fn panel(area: &Area<'_>, row: &Row) -> Drawn {
    let mut chart = ChartBuilder::on(area)
        .caption(format!("{}: {}", row.shots, row.level.title()), ("sans-serif", 15))
        .margin(12)
        .x_label_area_size(36)
        .y_label_area_size(44)
        .build_cartesian_2d(0.0..1.0, 0.0..1.0)?;
    let percent = |share: &f64| format!("{:.0} %", share * 100.0);
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(GREY)
        .x_desc("promised")
        .y_desc("observed")
        .x_label_formatter(&percent)
        .y_label_formatter(&percent)
        .draw()?;
    chart.draw_series([PathElement::new([(0.0, 0.0), (1.0, 1.0)], BLACK.mix(0.5))])?;
    let formulas = match row.level {
        Level::Pixel => "by the profile of its own frame",
        Level::Stratum | Level::Frame | Level::Shot => "as the formulas make it",
    };
    for (name, colour, calibrated) in
        [(formulas, FORMULAS, false), ("calibrated on other shots", CALIBRATED, true)]
    {
        let points: Vec<(f64, Share)> = row
            .points
            .iter()
            .filter_map(|p| Some((p.nominal, if calibrated { p.calibrated? } else { p.formulas })))
            .collect();
        if points.is_empty() {
            continue;
        }
        let style = colour.stroke_width(2);
        chart
            .draw_series([PathElement::new(
                points.iter().map(|(nominal, share)| (*nominal, share.share)).collect::<Vec<_>>(),
                style,
            )])?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
        chart.draw_series(points.iter().map(|(nominal, share)| {
            PathElement::new([(*nominal, share.low), (*nominal, share.high)], colour.mix(0.6))
        }))?;
        chart.draw_series(
            points.iter().map(|(nominal, share)| Circle::new((*nominal, share.share), 3, colour.filled())),
        )?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.85))
        .border_style(GREY)
        .label_font(("sans-serif", 12))
        .draw()?;
    Ok(())
}
