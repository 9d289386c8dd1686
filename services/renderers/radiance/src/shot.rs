//! The four questions of the door, to one scene of Radiance.

use crate::ambient::Ambient;
use crate::blocks::{Blocks, SIDE, pixels_of};
use crate::finished::{self, Content, Pixel};
use crate::ids;
use crate::image::{Traced, trace};
use crate::installation::Radiance;
use crate::opened::Opened;
use crate::pictures;
use crate::profile::RadianceProfiler;
use crate::scene::{Scene, SceneFrame};
use crate::settings::{ALLOW_MISSING, SCHEMA, allows_missing, shares_values};
use crate::shapes::Shapes;
use crate::tracer::Colour;
use forelight_renderer::door::{
    Artefact, BlockCosts, Camera, Capabilities, Capability, Common, Description, FrameCounts, Measured, Part,
    PieceCost, PixelProfiler, PreviewBackend, Region, Rendered, Renderer as _, RendererError, Run, Settings,
    Shot, Shown, TakenOver,
};
use std::path::Path;

/// Most pixels of a preview. Counts are scaled to the image.
const PREVIEW_PIXELS: u64 = 256 * 256;

/// Most pixels of an image.
const MOST_PIXELS: u64 = 1 << 28;

/// A scene of Radiance.
pub(crate) struct RadianceShot {
    opened: Opened,
    shapes: Shapes,
    description: Description,
}

impl RadianceShot {
    pub fn open(radiance: Radiance, path: &Path, run: &Run<'_>) -> Result<Self, RendererError> {
        let scene = Scene::open(&radiance, path, run)?;
        let shapes = Shapes::of(&radiance, &scene, run)?;
        let (width, height) = shapes.own;
        let common = Common { width, height, samples: scene.samples, seed: 0 };
        let mut own = radiance.defaults().clone();
        own.extend(scene.arguments.settings.clone());
        own.insert(ALLOW_MISSING.to_owned(), false.into());
        let description = Description {
            frames: scene.numbers(),
            frames_per_second: 24.0,
            cameras: cameras(&scene),
            layers: Vec::new(),
            // Known by name only where a preview shows them.
            objects: Some(Vec::new()),
            materials: Some(Vec::new()),
            settings: Settings { common, own },
            assets: scene.assets.clone(),
            notes: scene.notes.clone(),
            opening: scene.cost.clone(),
        };
        Ok(Self { opened: Opened::new(radiance, scene), shapes, description })
    }

    /// The file of ambient values of a render: with those that were taken over, or else an empty one if
    /// several processes share it.
    fn ambient(
        &self,
        settings: &Settings,
        values: &[u8],
        run: &Run<'_>,
    ) -> Result<Option<Ambient>, RendererError> {
        match (shares_values(settings), values) {
            (true, []) if run.limits.threads > 1 => Ambient::new(run.scratch).map(Some),
            (true, values) if !values.is_empty() => Ambient::with(run.scratch, values).map(Some),
            _ => Ok(None),
        }
    }

    fn check(&self, settings: &Settings) -> Result<(), RendererError> {
        settings.check(&SCHEMA)?;
        if settings.pixels() > MOST_PIXELS {
            let reason = format!("an image of {} pixels; the most are {MOST_PIXELS}", settings.pixels());
            return Err(RendererError::Unsupported(reason));
        }
        if allows_missing(settings) { Ok(()) } else { self.description.require_assets() }
    }

    /// A frame, if the size asked for does not distort it.
    fn frame(&self, number: i32, settings: &Settings, run: &Run<'_>) -> Result<&SceneFrame, RendererError> {
        let Opened { radiance, scene, .. } = &self.opened;
        let frame = scene.frame(number)?;
        self.shapes.check((radiance, scene), frame, &settings.common, run)?;
        Ok(frame)
    }

    /// Pixels and ambient values that artefacts hold.
    fn taken_over(
        &self,
        frame: i32,
        settings: &Settings,
        from: &[Artefact],
    ) -> Result<Content, RendererError> {
        let mut all = Content::default();
        for artefact in from {
            artefact.check(self.opened.radiance.id(), frame, settings)?;
            if !matches!(artefact.part, Part::Pixels(_)) {
                return Err(artefact.unusable("it is not of single pixels"));
            }
            let Content { pixels, ambient } = finished::read(artefact, settings.pixels())?;
            all.pixels.extend(pixels);
            // Several files of values cannot be joined by bytes; a render takes over one profile.
            if !ambient.is_empty() {
                all.ambient = ambient;
            }
        }
        Ok(all)
    }
}

fn cameras(scene: &Scene) -> Vec<Camera> {
    let named = scene.frames.iter().filter(|frame| !frame.view.name.is_empty());
    let mut names: Vec<&str> = named.map(|frame| frame.view.name.as_str()).collect();
    names.dedup();
    names.into_iter().map(|name| Camera { name: name.to_owned(), active: true }).collect()
}

/// Pixels of the pieces that are timed.
fn groups(image: &Common, part: &Part) -> Vec<Vec<u32>> {
    match part {
        Part::Samples { .. } => {
            let blocks = Blocks::new(image);
            (0..blocks.count()).map(|block| blocks.pixels(block)).collect()
        }
        Part::Regions(regions) => regions.iter().map(|region| pixels_of(region, image.width)).collect(),
        Part::Pixels(pixels) => pixels.iter().map(|&pixel| vec![pixel]).collect(),
    }
}

impl Shot for RadianceShot {
    fn description(&self) -> &Description {
        &self.description
    }

    fn image_extensions(&self, _settings: &Settings) -> Vec<String> {
        ["exr", "hdr", "png"].map(str::to_owned).to_vec()
    }

    fn capabilities(&self, settings: &Settings) -> Capabilities {
        let mut all = self.opened.radiance.capabilities();
        if shares_values(settings) {
            // A pixel's cost depends on those before it: a part by itself costs more than within the frame.
            all.remove(&Capability::MeasureSamples);
            all.remove(&Capability::MeasureRegions);
            all.remove(&Capability::MeasureManyRegions);
            all.insert(Capability::ShareCache);
        }
        all
    }

    fn names(&self, shown: Shown) -> (Option<String>, Option<String>) {
        let name = |number: Option<u32>| self.opened.names.name(number?);
        (name(shown.object), name(shown.material))
    }

    fn preview(
        &self,
        frames: &[i32],
        settings: &Settings,
        run: &Run<'_>,
    ) -> Result<Vec<FrameCounts>, RendererError> {
        self.check(settings)?;
        let small = settings.common.smaller(PREVIEW_PIXELS, 1.0);
        let sampled_pixels = small.pixels();
        let shown =
            frames.iter().map(|&frame| self.frame(frame, settings, run)).collect::<Result<Vec<_>, _>>()?;
        let mut all = Vec::with_capacity(frames.len());
        for (done, (&number, frame)) in frames.iter().zip(shown).enumerate() {
            let progress = |share: f64| (run.progress)((done as f64 + share) / frames.len() as f64);
            let (seen, cost) =
                self.opened.kept.see(&self.opened, frame, &small, &Run { progress: &progress, ..*run })?;
            let counts = ids::counts(&seen.shown, settings.pixels());
            all.push(FrameCounts {
                frame: number,
                counts,
                sampled_pixels,
                backend: PreviewBackend::Renderer,
                cost,
            });
        }
        Ok(all)
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
        let all = settings.common.samples;
        let samples = match *part {
            Part::Samples { offset, count } => offset..offset + count,
            Part::Regions(_) | Part::Pixels(_) => 0..all,
        };
        let shown = self.frame(frame, settings, run)?;
        let groups = groups(&settings.common, part);
        let ambient = self.ambient(settings, &[], run)?;
        let shared = (ambient.as_ref(), run);
        let traced = trace(&self.opened, shown, settings, &groups, samples, shared)?;
        let fixed = traced.fixed();
        let region = |pixels: &Vec<u32>| Region {
            x: pixels[0] % settings.common.width,
            y: pixels[0] / settings.common.width,
            width: 1,
            height: 1,
        };
        let (pieces, blocks) = match part {
            Part::Samples { .. } => (Vec::new(), Some(block_costs(settings, &traced.nanos))),
            Part::Regions(regions) => (pieces(regions.iter().copied(), &traced), None),
            Part::Pixels(_) => (pieces(groups.iter().map(region), &traced), None),
        };
        Ok(Measured {
            cost: traced.cost,
            fixed,
            pieces,
            strata: Vec::new(),
            blocks,
            ids: None,
            artefact: None,
            stopping: None,
        })
    }

    fn profile_pixels<'a>(
        &'a self,
        frame: i32,
        settings: &'a Settings,
        run: &'a Run<'a>,
    ) -> Result<Box<dyn PixelProfiler + 'a>, RendererError> {
        self.check(settings)?;
        Ok(Box::new(RadianceProfiler::start(&self.opened, self.frame(frame, settings, run)?, settings, run)?))
    }

    fn render(
        &self,
        frame: i32,
        settings: &Settings,
        taken_over: &[Artefact],
        run: &Run<'_>,
    ) -> Result<Rendered, RendererError> {
        self.check(settings)?;
        let shown = self.frame(frame, settings, run)?;
        let Content { pixels: mut finished, ambient } = self.taken_over(frame, settings, taken_over)?;
        let ambient = self.ambient(settings, &ambient, run)?;
        let over = TakenOver {
            pixels: finished.len() as u64,
            cpu_nanos: finished.values().map(|pixel| pixel.cpu_nanos).sum(),
        };
        let blocks = Blocks::new(&settings.common);
        let rest = |block: u32| -> Vec<u32> {
            let mut pixels = blocks.pixels(block);
            pixels.retain(|pixel| !finished.contains_key(pixel));
            pixels
        };
        let groups: Vec<Vec<u32>> = (0..blocks.count()).map(rest).collect();
        let shared = (ambient.as_ref(), run);
        let traced = trace(&self.opened, shown, settings, &groups, 0..settings.common.samples, shared)?;
        let fixed = traced.fixed();
        let Traced { pixels, mut nanos, cost, .. } = traced;
        for (&index, pixel) in &finished {
            nanos[blocks.of(index) as usize] += pixel.cpu_nanos;
        }
        finished.extend(pixels.into_iter().map(|(index, colour)| (index, Pixel { colour, cpu_nanos: 0 })));
        let pixels: Vec<Colour> = finished.into_values().map(|pixel| pixel.colour).collect();
        let (exr, hdr) = (format!("frame-{frame:04}.exr"), format!("frame-{frame:04}.hdr"));
        let files = vec![run.scratch.join(exr), run.scratch.join(hdr)];
        pictures::write_exr(&files[0], &pixels, &settings.common)?;
        pictures::write_hdr(&files[1], &pixels, &settings.common, shown)?;
        Ok(Rendered {
            files,
            picture: Some(pictures::picture(&pixels, &settings.common)),
            ids: None,
            cost,
            fixed,
            strata: Vec::new(),
            blocks: Some(block_costs(settings, &nanos)),
            taken_over: over,
        })
    }
}

fn block_costs(settings: &Settings, nanos: &[u64]) -> BlockCosts {
    let columns = Blocks::new(&settings.common).columns();
    BlockCosts { side: SIDE, columns, nanos: nanos.to_vec() }
}

fn pieces(regions: impl Iterator<Item = Region>, traced: &Traced) -> Vec<PieceCost> {
    regions.zip(&traced.nanos).map(|(region, &cpu_nanos)| PieceCost { region, cpu_nanos }).collect()
}
