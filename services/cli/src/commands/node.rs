//! `forelight node`: lists the farm's nodes, changes them, and gives them orders.

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use anyhow::{Context, Result};
use clap::ValueEnum;
use forelight_protocol::{
    Money, Node, NodeActivity, NodeCalendar, NodeChange, NodeState, NodeTerms, PowerState, TimeSpan,
    Timestamp, WindowEnd,
};
use forelight_terminal::failure::BadInput;
use forelight_terminal::options::duration;
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{clock, money, parse_money, seconds};
use forelight_terminal::table::{Align, Table};
use std::time::Duration;

/// List the farm's nodes, change one, or give it an order
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight node --data farm-data
  forelight node rack-7 drain --data farm-data
  forelight node rack-7 resume --server http://farm:7878
  forelight node rack-7 remove --data farm-data
  forelight node rack-7 --schedule 'Mon-Fri 20:00-08:00, Sat-Sun 00:00-00:00 Europe/Berlin' --data farm-data
  forelight node cloud-1 --price 2.40 --billing-step 1h --setup 3m --window-end stop --data farm-data
  forelight node rack-7 --maintenance 2026-03-01T08:00:00Z/2026-03-01T12:00:00Z --data farm-data

A worker gets an order when it next renews its lease, within a few seconds. The column `state` shows whether the \
worker has obeyed. With a name alone, the command shows the node's terms, too. The farm sets a node aside after three \
jobs failed on it within a day; the list shows the reason. The order `back` returns the node to service.

A node gets no tasks while its schedule says that it is asleep. Before a window ends, it gets only tasks that can end \
in time. Every change makes the farm plan again, and move as few bookings as possible.")]
pub struct Args {
    /// Name or id of the node [default: list all nodes]
    name: Option<String>,
    /// Order to give to the node
    order: Option<Order>,
    /// Remove the node although it holds a task, which another node then starts again
    #[arg(long, requires = "order")]
    cancel_task: bool,
    /// When the node is awake, such as "Mon-Fri 20:00-08:00 Europe/Berlin" or `always`. `default`: as the
    /// worker says
    #[arg(long, value_name = "WINDOWS", requires = "name")]
    schedule: Option<String>,
    /// Price of an hour, in the farm's currency, such as 2.40. `default`: as the worker says
    #[arg(long, value_name = "AMOUNT", requires = "name")]
    price: Option<String>,
    /// Bill rented time in multiples of this, such as 1h
    #[arg(long, value_name = "DURATION", requires = "name", value_parser = duration)]
    billing_step: Option<Duration>,
    /// Bill at least this much rented time, such as 10m
    #[arg(long, value_name = "DURATION", requires = "name", value_parser = duration)]
    minimum_booking: Option<Duration>,
    /// Time that the node needs to start before its first frame, such as 3m
    #[arg(long, value_name = "DURATION", requires = "name", value_parser = duration)]
    setup: Option<Duration>,
    /// What to do with a task that still runs when a window of the schedule ends
    #[arg(long, value_name = "WHAT", requires = "name")]
    window_end: Option<EndOfWindow>,
    /// Close the node: START/END, or START/ without a known end. May be repeated. `none` ends all maintenance
    #[arg(long, value_name = "START/END", requires = "name", value_parser = maintenance)]
    maintenance: Vec<Maintenance>,
    /// Print the nodes as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Order {
    /// Finish the current task, then take no more.
    Drain,
    /// Pause the current task, and take no more.
    Pause,
    /// Take tasks again after `drain` or `pause`.
    Resume,
    /// Drop the current task for another node to start again. A drained node takes no next task
    Cancel,
    /// Drop the current task and take no more.
    Stop,
    /// Return to service after the farm has set the node aside.
    Back,
    /// Remove the node from the farm, with its own token. Its bookings are planned again.
    Remove,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum EndOfWindow {
    /// The node finishes it.
    Finish,
    /// The node stops it, and another node starts it again.
    Stop,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Maintenance {
    None,
    At(TimeSpan),
}

fn maintenance(text: &str) -> Result<Maintenance, String> {
    if text == "none" {
        return Ok(Maintenance::None);
    }
    let (start, end) = text
        .split_once('/')
        .ok_or("expected START/END, such as 2026-03-01T08:00:00Z/2026-03-01T12:00:00Z")?;
    let instant = |text: &str| text.parse::<Timestamp>().map_err(|error| error.to_string());
    let end = if end.is_empty() { None } else { Some(instant(end)?) };
    Ok(Maintenance::At(TimeSpan { start: instant(start)?, end }))
}

/// Reads `default` as `None`, and anything else as a value.
fn or_default<T>(text: &str, parse: impl Fn(&str) -> Result<T, String>) -> Result<Option<T>, String> {
    if text == "default" { Ok(None) } else { parse(text).map(Some) }
}

impl Args {
    /// The change of `node` that the flags ask for. It is empty if they ask for none.
    fn change(&self, node: &Node) -> Result<NodeChange> {
        let mut change = self.order.map_or_else(NodeChange::default, Order::change);
        let wrong = |flag: &str, reason: String| BadInput::new(format!("--{flag}: {reason}"));
        if let Some(text) = &self.schedule {
            let parse = |text: &str| text.parse::<NodeCalendar>().map_err(|error| error.to_string());
            change.schedule = Some(or_default(text, parse).map_err(|reason| wrong("schedule", reason))?);
        }
        if let Some(text) = &self.price {
            let price = or_default(text, |text| parse_money(text).map(Money));
            change.price_per_hour = Some(price.map_err(|reason| wrong("price", reason))?);
        }
        let seconds = |time: Duration| u32::try_from(time.as_secs()).unwrap_or(u32::MAX);
        let mut terms = node.terms.clone();
        terms.billing_step_seconds = self.billing_step.map_or(terms.billing_step_seconds, seconds);
        terms.minimum_booking_seconds = self.minimum_booking.map_or(terms.minimum_booking_seconds, seconds);
        terms.setup_seconds = self.setup.map_or(terms.setup_seconds, seconds);
        terms.window_end = match self.window_end {
            None => terms.window_end,
            Some(EndOfWindow::Finish) => WindowEnd::Finish,
            Some(EndOfWindow::Stop) => WindowEnd::Stop,
        };
        for maintenance in &self.maintenance {
            match maintenance {
                Maintenance::None => terms.maintenance.clear(),
                Maintenance::At(span) => terms.maintenance.push(*span),
            }
        }
        change.terms = (terms != node.terms).then_some(terms);
        Ok(change)
    }
}

impl Order {
    fn change(self) -> NodeChange {
        let mut change = NodeChange::default();
        match self {
            Order::Drain => change.drain = Some(true),
            Order::Pause => change.pause = Some(true),
            Order::Resume => (change.drain, change.pause) = (Some(false), Some(false)),
            Order::Cancel => change.cancel_task = Some(true),
            Order::Stop => (change.drain, change.cancel_task) = (Some(true), Some(true)),
            Order::Back => change.set_aside = Some(false),
            Order::Remove => {}
        }
        change
    }
}
pub async fn run(args: Args) -> Result<()> {
    if args.cancel_task && args.order != Some(Order::Remove) {
        return Err(BadInput::new("--cancel-task is for the order `remove`")
            .hint("`stop` drops the task, and the node takes no more")
            .into());
    }
    let client = connect(&args.connection)?;
    let nodes = client.nodes().await.context("cannot list the nodes")?;
    let shown = match &args.name {
        Some(name) => {
            let node = nodes.iter().find(|node| node.name == *name || node.id.to_string() == *name);
            let Some(node) = node else {
                return Err(BadInput::new(format!("{name}: no node has this name or id"))
                    .hint("`forelight node` without a name lists all nodes")
                    .into());
            };
            if args.order == Some(Order::Remove) {
                if args.change(node)? != NodeChange::default() {
                    return Err(BadInput::new("`remove` takes no changes of the node").into());
                }
                client
                    .remove_node(node.id, args.cancel_task)
                    .await
                    .with_context(|| format!("node {name}"))?;
                return if args.json {
                    output::json(&[node])
                } else {
                    output::line(format!("{name} is removed"))
                };
            }
            if args.order == Some(Order::Back) && node.set_aside.is_none() {
                let note = "it is not set aside, so `back` changes nothing; `resume` ends a drain or a pause";
                Bars::new(args.json).note(format!("{name}: {note}"));
            }
            let change = args.change(node)?;
            if change == NodeChange::default() {
                vec![node.clone()]
            } else {
                vec![client.change_node(node.id, &change).await.with_context(|| format!("node {name}"))?]
            }
        }
        None => nodes,
    };
    if args.json {
        return output::json(&shown);
    }
    let now = Timestamp::now();
    let of_one = args.name.as_ref().and(shown.first()).map_or_else(String::new, |node| terms(node, now));
    output::print(&(report(&shown, now) + &of_one))
}

fn report(nodes: &[Node], now: Timestamp) -> String {
    if nodes.is_empty() {
        return "there are no nodes yet\n".into();
    }
    let mut table = Table::new(&[
        ("node", Align::Left),
        ("state", Align::Left),
        ("does", Align::Left),
        ("cores", Align::Right),
        ("speed", Align::Right),
        ("version", Align::Left),
        ("memory", Align::Right),
        ("previews on", Align::Left),
        ("last seen", Align::Left),
        ("power", Align::Left),
    ]);
    for node in nodes {
        let has = &node.capabilities;
        table.row([
            node.name.clone(),
            node.state.name().replace('_', " "),
            node.activity.as_ref().map_or_else(String::new, activity),
            node.cores.to_string(),
            format!("{:.2}", node.speed),
            version(node),
            has.memory_bytes
                .map_or("-".into(), |bytes| format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30))),
            if has.gpu { "GPU".into() } else { "CPU".into() },
            clock(node.last_seen_at, now),
            power(node, now),
        ]);
    }
    let mut text = table.render();
    for node in nodes.iter().filter(|node| node.state == NodeState::SetAside) {
        let reason = node.set_aside.as_deref().unwrap_or_default();
        text += &format!("{} is set aside: {reason}\n", node.name);
    }
    for node in nodes {
        if let Some(reason) = &node.idle_reason {
            text += &format!("{} is idle: {reason}\n", node.name);
        }
    }
    text
}

/// What the node does, such as `render of frame 8 of kitchen, 84 %`.
fn activity(does: &NodeActivity) -> String {
    let NodeActivity { kind, frame, job, progress, .. } = does;
    let frame = frame.map_or(String::new(), |frame| format!(" of frame {frame}"));
    let kind = kind.name().replace('_', " ");
    format!("{kind}{frame} of {job}, {:.0} %", 100.0 * progress)
}

/// The terms of a node, a line each.
fn terms(node: &Node, now: Timestamp) -> String {
    let NodeTerms { billing_step_seconds, minimum_booking_seconds, setup_seconds, window_end, maintenance } =
        &node.terms;
    let time = |whole: u32| if whole == 0 { "none".to_owned() } else { seconds(f64::from(whole)) };
    let whose = |is_set: bool| if is_set { "set by an operator" } else { "as the worker says" };
    let schedule = node.schedule.as_ref().map_or_else(|| "always".to_owned(), ToString::to_string);
    let end = match window_end {
        WindowEnd::Finish => "is finished",
        WindowEnd::Stop => "is stopped, and started again on another node",
    };
    let price = format!("{} an hour, {}", money(node.price_per_hour.micro_units()), whose(node.price_set));
    let mut lines = vec![
        ("price", price),
        ("billing step", time(*billing_step_seconds)),
        ("least billed", time(*minimum_booking_seconds)),
        ("setup", time(*setup_seconds)),
        ("awake", format!("{schedule}, {}", whose(node.schedule_set))),
        ("window end", format!("a task that still runs {end}")),
    ];
    lines.extend(maintenance.iter().map(|span| {
        let end = span.end.map_or_else(|| "no known end".to_owned(), |end| clock(end, now));
        ("maintenance", format!("{} to {end}", clock(span.start, now)))
    }));
    let lines: Vec<String> = lines.into_iter().map(|(name, what)| format!("{name:<13} {what}\n")).collect();
    format!("\n{}", lines.concat())
}

/// Version of the worker, and of our own renderer: `0.1.0 tracer-13`.
fn version(node: &Node) -> String {
    let stated = node.capabilities.version.as_deref().into_iter().chain(node.own_version());
    let stated: Vec<&str> = stated.collect();
    if stated.is_empty() { "-".to_owned() } else { stated.join(" ") }
}

/// `awake`, or `asleep until 20:00:00`.
fn power(node: &Node, now: Timestamp) -> String {
    let Some(power) = &node.power else { return String::new() };
    let word = match power.state {
        PowerState::Awake => "awake",
        PowerState::Asleep => "asleep",
    };
    power.until.map_or_else(|| word.to_owned(), |until| format!("{word} until {}", clock(until, now)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::connection::{Credentials, ServerOptions};
    use forelight_protocol::{Capabilities, NodeId};
    use forelight_terminal::options::parsed;

    #[test]
    fn what_is_not_named_stays_as_it_is() {
        let args = Args {
            name: Some("a".into()),
            order: None,
            cancel_task: false,
            schedule: Some("default".into()),
            price: None,
            billing_step: Some(Duration::from_secs(3600)),
            minimum_booking: None,
            setup: None,
            window_end: None,
            maintenance: vec![maintenance("2026-03-01T08:00:00Z/").unwrap()],
            json: false,
            connection: ConnectionOptions {
                server: ServerOptions { server: String::new(), ca_file: None },
                credentials: Credentials { token_file: None, token: None, data: None },
            },
        };
        let had = NodeTerms { setup_seconds: 5, window_end: WindowEnd::Stop, ..NodeTerms::default() };
        let change = args.change(&Node { terms: had.clone(), ..node() }).unwrap();
        let terms = change.terms.unwrap();
        assert_eq!((change.schedule, change.price_per_hour, change.drain), (Some(None), None, None));
        assert_eq!(
            (terms.billing_step_seconds, terms.setup_seconds, terms.window_end),
            (3600, 5, WindowEnd::Stop)
        );
        assert_eq!((terms.maintenance.len(), terms.maintenance[0].end), (1, None));
        let dear = Args { price: Some("-1".into()), ..parsed(["node", "a"]) };
        let error = dear.change(&node()).unwrap_err().to_string();
        assert!(error.starts_with("--price: expected an amount"), "{error}");
        let none = Args { billing_step: None, maintenance: Vec::new(), schedule: None, ..args };
        assert_eq!(none.change(&Node { terms: had, ..node() }).unwrap(), NodeChange::default());
    }

    #[test]
    fn a_node_that_was_set_aside_says_why() {
        let text = report(&[node()], Timestamp::from_micros(0));
        for part in ["rack-7", "set aside", "48.0 GiB", "3 jobs failed on it"] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn the_terms_of_a_node_that_is_named_are_shown() {
        let changed = NodeTerms {
            billing_step_seconds: 3600,
            window_end: WindowEnd::Stop,
            maintenance: vec![TimeSpan { start: Timestamp::from_micros(0), end: None }],
            ..NodeTerms::default()
        };
        let node = Node { price_per_hour: Money(2_400_000), price_set: true, terms: changed, ..node() };
        let text = terms(&node, Timestamp::from_micros(0));
        for said in ["price         2.40 an hour, set by an operator", "is stopped", "to no known end"] {
            assert!(text.contains(said), "{said}: {text}");
        }
        assert!(text.contains("setup         none\nawake         always, as the worker says"), "{text}");
    }

    fn node() -> Node {
        let now = Timestamp::from_micros(0);
        Node {
            id: NodeId::new(),
            name: "rack-7".into(),
            speed: 1.0,
            speed_set: false,
            price_per_hour: Money(0),
            price_set: false,
            time_factor: 1.0,
            cores: 8,
            capabilities: Capabilities { memory_bytes: Some(48 << 30), ..Capabilities::default() },
            schedule: None,
            schedule_set: false,
            terms: NodeTerms::default(),
            power: None,
            state: NodeState::SetAside,
            drain: false,
            pause: false,
            set_aside: Some("3 jobs failed on it".into()),
            idle_reason: None,
            task_id: None,
            activity: None,
            created_at: now,
            last_seen_at: now,
        }
    }
}
