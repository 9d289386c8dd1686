//! `forelight bench effects`: how much time it saves to simulate only the effects that a scene calls for.

use crate::report::Report;
use crate::statistics::{sorted, upper_median};
use anyhow::Result;
use forelight_protocol::LeftOut;
use forelight_scene::{Frame, Limits, Scene};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::{settings_request, thread_pool};
use forelight_terminal::options::QualityOptions;
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{count, percent, seconds};
use forelight_terminal::table::{Align, Table};
use forelight_tracer::{Effects, Image, Settings, Tracer};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Measure how much time it saves to simulate only the effects that a scene calls for
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench effects kitchen/ corridor/
  forelight bench effects kitchen/ --spp 4 --ambient-bounces 1 --repeats 9 --json

Every scene is rendered by default, then with everything (code for all effects, and lights and objects that \
cannot affect the image), then with the code for one more effect at a time. The variants take turns. Ratios \
compare renders of one turn, and their median counts. The image is 256 x 256 unless --width or --height is \
given. The command fails if any image differs by a bit.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true, value_name = "BUNDLE")]
    bundles: Vec<PathBuf>,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Number of times to render every image
    #[arg(long, value_name = "NUMBER", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    quality: QualityOptions,
}

/// Default width and height, pixels.
const SIZE: u32 = 256;

#[derive(Debug, Serialize)]
struct Measured {
    bundle: String,
    frame: u32,
    width: u32,
    height: u32,
    spp: u32,
    ambient_bounces: u32,
    repeats: u32,
    triangles: usize,
    /// Effects that the frame calls for.
    effects: Vec<&'static str>,
    /// Lights and objects that cannot affect the image.
    left_out: Vec<LeftOut>,
    /// First the default, then everything, then one added effect each.
    variants: Vec<Variant>,
}

#[derive(Debug, Serialize)]
struct Variant {
    name: String,
    /// True if the image equals that of the first variant, bit for bit.
    same_image: bool,
    rays: u64,
    work: u64,
    /// Size of the tree over the triangles.
    tree_bytes: usize,
    build_cpu_seconds: f64,
    /// Median over the repeats.
    cpu_seconds: f64,
    /// CPU time relative to the first variant.
    ratio: Ratio,
}

/// Statistics over the repeats.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Ratio {
    median: f64,
    lowest: f64,
    highest: f64,
}

struct Runner {
    name: String,
    tracer: Tracer,
    image: Option<Image>,
    nanos: Vec<u64>,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    let bars = Bars::new(args.json);
    let pool = thread_pool(args.threads)?;
    let mut all = Vec::new();
    for bundle in &args.bundles {
        let spinner = bars.spinner(format!("rendering {}", bundle.display()));
        all.push(measure(args, bundle, &pool, interrupt)?);
        spinner.finish_and_clear();
    }
    let reports = all.iter().enumerate().map(|(place, measured)| {
        let gap = if place == 0 { "" } else { "\n" };
        Report::default().text(gap).then(report(measured))
    });
    let report = reports.fold(Report::default(), Report::then).printed(args.json, &all)?;
    let other = all.iter().flat_map(|m| m.variants.iter().map(move |v| (m, v))).find(|(_, v)| !v.same_image);
    match other {
        None => Ok(report),
        Some((measured, variant)) => {
            anyhow::bail!(
                "bundle {}: the image of {:?} differs from the default one",
                measured.bundle,
                variant.name
            )
        }
    }
}

fn measure(args: &Args, bundle: &Path, pool: &rayon::ThreadPool, interrupt: &Interrupt) -> Result<Measured> {
    let bad = |error: &dyn std::fmt::Display| BadInput::new(format!("bundle {}: {error}", bundle.display()));
    let scene = Scene::load(bundle, &Limits::default()).map_err(|error| bad(&error))?;
    args.quality.check()?;
    let settings = Settings::from(&settings_request(&args.quality, (SIZE, SIZE)).complete((SIZE, SIZE)));
    settings.validate().map_err(|error| BadInput::new(error.to_string()))?;
    let size = Some((settings.width, settings.height));
    let frame = scene.frame_with(args.frame, size).map_err(|error| bad(&error))?;
    let mut runners = pool.install(|| runners(&frame, &settings));
    for _ in 0..args.repeats {
        for runner in &mut runners {
            let image = pool.install(|| runner.tracer.render(None, &|_| (), interrupt.flag()));
            let image = image.ok_or(Interrupted)?;
            runner.nanos.push(image.totals().cpu_nanos);
            runner.image = Some(image);
        }
    }
    let first = &runners[0];
    let left_out = first.tracer.left_out().iter();
    Ok(Measured {
        bundle: bundle.display().to_string(),
        frame: args.frame,
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        ambient_bounces: settings.ambient_bounces,
        repeats: args.repeats,
        triangles: frame.geometry.triangles.len(),
        effects: first.tracer.effects().names().collect(),
        left_out: left_out
            .map(|left| LeftOut { what: left.what.to_string(), reason: left.reason.to_string() })
            .collect(),
        variants: runners.iter().map(|runner| variant(runner, first)).collect(),
    })
}

fn runners(frame: &Frame, settings: &Settings) -> Vec<Runner> {
    let runner = |name: String, tracer| Runner { name, tracer, image: None, nanos: Vec::new() };
    let plain = Tracer::new(frame, settings);
    let (tree, called_for) = (plain.bvh().clone(), plain.effects());
    let again = || Tracer::with_bvh(frame, settings, tree.clone());
    let complete = || Tracer::complete(frame, settings);
    let all = complete().effects().with_all();
    let mut runners = vec![
        runner("what it calls for".into(), plain),
        runner("everything".into(), complete().with_kernel_for(all)),
    ];
    if !runners[0].tracer.left_out().is_empty() {
        runners.push(runner("+ what was left out".into(), complete()));
    }
    for bit in (0..u32::BITS).map(|shift| 1 << shift).filter(|&bit| all.has(bit) && !called_for.has(bit)) {
        let effect = Effects::default() | bit;
        for name in effect.names() {
            runners.push(runner(format!("+ {name}"), again().with_kernel_for(effect)));
        }
    }
    runners
}

fn variant(runner: &Runner, first: &Runner) -> Variant {
    let totals = runner.image.as_ref().map(Image::totals).unwrap_or_default();
    let ratios = runner.nanos.iter().zip(&first.nanos).map(|(&own, &first)| own as f64 / first.max(1) as f64);
    Variant {
        name: runner.name.clone(),
        same_image: bits(runner).eq(bits(first)),
        rays: totals.rays.iter().sum(),
        work: totals.work,
        tree_bytes: runner.tracer.bvh().bytes(),
        build_cpu_seconds: runner.tracer.tree_cost().build.cpu_nanos as f64 * 1e-9,
        cpu_seconds: spread(runner.nanos.iter().map(|&nanos| nanos as f64 * 1e-9).collect()).median,
        ratio: spread(ratios.collect()),
    }
}

fn bits(runner: &Runner) -> impl Iterator<Item = ([u32; 3], u32)> {
    let pixels = runner.image.iter().flat_map(|image| &image.pixels);
    pixels.map(|pixel| (pixel.color.map(f32::to_bits), pixel.stratum))
}

/// Upper median, minimum and maximum. Zero without values.
fn spread(values: Vec<f64>) -> Ratio {
    let values = sorted(values);
    let end = |value: Option<&f64>| value.copied().unwrap_or(0.0);
    let median = upper_median(&values).unwrap_or(0.0);
    Ratio { median, lowest: end(values.first()), highest: end(values.last()) }
}

fn report(measured: &Measured) -> Report {
    let Measured { bundle, width, height, spp, ambient_bounces, triangles, .. } = measured;
    let mut text = format!(
        "{bundle}: {width} x {height}, {spp} spp, {ambient_bounces} bounces, {} triangles\n",
        count(*triangles as f64)
    );
    text += &format!("calls for  {}\n", output::list(&measured.effects));
    for (index, LeftOut { what, reason }) in measured.left_out.iter().enumerate() {
        text += &format!("{:9}  {what}: {reason}\n", if index == 0 { "left out" } else { "" });
    }
    let head = [
        ("simulated", Align::Left),
        ("image", Align::Left),
        ("rays", Align::Right),
        ("work", Align::Right),
        ("tree", Align::Right),
        ("build", Align::Right),
        ("CPU", Align::Right),
        ("longer by", Align::Right),
        ("from", Align::Right),
        ("to", Align::Right),
    ];
    let mut table = Table::new(&head);
    for variant in &measured.variants {
        let ratio = variant.ratio;
        table.row([
            variant.name.clone(),
            if variant.same_image { "same".into() } else { "OTHER".into() },
            count(variant.rays as f64),
            count(variant.work as f64),
            format!("{}B", count(variant.tree_bytes as f64)),
            seconds(variant.build_cpu_seconds),
            seconds(variant.cpu_seconds),
            percent(ratio.median - 1.0),
            percent(ratio.lowest - 1.0),
            percent(ratio.highest - 1.0),
        ]);
    }
    Report::default().text(text).table(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube with triangles wound inward.
    fn cube(name: &str, low: [f32; 3], high: [f32; 3], first: usize) -> String {
        let mut text = format!("o {name}\nusemtl wall\n");
        for i in 0..8 {
            let p: [f32; 3] =
                std::array::from_fn(|axis| if i >> axis & 1 == 1 { high[axis] } else { low[axis] });
            text += &format!("v {} {} {}\n", p[0], p[1], p[2]);
        }
        for face in [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]] {
            let [a, b, c, d] = face.map(|corner: usize| corner + first);
            text += &format!("f {a} {b} {c}\nf {a} {c} {d}\n");
        }
        text
    }

    #[test]
    fn a_sun_outside_a_closed_room_is_left_out_and_every_image_is_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let rooms = cube("room", [-2.0, 0.0, -2.0], [2.0, 3.0, 2.0], 1)
            + &cube("next", [3.0, 0.0, -2.0], [6.0, 3.0, 2.0], 9);
        std::fs::write(folder.path().join("rooms.obj"), format!("mtllib rooms.mtl\n{rooms}")).unwrap();
        std::fs::write(folder.path().join("rooms.mtl"), "newmtl wall\nillum 1\nKd 0.7 0.7 0.7\n").unwrap();
        let scene = r#"{"version": 1, "name": "rooms", "geometry": ["rooms.obj"],
            "camera": {"origin": [0, 1.5, 1.9], "target": [0, 1.5, 0], "up": [0, 1, 0], "fov_deg": 60,
                "fov_axis": "x", "width": 16, "height": 16},
            "lights": [{"type": "sun", "direction": [0.6, 0.8, 0], "irradiance": [9, 9, 9], "angle_deg": 0.5},
                {"type": "quad", "corner": [-0.5, 2.9, -0.5], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1],
                    "radiance": [9, 9, 9]}]}"#;
        std::fs::write(folder.path().join("scene.json"), scene).unwrap();
        let flags = ["effects", "bundle", "--width", "12", "--height", "8", "--spp", "1", "--repeats", "2"];
        let args: Args = forelight_terminal::options::parsed(flags);
        let pool = thread_pool(Some(1)).unwrap();
        let measured = measure(&args, folder.path(), &pool, &Interrupt::default()).unwrap();
        let left_out: Vec<&str> = measured.left_out.iter().map(|l| l.what.as_str()).collect();
        assert_eq!(left_out, ["sun 0", "next (12 triangles)"]);
        let named = |name: &str| measured.variants.iter().find(|v| v.name == name).unwrap();
        assert!(measured.variants.iter().all(|v| v.same_image), "{:?}", measured.variants);
        let (plain, complete) = (named("what it calls for"), named("+ what was left out"));
        assert!(plain.rays < complete.rays && plain.tree_bytes < complete.tree_bytes);
        assert_eq!(plain.rays, named("+ sun").rays, "code for suns without a sun casts no rays");
        let text = report(&measured).for_terminal();
        assert!(text.contains("left out   sun 0: outside the closed room room"), "{text}");
        assert!(text.contains("same") && !text.contains("OTHER"), "{text}");
    }

    #[test]
    fn a_ratio_is_told_with_its_spread() {
        assert_eq!(spread(vec![1.2, 0.9, 1.0]), Ratio { median: 1.0, lowest: 0.9, highest: 1.2 });
        assert_eq!(spread(vec![2.0, 1.0]), Ratio { median: 2.0, lowest: 1.0, highest: 2.0 });
        assert_eq!(spread(Vec::new()), Ratio { median: 0.0, lowest: 0.0, highest: 0.0 });
    }
}
