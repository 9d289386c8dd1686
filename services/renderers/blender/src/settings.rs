//! Cycles' own settings.

use forelight_renderer::door::Settings;
use serde_json::{Value, json};
use std::sync::LazyLock;

/// The schema of the settings that other renderers do not have. Where neither file nor job says anything,
/// Blender's own defaults hold.
pub(crate) static SCHEMA: LazyLock<Value> = LazyLock::new(|| {
    json!({
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "camera": {"type": "string", "description": "Name of the camera. Default: the active camera of the file, or those of its markers."},
            "adaptive_sampling": {"type": "boolean", "default": true,
                "description": "Stop sampling a pixel when its noise is below the threshold. Samples are not taken over then."},
            "noise_threshold": {"type": "number", "minimum": 0, "maximum": 1, "default": 0.01,
                "description": "Noise at which adaptive sampling stops. 0: chosen by the number of samples."},
            "minimum_samples": {"type": "integer", "minimum": 0, "maximum": 4096, "default": 0,
                "description": "Least samples of a pixel with adaptive sampling. 0: chosen by the threshold."},
            "denoise": {"type": "boolean", "default": false, "description": "Denoise the image."},
            "compositing": {"type": "boolean", "default": false, "description": "Run the file's compositor."},
            "motion_blur": {"type": "boolean", "default": false, "description": "Blur what moves while the shutter is open."},
            "max_bounces": {"type": "integer", "minimum": 0, "maximum": 1024, "default": 12,
                "description": "Most bounces of a path."},
            "allow_missing": {"type": "boolean", "default": false,
                "description": "Render although files that the scene refers to are missing."},
        },
    })
});

/// Whether a setting is on. Where it is not stated, its default in the schema holds.
pub(crate) fn is_on(settings: &Settings, name: &str) -> bool {
    let stated = settings.own.get(name).and_then(Value::as_bool);
    stated.or_else(|| SCHEMA["properties"][name]["default"].as_bool()).unwrap_or(false)
}

/// Why shares of the samples do not add up to one render at these settings. `None` if they do.
pub(crate) fn why_indivisible(settings: &Settings) -> Option<&'static str> {
    if is_on(settings, "adaptive_sampling") {
        Some("adaptive sampling decides on earlier samples")
    } else if is_on(settings, "denoise") {
        Some("denoising needs the whole image")
    } else if is_on(settings, "compositing") {
        Some("compositing needs the whole image")
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_renderer::door::Common;

    #[test]
    fn samples_can_be_divided_without_adaptive_sampling_denoising_and_compositing() {
        let with = |own: Value| {
            let common = Common { width: 8, height: 8, samples: 4, seed: 0 };
            Settings { common, own: own.as_object().unwrap().clone() }
        };
        let plain = with(json!({"adaptive_sampling": false}));
        assert_eq!(plain.check(&SCHEMA), Ok(()));
        assert_eq!(why_indivisible(&plain), None);
        assert!(why_indivisible(&with(json!({}))).is_some(), "Cycles samples adaptively by default");
        assert!(why_indivisible(&with(json!({"adaptive_sampling": false, "denoise": true}))).is_some());
    }
}
