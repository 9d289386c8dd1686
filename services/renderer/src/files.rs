//! Files of a task's result.

use bytes::Bytes;
use forelight_protocol::ArtifactHash;

/// Files to upload, named by their hash.
#[derive(Debug, Default)]
pub struct Files {
    /// Contents of the files, in the order in which they were added.
    pub contents: Vec<Bytes>,
}

impl Files {
    /// Adds a file, and returns its name.
    pub fn add(&mut self, content: Vec<u8>) -> ArtifactHash {
        let hash = artifact_name(&content);
        self.contents.push(content.into());
        hash
    }
}

/// Name of an artefact: BLAKE3 hash of its content.
pub fn artifact_name(content: &[u8]) -> ArtifactHash {
    ArtifactHash(*blake3::hash(content).as_bytes())
}
