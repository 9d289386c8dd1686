//! What known messages of a failed program mean.

use crate::door::RendererError;

/// What a message means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Meaning {
    /// A file or texture is missing.
    MissingFile,
    /// Memory ran out.
    OutOfMemory,
    /// There is no licence.
    Licence,
    /// The GPU failed.
    Gpu,
}

impl Meaning {
    /// The error that a line with this meaning tells of.
    pub fn error(self, line: String) -> RendererError {
        match self {
            Self::MissingFile => RendererError::MissingFile(line),
            Self::OutOfMemory => RendererError::OutOfMemory(line),
            Self::Licence => RendererError::Licence(line),
            Self::Gpu => RendererError::Gpu(line),
        }
    }
}

/// A part of a line, in lower case, and its meaning.
pub type Message = (&'static str, Meaning);

/// Messages of programs in general.
pub const COMMON_MESSAGES: &[Message] = &[
    ("out of memory", Meaning::OutOfMemory),
    ("cannot allocate memory", Meaning::OutOfMemory),
    ("std::bad_alloc", Meaning::OutOfMemory),
    ("memoryerror", Meaning::OutOfMemory),
    ("no such file or directory", Meaning::MissingFile),
    ("license error", Meaning::Licence),
    ("no license", Meaning::Licence),
    ("licence", Meaning::Licence),
    ("cuda error", Meaning::Gpu),
    ("optix error", Meaning::Gpu),
    ("hip error", Meaning::Gpu),
];

/// The error that one of the last lines tells of: the first of the known messages that is found. A GPU that
/// runs out of memory is the GPU's error.
pub(super) fn meaning(lines: &[String], known: &[Message]) -> Option<RendererError> {
    let found = |wanted: Option<Meaning>| {
        known.iter().chain(COMMON_MESSAGES).find_map(|&(part, meaning)| {
            let line = lines.iter().rev().find(|line| line.to_lowercase().contains(part))?;
            (wanted.is_none() || wanted == Some(meaning)).then(|| (meaning, line.clone()))
        })
    };
    let (meaning, line) = found(Some(Meaning::Gpu)).or_else(|| found(None))?;
    Some(meaning.error(line))
}
