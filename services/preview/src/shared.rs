//! A previewer that several renderers share, as a process has one graphics device.

use crate::error::PreviewError;
use crate::previewer::{Choice, Previewer};
use parking_lot::Mutex;

/// The previewer, created on first use: opening a graphics device takes longer than many renders.
pub struct SharedPreviewer {
    choice: Choice,
    made: Mutex<Option<Previewer>>,
}

impl SharedPreviewer {
    /// No previewer yet; the first use makes it.
    pub fn new(choice: Choice) -> Self {
        Self { choice, made: Mutex::default() }
    }

    /// Does something with the previewer, while nobody else does. The first use opens the graphics device.
    ///
    /// # Errors
    /// Those of [`Previewer::new`] and of `work`.
    pub fn with<T>(
        &self,
        work: impl FnOnce(&mut Previewer) -> Result<T, PreviewError>,
    ) -> Result<T, PreviewError> {
        let mut made = self.made.lock();
        let previewer = match &mut *made {
            Some(previewer) => previewer,
            none => none.insert(Previewer::new(self.choice)?),
        };
        work(previewer)
    }
}
