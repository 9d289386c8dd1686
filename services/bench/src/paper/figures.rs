//! The files of the paper's figures.

use super::chart;
use super::level::{Level, Seen, Truth, mean_record};
use super::picture::positions;
use super::predicted;
use super::study::Curve;
use super::trial::Records;
use anyhow::Result;
use forelight_forecast::{Costs, Strategy};
use forelight_renderer_own::png;
use forelight_terminal::cost_picture::{Paint, Scale, key, map};
use image::RgbImage;
use std::path::{Path, PathBuf};

#[derive(Debug)]
pub struct File {
    /// Relative to the report's folder.
    pub path: PathBuf,
    pub contents: Vec<u8>,
}

/// Quantity that a map shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    Cost,
    Rays,
}

impl Shown {
    pub const ALL: [Shown; 2] = [Shown::Cost, Shown::Rays];

    /// Name in a file name.
    pub const fn slug(self) -> &'static str {
        match self {
            Shown::Cost => "cost",
            Shown::Rays => "rays",
        }
    }

    fn paint(self) -> Paint {
        match self {
            Shown::Cost => Paint::Colour,
            Shown::Rays => Paint::Grey,
        }
    }
}

/// Strategies with maps at a level. With a cache they are those that use the preview, as in the paper.
pub fn mapped(level: Level) -> &'static [Strategy] {
    let all = &Strategy::ALL;
    if level.is_cached() { &all[all.len() - 3..] } else { all }
}

/// File name of a map of a strategy's prediction, or of the truth.
pub fn map_file(shown: Shown, level: Level, strategy: Option<Strategy>) -> String {
    format!("{}-{}-{}.png", shown.slug(), level.slug(), strategy.map_or("truth", Strategy::name))
}

/// File name of a strategy's positions.
pub fn positions_file(strategy: Strategy) -> String {
    format!("positions-{}.png", strategy.name())
}

/// All figures of a frame, below `folder`. Strategies use seed 0.
pub fn of(
    folder: &Path,
    seen: &Seen,
    truths: &[Truth],
    curves: &[Curve],
    size: u32,
    samples: u32,
) -> Result<Vec<File>> {
    let mut files = Vec::new();
    let mut add = |name: String, picture: &RgbImage| -> Result<()> {
        files.push(File { path: folder.join(name), contents: png(picture)? });
        Ok(())
    };
    add("preview.png".into(), &seen.picture)?;
    for shown in Shown::ALL {
        add(format!("key-{}.png", shown.slug()), &key(shown.paint()))?;
    }
    if let Some(truth) = truths.iter().find(|truth| truth.level == Level::OneBounce) {
        add("image.png".into(), &truth.picture)?;
        for strategy in Strategy::ALL {
            let design = strategy.design(&seen.strata, &seen.ids, size, samples, 0, 0)?;
            let (picks, _) = design.profile(|pixel| truth.pixels[pixel as usize])?;
            let picture = positions(&seen.picture, picks.iter().map(|pick| pick.pixel));
            add(positions_file(strategy), &picture)?;
        }
    }
    for truth in truths {
        let value =
            |shown, costs: &Costs<f64>| if shown == Shown::Cost { costs.work } else { costs.all_rays };
        let truly = |shown| -> Vec<f64> {
            let mut values: Vec<f64> =
                truth.pixels.iter().map(|cost| value(shown, &Costs::from(*cost))).collect();
            for (pixel, record) in &truth.seen_records {
                values[*pixel as usize] += value(shown, &Costs::from(*record));
            }
            values
        };
        let scales = Shown::ALL.map(|shown| Scale::of(&truly(shown)));
        for (shown, scale) in Shown::ALL.into_iter().zip(scales) {
            add(map_file(shown, truth.level, None), &map(size, &truly(shown), scale, shown.paint()))?;
        }
        let one_record = mean_record(&truth.sampled(samples)[..truth.sampled(samples).len().min(1)]);
        for &strategy in mapped(truth.level) {
            // Our strategy knows the planned records and reads them. The others meet an empty cache.
            let ours = Records::of(strategy) == Records::Planned && truth.has_plan();
            let costs = if ours { &truth.pixels } else { &truth.cold };
            let design = strategy.design(&seen.strata, &seen.ids, size, samples, 0, 0)?;
            let (picks, observations) = design.profile(|pixel| costs[pixel as usize])?;
            let shown = (&*seen.strata, &*seen.ids);
            let predicted = predicted::map(strategy, &design, shown, size, &picks, &observations)?;
            for (shown, scale) in Shown::ALL.into_iter().zip(scales) {
                let mut values: Vec<f64> = predicted.iter().map(|costs| value(shown, costs)).collect();
                for (pixel, _) in truth.seen_records.iter().filter(|_| ours) {
                    values[*pixel as usize] += value(shown, &one_record);
                }
                let picture = map(size, &values, scale, shown.paint());
                add(map_file(shown, truth.level, Some(strategy)), &picture)?;
            }
        }
    }
    let mut panels: Vec<(&str, Vec<&Curve>)> = Vec::new();
    for level in Level::ALL {
        let own: Vec<&Curve> = curves.iter().filter(|curve| curve.level == level).collect();
        if !own.is_empty() {
            panels.push((level.title(), own));
        }
    }
    files.push(File { path: folder.join("samples.svg"), contents: chart::draw(&panels)?.into_bytes() });
    Ok(files)
}
