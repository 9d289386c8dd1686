//! Which version of our own renderer renders a job.
//!
//! A job is rendered by one version, as images and costs of others may differ. It is chosen when the job is
//! previewed. During an upgrade, the job stays with nodes of that version. Once none is left, it goes on with
//! another one, and says so: a deadline is worth more than equal noise, and whoever thinks otherwise can cancel.
//! Each frame comes from one version all the same: parts of a divided frame are rendered again.

use std::collections::BTreeMap;

use forelight_protocol::{Node, Timestamp};

use crate::nodes::LOST;
use crate::policy::availability::silence;

/// The version of our own renderer that most cores of these nodes have; of several, the newest. `None` if no
/// node that takes tasks states its version, or none of them can `denoise` where that is asked for.
pub(crate) fn version_to_use(nodes: &[Node], denoise: bool, now: Timestamp) -> Option<String> {
    let mut cores: BTreeMap<&str, u64> = BTreeMap::new();
    let fits = |node: &&Node| node.takes_tasks() && is_there(node, now) && can(node, denoise);
    for node in nodes.iter().filter(fits) {
        let Some(version) = node.own_version() else { continue };
        *cores.entry(version).or_default() += u64::from(node.cores);
    }
    let most = cores.into_iter().max_by_key(|&(version, cores)| (cores, age(version)));
    most.map(|(version, _)| version.to_owned())
}

/// Whether a node with this version may still work: it is there, and is neither drained nor set aside. One that
/// is paused or asleep comes back.
pub(crate) fn is_left(nodes: &[Node], version: &str, denoise: bool, now: Timestamp) -> bool {
    let works =
        |node: &Node| !node.drain && node.set_aside.is_none() && is_there(node, now) && can(node, denoise);
    nodes.iter().any(|node| node.own_version() == Some(version) && works(node))
}

/// Whether the node can remove noise, if it is to.
fn can(node: &Node, denoise: bool) -> bool {
    !denoise || node.capabilities.denoiser.is_some()
}

pub(crate) fn is_there(node: &Node, now: Timestamp) -> bool {
    silence(node, now) <= LOST
}

/// Orders versions: by the number at the end of `tracer-13`, else by name.
fn age(version: &str) -> (u32, &str) {
    let number = version.rsplit('-').next().and_then(|number| number.parse().ok());
    (number.unwrap_or(0), version)
}

/// What a job says of itself once its frames come from more than one version.
pub(crate) fn words(before: &str, after: &str, why: &str, now: Timestamp) -> String {
    format!(
        "{why}: what is rendered after {now} comes from {after} instead of {before}, which profiled this job, \
         so noise, work and costs of these frames may differ from the others and from the quote"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::nodes::tests::node;
    use forelight_protocol::RendererId;

    fn having(tracer: u32, cores: u32) -> Node {
        let mut node = Node { cores, ..node() };
        node.capabilities.renderers.push(RendererId::own(tracer));
        node
    }

    #[test]
    fn the_version_of_most_cores_is_used_and_of_equal_ones_the_newest() {
        let now = node().last_seen_at;
        let used = |nodes: &[Node]| version_to_use(nodes, false, now);
        assert_eq!(used(&[having(9, 8), having(10, 4), having(10, 3)]).as_deref(), Some("tracer-9"));
        assert_eq!(used(&[having(9, 8), having(10, 8)]).as_deref(), Some("tracer-10"));
        assert_eq!(
            used(&[Node { drain: true, ..having(9, 8) }, having(10, 1)]).as_deref(),
            Some("tracer-10")
        );
        assert_eq!(used(&[node()]), None);
        let mut denoising = having(9, 1);
        denoising.capabilities.denoiser = Some("Open Image Denoise 2.5.1".to_owned());
        let denoised = |nodes: &[Node]| version_to_use(nodes, true, now);
        assert_eq!(denoised(&[having(10, 8), denoising]).as_deref(), Some("tracer-9"));
        assert_eq!(denoised(&[having(10, 8)]), None);
    }

    #[test]
    fn a_version_is_left_while_a_node_that_has_it_may_come_back() {
        let now = node().last_seen_at;
        let left = |node: Node, now| is_left(&[node, having(14, 1)], "tracer-13", false, now);
        assert!(left(having(13, 1), now) && left(Node { pause: true, ..having(13, 1) }, now));
        assert!(!left(Node { drain: true, ..having(13, 1) }, now));
        assert!(!left(Node { set_aside: Some("faults".to_owned()), ..having(13, 1) }, now));
        assert!(
            left(having(13, 1), now.plus_micros(LOST)) && !left(having(13, 1), now.plus_micros(LOST + 1))
        );
    }
}
