//! `forelight forecast --explain`: why the frames are dear, in words and numbers.

use crate::quantities::count;
use crate::table::{Align, Table};
use forelight_protocol::{Explanation, Halving, ObjectShare};

/// So many objects are shown; the JSON has all.
const SHOWN: usize = 10;

/// The explanation for people.
pub fn text(explanation: &Explanation) -> String {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let mut text = String::from("\nWhy it costs that\n\n");
    for part in &explanation.parts {
        text += &format!("{:>8}  {} ({} operations)\n", percent(part.share), part.part, count(part.work));
    }
    if !explanation.objects.is_empty() {
        let mut table = Table::new(&[
            ("pixels that show", Align::Left),
            ("share of the work", Align::Right),
            ("share of the pixels' number", Align::Right),
            ("a pixel costs", Align::Right),
        ]);
        for object in explanation.objects.iter().take(SHOWN) {
            let ObjectShare { shows, share, share_of_pixels, times_mean_pixel, .. } = object;
            let name =
                shows.as_ref().map_or("nothing".into(), |name| format!("{}, {}", name.object, name.material));
            table.row([
                name,
                percent(*share),
                percent(*share_of_pixels),
                format!("{times_mean_pixel:.2} x the mean"),
            ]);
        }
        text += "\n";
        text += &table.render();
        if explanation.objects.len() > SHOWN {
            text += &format!("and {} others\n", explanation.objects.len() - SHOWN);
        }
    }
    if !explanation.rays.is_empty() {
        let rays = explanation.rays.iter().map(|ray| format!("{} {}", ray.category, percent(ray.share)));
        text += &format!("\nrays: {}\n", rays.collect::<Vec<_>>().join(", "));
    }
    text += &halving(&explanation.halving);
    text
}

fn halving(ways: &[Halving]) -> String {
    let way = |way: &Halving| match way.setting.as_str() {
        "spp" => format!("{} camera samples per pixel in place of {}", way.to, way.from),
        setting => format!("--{setting} {} in place of {}", way.to, way.from),
    };
    match ways {
        [] => "half of it: no single setting does that\n".into(),
        ways => format!("half of it: {}\n", ways.iter().map(way).collect::<Vec<_>>().join("; or ")),
    }
}
