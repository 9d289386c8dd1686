//! Things that people mean by their name, or by their id where several have the name.

use forelight_terminal::failure::BadInput;

/// How messages speak of a kind of thing.
pub struct Kind {
    /// If none is meant, such as `no job has this name`.
    pub none: &'static str,
    /// After the number of several, such as `jobs have this name`.
    pub several: &'static str,
    /// The command that lists them.
    pub list: &'static str,
}

impl Kind {
    /// The error if none is meant, for this reason.
    pub fn missing(&self, wanted: &str, reason: &str) -> BadInput {
        BadInput::new(format!("{wanted}: {reason}")).hint(format!("`{}` lists them", self.list))
    }
}

/// The only thing that was found.
///
/// # Errors
/// If nothing was found, or several things: these are named by their ids.
pub fn the_one<T>(
    wanted: &str,
    mut found: Vec<T>,
    kind: &Kind,
    id: impl Fn(&T) -> String,
) -> Result<T, BadInput> {
    if found.len() > 1 {
        let ids: Vec<String> = found.iter().map(id).collect();
        return Err(BadInput::new(format!("{wanted}: {} {}", ids.len(), kind.several))
            .hint(format!("name one by its id: {}", ids.join(" "))));
    }
    found.pop().ok_or_else(|| kind.missing(wanted, kind.none))
}
