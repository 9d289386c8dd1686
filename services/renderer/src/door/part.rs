//! Parts of a frame: what a renderer is asked to measure.

use super::{Common, RendererError};
use serde::{Deserialize, Serialize};

/// A rectangle of the image, pixels from the top left corner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Region {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

/// A part of a frame, to be measured.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// `count` of the samples of every pixel, from the sample `offset` on.
    Samples {
        /// Number of samples before these.
        offset: u32,
        /// Number of samples.
        count: u32,
    },
    /// Rectangles, with all samples.
    Regions(Vec<Region>),
    /// Pixels by index, in rows from the top, with all samples.
    Pixels(Vec<u32>),
}

impl Region {
    fn is_inside(&self, image: &Common) -> bool {
        let inside = |start: u32, length: u32, all: u32| {
            length > 0 && start.checked_add(length).is_some_and(|end| end <= all)
        };
        inside(self.x, self.width, image.width) && inside(self.y, self.height, image.height)
    }
}

impl Part {
    /// Checks that the part is not empty, and lies within the frame.
    ///
    /// # Errors
    /// [`RendererError::Unsupported`], with the samples, the region or the pixel that is outside.
    pub fn check(&self, frame: &Common) -> Result<(), RendererError> {
        match self.outside(frame) {
            Some(what) => Err(RendererError::Unsupported(format!("cannot measure {what}"))),
            None => Ok(()),
        }
    }

    fn outside(&self, frame: &Common) -> Option<String> {
        let Common { width, height, samples, .. } = *frame;
        match self {
            &Self::Samples { offset, count } => {
                let fits = count > 0 && offset.checked_add(count).is_some_and(|end| end <= samples);
                let end = u64::from(offset) + u64::from(count);
                (!fits).then(|| format!("samples {offset} to {end} of {samples}"))
            }
            Self::Regions(regions) => regions.iter().find(|region| !region.is_inside(frame)).map(|r| {
                format!(
                    "the region {} × {} at ({}, {}) of an image of {width} × {height}",
                    r.width, r.height, r.x, r.y
                )
            }),
            Self::Pixels(pixels) => pixels
                .iter()
                .find(|&&pixel| u64::from(pixel) >= frame.pixels())
                .map(|pixel| format!("pixel {pixel} of an image of {width} × {height}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_outside_of_its_frame_is_named() {
        let frame = Common { width: 8, height: 4, samples: 16, seed: 0 };
        let refused = |part: Part| part.check(&frame).unwrap_err().to_string();
        let region = |x, width| Part::Regions(vec![Region { x, y: 0, width, height: 4 }]);
        for part in [Part::Samples { offset: 10, count: 6 }, region(4, 4), Part::Pixels(vec![0, 31])] {
            assert!(part.check(&frame).is_ok(), "{part:?}");
        }
        for (part, named) in [
            (Part::Samples { offset: 10, count: 7 }, "samples 10 to 17 of 16"),
            (Part::Samples { offset: 3, count: 0 }, "samples 3 to 3 of 16"),
            (Part::Samples { offset: u32::MAX, count: 1 }, "samples 4294967295 to 4294967296 of 16"),
            (region(4, 5), "5 × 4 at (4, 0) of an image of 8 × 4"),
            (region(u32::MAX, 1), "at (4294967295, 0)"),
            (region(0, 0), "0 × 4 at (0, 0)"),
            (Part::Pixels(vec![0, 32]), "pixel 32 of an image of 8 × 4"),
        ] {
            assert!(refused(part).contains(named), "{named}");
        }
    }
}
