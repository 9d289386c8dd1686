//! `forelight webhook`: the addresses that the farm tells of events, and what each was told.

use crate::connection::{ConnectionOptions, connect};
use crate::named::{Kind, the_one};
use anyhow::{Context, Result, bail};
use clap::Subcommand;
use forelight_client::Client;
use forelight_protocol::words::by_name;
use forelight_protocol::{
    Delivery, DeliveryState, Timestamp, Webhook, WebhookId, WebhookKind, WebhookRequest,
};
use forelight_terminal::atomic_file;
use forelight_terminal::failure::BadInput;
use forelight_terminal::output;
use forelight_terminal::quantities::clock;
use forelight_terminal::table::{Align, Table};
use serde_json::Value;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// List, add, test and remove webhooks: addresses that the farm tells of events
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight webhook list --data farm-data
  forelight webhook add https://chat.example/hook --template '{\"text\": \"{text}\"}' --data farm-data
  forelight webhook add https://studio.example/farm --kinds job_done,job_failed --project film --data farm-data
  forelight webhook test https://chat.example/hook --data farm-data
  forelight webhook deliveries https://chat.example/hook --data farm-data
  forelight webhook remove https://chat.example/hook --data farm-data

A webhook is told of promises at risk and safe again, jobs that are done or failed, budgets that reach a threshold, \
and nodes that are set aside. A message that is not answered with 2xx is sent again for a day. The farm never waits \
for a receiver.")]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    List(ListArgs),
    Add(AddArgs),
    Test(TestArgs),
    Deliveries(DeliveriesArgs),
    Remove(RemoveArgs),
}

/// List the webhooks
#[derive(Debug, clap::Args)]
struct ListArgs {
    /// Print the webhooks as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Add a webhook. It is told of what happens from now on
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight webhook add https://chat.example/hook --template '{\"text\": \"{text}\"}' --data farm-data
  forelight webhook add https://studio.example/farm --kinds node_set_aside,budget --out hook.secret --data farm-data

The secret signs what is sent (Standard Webhooks), and is printed or written once. In the strings of a template, \
{text}, {kind}, {job}, {project} and {url} are replaced. `--template '{\"text\": \"{text}\"}'` suits most chat services.")]
struct AddArgs {
    /// Address of the receiver, http or https
    url: String,
    /// What it is told of [default: everything]
    #[arg(long, value_name = "KIND,...", value_delimiter = ',', value_parser = by_name::<WebhookKind>)]
    kinds: Vec<WebhookKind>,
    /// Tell it of jobs and budgets of this project alone [default: of all, and of nodes]
    #[arg(long, value_name = "NAME")]
    project: Option<String>,
    /// The body that it gets, as JSON [default: a `WebhookMessage`, see docs/api.md]
    #[arg(long, value_name = "JSON", value_parser = template)]
    template: Option<Value>,
    /// Write the secret to this file, readable by its owner alone, instead of printing it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Send a test message, and say what the receiver answered. Fails if it was not delivered
#[derive(Debug, clap::Args)]
struct TestArgs {
    /// Id of the webhook. Its address works if only one webhook has it
    #[arg(value_name = "WEBHOOK")]
    wanted: String,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// List what a webhook was told, newest first
#[derive(Debug, clap::Args)]
struct DeliveriesArgs {
    /// Id of the webhook. Its address works if only one webhook has it
    #[arg(value_name = "WEBHOOK")]
    wanted: String,
    /// List at most this many, 1 to 200
    #[arg(long, value_name = "COUNT", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=200))]
    most: u32,
    /// Print the deliveries as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Remove a webhook and the list of its deliveries
#[derive(Debug, clap::Args)]
struct RemoveArgs {
    /// Id of the webhook. Its address works if only one webhook has it
    #[arg(value_name = "WEBHOOK")]
    wanted: String,
    #[command(flatten)]
    connection: ConnectionOptions,
}

fn template(text: &str) -> Result<Value, String> {
    serde_json::from_str(text).map_err(|error| format!("this is no JSON: {error}"))
}

pub async fn run(args: Args) -> Result<()> {
    match args.command {
        Command::List(list) => {
            let webhooks = connect(&list.connection)?.webhooks().await.context("cannot list the webhooks")?;
            if list.json { output::json(&webhooks) } else { output::print(&report(&webhooks)) }
        }
        Command::Add(add) => add_webhook(add).await,
        Command::Test(test) => {
            let client = connect(&test.connection)?;
            let webhook = find(&client, &test.wanted).await?;
            let answer = tested(&client, webhook.id).await.with_context(|| webhook.url.clone())?;
            output::line(format!("{}: {answer}", webhook.url))
        }
        Command::Deliveries(list) => {
            let client = connect(&list.connection)?;
            let webhook = find(&client, &list.wanted).await?;
            let told =
                client.deliveries(webhook.id, list.most).await.context("cannot list the deliveries")?;
            if list.json { output::json(&told) } else { output::print(&history(&told, Timestamp::now())) }
        }
        Command::Remove(remove) => {
            let client = connect(&remove.connection)?;
            let webhook = find(&client, &remove.wanted).await?;
            client.remove_webhook(webhook.id).await.context("cannot remove the webhook")?;
            output::line(format!("{} ({}) is removed", webhook.url, webhook.id))
        }
    }
}

async fn add_webhook(args: AddArgs) -> Result<()> {
    atomic_file::check([args.out.as_deref()])?;
    let client = connect(&args.connection)?;
    let kinds = (!args.kinds.is_empty()).then_some(args.kinds);
    let request = WebhookRequest { url: args.url, kinds, project: args.project, template: args.template };
    let webhook = client.add_webhook(&request).await.context("cannot add the webhook")?;
    let secret = webhook.secret.unwrap_or_default();
    match &args.out {
        Some(path) => {
            atomic_file::write_secret(path, secret.as_bytes())?;
            output::line(webhook.id.to_string())
        }
        None => output::line(format!("{}\nsecret {secret}", webhook.id)),
    }
}

/// Sends a test, and waits for its first attempt: what the receiver answered.
///
/// # Errors
/// If it was not delivered, although it will be sent again.
async fn tested(client: &Client, webhook: WebhookId) -> Result<String> {
    /// Longer than a receiver may take to answer.
    const PATIENCE: Duration = Duration::from_secs(20);
    let before = client.deliveries(webhook, 1).await.context("cannot list the deliveries")?;
    let before = before.first().map(|delivery| delivery.id);
    client.test_webhook(webhook).await.context("cannot test the webhook")?;
    let begun = Instant::now();
    while begun.elapsed() < PATIENCE {
        let told = client.deliveries(webhook, 200).await.context("cannot list the deliveries")?;
        let test = told.into_iter().find(|one| one.kind == WebhookKind::Test);
        if let Some(test) = test.filter(|test| Some(test.id) > before && test.attempts > 0) {
            return match test.error {
                None => Ok(format!("the receiver answered {}", test.status.unwrap_or_default())),
                Some(error) => bail!("not delivered: {error}; it will be sent again"),
            };
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    bail!("the test was not sent yet; see `forelight webhook deliveries`")
}

const WEBHOOKS: Kind = Kind {
    none: "no webhook has this id or address",
    several: "webhooks have this address",
    list: "forelight webhook list",
};

/// The webhook with this id, or the only one with this address.
async fn find(client: &Client, wanted: &str) -> Result<Webhook> {
    let webhooks = client.webhooks().await.context("cannot list the webhooks")?;
    only_one(wanted, webhooks).map_err(Into::into)
}

fn only_one(wanted: &str, webhooks: Vec<Webhook>) -> Result<Webhook, BadInput> {
    let id: Option<WebhookId> = wanted.parse().ok();
    let is_meant = |webhook: &Webhook| Some(webhook.id) == id || webhook.url == wanted;
    let found = webhooks.into_iter().filter(is_meant).collect();
    the_one(wanted, found, &WEBHOOKS, |webhook| webhook.id.to_string())
}

fn report(webhooks: &[Webhook]) -> String {
    if webhooks.is_empty() {
        return "no webhooks\n".into();
    }
    let mut table = Table::new(&[
        ("webhook", Align::Left),
        ("address", Align::Left),
        ("told of", Align::Left),
        ("project", Align::Left),
        ("to send", Align::Right),
    ]);
    for webhook in webhooks {
        let kinds = match webhook.kinds.len() {
            all if all == WebhookKind::ALL.len() => "everything".to_owned(),
            _ => webhook.kinds.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", "),
        };
        table.row([
            webhook.id.to_string(),
            webhook.url.clone(),
            kinds,
            webhook.project.clone().unwrap_or_else(|| "all".to_owned()),
            webhook.pending.to_string(),
        ]);
    }
    table.render()
}

fn history(deliveries: &[Delivery], now: Timestamp) -> String {
    if deliveries.is_empty() {
        return "it was told nothing yet\n".into();
    }
    let mut table = Table::new(&[
        ("seen", Align::Left),
        ("told of", Align::Left),
        ("state", Align::Left),
        ("attempts", Align::Right),
        ("last answer", Align::Left),
        ("next attempt", Align::Left),
    ]);
    for delivery in deliveries {
        let state = match delivery.state {
            DeliveryState::Pending => "to send",
            DeliveryState::Delivered => "delivered",
            DeliveryState::GivenUp => "given up",
        };
        let status = delivery.status.map(|status| status.to_string());
        table.row([
            clock(delivery.created_at, now),
            delivery.kind.name().to_owned(),
            state.to_owned(),
            delivery.attempts.to_string(),
            delivery.error.clone().or(status).unwrap_or_default(),
            delivery.next_at.map(|at| clock(at, now)).unwrap_or_default(),
        ]);
    }
    table.render()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn webhook(url: &str, kinds: &[WebhookKind]) -> Webhook {
        Webhook {
            id: WebhookId::new(),
            url: url.to_owned(),
            kinds: kinds.to_vec(),
            project: None,
            template: None,
            secret: None,
            pending: 3,
            created_at: Timestamp::from_micros(0),
        }
    }

    #[test]
    fn an_address_is_enough_where_one_webhook_has_it() {
        let [one, two] = [webhook("http://a", &[]), webhook("http://b", &[])];
        let all = || vec![one.clone(), two.clone(), webhook("http://b", &[])];
        assert_eq!(only_one("http://a", all()).map_err(|error| error.to_string()), Ok(one.clone()));
        assert_eq!(only_one(&two.id.to_string(), all()).map_err(|error| error.to_string()), Ok(two.clone()));
        let refused = |wanted: &str| only_one(wanted, all()).unwrap_err().to_string();
        assert_eq!(refused("http://b"), "http://b: 2 webhooks have this address");
        assert_eq!(refused("http://c"), "http://c: no webhook has this id or address");
    }

    #[test]
    fn lists_say_what_is_told_and_what_became_of_it() {
        let shown =
            report(&[webhook("http://a", &[WebhookKind::JobDone]), webhook("http://b", &WebhookKind::ALL)]);
        assert!(shown.contains("job_done") && shown.contains("everything"), "{shown}");
        let delivery = Delivery {
            id: forelight_protocol::DeliveryId::new(),
            kind: WebhookKind::NodeSetAside,
            event_id: Some(7),
            job_id: None,
            state: DeliveryState::Pending,
            attempts: 2,
            status: Some(500),
            error: Some("the receiver answered 500 Internal Server Error".to_owned()),
            created_at: Timestamp::from_micros(0),
            next_at: Some(Timestamp::from_micros(4_000_000)),
            ended_at: None,
        };
        let shown = history(&[delivery], Timestamp::from_micros(1));
        assert!(shown.contains("node_set_aside") && shown.contains("to send"), "{shown}");
        assert!(shown.contains("answered 500"), "{shown}");
    }

    #[test]
    fn a_kind_is_named_as_in_the_api() {
        assert_eq!(by_name("node_set_aside"), Ok(WebhookKind::NodeSetAside));
        assert!(by_name::<WebhookKind>("weather").unwrap_err().contains("promise_at_risk, promise_safe"));
    }
}
