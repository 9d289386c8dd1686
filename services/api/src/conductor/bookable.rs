//! Which nodes plans may use. Pure.

use forelight_protocol::{Node, Timestamp};
use forelight_store::{LOST, silence};

/// The nodes that may be booked: they take tasks and are not lost. No node is heard of while the service is
/// down. So for a while after its start, silence counts only up to the latest sign of any node before the start:
/// those that are heard again first say nothing about the others.
pub(crate) fn bookable(nodes: Vec<Node>, now: Timestamp, started: Timestamp) -> Vec<Node> {
    let signs = nodes.iter().map(|node| node.last_seen_at);
    let last_heard = signs.filter(|&at| at <= started).max().unwrap_or(now);
    let until = if now.micros_since(started) <= LOST { last_heard.min(now) } else { now };
    nodes.into_iter().filter(|node| node.takes_tasks() && silence(node, until) <= LOST).collect()
}

#[cfg(test)]
mod tests {
    use forelight_protocol::NodeId;

    use super::*;

    #[test]
    fn after_a_long_stop_of_the_service_no_node_is_lost_because_others_are_heard_first() {
        let minutes = |minutes: i64| Timestamp::from_micros(minutes * 60_000_000);
        let node = |name: &str, last_seen: i64| -> Node {
            serde_json::from_value(serde_json::json!({
                "id": NodeId::new(), "name": name, "speed": 1.0, "speed_set": false, "price_per_hour": 0,
                "price_set": false, "cores": 1, "drain": false, "task_id": null, "created_at": minutes(0),
                "last_seen_at": minutes(last_seen)
            }))
            .unwrap()
        };
        // The service was down from minute 100 to minute 140. One node was lost long before.
        let names = |now: i64, heard: i64| -> Vec<String> {
            let nodes = vec![node("heard", heard), node("not yet", 100), node("lost", 60)];
            bookable(nodes, minutes(now), minutes(140)).into_iter().map(|node| node.name).collect()
        };
        assert_eq!(names(140, 100), ["heard", "not yet"]);
        assert_eq!(names(141, 141), ["heard", "not yet"]);
        assert_eq!(names(146, 146), ["heard"], "five minutes are enough to be heard again");
    }
}
