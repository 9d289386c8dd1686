//! `forelight preview`: what the camera sees, by object and material.

use crate::job_options::png_file;
use anyhow::{Context, Result};
use forelight_protocol::{PreviewBackend, Spent};
use forelight_renderer_own::{StratumInfo, png};
use forelight_scene::MaterialClass;
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use std::path::PathBuf;

/// Draw the ID preview of a frame: transparent red, specular blue, all others green
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight preview kitchen/ --frame 12 --out ids.png
  forelight preview kitchen/ --width 256 --height 256 --json > ids.json")]
pub struct Args {
    /// Scene: a .glb or .gltf file, or a bundle, which is a folder or a zip file
    bundle: PathBuf,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Picture to write
    #[arg(long, value_name = "FILE.png", value_parser = png_file)]
    out: Option<PathBuf>,
    /// Print the strata as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    machine: MachineOptions,
}

/// The strata of a frame.
#[derive(Debug, Serialize)]
struct Seen {
    frame: u32,
    width: u32,
    height: u32,
    backend: PreviewBackend,
    spent: Spent,
    background: u32,
    /// Largest first.
    strata: Vec<SeenStratum>,
}

#[derive(Debug, Serialize)]
struct SeenStratum {
    object: String,
    material: String,
    class: &'static str,
    pixels: u32,
    /// Colour in the picture, before shading.
    color: [u8; 3],
}

/// Largest number of rows of the table. The JSON has all strata.
const MOST_ROWS: usize = 25;
pub fn run(args: &Args) -> Result<()> {
    let bars = Bars::new(args.json);
    let local = Local::open(&args.bundle, &args.machine, &bars)?;
    let settings = local.settings(&args.quality)?;
    let (previewed, picture, palette) = local
        .pool
        .install(|| {
            let frame = local.shot.frame(args.frame, &settings)?;
            let previewed = frame.preview()?;
            let picture = forelight_preview::picture(&previewed.preview, frame.frame());
            Ok::<_, forelight_renderer_own::RenderError>((
                previewed,
                picture,
                forelight_preview::palette(frame.frame()),
            ))
        })
        .with_context(|| format!("bundle {}", args.bundle.display()))?;
    if let Some(path) = &args.out {
        write_bytes(path, &png(&picture)?)?;
    }
    let counts = previewed.preview.counts();
    let strata = local.shot.info().strata.iter().zip(&palette).zip(&counts.per_stratum);
    let mut strata: Vec<SeenStratum> = strata
        .filter(|(_, pixels)| **pixels > 0)
        .map(|((info, color), &pixels)| SeenStratum {
            object: info.name.object.clone(),
            material: info.name.material.clone(),
            class: class_name(info),
            pixels,
            color: *color,
        })
        .collect();
    // A stable sort keeps strata of equal size in the order of the scene.
    strata.sort_by_key(|stratum| std::cmp::Reverse(stratum.pixels));
    let seen = Seen {
        frame: args.frame,
        width: settings.width,
        height: settings.height,
        backend: previewed.backend,
        spent: previewed.spent,
        background: counts.background,
        strata,
    };
    if args.json { output::json(&seen) } else { output::print(&report(&seen)) }
}

fn class_name(info: &StratumInfo) -> &'static str {
    match info.class {
        MaterialClass::Transparent => "transparent",
        MaterialClass::Specular => "specular",
        MaterialClass::Diffuse => "diffuse",
    }
}

fn report(seen: &Seen) -> String {
    let all = f64::from(seen.width) * f64::from(seen.height);
    let share = |pixels: u32| format!("{:.1} %", 100.0 * f64::from(pixels) / all);
    let head = [
        ("object", Align::Left),
        ("material", Align::Left),
        ("class", Align::Left),
        ("pixels", Align::Right),
        ("share", Align::Right),
    ];
    let mut table = Table::new(&head);
    for stratum in seen.strata.iter().take(MOST_ROWS) {
        let SeenStratum { object, material, class, pixels, .. } = stratum;
        table.row([object.clone(), material.clone(), (*class).into(), pixels.to_string(), share(*pixels)]);
    }
    let rest = seen.strata.get(MOST_ROWS..).unwrap_or_default();
    if !rest.is_empty() {
        let pixels = rest.iter().map(|stratum| stratum.pixels).sum();
        let others = format!("and {} others", rest.len());
        table.row([others, String::new(), String::new(), u32::to_string(&pixels), share(pixels)]);
    }
    table.footer();
    table.row([
        "background".into(),
        String::new(),
        String::new(),
        seen.background.to_string(),
        share(seen.background),
    ]);
    let who = match seen.backend {
        PreviewBackend::Gpu => "GPU",
        PreviewBackend::Cpu => "CPU",
        PreviewBackend::Renderer => "renderer",
    };
    table.render() + &format!("\nframe {}, {} x {}, on the {who}\n", seen.frame, seen.width, seen.height)
}
