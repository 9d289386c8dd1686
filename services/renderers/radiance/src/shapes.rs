//! Shapes of images: the size of the scene's own, and whether a size that a job asks for fits a view.

use crate::installation::{MESSAGES, Radiance};
use crate::scene::{Scene, SceneFrame};
use crate::views::View;
use forelight_renderer::door::{Common, RendererError, Run, SettingsError};
use forelight_renderer::process::run as run_program;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::OnceLock;

/// Width and height, pixels.
type Size = (u32, u32);

/// An image that is so large that rounding its size changes nothing of its shape.
const LARGE: Size = (1 << 20, 1 << 20);

/// Sizes that images of a scene may have.
pub(crate) struct Shapes {
    /// The scene's own: within what it says, and in the shape of the first view.
    pub own: Size,
    /// Size of a large image, by the options that shape it.
    known: Mutex<BTreeMap<String, Size>>,
    /// Whether all views have one shape. vwrays takes as long for each of them as for a small image, so they
    /// are asked for when an answer depends on it.
    is_one: OnceLock<bool>,
}

impl Shapes {
    /// Finds the scene's own size.
    pub fn of(radiance: &Radiance, scene: &Scene, run: &Run<'_>) -> Result<Self, RendererError> {
        let Some(first) = scene.frames.first() else { return Ok(Self::new(scene.size)) };
        let shapes = Self::new(within(scene.size, &first.view, (radiance, scene), run)?);
        let options = first.view.shape();
        if scene.frames.iter().all(|frame| frame.view.shape() == options) {
            let _ = shapes.is_one.set(true);
        }
        Ok(shapes)
    }

    fn new(own: Size) -> Self {
        Self { own, known: Mutex::default(), is_one: OnceLock::new() }
    }

    /// Checks that the size asked for does not distort a frame. Where all views have one shape, a job may ask
    /// for pixels that are no squares.
    pub fn check(
        &self,
        of: (&Radiance, &Scene),
        frame: &SceneFrame,
        common: &Common,
        run: &Run<'_>,
    ) -> Result<(), RendererError> {
        if self.is_one.get() == Some(&true) {
            return Ok(());
        }
        let shape = self.shape(of, &frame.view, run)?;
        let asked = (common.width, common.height);
        // A width or height alone keeps the shape of the scene's own size, which was rounded.
        let is_right = fits(shape, asked)
            || fits(shape, self.own) && (fits(self.own, asked) || self.all_are_one(of, run)?);
        if is_right { Ok(()) } else { Err(wrong(frame, shape, asked).into()) }
    }

    /// Size of a large image of a view.
    fn shape(&self, of: (&Radiance, &Scene), view: &View, run: &Run<'_>) -> Result<Size, RendererError> {
        let options = view.shape().concat().join(" ");
        if let Some(&known) = self.known.lock().get(&options) {
            return Ok(known);
        }
        let shape = within(LARGE, view, of, run)?;
        self.known.lock().insert(options, shape);
        Ok(shape)
    }

    fn all_are_one(&self, of: (&Radiance, &Scene), run: &Run<'_>) -> Result<bool, RendererError> {
        if let Some(&known) = self.is_one.get() {
            return Ok(known);
        }
        for frame in &of.1.frames {
            match self.shape(of, &frame.view, run) {
                Ok(shape) if !fits(shape, self.own) => return Ok(*self.is_one.get_or_init(|| false)),
                // A view that is wrong fails with its own frames.
                Ok(_)
                | Err(
                    RendererError::Ended { .. } | RendererError::MissingFile(_) | RendererError::Answer(_),
                ) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(*self.is_one.get_or_init(|| true))
    }
}

/// The error of a size that does not fit the view of a frame.
fn wrong(frame: &SceneFrame, shape: Size, (asked_width, asked_height): Size) -> SettingsError {
    let (width, height) = largest(shape, (asked_width, asked_height));
    let name = if frame.view.name.is_empty() { String::new() } else { format!(" {}", frame.view.name) };
    let path = if width == asked_width { "/height" } else { "/width" }.to_owned();
    let reason = format!(
        "the view{name} of frame {} needs {width} × {height} pixels, not {asked_width} × {asked_height}; render \
         frames of this shape as a job of their own, with --width {width} --height {height}",
        frame.number
    );
    SettingsError { path, reason }
}

/// The largest image of a view within a size, as vwrays says.
fn within(
    (width, height): Size,
    view: &View,
    (radiance, scene): (&Radiance, &Scene),
    run: &Run<'_>,
) -> Result<Size, RendererError> {
    let program = radiance
        .program("vwrays", &scene.folder, scene.home.path())
        .args(["-d".to_owned(), "-x".to_owned(), width.to_string(), "-y".to_owned(), height.to_string()])
        .args(view.arguments.iter().cloned());
    let mut printed = String::new();
    run_program(&program, MESSAGES, run, &mut |line| printed.push_str(&line.text))?;
    let words: Vec<&str> = printed.split_whitespace().collect();
    let number = |option: &str| {
        let at = words.iter().position(|&word| word == option)?;
        words.get(at + 1)?.parse::<u32>().ok().filter(|&size| size > 0)
    };
    number("-x")
        .zip(number("-y"))
        .ok_or_else(|| RendererError::Answer(format!("vwrays -d printed `{printed}`, which is no size")))
}

/// Whether an image of this size has the shape, but for a pixel of its width or height.
fn fits((across, down): Size, (width, height): Size) -> bool {
    let [across, down, width, height] = [across, down, width, height].map(u64::from);
    (height * across).abs_diff(width * down) <= across.max(down)
}

/// The largest image of the shape within a size.
fn largest((across, down): Size, (width, height): Size) -> Size {
    let scaled = |side: u32, by: u32, over: u32| {
        let over = u64::from(over.max(1));
        let rounded = (2 * u64::from(side) * u64::from(by) + over) / (2 * over);
        u32::try_from(rounded).unwrap_or(u32::MAX).max(1)
    };
    if u64::from(height) * u64::from(across) > u64::from(width) * u64::from(down) {
        (width, scaled(width, down, across))
    } else {
        (scaled(height, across, down), height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(number: i32, name: &str) -> SceneFrame {
        let view = View { name: name.to_owned(), arguments: vec!["-vtv".to_owned()] };
        SceneFrame { number, octree: "a.oct".into(), view }
    }

    #[test]
    fn a_size_fits_a_shape_but_for_a_pixel() {
        let flat = (1_048_576, 486_646);
        for (size, expected) in [((64, 30), true), ((64, 29), true), ((64, 31), false), ((65, 30), true)] {
            assert_eq!(fits(flat, size), expected, "{size:?}");
        }
        // The larger side has more than a pixel for each of the smaller.
        assert!(fits((1_048_576, 104_858), (64, 6)) && !fits((1_048_576, 104_858), (64, 8)));
        assert!(fits((18_303, 1_048_576), (1, 64)));
        assert_eq!(largest(flat, (64, 64)), (64, 30));
        assert_eq!(largest(flat, (512, 222)), (478, 222));
        assert_eq!(largest((18_303, 1_048_576), (9, 9)), (1, 9));
    }

    #[test]
    fn the_error_of_a_size_says_which_one_fits() {
        let flat = (1_048_576, 486_646);
        let said = "setting /height: the view of frame 2 needs 64 × 30 pixels, not 64 × 64; render frames of this \
                    shape as a job of their own, with --width 64 --height 30";
        assert_eq!(wrong(&frame(2, ""), flat, (64, 64)).to_string(), said);
        let said = wrong(&frame(1, "front"), LARGE, (640, 297)).to_string();
        assert!(
            said.starts_with("setting /width: the view front of frame 1 needs 297 × 297 pixels"),
            "{said}"
        );
    }
}
