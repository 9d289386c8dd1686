//! Artefacts in a remote object store.

use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use futures::stream::BoxStream;
use futures::{StreamExt as _, TryStreamExt as _};
use object_store::path::Path;
use object_store::{MultipartUpload, ObjectMeta, ObjectStore, ObjectStoreExt as _, PutPayload};
use tokio::io::AsyncReadExt as _;

use crate::error::{Result, StoreError};

/// Bytes per part. S3 accepts at most 10,000 parts of at least 5 MiB, except for the last: 80 GB with this.
const PART: usize = 8 << 20;

/// A bucket, or its stand-in in tests.
#[derive(Clone)]
pub(super) struct Remote {
    objects: Arc<dyn ObjectStore>,
    /// Prefix of all names.
    folder: Path,
    /// Name for messages.
    name: String,
}

impl Remote {
    pub fn new(objects: Arc<dyn ObjectStore>, folder: Path, name: String) -> Self {
        Self { objects, folder, name }
    }

    /// Checks that the bucket stores and returns objects, with the same two requests that all work needs. A
    /// permanent refusal is an error. No answer is only a warning, because a service may start before its
    /// bucket.
    pub async fn probe(&self) -> Result<()> {
        const CONTENT: &[u8] = b"artefacts of a forelight farm, named by their BLAKE3 hash\n";
        let place = self.below(&Path::from("farm"));
        let written = self.objects.put(&place, PutPayload::from_static(CONTENT)).await.map(drop);
        let read = match written {
            Ok(()) => self.objects.get(&place).await.map(drop),
            Err(error) => Err(error),
        };
        let refused = |reason: &str| Err(StoreError::ArtifactPlace(format!("{}: {reason}", self.name)));
        match read {
            Ok(()) => Ok(()),
            Err(object_store::Error::NotFound { .. }) => refused("there is no such bucket; create it first"),
            Err(object_store::Error::PermissionDenied { .. }) => {
                refused("the credentials do not allow reading and writing (s3:GetObject, s3:PutObject)")
            }
            Err(object_store::Error::Unauthenticated { .. }) => {
                refused("the server does not know the credentials (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY)")
            }
            Err(error) => {
                let place = &self.name;
                tracing::warn!(place, %error, "the artefact store does not answer yet; requests wait for it");
                Ok(())
            }
        }
    }

    /// Whether an object of this name and length exists.
    pub async fn holds(&self, name: &Path, size: u64) -> Result<bool> {
        match self.objects.head(&self.below(name)).await {
            Ok(meta) => Ok(meta.size == size),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(StoreError::ArtifactsAway(error)),
        }
    }

    /// Uploads a local file. The object appears whole or not at all, and is durable on return: S3 promises
    /// this for an answered PUT and for a completed multipart upload.
    pub async fn upload(&self, file: &std::path::Path, name: &Path) -> Result<()> {
        let place = self.below(name);
        let failed = |error| StoreError::file(file, error);
        let mut source = tokio::fs::File::open(file).await.map_err(failed)?;
        let first = read_part(&mut source).await.map_err(failed)?;
        if first.len() < PART {
            self.objects.put(&place, first.into()).await.map_err(StoreError::ArtifactsAway)?;
            return Ok(());
        }
        let mut upload = self.objects.put_multipart(&place).await.map_err(StoreError::ArtifactsAway)?;
        let sent = async {
            let mut part = first;
            while !part.is_empty() {
                upload.put_part(part.into()).await.map_err(StoreError::ArtifactsAway)?;
                part = read_part(&mut source).await.map_err(failed)?;
            }
            upload.complete().await.map_err(StoreError::ArtifactsAway)
        }
        .await;
        match sent {
            Ok(_) => Ok(()),
            Err(error) => {
                if let Err(leftover) = upload.abort().await {
                    let place = &self.name;
                    tracing::warn!(place, error = %leftover, "could not delete the parts of a failed upload");
                }
                Err(error)
            }
        }
    }

    /// The object's length and content; `None` if it is not there.
    pub async fn get(&self, name: &Path) -> Result<Option<(u64, BoxStream<'static, Result<Bytes>>)>> {
        match self.objects.get(&self.below(name)).await {
            Ok(object) => {
                let size = object.meta.size;
                let stream = object.into_stream().map_err(StoreError::ArtifactsAway).boxed();
                Ok(Some((size, stream)))
            }
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(StoreError::ArtifactsAway(error)),
        }
    }

    /// Deletes an object.
    pub async fn delete(&self, name: &Path) -> Result<()> {
        match self.objects.delete(&self.below(name)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(StoreError::ArtifactsAway(error)),
        }
    }

    /// All objects in a folder.
    pub fn list(&self, folder: &Path) -> BoxStream<'static, Result<ObjectMeta>> {
        self.objects.list(Some(&self.below(folder))).map_err(StoreError::ArtifactsAway).boxed()
    }

    fn below(&self, name: &Path) -> Path {
        self.folder.parts().chain(name.parts()).collect()
    }
}

/// The next part of a file: shorter than [`PART`] only at its end.
async fn read_part(file: &mut tokio::fs::File) -> Result<Bytes, std::io::Error> {
    let mut part = BytesMut::with_capacity(PART);
    let mut rest = file.take(PART as u64);
    while rest.read_buf(&mut part).await? > 0 {}
    Ok(part.freeze())
}
