//! CPU time in money.

use forelight_protocol::{ByClass, Node};

use crate::serial_time::SerialTime;

/// Mean price over the nodes of a CPU second of such work on a core of speed 1, in micro-units. `None`
/// without nodes.
pub fn mean_price(nodes: &[Node], work: Option<&ByClass>) -> Option<f64> {
    let speed = |node: &Node| node.speed_for(work) * f64::from(node.cores);
    let price = |node: &Node| node.price_per_hour.micro_units() as f64 / 3600.0 / speed(node);
    (!nodes.is_empty()).then(|| nodes.iter().map(price).sum::<f64>() / nodes.len() as f64)
}

/// Mean price over the nodes of the serial time of a frame, in micro-units. 0 without nodes.
pub fn mean_serial_price(nodes: &[Node], serial: SerialTime) -> f64 {
    let price = |node: &Node| node.price_per_hour.micro_units() as f64 / 3.6e9 * serial.on(node.cores) as f64;
    nodes.iter().map(price).sum::<f64>() / nodes.len().max(1) as f64
}
