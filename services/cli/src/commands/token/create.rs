//! `forelight token create`: makes a bearer token, or a one-time token with which a machine joins.

use super::{after, hand_over};
use crate::connection::{LOCAL, ServerOptions, read_token};
use crate::data_folder;
use anyhow::{Context, Result};
use forelight_protocol::{JoinTokenRequest, Role, Timestamp, TokenKind, TokenRequest, UnknownRole};
use forelight_store::Store;
use forelight_terminal::atomic_file;
use forelight_terminal::failure::BadInput;
use forelight_terminal::options::duration;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Make a token
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight token create --data farm-data --role submitter --name anna --expires 90d
  forelight token create --data farm-data --role submitter --project hero-film --project ads=viewer --name anna
  forelight token create --server https://farm:7878 --token-file operator.token --role viewer --name wall-screen

With --data, the token is made in that folder, whether the service runs or not. With an operator's token, the \
service is asked.")]
pub struct Args {
    #[command(flatten)]
    pub options: Options,
}

#[derive(Debug, clap::Args)]
pub struct Options {
    /// Data folder of the farm [default: farm-data]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Role of the token: viewer, submitter, worker or operator
    #[arg(long, value_name = "ROLE", required_unless_present = "one_time")]
    role: Option<Role>,
    /// Reach only this project, with --role, or with another role: NAME=viewer. May be repeated
    #[arg(long, value_name = "NAME[=ROLE]", requires = "role", value_parser = project)]
    project: Vec<(String, Option<Role>)>,
    /// The token belongs to a service, not to a person
    #[arg(long, conflicts_with = "one_time")]
    service: bool,
    /// Create a one-time token, with which one machine joins the farm as a node
    #[arg(long, conflicts_with = "role")]
    one_time: bool,
    /// Time for which a one-time token is valid, such as 24h [default: 24h]
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    valid: Option<Duration>,
    /// Time until the token expires, such as 90d [default: never]
    #[arg(long, value_name = "DURATION", value_parser = duration, conflicts_with = "one_time")]
    expires: Option<Duration>,
    /// Name of the person or machine. A one-time token with a node's name lets a machine replace that node
    #[arg(long, value_name = "NAME", default_value = "unnamed")]
    name: String,
    /// Write the token to this file, readable by its owner alone, instead of printing it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// File with the operator's token
    #[arg(long, value_name = "FILE", conflicts_with = "data")]
    token_file: Option<PathBuf>,
    #[command(flatten)]
    server: ServerOptions,
}

/// How long a one-time token is valid without --valid.
const DAY: Duration = Duration::from_secs(24 * 3600);

fn project(text: &str) -> Result<(String, Option<Role>), String> {
    match text.rsplit_once('=') {
        Some((name, role)) => {
            Ok((name.to_owned(), Some(role.parse().map_err(|e: UnknownRole| e.to_string())?)))
        }
        None => Ok((text.to_owned(), None)),
    }
}

pub async fn run(args: Options) -> Result<()> {
    let name = args.name.trim();
    if name.is_empty() || name.chars().count() > 200 {
        return Err(BadInput::new("--name: a name has 1 to 200 characters").into());
    }
    // clap would not require --one-time, which --role excludes.
    if args.valid.is_some() && !args.one_time {
        return Err(BadInput::new("--valid: only a one-time token has this; add --one-time")
            .hint("--expires says when another token ends")
            .into());
    }
    if args.token_file.is_none() && args.data.is_some() && args.server.is_named_by_flag() {
        let reason = format!(
            "--server {}: cannot be used with --data, which makes the token in the farm's folder",
            args.server.server
        );
        let hint = "leave out --server, or replace --data by --token-file FILE with an operator's token";
        return Err(BadInput::new(reason).hint(hint).into());
    }
    atomic_file::check([args.out.as_deref()])?;
    if args.token_file.is_none() && args.data.is_none() && args.server.server != LOCAL {
        return Err(BadInput::new(format!(
            "the service at {} makes a token for an operator only",
            args.server.server
        ))
        .hint("add --token-file FILE with an operator's token, or --data DIR for the farm in that folder")
        .into());
    }
    let request = args.role.map(|role| {
        let projects = args.project.iter().map(|(name, own)| (name.clone(), own.unwrap_or(role)));
        let projects = Some(projects.collect::<BTreeMap<_, _>>()).filter(|projects| !projects.is_empty());
        let is_service = args.service || role == Role::Worker;
        TokenRequest {
            name: name.to_owned(),
            kind: if is_service { TokenKind::Service } else { TokenKind::Person },
            role: Some(role).filter(|_| projects.is_none()),
            projects,
            expires_at: args.expires.map(after),
        }
    });
    let is_for_the_farm = |role: &Role| matches!(role, Role::Worker | Role::Operator);
    if request.iter().flat_map(|request| &request.projects).flat_map(BTreeMap::values).any(is_for_the_farm) {
        return Err(BadInput::new("--project: workers and operators are for the whole farm")
            .hint("in a project, a token is a viewer's or a submitter's")
            .into());
    }
    let secret = match &args.token_file {
        Some(file) => by_the_service(&args, file, request.as_ref()).await?,
        None => in_the_folder(&args, request.as_ref()).await?,
    };
    hand_over(&secret, args.out.as_deref())
}

async fn by_the_service(args: &Options, token_file: &Path, request: Option<&TokenRequest>) -> Result<String> {
    let client = args.server.client(read_token(token_file)?)?;
    match request {
        Some(request) => Ok(client.create_token(request).await.context("cannot make the token")?.secret),
        None => {
            let hours = args.valid.unwrap_or(DAY).as_secs().div_ceil(3600);
            let request = JoinTokenRequest {
                name: args.name.trim().to_owned(),
                valid_hours: u32::try_from(hours).unwrap_or(u32::MAX),
            };
            Ok(client.create_join_token(&request).await.context("cannot make the one-time token")?.token)
        }
    }
}

async fn in_the_folder(args: &Options, request: Option<&TokenRequest>) -> Result<String> {
    let data = args.data.clone().unwrap_or_else(|| PathBuf::from("farm-data"));
    data_folder::check("--data", &data)?;
    let store = Store::open_beside(&data)
        .await
        .with_context(|| format!("cannot open the farm's data in {}", data.display()))?;
    let now = Timestamp::now();
    let secret = match request {
        Some(request) => store.create_token(request, now).await?.secret,
        None => {
            let valid = i64::try_from(args.valid.unwrap_or(DAY).as_micros()).unwrap_or(i64::MAX);
            store.create_join_token(args.name.trim(), valid, now).await?.token
        }
    };
    store.close().await;
    Ok(secret)
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    #[tokio::test]
    async fn flags_that_would_have_no_effect_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().display().to_string();
        for (words, flag) in [
            (&["--role", "viewer", "--valid", "1h"][..], "--valid"),
            (&["--role", "viewer", "--server", "http://farm:1"], "--server http://farm:1"),
        ] {
            let words = [&["token", "--data", data.as_str()][..], words].concat();
            let error = run(parsed::<Options>(words)).await.unwrap_err();
            assert!(error.to_string().contains(flag), "{error}");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{flag}: a token was made");
        }
    }
}
