//! `forelight node`: what the farm's nodes do, and orders for them.

use crate::connection::connect;
use crate::failure::BadInput;
use crate::options::ConnectionOptions;
use crate::output;
use crate::quantities::clock;
use crate::table::{Align, Table};
use anyhow::{Context, Result};
use clap::ValueEnum;
use forelight_protocol::{Node, NodeChange, NodeState, Timestamp};

/// List nodes and what they do, or give one an order
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight node --data farm-data
  forelight node rack-7 drain --data farm-data
  forelight node rack-7 resume --server http://farm:7878

A worker hears of an order when it next renews its lease, a few seconds later at most; STATE says whether it has obeyed. A node on \
which three jobs failed within a day is set aside, and says why; `back` returns it to service.")]
pub struct Args {
    /// Name of the node [default: all of them]
    #[arg(requires = "order")]
    name: Option<String>,
    /// What it shall do
    order: Option<Order>,
    /// Print nodes as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Orders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Order {
    /// Finish the task at hand and take no more.
    Drain,
    /// Stand still; the task at hand is kept.
    Pause,
    /// Take tasks again, after drain or pause.
    Resume,
    /// Drop the task at hand; another node starts it anew. This one takes what comes next, unless it is drained.
    Cancel,
    /// Drop the task at hand and take no more.
    Stop,
    /// Return to service after having been set aside.
    Back,
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
        }
        change
    }
}

/// Runs the command.
pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let nodes = client.nodes().await.context("cannot list the nodes")?;
    let shown = match (&args.name, args.order) {
        (Some(name), Some(order)) => {
            let node = nodes.iter().find(|node| node.name == *name || node.id.to_string() == *name);
            let Some(node) = node else {
                return Err(BadInput::new(format!("{name}: there is no such node"))
                    .hint("`forelight node` without a name lists them")
                    .into());
            };
            vec![client.change_node(node.id, &order.change()).await.with_context(|| format!("node {name}"))?]
        }
        _ => nodes,
    };
    if args.json { output::json(&shown) } else { output::print(&report(&shown, Timestamp::now())) }
}

fn report(nodes: &[Node], now: Timestamp) -> String {
    if nodes.is_empty() {
        return "no node has registered yet\n".into();
    }
    let mut table = Table::new(&[
        ("node", Align::Left),
        ("state", Align::Left),
        ("cores", Align::Right),
        ("speed", Align::Right),
        ("memory", Align::Right),
        ("previews on", Align::Left),
        ("heard of", Align::Left),
    ]);
    for node in nodes {
        let has = &node.capabilities;
        table.row([
            node.name.clone(),
            node.state.name().replace('_', " "),
            node.cores.to_string(),
            format!("{:.2}", node.speed),
            has.memory_bytes
                .map_or("-".into(), |bytes| format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30))),
            has.vulkan_adapter.clone().unwrap_or_else(|| "CPU".into()),
            clock(node.last_seen_at, now),
        ]);
    }
    let mut text = table.render();
    for node in nodes.iter().filter(|node| node.state == NodeState::SetAside) {
        let reason = node.set_aside.as_deref().unwrap_or_default();
        text += &format!("{} is set aside: {reason}\n", node.name);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::{Capabilities, Money, NodeId};

    #[test]
    fn a_node_that_was_set_aside_says_why() {
        let now = Timestamp::from_micros(0);
        let node = Node {
            id: NodeId::new(),
            name: "rack-7".into(),
            speed: 1.0,
            speed_set: false,
            price_per_hour: Money(0),
            price_set: false,
            time_factor: 1.0,
            cores: 8,
            capabilities: Capabilities { memory_bytes: Some(48 << 30), ..Capabilities::default() },
            state: NodeState::SetAside,
            drain: false,
            pause: false,
            set_aside: Some("3 jobs failed on it".into()),
            task_id: None,
            created_at: now,
            last_seen_at: now,
        };
        let text = report(&[node], now);
        for part in ["rack-7", "set aside", "48.0 GiB", "3 jobs failed on it"] {
            assert!(text.contains(part), "{text}");
        }
    }
}
