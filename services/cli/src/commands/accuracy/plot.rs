//! The ladders as a plot: error over CPU time, both logarithmic.

use super::value;
use forelight_plots::{self as plots, Area, Drawn, PlotError};
use forelight_protocol::{AccuracyDoc, AccuracyRung, ImageError, LadderKind};
use forelight_quote::points;
use forelight_terminal::quantities::seconds;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

const SIZE: (u32, u32) = (1100, 720);
/// Margin around the data, as a factor on both axes.
const MARGIN: f64 = 1.35;
const FRONT: RGBColor = RGBColor(235, 200, 90);
const GREY: RGBColor = RGBColor(90, 90, 90);

struct Look {
    kind: LadderKind,
    colour: RGBColor,
    legend: &'static str,
}

/// Resolutions cannot be compared with the others, so they are not drawn.
const LOOKS: [Look; 5] = [
    Look { kind: LadderKind::Ambient, colour: RGBColor(31, 95, 168), legend: "ambient, by camera samples" },
    Look { kind: LadderKind::Path, colour: RGBColor(190, 60, 40), legend: "path, by camera samples" },
    Look {
        kind: LadderKind::CachedSamples,
        colour: RGBColor(20, 150, 160),
        legend: "with a cache, by camera samples",
    },
    Look { kind: LadderKind::Cache, colour: RGBColor(40, 130, 70), legend: "irradiance cache, by its error" },
    Look { kind: LadderKind::Divisions, colour: RGBColor(130, 80, 160), legend: "gathers, by their rays" },
];

/// A rung in the plot. The axes are in powers of ten.
struct Mark<'a> {
    index: usize,
    rung: &'a AccuracyRung,
    at: (f64, f64),
    error: ImageError,
}

pub fn svg(title: &str, document: &AccuracyDoc) -> Result<String, PlotError> {
    plots::svg(SIZE, |area| draw(area, title, document))
}

fn draw(area: &Area<'_>, title: &str, document: &AccuracyDoc) -> Drawn {
    let marks = marks(document);
    let (x, y) = bounds(&marks);
    let settings = &document.settings;
    let caption = format!("What accuracy costs in time: {title}, {} x {}", settings.width, settings.height);
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 20))
        .margin(16)
        .x_label_area_size(52)
        .y_label_area_size(78)
        .build_cartesian_2d(x.clone(), y.clone())?;
    // The axes hold logarithms, so the labels at 1, 2 and 5 times powers of ten are drawn separately.
    grid(&mut chart, area, &x, &y)?;
    front(&mut chart, document, &marks)?;
    for look in &LOOKS {
        ladder(&mut chart, look, &marks)?;
    }
    measured(&mut chart, &marks)?;
    labels(&chart, area, document, &marks)?;
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.9))
        .border_style(GREY.mix(0.5))
        .label_font(("sans-serif", 14))
        .draw()?;
    Ok(())
}

/// The rungs with positive time and error, which logarithmic axes can show.
fn marks(document: &AccuracyDoc) -> Vec<Mark<'_>> {
    let points = points(document);
    let placed = document.rungs.iter().enumerate().filter_map(|(index, rung)| {
        let (cost, error) = points[index].filter(|&(cost, error)| cost > 0.0 && error > 0.0)?;
        Some(Mark { index, rung, at: (cost.log10(), error.log10()), error: rung.delivered_error()? })
    });
    placed.collect()
}

fn bounds(marks: &[Mark<'_>]) -> (std::ops::Range<f64>, std::ops::Range<f64>) {
    let truth = |mark: &Mark<'_>| mark.rung.measured.map(|measured| measured.delivered());
    let costs = marks.iter().flat_map(|mark| {
        let cpu = mark.rung.cpu_seconds;
        [Some(cpu.p50), Some(cpu.p95), truth(mark).map(|truth| truth.0)]
    });
    let errors =
        marks.iter().flat_map(|mark| [Some(mark.error.p05), Some(mark.error.p95), truth(mark).map(|t| t.1)]);
    let range = |values: &mut dyn Iterator<Item = f64>| {
        let logs = values.filter(|value| *value > 0.0 && value.is_finite()).map(f64::log10);
        let (low, high) = logs.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let margin = MARGIN.log10();
        // Without rungs, the axes have a default range.
        if low <= high { low - margin..high + margin } else { -1.0..1.0 }
    };
    (range(&mut costs.flatten()), range(&mut errors.flatten()))
}

fn grid(
    chart: &mut Chart<'_, '_>,
    area: &Area<'_>,
    x: &std::ops::Range<f64>,
    y: &std::ops::Range<f64>,
) -> Drawn {
    chart.configure_mesh().disable_mesh().x_labels(0).y_labels(0).axis_style(GREY).draw()?;
    let font = ("sans-serif", 14).into_font().color(&GREY);
    let (left, bottom) =
        (chart.plotting_area().get_pixel_range().0.start, chart.plotting_area().get_pixel_range().1.end);
    for tick in ticks(x) {
        let line = [(tick.log10(), y.start), (tick.log10(), y.end)];
        chart.draw_series([PathElement::new(line, GREY.mix(0.18))])?;
        let (pixel, _) = chart.backend_coord(&(tick.log10(), y.start));
        let style = font.clone().pos(Pos::new(HPos::Center, VPos::Top));
        area.draw(&Text::new(time(tick), (pixel, bottom + 7), style))?;
    }
    for tick in ticks(y) {
        let line = [(x.start, tick.log10()), (x.end, tick.log10())];
        chart.draw_series([PathElement::new(line, GREY.mix(0.18))])?;
        let (_, pixel) = chart.backend_coord(&(x.start, tick.log10()));
        let style = font.clone().pos(Pos::new(HPos::Right, VPos::Center));
        area.draw(&Text::new(percentage(tick), (left - 8, pixel), style))?;
    }
    let (width, height) = (SIZE.0 as i32, SIZE.1 as i32);
    let name = ("sans-serif", 15).into_font();
    let centred = name.clone().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Bottom));
    area.draw(&Text::new("CPU time of the frame, all threads", ((left + width) / 2, height - 12), centred))?;
    let turned =
        name.transform(FontTransform::Rotate270).color(&BLACK).pos(Pos::new(HPos::Center, VPos::Top));
    area.draw(&Text::new("error of the image (RMSE over its mean)", (14, bottom / 2 + 16), turned))?;
    Ok(())
}

/// 1, 2 and 5 times powers of ten within a range of logarithms. A wide range has powers of ten only.
fn ticks(range: &std::ops::Range<f64>) -> Vec<f64> {
    let steps: &[f64] = if range.end - range.start > 4.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let decades = range.start.floor() as i32..=range.end.ceil() as i32;
    let all = decades.flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)));
    all.filter(|tick| range.contains(&tick.log10())).collect()
}

fn time(value: f64) -> String {
    if value < 1.0 { format!("{} ms", (value * 1e3 * 1e3).round() / 1e3) } else { seconds_short(value) }
}

fn seconds_short(value: f64) -> String {
    if value < 100.0 { format!("{value} s") } else { seconds(value) }
}

fn percentage(value: f64) -> String {
    format!("{} %", (value * 100.0 * 1e6).round() / 1e6)
}

/// Draws the Pareto front as a broad line behind the data.
fn front(chart: &mut Chart<'_, '_>, document: &AccuracyDoc, marks: &[Mark<'_>]) -> Drawn {
    let mut line: Vec<(f64, f64)> =
        marks.iter().filter(|mark| document.rungs[mark.index].worth_taking).map(|mark| mark.at).collect();
    line.sort_by(|a, b| a.0.total_cmp(&b.0));
    let style = FRONT.mix(0.55).stroke_width(12);
    chart
        .draw_series([PathElement::new(line, style)])?
        .label("worth taking: no rung is cheaper and better")
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], style));
    Ok(())
}

fn ladder(chart: &mut Chart<'_, '_>, look: &Look, marks: &[Mark<'_>]) -> Drawn {
    let own: Vec<&Mark<'_>> = marks.iter().filter(|mark| mark.rung.ladder == look.kind).collect();
    if own.is_empty() {
        return Ok(());
    }
    let colour = look.colour;
    let thin = colour.mix(0.45).stroke_width(1);
    for mark in &own {
        let (x, y) = mark.at;
        let low = if mark.error.p05 > 0.0 { mark.error.p05.log10() } else { y };
        chart.draw_series([
            PathElement::new([(x, low), (x, mark.error.p95.log10())], thin),
            PathElement::new([(x, y), (mark.rung.cpu_seconds.p95.log10(), y)], thin),
        ])?;
    }
    chart
        .draw_series([PathElement::new(
            own.iter().map(|mark| mark.at).collect::<Vec<_>>(),
            colour.stroke_width(2),
        )])?
        .label(look.legend)
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], colour.stroke_width(2)));
    chart.draw_series(own.iter().map(|mark| Circle::new(mark.at, 4, colour.filled())))?;
    let asked = own.iter().filter(|mark| mark.rung.asked_for);
    chart.draw_series(asked.map(|mark| Circle::new(mark.at, 8, colour.stroke_width(2))))?;
    Ok(())
}

/// Positions of a label: pixels right and down of its point, and the label's side that is there.
const PLACES: [(i32, i32, HPos, VPos); 8] = [
    (8, -6, HPos::Left, VPos::Bottom),
    (-8, 6, HPos::Right, VPos::Top),
    (-8, -6, HPos::Right, VPos::Bottom),
    (8, 6, HPos::Left, VPos::Top),
    (0, -14, HPos::Center, VPos::Bottom),
    (0, 14, HPos::Center, VPos::Top),
    (0, -30, HPos::Center, VPos::Bottom),
    (0, 30, HPos::Center, VPos::Top),
];

/// Height of a label and mean width of a letter, pixels.
const LABEL: (i32, i32) = (14, 7);

/// Left, top, right and bottom of an occupied rectangle, pixels.
type Space = (i32, i32, i32, i32);

/// Draws the names of the rungs. A name is left out if it has no free position.
fn labels(chart: &Chart<'_, '_>, area: &Area<'_>, document: &AccuracyDoc, marks: &[Mark<'_>]) -> Drawn {
    let meets = |a: &Space, b: &Space| a.0 < b.2 && b.0 < a.2 && a.1 < b.3 && b.1 < a.3;
    let point = |mark: &Mark<'_>| chart.backend_coord(&mark.at);
    let mut taken: Vec<Space> = marks.iter().map(point).map(|(x, y)| (x - 4, y - 4, x + 4, y + 4)).collect();
    let mut named: Vec<(i32, i32)> = Vec::new();
    for mark in marks {
        let Some(look) = LOOKS.iter().find(|look| look.kind == mark.rung.ladder) else { continue };
        let (x, y) = point(mark);
        // A quality that is on two ladders gets one name.
        if named.contains(&(x, y)) {
            continue;
        }
        let text = value(document, mark.index);
        let (height, width) = (LABEL.0, LABEL.1 * text.chars().count() as i32);
        let free = PLACES.iter().find_map(|(right, down, horizontal, vertical)| {
            let left = match horizontal {
                HPos::Left => x + right,
                HPos::Center => x + right - width / 2,
                HPos::Right => x + right - width,
            };
            let top = match vertical {
                VPos::Top => y + down,
                VPos::Center => y + down - height / 2,
                VPos::Bottom => y + down - height,
            };
            let space = (left, top, left + width, top + height);
            let inside = left >= 0 && space.2 <= SIZE.0 as i32 && top >= 0;
            (inside && !taken.iter().any(|other| meets(&space, other)))
                .then_some((space, right, down, horizontal, vertical))
        });
        let Some((space, right, down, horizontal, vertical)) = free else { continue };
        taken.push(space);
        named.push((x, y));
        let style = ("sans-serif", 13).into_font().color(&look.colour).pos(Pos::new(*horizontal, *vertical));
        area.draw(&Text::new(text, (x + right, y + down), style))?;
    }
    Ok(())
}

/// Draws measured rungs, each joined with its forecast.
fn measured(chart: &mut Chart<'_, '_>, marks: &[Mark<'_>]) -> Drawn {
    let truths: Vec<((f64, f64), (f64, f64))> = marks
        .iter()
        .filter_map(|mark| {
            let (cpu_seconds, error) = mark.rung.measured?.delivered();
            (error > 0.0 && cpu_seconds > 0.0).then(|| (mark.at, (cpu_seconds.log10(), error.log10())))
        })
        .collect();
    if truths.is_empty() {
        return Ok(());
    }
    chart.draw_series(truths.iter().map(|&(said, is)| PathElement::new([said, is], BLACK.mix(0.4))))?;
    chart
        .draw_series(truths.iter().map(|&(_, is)| Cross::new(is, 5, BLACK.stroke_width(2))))?
        .label("measured")
        .legend(|(x, y)| Cross::new((x + 11, y), 5, BLACK.stroke_width(2)));
    Ok(())
}
