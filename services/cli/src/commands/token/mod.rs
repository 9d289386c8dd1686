//! `forelight token`: makes, lists, renames, rotates and revokes bearer tokens.

mod create;

use crate::connection::{ConnectionOptions, connect};
use crate::named::{Kind, each, the_one};
use anyhow::{Context, Result};
use clap::Subcommand;
use forelight_client::Client;
use forelight_protocol::{Role, RotateRequest, Timestamp, Token, TokenChange, TokenId};
use forelight_terminal::atomic_file;
use forelight_terminal::failure::BadInput;
use forelight_terminal::options::duration;
use forelight_terminal::output;
use forelight_terminal::quantities::clock;
use forelight_terminal::table::{Align, Table};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// Make, list, rotate and revoke bearer tokens of people and workers
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(after_help = "\
Examples:
  forelight token --data farm-data --role submitter --name anna
  forelight token --data farm-data --role worker --name rack-7 --out rack-7.token
  forelight token --data farm-data --one-time --name rack-8 --out rack-8.join
  forelight token list --data farm-data
  forelight token rotate anna --data farm-data --out anna.token
  forelight token revoke rack-7 --data farm-data

Without a subcommand, a token is made, as by `forelight token create`. A token is printed or written once; the farm \
keeps only its hash.

Roles:
  viewer      reads
  submitter   reads, and submits jobs and bundles
  worker      registers a node and takes tasks; reads nothing else
  operator    does everything

A one-time token lets one machine join the farm once: `forelight worker --join-token-file rack-8.join --token-file \
rack-8.token`. The machine then gets its own token, which is valid for its node only. To replace an existing node, \
give the one-time token the --name of that node.")]
pub struct Args {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    create: create::Options,
}

#[derive(Debug, Subcommand)]
enum Command {
    Create(create::Args),
    List(ListArgs),
    Rename(RenameArgs),
    Rotate(RotateArgs),
    Revoke(RevokeArgs),
}

/// List the tokens: whose they are, when they expire, and when they were last used
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight token list --data farm-data
  forelight token list --json --server https://farm:7878 --token-file operator.token")]
struct ListArgs {
    /// Print the tokens as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Change a token's name, or when it expires
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight token rename anna --to anna-laptop --data farm-data
  forelight token rename anna --expires 30d --data farm-data
  forelight token rename anna --expires never --data farm-data")]
struct RenameArgs {
    /// Id of the token. A name works if only one token has it
    #[arg(value_name = "TOKEN")]
    wanted: String,
    /// The new name
    #[arg(long, value_name = "NAME", required_unless_present = "expires")]
    to: Option<String>,
    /// Time until it expires, such as 30d, or `never`
    #[arg(long, value_name = "DURATION", value_parser = end)]
    expires: Option<End>,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Replace a token by a new one with the same rights
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight token rotate anna --data farm-data --out anna.token
  forelight token rotate rack-7 --grace 10m --out rack-7.token --data farm-data

The old token ends at once, or after the grace, and its sessions with it. A worker or command that was started with \
--token-file reads the file again when its token is refused. So a token that is rotated into that file interrupts \
nothing.")]
struct RotateArgs {
    /// Id of the token. A name works if only one token has it
    #[arg(value_name = "TOKEN")]
    wanted: String,
    /// Time for which the old token is still valid, such as 10m; at most a week
    #[arg(long, value_name = "DURATION", default_value = "0s", value_parser = grace)]
    grace: Duration,
    /// Write the token to this file, readable by its owner alone, instead of printing it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Revoke tokens at once, with their sessions and open streams
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight token revoke anna --data farm-data
  forelight token revoke 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data")]
struct RevokeArgs {
    /// Ids of the tokens. A name works if only one token has it
    #[arg(required = true, value_name = "TOKEN")]
    tokens: Vec<String>,
    #[command(flatten)]
    connection: ConnectionOptions,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Never,
    After(Duration),
}

fn end(text: &str) -> Result<End, String> {
    if text == "never" { Ok(End::Never) } else { duration(text).map(End::After) }
}

fn grace(text: &str) -> Result<Duration, String> {
    if text == "0s" { Ok(Duration::ZERO) } else { duration(text) }
}

/// The instant this long from now.
fn after(time: Duration) -> Timestamp {
    Timestamp::now().plus_micros(i64::try_from(time.as_micros()).unwrap_or(i64::MAX))
}

pub async fn run(args: Args) -> Result<()> {
    match args.command {
        None => create::run(args.create).await,
        Some(Command::Create(create)) => create::run(create.options).await,
        Some(Command::List(list)) => {
            let tokens = connect(&list.connection)?.tokens().await.context("cannot list the tokens")?;
            if list.json { output::json(&tokens) } else { output::print(&report(&tokens, Timestamp::now())) }
        }
        Some(Command::Rename(rename)) => {
            let client = connect(&rename.connection)?;
            let token = find(&client, &rename.wanted).await?;
            let expires_at = rename.expires.map(|end| match end {
                End::Never => None,
                End::After(time) => Some(after(time)),
            });
            let change = TokenChange { name: rename.to, expires_at, projects: None };
            let changed = client.change_token(token.id, &change).await.context("cannot change the token")?;
            output::print(&report(&[changed], Timestamp::now()))
        }
        Some(Command::Rotate(rotate)) => {
            atomic_file::check([rotate.out.as_deref()])?;
            let client = connect(&rotate.connection)?;
            let token = find(&client, &rotate.wanted).await?;
            let grace_seconds = u32::try_from(rotate.grace.as_secs()).unwrap_or(u32::MAX);
            let new = client.rotate_token(token.id, &RotateRequest { grace_seconds }).await;
            hand_over(&new.context("cannot rotate the token")?.secret, rotate.out.as_deref())
        }
        Some(Command::Revoke(revoke)) => {
            let client = connect(&revoke.connection)?;
            // Nothing is revoked if one is not known.
            for wanted in &revoke.tokens {
                find(&client, wanted).await?;
            }
            each(&revoke.tokens, "revoked", async |wanted: &str| {
                let Token { id, name, .. } = find(&client, wanted).await?;
                client.revoke_token(id).await.with_context(|| format!("cannot revoke {name}"))?;
                output::line(format!("{name} ({id}) is revoked"))
            })
            .await
        }
    }
}

/// Writes a secret to the file, or prints it: once. If it cannot be written, it is printed, for there is no other
/// copy.
fn hand_over(secret: &str, out: Option<&std::path::Path>) -> Result<()> {
    let Some(path) = out else { return output::line(secret) };
    atomic_file::write_secret(path, secret.as_bytes()).or_else(|error| {
        output::line(secret)?;
        Err(error)
    })
}

const TOKENS: Kind = Kind {
    none: "no token has this id or name",
    several: "tokens have this name",
    list: "forelight token list",
};

/// The token with this id, or the only one with this name.
async fn find(client: &Client, wanted: &str) -> Result<Token> {
    let tokens = client.tokens().await.context("cannot list the tokens")?;
    only_one(wanted, tokens, Timestamp::now()).map_err(Into::into)
}

fn only_one(wanted: &str, tokens: Vec<Token>, now: Timestamp) -> Result<Token, BadInput> {
    let id: Option<TokenId> = wanted.parse().ok();
    let is_meant = |token: &Token| Some(token.id) == id || token.name == wanted;
    let is_valid = |token: &Token| token.expires_at.is_none_or(|end| end > now);
    let mut found: Vec<Token> = tokens.into_iter().filter(is_meant).collect();
    // Expired tokens stay in the list for a while, such as the one before a rotation.
    if found.len() > 1 && found.iter().any(is_valid) {
        found.retain(is_valid);
    }
    the_one(wanted, found, &TOKENS, |token| token.id.to_string())
}

fn report(tokens: &[Token], now: Timestamp) -> String {
    let mut table = Table::new(&[
        ("name", Align::Left),
        ("role", Align::Left),
        ("projects", Align::Left),
        ("made", Align::Right),
        ("expires", Align::Right),
        ("last used", Align::Right),
        ("", Align::Left),
        ("id", Align::Left),
    ]);
    for token in tokens {
        let time = |at: Option<Timestamp>| at.map_or("-".into(), |at| clock(at, now));
        table.row([
            token.name.clone(),
            token.role.to_string(),
            token.projects.as_ref().map_or("all".into(), projects),
            clock(token.created_at, now),
            time(token.expires_at),
            time(token.last_used_at),
            if token.expires_at.is_some_and(|end| end <= now) { "expired".into() } else { String::new() },
            token.id.to_string(),
        ]);
    }
    table.render()
}

fn projects(projects: &BTreeMap<String, Role>) -> String {
    let words = projects.iter().map(|(name, role)| format!("{name}={role}"));
    words.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::TokenKind;

    fn token(name: &str) -> Token {
        Token {
            id: TokenId::new(),
            name: name.into(),
            kind: TokenKind::Person,
            role: Role::Viewer,
            projects: None,
            node_id: None,
            created_at: Timestamp::from_micros(0),
            expires_at: None,
            last_used_at: None,
        }
    }

    #[test]
    fn a_name_is_enough_where_one_token_has_it() {
        let (anna, first, second) = (token("anna"), token("screen"), token("screen"));
        let all = || vec![anna.clone(), first.clone(), second.clone()];
        let now = Timestamp::from_micros(5);
        let found = |wanted: &str, all| only_one(wanted, all, now).map_err(|error| error.to_string());
        assert_eq!(found("anna", all()), Ok(anna.clone()));
        assert_eq!(found(&second.id.to_string(), all()), Ok(second.clone()));
        let before = Token { expires_at: Some(now), ..token("anna") };
        assert_eq!(found("anna", vec![before.clone(), anna.clone()]), Ok(anna.clone()));
        assert_eq!(found("anna", vec![before.clone()]), Ok(before));
        let refused = |wanted: &str| found(wanted, all()).unwrap_err();
        assert_eq!(refused("screen"), "screen: 2 tokens have this name");
        assert_eq!(refused("bert"), "bert: no token has this id or name");
    }

    #[test]
    fn a_token_that_expired_is_marked() {
        let now = Timestamp::from_micros(10_000_000);
        let expired = Token { expires_at: Some(now), ..token("anna") };
        assert!(report(&[expired], now).contains("expired"));
        assert!(!report(&[token("anna")], now).contains("expired"));
    }
}
