//! A job's price against its deadline.

use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::{Area, Drawn, PlotError, clock, svg, time_ticks};

/// Width and height, pixels.
const SIZE: (u32, u32) = (1200, 460);
const LINE: RGBColor = RGBColor(31, 95, 168);
const GREY: RGBColor = RGBColor(120, 120, 120);

/// A deadline and the price of meeting it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offer {
    /// Microseconds UTC.
    pub deadline: i64,
    /// Cost of the cheapest plan found, micro-units.
    pub cost: i64,
    /// Lower bound of the cost, micro-units.
    pub cost_bound: i64,
}

/// Draws the cost of a job over its deadline, with the lower bound dashed.
///
/// Offers are in the order of their deadlines. `money` writes an amount in micro-units. Without offers, the
/// picture is empty.
///
/// # Errors
/// If drawing fails.
pub fn price_curve(offers: &[Offer], money: impl Fn(i64) -> String) -> Result<String, PlotError> {
    svg(SIZE, |area| match (offers.first(), offers.last()) {
        (Some(first), Some(last)) => draw(area, offers, [first, last], &money),
        _ => Ok(()),
    })
}

fn draw(area: &Area<'_>, offers: &[Offer], ends: [&Offer; 2], money: &dyn Fn(i64) -> String) -> Drawn {
    let from = ends[0].deadline;
    let until = ends[1].deadline.max(from.saturating_add(1));
    let most = offers.iter().map(|offer| offer.cost).max().unwrap_or(0).max(1);
    let mut chart =
        ChartBuilder::on(area).margin(20).x_label_area_size(40).y_label_area_size(110).build_cartesian_2d(
            (from..until).with_key_points(time_ticks(from, until)),
            0.0..most as f64 * 1.08,
        )?;
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(GREY.mix(0.25))
        .axis_style(GREY)
        .x_desc("deadline (UTC)")
        .x_label_formatter(&|instant| clock(*instant))
        .y_label_formatter(&|cost| money(cost.round() as i64))
        .draw()?;
    let style = LINE.stroke_width(2);
    let line = |cost: fn(&Offer) -> i64| offers.iter().map(move |offer| (offer.deadline, cost(offer) as f64));
    let example = |(x, y)| [(x, y), (x + 20, y)];
    chart
        .draw_series(LineSeries::new(line(|offer| offer.cost), style))?
        .label("price")
        .legend(move |at| PathElement::new(example(at), style));
    chart
        .draw_series(DashedLineSeries::new(line(|offer| offer.cost_bound), 5, 4, style))?
        .label("at least")
        .legend(move |at| DashedPathElement::new(example(at), 5, 4, style));
    // The first price is right of its point, the last left of it.
    for (offer, side) in ends.into_iter().zip([HPos::Left, HPos::Right]) {
        let font = ("sans-serif", 13).into_font().color(&BLACK).pos(Pos::new(side, VPos::Bottom));
        let place = (offer.deadline, offer.cost as f64);
        chart.draw_series([EmptyElement::at(place) + Text::new(money(offer.cost), (0, -6), font)])?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(GREY.mix(0.5))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{Offer, price_curve};

    #[test]
    fn a_curve_shows_the_prices_of_its_ends_and_without_offers_nothing() {
        let offer = |hours: i64, cost| Offer { deadline: hours * 3_600_000_000, cost, cost_bound: cost / 2 };
        let curve = price_curve(&[offer(1, 50), offer(5, 20), offer(9, 7)], |cost| format!("<{cost} µ>"));
        let curve = curve.expect("a picture");
        let document = roxmltree::Document::parse(&curve).expect("XML");
        let texts: Vec<&str> = document.descendants().filter_map(|node| node.text()).map(str::trim).collect();
        for text in ["<50 µ>", "<7 µ>", "price", "at least"] {
            assert!(texts.contains(&text), "{text} is missing: {texts:?}");
        }
        let nothing = price_curve(&[], |cost| cost.to_string()).expect("a picture");
        assert!(roxmltree::Document::parse(&nothing).is_ok() && !nothing.contains("polyline"));
        let point = price_curve(&[offer(1, 0)], |cost| cost.to_string()).expect("a picture");
        assert!(roxmltree::Document::parse(&point).is_ok());
    }
}
