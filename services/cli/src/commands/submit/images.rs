//! Fetching a job's images, and the contact sheet.

use crate::atomic_file::write_bytes;
use crate::contact_sheet::{Cell, contact_sheet};
use crate::failure::Interrupted;
use crate::interrupt::Interrupt;
use crate::output::Bars;
use anyhow::{Context, Result};
use forelight_protocol::{FrameRow, Job};
use forelight_worker::{Client, FramePicture, png};
use futures::{StreamExt, TryStreamExt};
use image::RgbImage;
use std::path::{Path, PathBuf};

/// Downloads at once.
const AT_ONCE: usize = 4;

/// The pictures of a frame that are fetched, and the ends of their file names.
const PICTURES: [(FramePicture, &str); 4] = [
    (FramePicture::Exr, ".exr"),
    (FramePicture::Png, ".png"),
    (FramePicture::CostMap, "-cost.png"),
    (FramePicture::Preview, "-preview.png"),
];

/// Puts the pictures of all frames that are there into `folder`, and a contact sheet beside them.
pub async fn fetch(
    client: &Client,
    job: &Job,
    frames: &[FrameRow],
    folder: &Path,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<()> {
    let wanted: Vec<(u32, FramePicture, PathBuf)> =
        frames.iter().flat_map(|row| files(row, folder)).collect();
    let bar = bars.bar("fetching", wanted.len() as u64);
    let fetched = futures::stream::iter(wanted).map(|(frame, picture, path)| {
        let (client, bar) = (client.clone(), &bar);
        async move {
            let name = picture.file_name();
            let content = client
                .picture(job.id, frame, picture)
                .await
                .with_context(|| format!("cannot fetch {name} of frame {frame}"))?;
            write_bytes(&path, &content)?;
            bar.inc(1);
            Ok::<_, anyhow::Error>(())
        }
    });
    let stopped = interrupt.token();
    tokio::select! {
        fetched = fetched.buffer_unordered(AT_ONCE).try_collect::<()>() => fetched?,
        () = stopped.cancelled() => return Err(Interrupted.into()),
    }
    bar.finish_and_clear();
    let (rows, folder) = (frames.to_vec(), folder.to_owned());
    tokio::task::spawn_blocking(move || write_sheet(&rows, &folder)).await?
}

/// The files of a frame, of the pictures that are there.
fn files(row: &FrameRow, folder: &Path) -> Vec<(u32, FramePicture, PathBuf)> {
    let there = |picture: FramePicture| match picture {
        FramePicture::Preview => row.artifacts.preview_png.is_some(),
        FramePicture::CostMap => row.artifacts.cost_map_png.is_some(),
        FramePicture::Png => row.artifacts.image_png.is_some(),
        FramePicture::Exr => row.artifacts.image_exr.is_some(),
    };
    let path = |end: &str| folder.join(format!("frame-{:04}{end}", row.frame));
    PICTURES
        .into_iter()
        .filter(|(picture, _)| there(*picture))
        .map(|(picture, end)| (row.frame, picture, path(end)))
        .collect()
}

fn write_sheet(frames: &[FrameRow], folder: &Path) -> Result<()> {
    let load = |row: &FrameRow, wanted: FramePicture| -> Result<Option<RgbImage>> {
        let files = files(row, folder);
        let Some((_, _, path)) = files.into_iter().find(|(_, picture, _)| *picture == wanted) else {
            return Ok(None);
        };
        let picture = image::open(&path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(Some(picture.into_rgb8()))
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
