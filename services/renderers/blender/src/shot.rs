//! The four questions of the door, to one Blender file.

use crate::connection::Connection;
use crate::idle::Idle;
use crate::image::{Image, Share, merge};
use crate::installation::Cycles;
use crate::preview::Previewing;
use crate::settings::{SCHEMA, is_on, why_indivisible};
use forelight_preview::SharedPreviewer;
use forelight_renderer::door::{
    Artefact, Asset, Capabilities, Capability, Cost, Description, FixedCosts, FrameCounts, Measured, Part,
    PieceCost, Region, Rendered, Renderer as _, RendererError, Run, Settings, SettingsError, Shot, Stopping,
    TakenOver,
};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A Blender file, open in as many processes as there are questions at a time.
pub(crate) struct BlenderShot {
    cycles: Cycles,
    scene: PathBuf,
    description: Description,
    /// Why shares of the samples never add up to one render, whatever the settings are.
    indivisible: Option<String>,
    /// A question starts a process if none waits.
    idle: Idle,
}

/// Answer of the driver to the opening of a file.
#[derive(Deserialize)]
struct Opened {
    #[serde(flatten)]
    description: Description,
    indivisible: Option<String>,
}

/// Answer of the driver to a render.
#[derive(Deserialize)]
pub(crate) struct Costs {
    pub cost: Cost,
    pub fixed: FixedCosts,
    #[serde(default)]
    pub pieces: Vec<PieceCost>,
    stopping: Option<Stopped>,
}

/// An image of few pixels, which shows at how many samples they stop.
#[derive(Deserialize)]
struct Stopped {
    cost: Cost,
    /// Samples after which all pixels had stopped, by view layer.
    rendered: BTreeMap<String, u32>,
}

/// Answer of the driver to the wish for a copy.
#[derive(Deserialize)]
struct Packed {
    /// Files that are not inside.
    outside: Vec<Asset>,
}

impl BlenderShot {
    pub fn open(cycles: Cycles, scene: &Path, run: &Run<'_>) -> Result<Self, RendererError> {
        let (connection, opened) = Connection::open(&cycles, scene, run)?;
        let Opened { description, indivisible } = opened;
        Ok(Self { cycles, scene: scene.to_owned(), description, indivisible, idle: Idle::new(connection) })
    }

    pub(crate) fn previewer(&self) -> &SharedPreviewer {
        &self.cycles.previewer
    }

    pub(crate) fn ask<T: DeserializeOwned>(
        &self,
        question: &Value,
        run: &Run<'_>,
    ) -> Result<T, RendererError> {
        let mut connection = match self.idle.take() {
            Some(connection) => connection,
            None => Connection::open::<Value>(&self.cycles, &self.scene, run)?.0,
        };
        let answer = connection.ask(question, run);
        // After any other error the process is gone, or nobody knows what it does.
        if matches!(answer, Ok(_) | Err(RendererError::Failed(_))) {
            self.idle.put(connection);
        }
        answer
    }

    fn check(&self, settings: &Settings) -> Result<(), RendererError> {
        settings.check(&SCHEMA)?;
        if settings.common.seed > MOST_SEED {
            let reason = format!("Blender's seeds go up to {MOST_SEED}");
            return Err(SettingsError { path: "/seed".to_owned(), reason }.into());
        }
        let cameras = || self.description.cameras.iter().map(|camera| camera.name.as_str());
        if let Some(name) = settings.own.get("camera").and_then(Value::as_str)
            && !name.is_empty()
            && cameras().all(|known| known != name)
        {
            let known = cameras().collect::<Vec<_>>().join(", ");
            let reason = format!("the scene has no camera {name}; its cameras are: {known}");
            return Err(SettingsError { path: "/own/camera".to_owned(), reason }.into());
        }
        if is_on(settings, "allow_missing") { Ok(()) } else { self.description.require_assets() }
    }

    /// Why shares of the samples do not add up to one render. `None` if they do.
    fn why_indivisible(&self, settings: &Settings) -> Option<&str> {
        if self.cycles.capabilities().contains(&Capability::TakeOverSamples) {
            why_indivisible(settings).or(self.indivisible.as_deref())
        } else {
            Some("Blender renders shares of the samples since version 4.4")
        }
    }

    /// Renders a frame, or with (offset, count) a share of its samples, into a file.
    fn samples(
        &self,
        frame: i32,
        settings: &Settings,
        share: Option<(u32, u32)>,
        out: &Path,
        run: &Run<'_>,
    ) -> Result<Costs, RendererError> {
        let mut question = question("samples", frame, settings, out, run);
        if let Some((offset, count)) = share {
            question["offset"] = offset.into();
            question["count"] = count.into();
            if offset == 0 && is_on(settings, "adaptive_sampling") {
                question["stopping"] = json!(stopping_file(out));
            }
        }
        self.ask(&question, run)
    }

    fn measure_samples(
        &self,
        frame: i32,
        settings: &Settings,
        (offset, count): (u32, u32),
        run: &Run<'_>,
    ) -> Result<Measured, RendererError> {
        let path = run.scratch.join(format!("frame-{frame:04}-samples-{offset}-{count}.exr"));
        let Costs { cost, fixed, stopping, .. } =
            self.samples(frame, settings, Some((offset, count)), &path, run)?;
        let image = Image::read(&path)?;
        let stopping = stopping.map(|stopped| stopping_at(stopped, &path, settings)).transpose()?;
        let strata = image.stratum_costs();
        // Nobody knows how long denoising and compositing take. Both are part of every share, like all that
        // is fixed, so that a line through two shares knows.
        let is_processed = is_on(settings, "denoise") || is_on(settings, "compositing");
        let (blocks, ids) = (image.block_costs(), image.ids());
        let in_pixels = blocks.as_ref().map(|blocks| blocks.nanos.iter().sum());
        let fixed =
            if is_processed { FixedCosts::new() } else { with_pixels(fixed, &cost, in_pixels, count) };
        let artefact = if self.why_indivisible(settings).is_none() {
            let renderer = self.cycles.id().clone();
            let part = Part::Samples { offset, count };
            Some(Artefact { renderer, frame, settings: settings.clone(), part, path })
        } else {
            std::fs::remove_file(&path).map_err(RendererError::io(&path))?;
            None
        };
        Ok(Measured { cost, fixed, pieces: Vec::new(), strata, blocks, ids, artefact, stopping })
    }

    fn measure_regions(
        &self,
        frame: i32,
        settings: &Settings,
        regions: &[Region],
        run: &Run<'_>,
    ) -> Result<Measured, RendererError> {
        let path = run.scratch.join(format!("frame-{frame:04}-regions.exr"));
        let mut question = question("regions", frame, settings, &path, run);
        question["regions"] = json!(regions);
        let Costs { cost, fixed, pieces, .. } = self.ask(&question, run)?;
        // Only the first frame is written.
        if path.exists() {
            std::fs::remove_file(&path).map_err(RendererError::io(&path))?;
        }
        Ok(Measured {
            cost,
            fixed,
            pieces,
            strata: Vec::new(),
            blocks: None,
            ids: None,
            artefact: None,
            stopping: None,
        })
    }

    /// Shares of the samples in order, without gaps from the first sample on: their files, and how many samples
    /// each has.
    fn shares(
        &self,
        frame: i32,
        settings: &Settings,
        from: &[Artefact],
    ) -> Result<Vec<(PathBuf, u32)>, RendererError> {
        let mut parts = Vec::new();
        for artefact in from {
            artefact.check(self.cycles.id(), frame, settings)?;
            if let Some(reason) = self.why_indivisible(settings) {
                return Err(artefact.unusable(reason));
            }
            let Part::Samples { offset, count } = artefact.part else {
                return Err(artefact.unusable("it is not a share of the samples"));
            };
            parts.push((offset, count, artefact));
        }
        parts.sort_by_key(|&(offset, ..)| offset);
        let (mut shares, mut end) = (Vec::new(), 0);
        for (offset, count, artefact) in parts {
            if offset != end {
                return Err(artefact
                    .unusable(format!("it begins at sample {offset}, and {end} were expected before it")));
            }
            end += count;
            shares.push((artefact.path.clone(), count));
        }
        Ok(shares)
    }
}

pub(crate) fn question(name: &str, frame: i32, settings: &Settings, out: &Path, run: &Run<'_>) -> Value {
    json!({"do": name, "frame": frame, "settings": settings, "threads": run.limits.threads, "out": out})
}

/// The file of the image of few pixels beside that of a share.
fn stopping_file(share: &Path) -> PathBuf {
    share.with_extension("stopping.exr")
}

fn stopping_at(stopped: Stopped, share: &Path, settings: &Settings) -> Result<Stopping, RendererError> {
    let Stopped { cost, rendered } = stopped;
    let path = stopping_file(share);
    let samples = Image::read(&path)?.mean_samples(&rendered, settings.common.samples)?;
    std::fs::remove_file(&path).map_err(RendererError::io(&path))?;
    Ok(Stopping { samples, cost })
}

/// Largest seed of Blender.
const MOST_SEED: u32 = i32::MAX.unsigned_abs();

/// What the first sample of a pixel takes longer than a later one, as a multiple of a later one. Cycles traces
/// the samples of a pixel one after the other, and the first finds less of the scene in the processor's caches.
/// In five rooms (256 × 256, Blender 5.0, medians of interleaved renders), it is 0.06 to 0.13, with a median of
/// 0.073. The images, which are counted apart, are 0.01 to 0.02 of it.
const FIRST_SAMPLE: f64 = 0.06;

/// Adds to the fixed costs of a share of the samples what it costs for each pixel, however many samples there
/// are. `in_pixels` are the nanoseconds of all pixels by the clock.
fn with_pixels(mut fixed: FixedCosts, cost: &Cost, in_pixels: Option<u64>, samples: u32) -> FixedCosts {
    // Cycles did not tell when the samples began, so a line through two shares must tell the fixed costs.
    if fixed.is_empty() {
        return fixed;
    }
    let sampling = cost.cpu_nanos.saturating_sub(fixed.values().sum());
    // What images cost beside the light in their pixels: buffers, passes. On a busy machine, pixels take longer
    // by the clock than all CPU time, and nothing is known about the images.
    let in_pixels = in_pixels.filter(|&nanos| (1..sampling).contains(&nanos)).unwrap_or(sampling);
    let first = in_pixels as f64 * FIRST_SAMPLE / (f64::from(samples) + FIRST_SAMPLE);
    let parts = [("images", sampling - in_pixels), ("pixels", first.round() as u64)];
    fixed.extend(
        parts.into_iter().filter(|&(_, nanos)| nanos > 0).map(|(name, nanos)| (name.to_owned(), nanos)),
    );
    fixed
}

impl Shot for BlenderShot {
    fn description(&self) -> &Description {
        &self.description
    }

    fn capabilities(&self, settings: &Settings) -> Capabilities {
        let mut all = self.cycles.capabilities();
        if self.why_indivisible(settings).is_some() {
            all.remove(&Capability::TakeOverSamples);
        }
        if is_on(settings, "adaptive_sampling") {
            // Few samples of all pixels do not tell which of them will take how many.
            all.remove(&Capability::LocateCosts);
        }
        all
    }

    fn pack(&self, settings: &Settings, out: &Path, run: &Run<'_>) -> Result<bool, RendererError> {
        self.check(settings)?;
        if self.description.outside().next().is_none() {
            return Ok(false);
        }
        let Packed { outside } = self.ask(&json!({"do": "pack", "out": out}), run)?;
        if outside.is_empty() { Ok(true) } else { Err(RendererError::NotPacked(outside)) }
    }

    fn preview(
        &self,
        frames: &[i32],
        settings: &Settings,
        run: &Run<'_>,
    ) -> Result<Vec<FrameCounts>, RendererError> {
        self.check(settings)?;
        Previewing::new(self, settings, run).counts(frames)
    }

    fn measure(
        &self,
        frame: i32,
        settings: &Settings,
        part: &Part,
        run: &Run<'_>,
    ) -> Result<Measured, RendererError> {
        self.check(settings)?;
        part.check(&settings.common)?;
        match part {
            &Part::Samples { offset, count } => self.measure_samples(frame, settings, (offset, count), run),
            Part::Regions(regions) => self.measure_regions(frame, settings, regions, run),
            Part::Pixels(_) => Err(RendererError::Unsupported(
                "Cycles cannot measure single pixels; measure regions".to_owned(),
            )),
        }
    }

    fn render(
        &self,
        frame: i32,
        settings: &Settings,
        taken_over: &[Artefact],
        run: &Run<'_>,
    ) -> Result<Rendered, RendererError> {
        self.check(settings)?;
        let mut shares = self.shares(frame, settings, taken_over)?;
        let first = shares.iter().map(|(_, samples)| samples).sum();
        let rest = settings.common.samples.saturating_sub(first);
        let path = run.scratch.join(format!("frame-{frame:04}.exr"));
        let (mut cost, mut fixed) = (Cost::default(), FixedCosts::default());
        let image = if shares.is_empty() {
            Costs { cost, fixed, .. } = self.samples(frame, settings, None, &path, run)?;
            Image::read(&path)?
        } else {
            let part = run.scratch.join(format!("frame-{frame:04}-rest.exr"));
            if rest > 0 {
                Costs { cost, fixed, .. } = self.samples(frame, settings, Some((first, rest)), &part, run)?;
                shares.push((part.clone(), rest));
            }
            // One after the other: all of them might not fit into memory.
            let read =
                |(path, samples): &(PathBuf, u32)| Ok(Share { image: Image::read(path)?, samples: *samples });
            let image = merge(first + rest, shares.iter().map(read))?;
            if rest > 0 {
                std::fs::remove_file(&part).map_err(RendererError::io(&part))?;
            }
            image.write(&path)?;
            image
        };
        let (strata, blocks) = (image.stratum_costs(), image.block_costs());
        Ok(Rendered {
            files: vec![path],
            picture: Some(image.picture()),
            ids: image.ids(),
            cost,
            fixed,
            strata,
            blocks,
            taken_over: TakenOver::default(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_pixels_cost_beside_their_samples_is_fixed() {
        let cost = |cpu_nanos| Cost { cpu_nanos, ..Cost::default() };
        let known = || FixedCosts::from([("tree".to_owned(), 1_000)]);
        let part = |fixed: &FixedCosts, name: &str| fixed.get(name).copied();
        // One sample of 1,060 in its pixels, of which 60 are those of a first one. Images take 40.
        let fixed = with_pixels(known(), &cost(2_100), Some(1_060), 1);
        assert_eq!((part(&fixed, "images"), part(&fixed, "pixels")), (Some(40), Some(60)));
        // Four samples.
        let fixed = with_pixels(known(), &cost(5_060), None, 4);
        assert_eq!((part(&fixed, "images"), part(&fixed, "pixels")), (None, Some(60)));
        // By the clock, pixels took longer than the CPU did.
        let fixed = with_pixels(known(), &cost(2_060), Some(5_000), 1);
        assert_eq!((part(&fixed, "images"), part(&fixed, "pixels")), (None, Some(60)));
        // Nothing is known, or there is nothing.
        assert!(with_pixels(FixedCosts::new(), &cost(2_060), Some(1_060), 1).is_empty());
        assert_eq!(with_pixels(known(), &cost(500), Some(1_060), 1), known());
    }
}
