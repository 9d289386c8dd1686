//! Fetches a job's images, and makes the contact sheet.

use crate::contact_sheet::{Cell, contact_sheet, thumbnail};
use anyhow::{Context, Result, bail};
use forelight_client::{Client, ClientError, FramePicture};
use forelight_protocol::words::{counted, was_or_were};
use forelight_protocol::{ArtifactHash, FrameArtifacts, FrameRow, FrameSet, FrameState, Job, ProblemKind};
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

/// File name of the contact sheet.
pub const SHEET: &str = "contact-sheet.png";

/// Writes the pictures of all finished frames and a contact sheet into `folder`. Says which frames' images were
/// deleted on the farm: the others are written then, without a contact sheet.
///
/// # Errors
/// If pictures are lost or damaged on the farm. The others are written then, without a contact sheet.
pub async fn fetch(
    client: &Client,
    job: &Job,
    frames: &[FrameRow],
    folder: &Path,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Option<FrameSet>> {
    let deleted = deleted(frames);
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
    if deleted.is_some() {
        return Ok(deleted);
    }
    let (rows, folder) = (frames.to_vec(), folder.to_owned());
    tokio::task::spawn_blocking(move || write_sheet(&rows, &folder)).await??;
    Ok(None)
}

/// The frames that were finished and whose images the farm deleted, because their time was over.
pub fn deleted(frames: &[FrameRow]) -> Option<FrameSet> {
    FrameSet::from_frames(frames.iter().filter(|row| is_deleted(row)).map(|row| row.frame))
}

/// Whether the image of a frame was deleted. A result always comes with one.
pub fn is_deleted(row: &FrameRow) -> bool {
    let FrameArtifacts { image_png, image_exr, .. } = &row.artifacts;
    row.state == FrameState::Done && image_png.is_none() && image_exr.is_none()
}

/// Whose images are gone, in words.
pub fn were_deleted(frames: &FrameSet) -> String {
    let count = frames.count();
    let images = if count == 1 { "the image" } else { "the images" };
    format!("{images} of {} {} deleted", counted(count, "frame"), was_or_were(count))
}

/// How images that were deleted are made again, in words.
pub fn again(job: &Job, frames: &FrameSet) -> String {
    let make = if frames.count() == 1 { "makes it again" } else { "makes them again" };
    format!("`forelight retry {} --frames {frames}` {make}", job.id)
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
    write_bytes(&folder.join(SHEET), &png(&contact_sheet(&cells))?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::status::tests::job;
    use serde_json::json;

    fn row(frame: u32, state: &str, png: Option<ArtifactHash>) -> FrameRow {
        let artifacts =
            json!({"preview_png": null, "cost_map_png": null, "image_png": png, "image_exr": null});
        serde_json::from_value(json!({
            "frame": frame, "state": state, "forecast": null, "actual": null, "work": null,
            "cpu_seconds": null, "booked": null, "node": null, "attempts": 1, "progress": 1.0,
            "started": null, "finished": null, "artifacts": artifacts, "error": null,
        }))
        .expect("a frame")
    }

    #[test]
    fn images_that_were_deleted_are_counted_and_can_be_made_again() {
        let there = Some(ArtifactHash([7; 32]));
        let rows =
            [row(0, "done", None), row(1, "done", there), row(2, "done", None), row(3, "failed", None)];
        let gone = deleted(&rows).expect("two are gone");
        assert_eq!(were_deleted(&gone), "the images of 2 frames were deleted");
        assert_eq!(
            again(&job(), &gone),
            format!("`forelight retry {} --frames 0,2` makes them again", job().id)
        );
        let one = deleted(&rows[..1]).expect("one is gone");
        assert_eq!(were_deleted(&one), "the image of 1 frame was deleted");
        assert_eq!(deleted(&rows[1..2]), None);
    }
}
