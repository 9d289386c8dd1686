//! Artefacts: files named by their hash.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::{Payload, Request};
use bytes::Bytes;
use forelight_protocol::{ArtifactHash, ArtifactStored};
use reqwest::Method;
use std::path::Path;
use tokio::io::AsyncWriteExt;

impl Client {
    /// Stores bytes under their BLAKE3 hash. Storing the same bytes again changes nothing.
    pub async fn store(&self, content: Bytes) -> Result<ArtifactHash, ClientError> {
        let hash = ArtifactHash(*blake3::hash(&content).as_bytes());
        let request =
            Request::new(Method::PUT, format!("/v1/artifacts/{hash}")).payload(Payload::Bytes(content));
        let stored: ArtifactStored = self.transport.json(&request).await?;
        verify(hash, stored.hash)?;
        Ok(hash)
    }

    /// Fetches an artefact of at most `most` bytes into memory, and verifies its hash.
    pub async fn artifact(&self, hash: ArtifactHash, most: u64) -> Result<Bytes, ClientError> {
        let too_large = || ClientError::TooLarge { what: format!("artefact {hash}"), most };
        let request = Request::get(format!("/v1/artifacts/{hash}")).timeout(None);
        let mut response = self.transport.send(&request).await?;
        let announced = response.content_length().unwrap_or(0);
        if announced > most {
            return Err(too_large());
        }
        let mut content = Vec::with_capacity(usize::try_from(announced).unwrap_or(0));
        let broken = |source| self.transport.unreachable(&request, source);
        while let Some(chunk) = response.chunk().await.map_err(broken)? {
            if (content.len() + chunk.len()) as u64 > most {
                return Err(too_large());
            }
            content.extend_from_slice(&chunk);
        }
        verify(hash, ArtifactHash(*blake3::hash(&content).as_bytes()))?;
        Ok(content.into())
    }

    /// Streams an artefact into a file, and verifies its hash. The system may write the file to the disk
    /// later.
    pub async fn artifact_to_file(&self, hash: ArtifactHash, path: &Path) -> Result<(), ClientError> {
        let failed = |source| ClientError::File { path: path.into(), source };
        let request = Request::get(format!("/v1/artifacts/{hash}")).timeout(None);
        let mut response = self.transport.send(&request).await?;
        let mut file = tokio::fs::File::create(path).await.map_err(failed)?;
        let mut hasher = blake3::Hasher::new();
        let broken = |source| self.transport.unreachable(&request, source);
        while let Some(chunk) = response.chunk().await.map_err(broken)? {
            hasher.update(&chunk);
            file.write_all(&chunk).await.map_err(failed)?;
        }
        file.flush().await.map_err(failed)?;
        verify(hash, ArtifactHash(*hasher.finalize().as_bytes()))
    }
}

fn verify(expected: ArtifactHash, received: ArtifactHash) -> Result<(), ClientError> {
    if expected == received {
        return Ok(());
    }
    Err(ClientError::Corrupt { what: format!("artefact {expected}"), received: received.to_string() })
}
