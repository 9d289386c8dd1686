//! Things that people mean by their name, or by their id where several have the name.

use crate::arguments::Flags;
use crate::failure;
use anyhow::{Result, bail};
use forelight_protocol::JobId;
use forelight_terminal::failure::BadInput;
use std::io::Write as _;
use std::str::FromStr;

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
        // A shell leaves an empty name where a variable is not set.
        let wanted = if wanted.is_empty() { "the name is empty" } else { wanted };
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

/// Jobs.
pub const JOBS: Kind =
    Kind { none: "no job has this name or id", several: "jobs have this name", list: "forelight jobs" };

/// The id of a job, if it is named by it. A job without a name is named by nothing else.
///
/// # Errors
/// If the name is empty.
pub fn job_id(wanted: &str) -> Result<Option<JobId>, BadInput> {
    if wanted.is_empty() {
        return Err(JOBS.missing(wanted, JOBS.none));
    }
    Ok(wanted.parse().ok())
}

/// Parses an id.
///
/// # Errors
/// Says what an id looks like.
pub fn id<T: FromStr>(text: &str) -> Result<T, String> {
    text.parse().map_err(|_| "expected an id, such as 0192f0c1-7a3b-7c55-8f00-0123456789ab".to_owned())
}

/// Does the same to all of several named things, each for itself. What fails is said on standard error, in a
/// line each.
///
/// # Errors
/// That of the only thing. Of several, how many of them failed.
pub async fn each(wanted: &[String], did: &str, act: impl AsyncFn(&str) -> Result<()>) -> Result<()> {
    let mut failed = 0;
    for name in wanted {
        match act(name).await {
            Ok(()) => {}
            Err(error) if wanted.len() == 1 => return Err(error),
            Err(error) => {
                failed += 1;
                // If this write fails, there is no other place to report it.
                let _ = writeln!(std::io::stderr(), "{}", failure::describe(&error, &Flags::default()));
            }
        }
    }
    match failed {
        0 => Ok(()),
        failed => bail!("{failed} of {} could not be {did}", wanted.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn one_that_fails_does_not_stop_the_others() {
        let names = ["a", "b", "c"].map(str::to_owned);
        let done = std::cell::RefCell::new(Vec::new());
        let act = async |name: &str| {
            if name == "b" {
                return Err(JOBS.missing(name, JOBS.none).into());
            }
            done.borrow_mut().push(name.to_owned());
            Ok(())
        };
        let error = each(&names, "cancelled", act).await.unwrap_err();
        assert_eq!(
            (error.to_string(), failure::exit_code(&error)),
            ("1 of 3 could not be cancelled".into(), 1)
        );
        assert_eq!(*done.borrow(), ["a", "c"]);
        let only = each(&names[1..2], "cancelled", act).await.unwrap_err();
        assert_eq!(
            (only.to_string(), failure::exit_code(&only)),
            ("b: no job has this name or id".into(), 2)
        );
        each(&names[..1], "cancelled", act).await.unwrap();
    }

    #[test]
    fn a_name_that_is_empty_is_said_to_be_empty() {
        let error = job_id("").unwrap_err().to_string();
        assert_eq!(error, "the name is empty: no job has this name or id");
        assert_eq!(job_id("kitchen").unwrap(), None);
    }
}
