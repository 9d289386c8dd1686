//! Reading an artefact.

use bytes::Bytes;
use futures::stream::BoxStream;

use crate::error::Result;

/// An artefact's content.
pub struct ArtifactReader {
    /// Length in bytes.
    pub size: u64,
    /// The bytes.
    pub stream: BoxStream<'static, Result<Bytes>>,
}
