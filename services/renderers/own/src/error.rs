//! Why something cannot be rendered.

use forelight_preview::PreviewError;
use forelight_protocol::BadSetting;
use forelight_scene::SceneError;
use forelight_tracer::{CacheError, ProfileError, SampleCountsError};

/// Why a bundle cannot be rendered as asked.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The bundle, or a frame of it, cannot be loaded.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The frame cannot be previewed.
    #[error(transparent)]
    Preview(#[from] PreviewError),
    /// A setting is out of its range.
    #[error("settings: {0}")]
    Settings(#[from] BadSetting),
    /// The bytes are not a profile.
    #[error("profile: {0}")]
    Profile(#[from] ProfileError),
    /// An irradiance cache cannot be used.
    #[error("{0}")]
    Cache(#[from] CacheError),
    /// The numbers of camera samples do not fit the image.
    #[error("camera samples: {0}")]
    Samples(#[from] SampleCountsError),
    /// The profile belongs to another scene, frame, quality or version.
    #[error(
        "profile: made for another image ({differs}); make it again with this bundle, frame and settings"
    )]
    ForeignProfile {
        /// What differs.
        differs: String,
    },
}

impl RenderError {
    /// Whether the same input would always give this error.
    pub fn is_permanent(&self) -> bool {
        match self {
            // Storage may be temporarily unavailable.
            Self::Scene(SceneError::Io { .. }) => false,
            Self::Preview(PreviewError::EmptyImage { .. } | PreviewError::ImageTooLarge { .. }) => true,
            Self::Preview(error) => matches!(error, PreviewError::Camera(_)),
            Self::Scene(_)
            | Self::Settings(_)
            | Self::Profile(_)
            | Self::Cache(_)
            | Self::Samples(_)
            | Self::ForeignProfile { .. } => true,
        }
    }
}
