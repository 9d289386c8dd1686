//! What the pictures share: size, colours, legends.

use forelight_plots::Drawn;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

pub(super) const SIZE: (u32, u32) = (1120, 470);
pub(super) const CALIBRATED: RGBColor = RGBColor(0, 114, 178);
pub(super) const FORMULAS: RGBColor = RGBColor(213, 94, 0);
pub(super) const GREY: RGBColor = RGBColor(215, 215, 215);

pub(super) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

pub(super) fn legend<'a, 'b: 'a>(chart: &mut Chart<'a, 'b>, position: SeriesLabelPosition) -> Drawn {
    let mut labels = chart.configure_series_labels();
    labels.position(position).background_style(WHITE.mix(0.85)).border_style(GREY);
    Ok(labels.label_font(("sans-serif", 12)).draw()?)
}
