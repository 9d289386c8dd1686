//! What frames show: drawn from their triangles, or rendered by Cycles where triangles do not show all.
//!
//! Even without a GPU, drawing a frame takes a third to a sixth of the time of the least that Cycles can render. But
//! only Cycles knows what it will show. So frames are drawn if nothing in the file speaks against it (the driver looks
//! for transparent surfaces, hair and volumes), and if Cycles shows the same in the first and in the last of them.

use crate::image::{Image, scaled};
use crate::shot::{BlenderShot, Costs, question};
use crate::triangles::{Answer, Outcome, Pieces};
use forelight_preview::{Counts, PreviewError, Previewer};
use forelight_renderer::door::{
    Common, Cost, FrameCounts, PixelCount, PreviewBackend, RendererError, Run, Settings,
};
use forelight_scene::Frame;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

/// Most pixels of a preview. Counts are scaled to the image.
const MOST_PIXELS: u64 = 256 * 256;

/// Least share of the pixels in which Cycles must show the same object and material. Either may be shown where surfaces
/// coincide, and where an edge passes the centre of a pixel.
const AGREEMENT: f64 = 0.98;

/// Frames up to which all are rendered: those are all that would be compared.
const ALL_COMPARED: usize = 2;

/// Why frames are not drawn, and what it cost to find out.
struct NotDrawn {
    reason: String,
    cost: Cost,
}

/// Previews of some frames.
pub(crate) struct Previewing<'a> {
    shot: &'a BlenderShot,
    settings: Settings,
    /// Number of pixels of the image.
    pixels: u64,
    /// File for what Blender writes.
    out: PathBuf,
    run: &'a Run<'a>,
}

impl<'a> Previewing<'a> {
    pub fn new(shot: &'a BlenderShot, settings: &Settings, run: &'a Run<'a>) -> Self {
        let common = settings.common.smaller(MOST_PIXELS, 1.0);
        Self {
            shot,
            settings: Settings { common, own: settings.own.clone() },
            pixels: settings.pixels(),
            out: run.scratch.join("preview"),
            run,
        }
    }

    /// What each of the frames shows.
    pub fn counts(&self, frames: &[i32]) -> Result<Vec<FrameCounts>, RendererError> {
        let mut lost = Cost::default();
        let mut drawn = None;
        if frames.len() > ALL_COMPARED {
            match self.drawn(frames)? {
                Ok(counts) => drawn = Some(counts),
                Err(NotDrawn { reason, cost }) => {
                    (self.run.log)(&format!("Cycles renders the previews: {reason}"));
                    lost = cost;
                }
            }
        }
        let mut counts = drawn.map_or_else(|| self.rendered(frames), Ok)?;
        if let Some(first) = counts.first_mut() {
            first.cost += &lost;
            std::fs::remove_file(&self.out).map_err(RendererError::io(&self.out))?;
        }
        Ok(counts)
    }

    /// The frames, drawn.
    fn drawn(&self, frames: &[i32]) -> Result<Result<Vec<FrameCounts>, NotDrawn>, RendererError> {
        let pool = ThreadPoolBuilder::new().num_threads(self.run.limits.threads as usize).build();
        let pool = pool.map_err(|error| RendererError::Failed(format!("cannot draw previews: {error}")))?;
        let mut pieces = Pieces::new();
        let mut all: Vec<FrameCounts> = Vec::with_capacity(frames.len());
        let not_drawn = |reason, all: &[FrameCounts], mut cost: Cost| {
            all.iter().for_each(|frame| cost += &frame.cost);
            Ok(Err(NotDrawn { reason, cost }))
        };
        for (place, &number) in frames.iter().enumerate() {
            let of = (place, frames.len());
            let Answer { mut cost, outcome } = self.triangles(number, of, pieces.step())?;
            let step = match outcome {
                Outcome::Refused { refused } => return not_drawn(refused, &all, cost),
                Outcome::Step(step) => step,
            };
            let since = Instant::now();
            let Common { width, height, .. } = self.settings.common;
            let frame = pieces.advance(step, &self.out, (width, height))?;
            let reading = u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX);
            (cost.cpu_nanos, cost.wall_nanos) = (cost.cpu_nanos + reading, cost.wall_nanos + reading);
            let is_compared = place == 0 || place + 1 == frames.len();
            let (counts, backend) = if is_compared {
                let (preview, backend) = self.draw(&pool, &frame, Previewer::preview, &mut cost)?;
                let (image, rendering) = self.with_progress(of, |run| self.render(number, run))?;
                cost += &rendering;
                let agreement = image.agreement(preview.stratum.iter().map(|&s| pieces.pair(s)))?;
                if agreement < AGREEMENT {
                    let other = 100.0 * (1.0 - agreement);
                    let reason = format!("{other:.1} % of the pixels of frame {number} show other triangles");
                    return not_drawn(reason, &all, cost);
                }
                (preview.counts(), backend)
            } else {
                self.draw(&pool, &frame, Previewer::counts, &mut cost)?
            };
            all.push(FrameCounts {
                frame: number,
                counts: self.pixels_by_pair(&counts, &pieces),
                sampled_pixels: counts.pixels(),
                backend,
                cost,
            });
        }
        Ok(Ok(all))
    }

    /// Asks for the triangles of a frame, the one at `place`.
    fn triangles(
        &self,
        frame: i32,
        place: (usize, usize),
        after: Option<&str>,
    ) -> Result<Answer, RendererError> {
        self.with_progress(place, |run| {
            let mut question = question("triangles", frame, &self.settings, &self.out, run);
            question["after"] = json!(after);
            self.shot.ask(&question, run)
        })
    }

    /// Runs a part of the work for frame `done` of `all`.
    fn with_progress<T>(&self, (done, all): (usize, usize), work: impl FnOnce(&Run<'_>) -> T) -> T {
        let progress = |share: f64| (self.run.progress)((done as f64 + share) / all as f64);
        work(&Run { progress: &progress, ..*self.run })
    }

    /// Draws a frame, and adds what that costs.
    fn draw<T: Send>(
        &self,
        pool: &ThreadPool,
        frame: &Frame,
        draw: impl FnOnce(&mut Previewer, &Frame) -> Result<T, PreviewError> + Send,
        cost: &mut Cost,
    ) -> Result<(T, PreviewBackend), RendererError> {
        let since = Instant::now();
        let drawn = pool.install(|| {
            self.shot.previewer().with(|previewer| {
                let drawn = draw(previewer, frame)?;
                let backend =
                    if previewer.backend() == "gpu" { PreviewBackend::Gpu } else { PreviewBackend::Cpu };
                Ok((drawn, backend, previewer.cost()))
            })
        });
        let (drawn, backend, spent) =
            drawn.map_err(|error| RendererError::Failed(format!("cannot draw a preview: {error}")))?;
        cost.cpu_nanos += spent.nanos();
        cost.wall_nanos += u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX);
        Ok((drawn, backend))
    }

    fn pixels_by_pair(&self, counts: &Counts, pieces: &Pieces) -> Vec<PixelCount> {
        let mut by_pair = BTreeMap::from([((None, None), u64::from(counts.background))]);
        for (stratum, &pixels) in (0..).zip(&counts.per_stratum) {
            *by_pair.entry(pieces.pair(stratum)).or_default() += u64::from(pixels);
        }
        by_pair.retain(|_, pixels| *pixels > 0);
        let all = counts.pixels().max(1);
        let count = |((object, material), pixels)| PixelCount {
            object,
            material,
            pixels: scaled(pixels, self.pixels, all),
        };
        by_pair.into_iter().map(count).collect()
    }

    /// The frames, rendered by Cycles.
    fn rendered(&self, frames: &[i32]) -> Result<Vec<FrameCounts>, RendererError> {
        let one = |(place, &frame): (usize, &i32)| {
            let (image, cost) = self.with_progress((place, frames.len()), |run| self.render(frame, run))?;
            Ok(FrameCounts {
                frame,
                counts: image.counts(self.pixels)?,
                sampled_pixels: self.settings.pixels(),
                backend: PreviewBackend::Renderer,
                cost,
            })
        };
        frames.iter().enumerate().map(one).collect()
    }

    /// Renders what a frame shows, with the least light.
    fn render(&self, frame: i32, run: &Run<'_>) -> Result<(Image, Cost), RendererError> {
        let Costs { cost, .. } =
            self.shot.ask(&question("ids", frame, &self.settings, &self.out, run), run)?;
        Ok((Image::read(&self.out)?, cost))
    }
}
