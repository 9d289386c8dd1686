//! `forelight backup`: a copy of the farm's database, made while the service runs.

use crate::data_folder;
use anyhow::{Context, Result};
use forelight_protocol::words::counted;
use forelight_store::StoreError;
use forelight_terminal::atomic_file;
use forelight_terminal::failure::BadInput;
use forelight_terminal::output::{self, Bars};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Copy the farm's database while the service runs, and check the copy
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight backup --data farm-data --to backups/2026-03-01.sqlite
  forelight backup --data farm-data --to backup.sqlite --json

The copy holds the database as it was at one instant. Every page is checked before the copy gets its name. \
Artefacts (images, bundles, profiles) are files that never change. Copy the folder DATA/artifacts after the \
database, with any tool.

To restore: stop the service. Move DATA/forelight.sqlite and DATA/forelight.sqlite-* away. Put the copy in their \
place as forelight.sqlite. Start the service. It renders frames that were delivered after the backup again.")]
pub struct Args {
    /// Data folder of the farm
    #[arg(long, value_name = "DIR", default_value = "farm-data")]
    data: PathBuf,
    /// File to write the copy to. The file must not exist
    #[arg(long, value_name = "FILE")]
    to: PathBuf,
    /// Print the numbers of the copy (bytes, jobs, artefacts) as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Document {
    file: PathBuf,
    bytes: u64,
    jobs: u64,
    artifacts: u64,
    artifact_bytes: u64,
}
pub async fn run(args: Args) -> Result<()> {
    data_folder::check_farm("--data", &args.data)?;
    check_place(&args.to)?;
    let spinner = Bars::new(args.json).spinner(format!("copying to {}", args.to.display()));
    let copied = forelight_store::backup(&args.data, &args.to).await;
    spinner.finish_and_clear();
    let backup = match copied {
        Err(StoreError::Conflict(reason)) => return Err(BadInput::new(format!("--to {reason}")).into()),
        other => other.with_context(|| format!("cannot back up the database in {}", args.data.display()))?,
    };
    let document = Document {
        file: args.to,
        bytes: backup.bytes,
        jobs: backup.jobs,
        artifacts: backup.artifacts,
        artifact_bytes: backup.artifact_bytes,
    };
    if args.json {
        return output::json(&document);
    }
    output::line(format!(
        "{}: {}, {}, checked; the database refers to {} of {} in {}",
        document.file.display(),
        counted(document.bytes, "byte"),
        counted(document.jobs, "job"),
        counted(document.artifacts, "artefact"),
        counted(document.artifact_bytes, "byte"),
        args.data.join("artifacts").display()
    ))
}

/// Checks that the copy can be written. Its folder must exist: one that is missing may be a disk that is not
/// mounted.
fn check_place(to: &Path) -> Result<()> {
    let folder = to.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.exists()) {
        let reason = format!("--to {}: the folder {} does not exist", to.display(), folder.display());
        return Err(BadInput::new(reason).hint("make the folder first, or name another one").into());
    }
    atomic_file::check([Some(to)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_is_not_written_into_a_folder_that_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        check_place(&folder.path().join("x.sqlite")).unwrap();
        let error = check_place(&folder.path().join("b/x.sqlite")).unwrap_err().to_string();
        assert!(error.contains("b/x.sqlite: the folder") && error.ends_with("b does not exist"), "{error}");
        assert!(!folder.path().join("b").exists());
    }
}
