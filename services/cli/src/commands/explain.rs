//! `forelight forecast --explain`: why the frames are dear, in words and numbers.

use crate::quantities::count;
use crate::table::{Align, Table};
use forelight_protocol::{Explanation, ObjectShare};

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
            ("profiled", Align::Right),
            ("each stands for", Align::Right),
        ]);
        for object in explanation.objects.iter().take(SHOWN) {
            let ObjectShare { share, share_of_pixels, times_mean_pixel, samples, share_per_sample, .. } =
                object;
            table.row([
                object.name(),
                percent(*share),
                percent(*share_of_pixels),
                format!("{times_mean_pixel:.2} x the mean"),
                samples.to_string(),
                share_per_sample.map_or("-".into(), |share| format!("{:.2} %", 100.0 * share)),
            ]);
        }
        text += "\n";
        text += &table.render();
        if explanation.objects.len() > SHOWN {
            text += &format!("and {} others\n", explanation.objects.len() - SHOWN);
        }
    }
    text += "\n";
    for line in &explanation.words {
        text += &format!("{line}\n");
    }
    text
}
