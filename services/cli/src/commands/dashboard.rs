//! `forelight dashboard`: opens the farm's page in a browser, signed in.

use super::serve::sign_in_link;
use crate::connection::{ConnectionOptions, connect};
use anyhow::{Context, Result};
use forelight_terminal::output;
use std::io::IsTerminal as _;

/// Open the farm's dashboard in a browser, signed in
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight dashboard --data farm-data
  forelight dashboard --server http://farm:7878 --token-file me.token
  forelight dashboard --print --data farm-data

The link holds a code that signs in once, within five minutes, with the rights of your token. Without a browser, or \
if the output is not a terminal, the link is printed instead. On the page you can also sign in with a token.")]
pub struct Args {
    /// Print the link instead of opening a browser
    #[arg(long)]
    print: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let code = client.session_code().await.context("cannot get a code to sign in with")?;
    let link = sign_in_link(client.address(), &code.code);
    if args.print || !std::io::stdout().is_terminal() {
        return output::line(link);
    }
    match open::that_detached(&link) {
        Ok(()) => output::line(format!("opening {}/ in a browser", client.address())),
        Err(error) => {
            tracing::debug!(%error, "no browser could be opened");
            output::line(format!("no browser was found; open this link within five minutes:\n{link}"))
        }
    }
}
