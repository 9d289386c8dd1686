//! Why something cannot be rendered.

use forelight_preview::PreviewError;
use forelight_protocol::BadSetting;
use forelight_renderer::door::RendererError;
use forelight_scene::SceneError;
use forelight_tracer::{CacheError, PixelFileError, SampleCountsError};

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
    /// The bytes are not a file of pixels.
    #[error("pixels: {0}")]
    Pixels(#[from] PixelFileError),
    /// An irradiance cache cannot be used.
    #[error("{0}")]
    Cache(#[from] CacheError),
    /// The numbers of camera samples do not fit the image.
    #[error("camera samples: {0}")]
    Samples(#[from] SampleCountsError),
    /// The noise of the image cannot be removed.
    #[error("denoising: {0}")]
    Denoiser(#[from] RendererError),
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
            Self::Denoiser(error) => error.is_permanent(),
            Self::Preview(PreviewError::EmptyImage { .. } | PreviewError::ImageTooLarge { .. }) => true,
            Self::Preview(error) => matches!(error, PreviewError::Camera(_)),
            Self::Scene(_)
            | Self::Settings(_)
            | Self::Pixels(_)
            | Self::Cache(_)
            | Self::Samples(_)
            | Self::ForeignProfile { .. } => true,
        }
    }
}

/// Why a quote cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ShotError {
    /// The renderer failed.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Pixels cannot be chosen.
    #[error(transparent)]
    Forecast(#[from] forelight_forecast::ForecastError),
    /// The quote cannot be computed.
    #[error(transparent)]
    Quote(#[from] forelight_quote::QuoteError),
    /// The caller cancelled.
    #[error("stopped")]
    Cancelled,
}
