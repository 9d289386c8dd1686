//! The connection to the service, from flags and environment.

use crate::data_folder;
use anyhow::{Context, Result};
use clap::Args;
use forelight_client::{Client, Token};
use forelight_terminal::failure::BadInput;
use std::path::{Path, PathBuf};

/// Path of the operator's token, relative to a farm's data folder.
pub const OPERATOR_TOKEN: &str = "tokens/operator.token";

/// Address of a service on this machine.
pub const LOCAL: &str = "http://127.0.0.1:7878";

/// Where the service is.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Connection")]
pub struct ServerOptions {
    /// Address of the service
    #[arg(long, value_name = "URL", env = "FORELIGHT_SERVER", default_value = LOCAL)]
    pub server: String,
    /// Certificates in PEM form, to one of which that of an https:// service must lead [default: those of the
    /// system]
    #[arg(long, value_name = "FILE", env = "FORELIGHT_CA_FILE")]
    pub ca_file: Option<PathBuf>,
}

impl ServerOptions {
    /// A client of the service with this token.
    pub fn client(&self, token: Token) -> Result<Client> {
        let client = match &self.ca_file {
            None => Client::new(&self.server, Some(token)),
            Some(file) => {
                let roots = std::fs::read(file)
                    .with_context(|| format!("cannot read the certificates in {}", file.display()))?;
                Client::trusting(&self.server, Some(token), &roots)
            }
        };
        client.map_err(|error| BadInput::new(error.to_string()).into())
    }

    /// Whether a flag names the service, and not the environment.
    pub fn is_named_by_flag(&self) -> bool {
        self.server != LOCAL && std::env::var("FORELIGHT_SERVER").ok().as_ref() != Some(&self.server)
    }
}

#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Connection")]
pub struct ConnectionOptions {
    #[command(flatten)]
    pub server: ServerOptions,
    #[command(flatten)]
    pub credentials: Credentials,
}

/// Who asks.
#[derive(Debug, Clone, Args)]
pub struct Credentials {
    /// File with the token
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// The token. Prefer the variable, because other users can read the command line
    #[arg(long, value_name = "TOKEN", env = "FORELIGHT_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Data folder of a farm on this machine. Its operator token is used
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
}

/// A client with the token from --token-file, else --token, else the farm's data folder.
pub fn connect(options: &ConnectionOptions) -> Result<Client> {
    let Credentials { token_file, token, data } = &options.credentials;
    // A variable that is set to nothing gives no token.
    let token = token.as_ref().filter(|text| !text.trim().is_empty());
    let token = match (token_file, token, data) {
        (Some(file), _, _) => read_token(file)?,
        (None, Some(text), _) => Token::new(text),
        (None, None, Some(data)) => {
            data_folder::check("--data", data)?;
            read_token(&data.join(OPERATOR_TOKEN))?
        }
        (None, None, None) => {
            return Err(BadInput::new("no token was given")
                .hint("set FORELIGHT_TOKEN, or name a token file with --token-file or the farm's folder with --data")
                .into());
        }
    };
    options.server.client(token)
}

/// The token in a file. Its client reads the file again when the service refuses the token.
pub fn read_token(path: &Path) -> Result<Token> {
    Token::in_file(path)
        .with_context(|| format!("cannot read the token file {}", path.display()))?
        .with_context(|| BadInput::new(format!("{}: the file does not contain a token", path.display())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    fn refused(words: &[&str]) -> anyhow::Error {
        let words = ["forelight"].iter().chain(words).copied();
        connect(&parsed::<ConnectionOptions>(words)).expect_err("it is refused")
    }

    #[test]
    fn who_asks_is_said_before_the_service_is_asked() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("none").display().to_string();
        for (words, said) in [
            (&["--token", ""][..], "no token was given"),
            (&["--data", &missing], "none: this folder does not exist"),
            (&["--token-file", &missing], "cannot read the token file"),
            (&["--token", "t", "--server", "127.0.0.1:7878"], "it must begin with http:// or https://"),
            (&["--token", "t", "--server", "farm:7878"], "it must begin with http:// or https://"),
        ] {
            let error = refused(words);
            assert!(error.to_string().contains(said), "{words:?}: {error}");
            assert_eq!(crate::failure::exit_code(&error), 2, "{words:?}");
        }
    }
}
