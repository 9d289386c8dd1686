//! Fetches a job's images, and makes the contact sheet.

use crate::contact_sheet::{Cell, contact_sheet, thumbnail};
use anyhow::{Context, Result, bail};
use forelight_client::{Client, ClientError, FramePicture};
use forelight_protocol::{ArtifactHash, FrameRow, Job, ProblemKind};
use forelight_renderer_own::png;
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use futures::{StreamExt, TryStreamExt};
use image::RgbImage;
use std::path::{Path, PathBuf};

/// Number of parallel downloads.
const AT_ONCE: usize = 4;

/// The pictures to fetch for each frame, and the ends of their file names.
const PICTURES: [(FramePicture, &str); 4] = [
    (FramePicture::Exr, ".exr"),
    (FramePicture::Png, ".png"),
    (FramePicture::CostMap, "-cost.png"),
    (FramePicture::Preview, "-preview.png"),
];

/// Writes the pictures of all finished frames and a contact sheet into `folder`.
pub async fn fetch(
    client: &Client,
    job: &Job,
    frames: &[FrameRow],
    folder: &Path,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<()> {
    let wanted: Vec<File> = frames.iter().flat_map(|row| files(row, folder)).collect();
    let bar = bars.bar("fetching", wanted.len() as u64);
    let fetched = futures::stream::iter(wanted).map(|file| {
        let (client, bar) = (client.clone(), &bar);
        async move {
            let name = format!("{} of frame {}", file.picture.file_name(), file.frame);
            let content = match client.picture(job.id, file.frame, file.picture).await {
                Err(ClientError::Refused(problem))
                    if matches!(
                        problem.known_kind(),
                        Some(ProblemKind::ArtifactLost | ProblemKind::ArtifactDamaged)
                    ) =>
                {
                    return Ok(Some(name));
                }
                content => content.with_context(|| format!("cannot fetch {name}"))?,
            };
            bar.inc(1);
            if file.hash.0 != *blake3::hash(&content).as_bytes() {
                return Ok(Some(name));
            }
            write_bytes(&file.path, &content)?;
            Ok::<_, anyhow::Error>(None)
        }
    });
    let fetched = fetched.buffer_unordered(AT_ONCE).try_filter_map(|damaged| async { Ok(damaged) });
    let stopped = interrupt.token();
    let mut damaged: Vec<String> = tokio::select! {
        fetched = fetched.try_collect() => fetched?,
        () = stopped.cancelled() => return Err(Interrupted.into()),
    };
    bar.finish_and_clear();
    if !damaged.is_empty() {
        damaged.sort_unstable();
        bail!(
            "these files are lost or damaged on the farm, and were not written: {}; submit these frames again",
            damaged.join(", ")
        );
    }
    let (rows, folder) = (frames.to_vec(), folder.to_owned());
    tokio::task::spawn_blocking(move || write_sheet(&rows, &folder)).await?
}

struct File {
    frame: u32,
    picture: FramePicture,
    hash: ArtifactHash,
    path: PathBuf,
}

fn files(row: &FrameRow, folder: &Path) -> Vec<File> {
    let hash = |picture: FramePicture| match picture {
        FramePicture::Preview => row.artifacts.preview_png,
        FramePicture::CostMap => row.artifacts.cost_map_png,
        FramePicture::Png => row.artifacts.image_png,
        FramePicture::Exr => row.artifacts.image_exr,
    };
    let path = |end: &str| folder.join(format!("frame-{:04}{end}", row.frame));
    let file =
        |(picture, end)| Some(File { frame: row.frame, picture, hash: hash(picture)?, path: path(end) });
    PICTURES.into_iter().filter_map(file).collect()
}

fn write_sheet(frames: &[FrameRow], folder: &Path) -> Result<()> {
    let load = |row: &FrameRow, wanted: FramePicture| -> Result<Option<RgbImage>> {
        let file = files(row, folder).into_iter().find(|file| file.picture == wanted);
        let Some(File { path, .. }) = file else { return Ok(None) };
        let picture = image::open(&path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(Some(thumbnail(&picture.into_rgb8())))
    };
    let mut cells = Vec::with_capacity(frames.len());
    for row in frames {
        cells.push(Cell {
            frame: row.frame,
            image: load(row, FramePicture::Png)?,
            cost_map: load(row, FramePicture::CostMap)?,
        });
    }
    write_bytes(&folder.join("contact-sheet.png"), &png(&contact_sheet(&cells))?)
}
