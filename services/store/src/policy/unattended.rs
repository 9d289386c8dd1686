//! Why no node works on new quotes.

use std::collections::BTreeMap;

use forelight_protocol::{Needs, Node, NodePower, NodeState, PowerState, Timestamp, WaitKind, Waits};

/// Why none of these nodes, as they are now, takes tasks that need this; `None` if one does.
pub(crate) fn why_nobody_works(nodes: &[Node], needs: Option<&Needs>) -> Option<Waits> {
    let mut kept_by: BTreeMap<&'static str, usize> = BTreeMap::new();
    let mut until: Option<Timestamp> = None;
    let fits = |node: &&Node| needs.is_none_or(|needs| node.has(needs));
    for node in nodes.iter().filter(fits) {
        let sleeps = node.power.filter(|power| power.state == PowerState::Asleep);
        let by = match (node.state, sleeps) {
            (NodeState::Silent, _) => "silent",
            (NodeState::SetAside, _) => "set aside",
            (NodeState::Draining | NodeState::Drained, _) => "drained",
            (NodeState::Pausing | NodeState::Paused, _) => "paused",
            (NodeState::Idle | NodeState::Working, Some(NodePower { until: wakes, .. })) => {
                until = until.into_iter().chain(wakes).min();
                "asleep"
            }
            (NodeState::Idle | NodeState::Working, None) => return None,
        };
        *kept_by.entry(by).or_default() += 1;
    }
    let because = if nodes.is_empty() {
        "waits because no worker has registered; `forelight worker` starts one".to_owned()
    } else if let (true, Some(needs)) = (kept_by.is_empty(), needs) {
        format!(
            "waits because no node has {needs}: install what is missing on a worker's machine and start the worker again"
        )
    } else {
        let counts: Vec<String> = kept_by.iter().map(|(by, count)| format!("{count} {by}")).collect();
        format!("waits because no node takes tasks: {}", counts.join(", "))
    };
    let kind = if kept_by.contains_key("asleep") { WaitKind::Calendar } else { WaitKind::Node };
    Some(Waits { kind, because, until, behind: Vec::new(), share: None })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::nodes::tests::node;
    use forelight_protocol::{RendererId, RendererRequest};

    fn asleep(until: Option<i64>) -> Node {
        let power = NodePower { state: PowerState::Asleep, until: until.map(Timestamp::from_micros) };
        Node { power: Some(power), ..node() }
    }

    #[test]
    fn one_node_that_takes_tasks_is_enough() {
        assert_eq!(why_nobody_works(&[asleep(None), node()], None), None);
        let none = why_nobody_works(&[], None).unwrap();
        assert!(none.because.contains("no worker has registered"));
    }

    #[test]
    fn the_wait_ends_when_the_first_node_wakes_up() {
        let drained = Node { state: NodeState::Drained, ..node() };
        let waits =
            why_nobody_works(&[asleep(Some(7)), asleep(Some(5)), asleep(None), drained], None).unwrap();
        assert_eq!((waits.kind, waits.until), (WaitKind::Calendar, Some(Timestamp::from_micros(5))));
        assert!(waits.because.ends_with("3 asleep, 1 drained"), "{}", waits.because);
    }

    #[test]
    fn a_job_waits_for_a_node_that_has_its_renderer() {
        let cycles = RendererRequest { name: "cycles".to_owned(), version: Some("5".to_owned()) };
        let cycles = Needs { renderer: cycles, denoiser: false };
        let none = why_nobody_works(&[node()], Some(&cycles)).unwrap();
        assert!(none.because.contains("no node has cycles 5"), "{}", none.because);
        let mut blender = node();
        let id = RendererId { name: "cycles".to_owned(), version: "5.0.1".to_owned() };
        blender.capabilities.renderers.push(id);
        assert_eq!(why_nobody_works(&[node(), blender.clone()], Some(&cycles)), None);
        let drained = Node { state: NodeState::Drained, ..blender };
        let none = why_nobody_works(&[node(), drained], Some(&cycles)).unwrap();
        assert!(none.because.ends_with("1 drained"), "{}", none.because);
    }
}
