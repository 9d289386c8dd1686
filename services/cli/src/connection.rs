//! A connection to the service, from flags and environment.

use anyhow::{Context, Result};
use clap::Args;
use forelight_client::{Client, Token};
use forelight_terminal::failure::BadInput;
use std::fs;
use std::path::{Path, PathBuf};

/// Where a farm keeps the operator's token, below its data folder.
pub const OPERATOR_TOKEN: &str = "tokens/operator.token";

/// Where the service is, and who asks.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Connection")]
pub struct ConnectionOptions {
    /// Address of the service
    #[arg(long, value_name = "URL", env = "FORELIGHT_SERVER", default_value = "http://127.0.0.1:7878")]
    pub server: String,
    /// File that holds the token
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// The token itself; better given by the variable than on the command line
    #[arg(long, value_name = "TOKEN", env = "FORELIGHT_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Data folder of a farm on this machine: its operator token is used
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
}

/// A client that speaks for whoever holds the token; of several tokens given, the most explicit counts: the file, then the
/// text, then the farm's own.
pub fn connect(options: &ConnectionOptions) -> Result<Client> {
    let token = match (&options.token_file, &options.token, &options.data) {
        (Some(file), _, _) => read_token(file)?,
        (None, Some(text), _) => Token::new(text),
        (None, None, Some(data)) => read_token(&data.join(OPERATOR_TOKEN))?,
        (None, None, None) => {
            return Err(BadInput::new("no token was given")
                .hint("set FORELIGHT_TOKEN, or name a file by --token-file, or the farm's folder by --data")
                .into());
        }
    };
    Client::new(&options.server, Some(token)).map_err(|error| BadInput::new(error.to_string()).into())
}

/// The token in a file.
pub fn read_token(path: &Path) -> Result<Token> {
    let text =
        fs::read_to_string(path).with_context(|| format!("cannot read the token file {}", path.display()))?;
    let text = text.trim();
    if text.is_empty() || text.contains(char::is_whitespace) {
        return Err(BadInput::new(format!("{}: the file does not hold a token", path.display())).into());
    }
    Ok(Token::new(text))
}
