//! How much time nodes have before any booking: for bounds, class by class.

use crate::calendar::{FOREVER, Window};
use crate::gaps::{Gap, Gaps};
use crate::looks::Looks;
use crate::model::Node;

/// The free time of all classes of nodes.
pub(crate) struct Supply {
    /// By class: free time after set-ups.
    pub gaps: Vec<Gaps>,
    /// By class: how many nodes are open.
    open: Vec<Open>,
    /// Instants at which a node of some class opens or closes.
    changes: Vec<i64>,
}

/// The number of open nodes of a class as a function of time.
struct Open {
    /// From each of these instants on, sorted: how many nodes are open, and how much time all of them
    /// together had before it.
    steps: Vec<(i64, u64, u128)>,
}

impl Open {
    fn new<'w>(windows: impl Iterator<Item = &'w Window>) -> Self {
        let mut edges: Vec<(i64, bool)> = windows
            .flat_map(|window| [(window.start, true), (window.end, false)])
            .filter(|&(instant, _)| instant < FOREVER)
            .collect();
        edges.sort_unstable();
        let mut steps: Vec<(i64, u64, u128)> = Vec::new();
        for edges in edges.chunk_by(|a, b| a.0 == b.0) {
            let instant = edges[0].0;
            let (before, passed) = steps.last().map_or((0, 0), |&(since, nodes, passed)| {
                (nodes, passed + u128::from(nodes) * u128::from(instant.abs_diff(since)))
            });
            let opens = edges.iter().filter(|&&(_, opens)| opens).count();
            // Every window opens before it closes, so the number never goes below zero.
            let nodes = (before + opens as u64).saturating_sub((edges.len() - opens) as u64);
            steps.push((instant, nodes, passed));
        }
        Open { steps }
    }

    /// How many nodes are open just after an instant, and how much time they had before it.
    fn at(&self, instant: i64) -> (u64, u128) {
        let step = self.steps.partition_point(|&(since, ..)| since <= instant).checked_sub(1);
        step.map_or((0, 0), |step| {
            let (since, nodes, passed) = self.steps[step];
            (nodes, passed + u128::from(nodes) * u128::from(instant.abs_diff(since)))
        })
    }
}

impl Supply {
    pub fn new(nodes: &[&Node], windows: &[Vec<Window>], classes: &[Vec<usize>], looks: &Looks) -> Self {
        let of_class = |members: &Vec<usize>| {
            let mut gaps = Gaps::new(looks);
            for &node in members {
                for window in &windows[node] {
                    let gap = Gap { start: window.ready(nodes[node]), node, end: window.end };
                    if gap.start < gap.end {
                        gaps.insert(gap);
                    }
                }
            }
            gaps
        };
        let open: Vec<Open> = classes
            .iter()
            .map(|members| Open::new(members.iter().flat_map(|&node| &windows[node])))
            .collect();
        let mut changes: Vec<i64> = open.iter().flat_map(|open| &open.steps).map(|step| step.0).collect();
        changes.sort_unstable();
        changes.dedup();
        Supply { gaps: classes.iter().map(of_class).collect(), open, changes }
    }

    /// The first instant at which the time of some classes since `release`, each times its speed, reaches
    /// this amount.
    pub fn reaches(&self, amount: u128, release: i64, classes: &[(usize, u64)]) -> Option<i64> {
        if amount == 0 {
            return Some(release);
        }
        let since = |class: usize, instant: i64| {
            let passed = |instant: i64| self.open[class].at(instant).1;
            passed(instant).saturating_sub(passed(release))
        };
        let got = |instant: i64| {
            classes.iter().fold(0u128, |sum, &(class, speed)| {
                sum.saturating_add(since(class, instant).saturating_mul(u128::from(speed)))
            })
        };
        let first = self.changes.partition_point(|&instant| instant <= release);
        let behind = first + self.changes[first..].partition_point(|&instant| got(instant) < amount);
        // Until the next change, the time grows evenly.
        let from = if behind == first { release } else { self.changes[behind - 1] };
        let rate: u128 = classes
            .iter()
            .map(|&(class, speed)| u128::from(self.open[class].at(from).0) * u128::from(speed))
            .sum();
        let left = amount - got(from);
        let stretch = (rate > 0).then(|| left.div_ceil(rate))?;
        from.checked_add(i64::try_from(stretch).ok()?)
    }
}

#[cfg(test)]
mod tests {
    use super::Supply;
    use crate::calendar::Window;
    use crate::chance::between;
    use crate::looks::Looks;
    use crate::model::Node;

    #[test]
    fn an_amount_is_reached_when_the_time_microsecond_by_microsecond_adds_up_to_it() {
        for seed in 0..300 {
            let draw = |n: &[u64], low, high| between(seed, n, low, high);
            let nodes: Vec<Node> = (0..6).map(|id| Node { id, ..Node::default() }).collect();
            let windows: Vec<Vec<Window>> = (0..6)
                .map(|node| {
                    let start = draw(&[0, node], 0, 20);
                    let middle = start + draw(&[1, node], 1, 20);
                    let again = middle + draw(&[2, node], 1, 9);
                    let end = again + draw(&[3, node], 1, 30);
                    [(start, middle), (again, if node == 5 { i64::MAX } else { end })]
                        .map(|(start, end)| Window { start, end, warm: true })
                        .to_vec()
                })
                .collect();
            let members = [vec![0, 1, 2], vec![3, 4], vec![5]];
            let nodes: Vec<&Node> = nodes.iter().collect();
            let supply = Supply::new(&nodes, &windows, &members, &Looks::default());
            let used = if draw(&[4], 0, 1) == 0 { vec![(0, 3), (1, 7)] } else { vec![(1, 2), (2, 5)] };
            let (amount, release) = (draw(&[5], 0, 400) as u128, draw(&[6], -5, 50));
            let (mut left, mut now) = (amount as i128, release);
            while left > 0 && now < 1000 {
                for &(class, speed) in &used {
                    let open = |node: &&usize| windows[**node].iter().any(|w| w.start <= now && now < w.end);
                    left -= i128::from(speed) * members[class].iter().filter(open).count() as i128;
                }
                now += 1;
            }
            let expected = (left <= 0).then_some(now);
            assert_eq!(supply.reaches(amount, release, &used), expected, "seed {seed}");
        }
    }
}
