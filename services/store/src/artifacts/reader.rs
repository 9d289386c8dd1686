//! Reading an artefact.

use std::fs::File;
use std::io::SeekFrom;
use std::ops::Range;

use bytes::Bytes;
use futures::stream::{self, BoxStream};
use futures::{StreamExt as _, TryStreamExt as _};
use tokio::io::{AsyncReadExt as _, AsyncSeekExt as _};
use tokio_util::io::ReaderStream;

use crate::error::{Result, StoreError};

/// Bytes that are read at once.
const CHUNK: usize = 64 << 10;

/// An artefact's content.
pub struct ArtifactReader {
    /// Length in bytes.
    pub size: u64,
    pub(super) content: Content,
}

pub(super) enum Content {
    Bytes(Bytes),
    File(File),
    Stream(BoxStream<'static, Result<Bytes>>),
}

impl ArtifactReader {
    /// All bytes.
    pub fn whole(self) -> BoxStream<'static, Result<Bytes>> {
        let all = 0..self.size;
        self.part(all)
    }

    /// The bytes of a range that lies within the content.
    pub fn part(self, range: Range<u64>) -> BoxStream<'static, Result<Bytes>> {
        let (start, length) =
            (range.start.min(self.size), range.end.min(self.size).saturating_sub(range.start));
        match self.content {
            Content::Bytes(bytes) => {
                let part = bytes.slice(start as usize..(start + length) as usize);
                stream::iter([Ok(part)]).boxed()
            }
            Content::File(file) => {
                let opened = async move {
                    let mut file = tokio::fs::File::from_std(file);
                    file.seek(SeekFrom::Start(start)).await.map_err(unreadable)?;
                    Ok::<_, StoreError>(
                        ReaderStream::with_capacity(file.take(length), CHUNK).map_err(unreadable),
                    )
                };
                stream::once(opened).try_flatten().boxed()
            }
            Content::Stream(all) => part_of(all, start, length),
        }
    }
}

fn unreadable(error: std::io::Error) -> StoreError {
    StoreError::File { path: "an artefact".to_owned(), source: error }
}

/// A part of a stream that can only be read from its beginning.
fn part_of(
    all: BoxStream<'static, Result<Bytes>>,
    start: u64,
    length: u64,
) -> BoxStream<'static, Result<Bytes>> {
    let (mut skip, mut left) = (start, length);
    all.try_filter_map(move |mut chunk| {
        let skipped = skip.min(chunk.len() as u64);
        skip -= skipped;
        let mut chunk = chunk.split_off(skipped as usize);
        chunk.truncate(usize::try_from(left).unwrap_or(usize::MAX));
        left -= chunk.len() as u64;
        std::future::ready(Ok(Some(chunk).filter(|chunk| !chunk.is_empty())))
    })
    .boxed()
}
