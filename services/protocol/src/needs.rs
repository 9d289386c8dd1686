//! What a node must have for the tasks of a job.

use std::fmt;

use crate::{Capabilities, Job, Node, OWN_RENDERER, RenderedBy, RendererId, RendererRequest};

/// How needs end that include a denoiser. No renderer can have this in its name or version.
pub const WITH_DENOISER: &str = " with Open Image Denoise";

/// What a node must have for a task.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct Needs {
    /// The renderer.
    pub renderer: RendererRequest,
    /// Whether it must be able to remove noise.
    pub denoiser: bool,
}

impl Needs {
    /// What quotes and frames of a job need that names this renderer, is rendered by this version of our own,
    /// and has the noise of its images removed or not. `None`: every node will do.
    pub fn of(
        renderer: Option<&RendererRequest>,
        rendered_by: Option<&RenderedBy>,
        denoise: bool,
    ) -> Option<Self> {
        let own = || rendered_by.map(|by| RendererRequest::own(&by.version));
        // Denoised jobs are our own renderer's.
        let any_own = || denoise.then(|| RendererRequest { name: OWN_RENDERER.to_owned(), version: None });
        let renderer = renderer.cloned().or_else(own).or_else(any_own)?;
        Some(Self { renderer, denoiser: denoise })
    }

    /// Our own renderer of this version.
    pub fn own(version: &str, denoiser: bool) -> Self {
        Self { renderer: RendererRequest::own(version), denoiser }
    }
}

impl fmt::Display for Needs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.renderer, if self.denoiser { WITH_DENOISER } else { "" })
    }
}

impl Job {
    /// What a node must have for its quote and its frames. `None`: every node will do.
    pub fn needs(&self) -> Option<Needs> {
        Needs::of(self.renderer.as_ref(), self.rendered_by.as_ref(), self.denoise)
    }
}

impl Node {
    /// Whether it has what tasks need.
    pub fn has(&self, needs: &Needs) -> bool {
        let capabilities = &self.capabilities;
        let has_denoiser = capabilities.denoiser.is_some() || !needs.denoiser;
        has_denoiser && capabilities.renderers.iter().any(|id| needs.renderer.allows(id))
    }
}

impl Capabilities {
    /// All needs that a node with them meets, as texts.
    pub fn answers(&self) -> Vec<String> {
        let alone = self.renderers.iter().flat_map(RendererId::answers_to);
        let own = self.renderers.iter().filter(|id| self.denoiser.is_some() && id.name == OWN_RENDERER);
        let denoised = own.flat_map(RendererId::answers_to).map(|answer| answer + WITH_DENOISER);
        alone.chain(denoised).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_meets_exactly_the_needs_that_it_answers() {
        let cycles = RendererId { name: "cycles".to_owned(), version: "5.0.1".to_owned() };
        let by = RenderedBy { version: "tracer-9".to_owned(), mixed: None };
        let none = Needs::of(None, None, false);
        assert_eq!(none, None);
        let asked = [
            Needs::of(Some(&RendererRequest::from(&cycles)), None, false),
            Needs::of(None, Some(&by), false),
            Needs::of(None, Some(&by), true),
            Needs::of(None, None, true),
        ]
        .map(Option::unwrap);
        let texts = asked.each_ref().map(ToString::to_string);
        assert_eq!(texts[2], "forelight tracer-9 with Open Image Denoise");
        for denoiser in [None, Some("Open Image Denoise 2.5.1".to_owned())] {
            let renderers = vec![RendererId::own(9), cycles.clone()];
            let capabilities = Capabilities { renderers, denoiser, ..Capabilities::default() };
            let expected = [true, true, capabilities.denoiser.is_some(), capabilities.denoiser.is_some()];
            let answers = capabilities.answers();
            assert_eq!(texts.each_ref().map(|text| answers.contains(text)), expected, "{answers:?}");
        }
        let other = Needs::own("tracer-10", false).to_string();
        let capabilities = Capabilities { renderers: vec![RendererId::own(9)], ..Capabilities::default() };
        assert!(!capabilities.answers().contains(&other));
    }
}
