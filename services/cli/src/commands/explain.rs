//! `forelight forecast --explain`: the reasons for the cost of the frames.

use forelight_protocol::{Explanation, ForecastDoc, ObjectShare, RayShare};
use forelight_terminal::quantities::{count, seconds};
use forelight_terminal::table::{Align, Table};

/// Number of objects in the table. The JSON has all objects with at least 1 % of the pixels' work.
const SHOWN: usize = 10;

/// The meaning of the work for a ray, below tables of it.
pub const WORK_FOR_RAYS: &str =
    "the work for a ray is its traversal and the shading of its hit; all rays of a gather count as ambient\n";

/// A quote with its reasons, as JSON.
#[derive(serde::Serialize)]
pub struct Explained<'a> {
    #[serde(flatten)]
    pub quote: &'a ForecastDoc,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub explanation: Option<&'a Explanation>,
}

fn rays(rays: &[RayShare], percent: impl Fn(f64) -> String) -> String {
    let mut table = Table::new(&[
        ("rays", Align::Left),
        ("count", Align::Right),
        ("work for them", Align::Right),
        ("share of the work", Align::Right),
    ]);
    for RayShare { category, rays, work, share_of_work, .. } in rays {
        let work = work.map_or("-".into(), count);
        table.row([category.clone(), count(*rays), work, share_of_work.map_or("-".into(), &percent)]);
    }
    let is_known = rays.iter().any(|ray| ray.work.is_some());
    format!("\n{}{}", table.render(), if is_known { WORK_FOR_RAYS } else { "" })
}

/// What work is counted in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Operations of our own renderer.
    Operations,
    /// CPU time of another renderer, microseconds.
    CpuMicros,
}

impl Unit {
    fn amount(self, work: f64) -> String {
        match self {
            Unit::Operations => format!("{} operations", count(work)),
            Unit::CpuMicros => format!("{} of CPU time", seconds(work * 1e-6)),
        }
    }
}

pub fn text(explanation: &Explanation, unit: Unit) -> String {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let mut text = String::from("\nWhy it costs this much\n\n");
    for part in &explanation.parts {
        text += &format!("{:>8}  {} ({})\n", percent(part.share), part.part, unit.amount(part.work));
    }
    if !explanation.rays.is_empty() {
        text += &rays(&explanation.rays, percent);
    }
    if !explanation.objects.is_empty() {
        let mut table = Table::new(&[
            ("pixels that show", Align::Left),
            ("share of the work", Align::Right),
            ("share of the pixels", Align::Right),
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
            text += &format!(
                "and {} others with at least 1 % of the pixels' work\n",
                explanation.objects.len() - SHOWN
            );
        }
    }
    text += "\n";
    for line in &explanation.words {
        text += &format!("{line}\n");
    }
    text
}
