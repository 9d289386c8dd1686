//! `forelight calibrate`: measures the speed of this machine, by class of work.

use anyhow::Result;
use forelight_protocol::{ByClass, NodeCalibration};
use forelight_renderer_own::{CALIBRATION_VERSION, ROUNDS, calibrate, node_speed};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::BadInput;
use forelight_terminal::json_file;
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::count;
use forelight_terminal::table::{Align, Table};
use forelight_tracer::tracer_version;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Measure the speed of one core of this machine, by class of work
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight calibrate
  forelight calibrate --out rack-7.json
  forelight forecast kitchen/ --for-node rack-7.json

The command traces a fixed set of small scenes, the same on every machine. The shortest time of each scene \
counts, because other programs can only make it longer. The time of a unit of work differs between machines and \
between classes of work: a processor with small caches, for example, is slow in large scenes only. Rates of \
classes are those of whole frames. A kernel's own rate differs from them by a known factor.

With the calibrations of two machines, a quote from one machine gives the CPU time on the other. A farm's worker \
calibrates itself when it first starts. It keeps the result beside its bundles as calibration-HOST.json, and \
measures again if that file is missing. Finished frames correct the calibration.")]
pub struct Args {
    /// Number of times to trace each scene. Use more on a machine that also runs other programs
    #[arg(long, value_name = "TIMES", default_value_t = 40, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    rounds: u16,
    /// Write the calibration to this file as JSON
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print the calibration as JSON to standard output
    #[arg(long)]
    json: bool,
}
pub fn run(args: &Args) -> Result<()> {
    atomic_file::check([args.out.as_deref()])?;
    let calibration = measured(usize::from(args.rounds), &Bars::new(args.json));
    json_file::write(args.out.as_deref(), &calibration)?;
    if args.json { output::json(&calibration) } else { output::print(&report(&calibration)) }
}

pub fn measured(rounds: usize, bars: &Bars) -> NodeCalibration {
    let bar = bars.bar("calibrating", 0);
    let calibration = calibrate(rounds, &|done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    calibration
}

/// A worker's stored calibration, so that a worker of a single task need not measure first.
#[derive(Debug, Serialize, Deserialize)]
struct Kept {
    processor: Option<String>,
    tracer: u32,
    version: u32,
    calibration: NodeCalibration,
}

/// This machine's calibration: read from `folder` if it is of this processor and tracer, otherwise measured
/// and written there.
pub fn kept(folder: &Path, processor: Option<&str>) -> NodeCalibration {
    // Several machines may share the folder.
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host: String = host.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '-').collect();
    let path = folder.join(format!("calibration-{host}.json"));
    match json_file::read::<Kept>(&path) {
        Ok(Kept { processor: of, tracer, version, calibration })
            if of.as_deref() == processor
                && (tracer, version) == (tracer_version(), CALIBRATION_VERSION)
                && calibration.check().is_ok() =>
        {
            calibration
        }
        _ => {
            let calibration = calibrate(ROUNDS, &|_, _| ());
            let kept = Kept {
                processor: processor.map(str::to_owned),
                tracer: tracer_version(),
                version: CALIBRATION_VERSION,
                calibration: calibration.clone(),
            };
            if let Err(error) = output::pretty(&kept).and_then(|text| write_bytes(&path, text.as_bytes())) {
                tracing::warn!(%error, "cannot write this machine's calibration; the next start measures again");
            }
            calibration
        }
    }
}

/// Reads a calibration that `--out` wrote. The file's name is the machine's name.
pub fn read(path: &Path) -> Result<(String, NodeCalibration)> {
    let calibration: NodeCalibration = json_file::read_written_by("forelight calibrate --out", path)?;
    calibration
        .check()
        .map_err(|(field, reason)| BadInput::new(format!("{}: {field} {reason}", path.display())))?;
    let name = path.file_stem().unwrap_or(path.as_os_str());
    Ok((name.to_string_lossy().into_owned(), calibration))
}

fn report(calibration: &NodeCalibration) -> String {
    let mut table = Table::new(&[("class of work", Align::Left), ("ns per unit", Align::Right)]);
    let nanos = calibration.picos_per_work.to_array().map(|picos| picos as f64 / 1000.0);
    for (name, nanos) in ByClass::NAMES.iter().zip(nanos) {
        table.row([(*name).to_owned(), format!("{nanos:.2}")]);
    }
    let mut text = table.render() + "\n";
    let mut table = Table::new(&[
        ("kernel", Align::Left),
        ("operations", Align::Right),
        ("time", Align::Right),
        ("ns per operation", Align::Right),
    ]);
    for kernel in &calibration.kernels {
        let (work, nanos) = (kernel.work.total() as f64, kernel.cpu_nanos as f64);
        table.row([
            kernel.name.clone(),
            count(work),
            format!("{:.1} ms", nanos * 1e-6),
            format!("{:.2}", nanos / work.max(1.0)),
        ]);
    }
    text += &table.render();
    text + &format!("\nspeed of one core, relative to the reference: {:.2}\n", node_speed(calibration))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kept_calibration_is_used_until_processor_or_tracer_are_others() {
        let folder = tempfile::tempdir().unwrap();
        let first = kept(folder.path(), Some("a processor"));
        // Two measurements are never the same to the picosecond.
        assert_eq!(kept(folder.path(), Some("a processor")), first);
        assert_ne!(kept(folder.path(), Some("another")), first);
    }

    #[test]
    fn a_calibration_reads_back_and_one_that_is_out_of_range_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rack-7.json");
        let written = NodeCalibration {
            picos_per_work: ByClass::from_array([900; ByClass::CLASSES]),
            kernels: Vec::new(),
        };
        std::fs::write(&path, serde_json::to_string(&written).unwrap()).unwrap();
        assert_eq!(read(&path).unwrap(), ("rack-7".to_owned(), written));
        std::fs::write(
            &path,
            r#"{"picos_per_work":{"rays":0,"traversal":1,"memory":1,"shading":1,"texture":1,"records":1}}"#,
        )
        .unwrap();
        let error = format!("{:#}", read(&path).unwrap_err());
        assert!(error.contains("rack-7.json") && error.contains("picos_per_work"), "{error}");
    }
}
