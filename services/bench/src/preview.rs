//! `forelight bench preview`: what an ID preview takes on the GPU, and whether the CPU sees the same.

use crate::report::Report;
use crate::statistics::{sorted, upper_median};
use anyhow::Result;
use forelight_preview::{Choice, Counts, Preview, Previewer};
use forelight_scene::{Frame, Limits, Scene};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::count;
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Measure ID previews on the GPU, and compare them with those of the CPU
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench preview kitchen/ corridor/
  forelight bench preview kitchen/ --sizes 1920x1080,3840x2160 --frames 48 --json

The first frame of a scene sends its triangles to the GPU. Counts read one number back for each pair of object and \
material; they are what forecasts need. Images read every pixel back; profiles need them. The CPU traces one ray for \
each pixel, on all cores. Times are wall times, medians over the frames. Pixels differ where an edge passes a \
pixel's centre within the snapping of the rasteriser.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true, value_name = "BUNDLE")]
    bundles: Vec<PathBuf>,
    /// Image sizes
    #[arg(long, value_name = "WIDTHxHEIGHT", value_delimiter = ',', default_values = ["512x512", "1920x1080", "3840x2160"], value_parser = size)]
    sizes: Vec<(u32, u32)>,
    /// Largest number of frames of a shot, spread from its first to its last. A still is drawn as often
    #[arg(long, value_name = "NUMBER", default_value_t = 12, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    frames: u32,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Measured {
    /// Name of the GPU, or of the program that stands in for one.
    adapter: String,
    rows: Vec<Row>,
}

#[derive(Debug, Serialize)]
struct Row {
    bundle: String,
    triangles: usize,
    strata: usize,
    width: u32,
    height: u32,
    frames: u32,
    /// Of the first frame on the GPU, counted.
    first_seconds: f64,
    gpu_counts_seconds: f64,
    gpu_image_seconds: f64,
    cpu_image_seconds: f64,
    /// Share of the pixels with the same object and material.
    same: f64,
    /// Of these pixels: share whose position and normal have the same bits.
    same_bits: f64,
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(width, height)| {
        Some((
            width.parse().ok().filter(|&width| width > 0)?,
            height.parse().ok().filter(|&height| height > 0)?,
        ))
    });
    parsed.ok_or_else(|| "write a size as 1920x1080".to_owned())
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    let bars = Bars::new(args.json);
    let gpu = Previewer::new(Choice::Gpu)?;
    let mut measured = Measured { adapter: gpu.adapter().unwrap_or("unknown").to_owned(), rows: Vec::new() };
    drop(gpu);
    for bundle in &args.bundles {
        let scene = Scene::load(bundle, &Limits::default())
            .map_err(|error| BadInput::new(format!("bundle {}: {error}", bundle.display())))?;
        for &size in &args.sizes {
            let spinner = bars.spinner(format!("drawing {} at {} × {}", bundle.display(), size.0, size.1));
            measured.rows.push(measure(bundle, &scene, size, args.frames, interrupt)?);
            spinner.finish_and_clear();
        }
    }
    report(&measured).printed(args.json, &measured)
}

/// One of so many frames of a shot, spread from the first to the last; a still as often as it is asked for.
fn frame(scene: &Scene, size: (u32, u32), (place, count): (u32, u32)) -> Result<Frame> {
    let last = scene.frame_count().saturating_sub(1);
    let number = u64::from(place) * u64::from(last) / u64::from(count - 1);
    // At most the number of the last frame.
    Ok(scene.frame_with(number as u32, Some(size))?)
}

fn measure(bundle: &Path, scene: &Scene, size: (u32, u32), most: u32, interrupt: &Interrupt) -> Result<Row> {
    // One that has not seen the scene.
    let (mut gpu, mut cpu) = (Previewer::new(Choice::Gpu)?, Previewer::new(Choice::Cpu)?);
    let (mut first, mut counts, mut images, mut on_cpu) = (0.0, Vec::new(), Vec::new(), Vec::new());
    let mut agreement = Agreement::default();
    let (mut triangles, mut strata) = (0, 0);
    for place in 0..most {
        if interrupt.is_set() {
            return Err(Interrupted.into());
        }
        let frame = &frame(scene, size, (place, most))?;
        (triangles, strata) = (frame.geometry.triangles.len(), frame.geometry.strata.pairs.len());
        let (counted, seconds) = timed(|| gpu.counts(frame));
        let counted: Counts = counted?;
        if place == 0 {
            first = seconds;
        } else {
            counts.push(seconds);
        }
        let (image, seconds) = timed(|| gpu.preview(frame));
        images.push(seconds);
        let (twin, seconds) = timed(|| cpu.preview(frame));
        on_cpu.push(seconds);
        let (image, twin) = (image?, twin?);
        anyhow::ensure!(image.counts() == counted, "frame {}: counts and image differ", frame.number);
        agreement.add(&image, &twin);
    }
    let median = |values| upper_median(&sorted(values)).unwrap_or(0.0);
    Ok(Row {
        bundle: bundle.display().to_string(),
        triangles,
        strata,
        width: size.0,
        height: size.1,
        frames: most,
        first_seconds: first,
        gpu_counts_seconds: median(counts),
        gpu_image_seconds: median(images),
        cpu_image_seconds: median(on_cpu),
        same: agreement.same as f64 / agreement.pixels.max(1) as f64,
        same_bits: agreement.same_bits as f64 / agreement.same.max(1) as f64,
    })
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let made = work();
    (made, start.elapsed().as_secs_f64())
}

/// What the previews of some frames have in common, in pixels.
#[derive(Debug, Default)]
struct Agreement {
    pixels: u64,
    same: u64,
    same_bits: u64,
}

impl Agreement {
    fn add(&mut self, one: &Preview, other: &Preview) {
        self.pixels += one.stratum.len() as u64;
        for i in (0..one.stratum.len()).filter(|&i| one.stratum[i] == other.stratum[i]) {
            self.same += 1;
            let bits = |preview: &Preview| {
                (
                    preview.position[i].to_array().map(f32::to_bits),
                    preview.normal[i].to_array().map(f32::to_bits),
                )
            };
            self.same_bits += u64::from(bits(one) == bits(other));
        }
    }
}

fn report(measured: &Measured) -> Report {
    let head = [
        ("bundle", Align::Left),
        ("triangles", Align::Right),
        ("size", Align::Right),
        ("first frame", Align::Right),
        ("counts", Align::Right),
        ("image", Align::Right),
        ("CPU", Align::Right),
        ("same", Align::Right),
        ("same bits", Align::Right),
    ];
    let mut table = Table::new(&head);
    let milliseconds = |seconds: f64| format!("{:.2} ms", 1000.0 * seconds);
    for row in &measured.rows {
        table.row([
            row.bundle.clone(),
            count(row.triangles as f64),
            format!("{} × {}", row.width, row.height),
            milliseconds(row.first_seconds),
            milliseconds(row.gpu_counts_seconds),
            milliseconds(row.gpu_image_seconds),
            milliseconds(row.cpu_image_seconds),
            format!("{:.4} %", 100.0 * row.same),
            format!("{:.4} %", 100.0 * row.same_bits),
        ]);
    }
    Report::default().text(format!("GPU: {}\n", measured.adapter)).table(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_and_wrong_ones_refused() {
        assert_eq!(size("1920x1080"), Ok((1920, 1080)));
        for wrong in ["1920", "0x5", "5x", "x", "-3x4", "3x4x5"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_gpu_and_the_cpu_see_the_same_of_a_shipped_scene() {
        if let Err(error) = Previewer::new(Choice::Gpu) {
            return forelight_test_needs::not_run(format_args!("no GPU preview: {error}"));
        }
        let bundle = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenes/corridor");
        let scene = Scene::load(&bundle, &Limits::default()).unwrap();
        let row = measure(&bundle, &scene, (64, 36), 3, &Interrupt::default()).unwrap();
        assert_eq!((row.frames, row.width, row.height), (3, 64, 36));
        assert!(row.same > 0.99 && row.same_bits > 0.9, "{row:?}");
        let measured = Measured { adapter: "a GPU".to_owned(), rows: vec![row] };
        let text = report(&measured).for_terminal();
        assert!(text.contains("GPU: a GPU") && text.contains("64 × 36"), "{text}");
    }
}
