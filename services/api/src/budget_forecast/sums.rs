//! Sums of money by night and by what it is spent on.

use std::collections::BTreeMap;

use forelight_protocol::{CostLine, JobId, LedgerLine, Money, NightForecast, Node, NodeId};
use forelight_store::OpenJob;

use super::basis::Basis;
use super::money::quantiles;

/// What costs are added up by.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
enum Group {
    Farm,
    Project(String),
    Job(JobId),
    Class(String),
}

/// Sums by night and group: of what was spent, and of what is to come, scenario by scenario.
pub(super) struct Sums {
    groups: Vec<Group>,
    /// Groups of each open job and of each node, by their places.
    pub of_jobs: Vec<[usize; 2]>,
    pub of_nodes: Vec<usize>,
    /// By night and group.
    pub spent: Vec<Vec<i64>>,
    pub to_come: Vec<Vec<Vec<i64>>>,
    /// All nights together.
    pub all: Vec<i64>,
}

impl Sums {
    /// All groups that there are, and what they spent.
    pub(super) fn new(basis: &Basis, scenarios: usize) -> Self {
        let nodes: BTreeMap<NodeId, &Node> = basis.nodes.iter().map(|node| (node.id, node)).collect();
        let of_line = |line: &LedgerLine| {
            let class =
                nodes.get(&line.node_id).map_or_else(|| "nodes that are gone".to_owned(), |node| class(node));
            [Group::Farm, Group::Project(line.project.clone()), Group::Job(line.job_id), Group::Class(class)]
        };
        let mut groups: Vec<Group> = vec![Group::Farm];
        groups.extend(
            basis
                .jobs
                .iter()
                .flat_map(|open| [Group::Project(open.job.project.clone()), Group::Job(open.job.id)]),
        );
        groups.extend(basis.nodes.iter().map(|node| Group::Class(class(node))));
        groups.extend(basis.ledger.iter().flat_map(of_line));
        groups.sort_unstable();
        groups.dedup();
        // Every group is in the list; the farm is the first.
        let place = |group: Group| groups.binary_search(&group).unwrap_or(0);
        let mut spent = vec![vec![0i64; groups.len()]; basis.nights.len()];
        for line in &basis.ledger {
            for (night, spent) in basis.nights.iter().zip(&mut spent) {
                let cost = line.cost_within(night.from, night.until.min(basis.now)).0;
                if cost > 0 {
                    for group in of_line(line) {
                        let sum = &mut spent[place(group)];
                        *sum = sum.saturating_add(cost);
                    }
                }
            }
        }
        let of_job = |open: &OpenJob| {
            [place(Group::Project(open.job.project.clone())), place(Group::Job(open.job.id))]
        };
        Self {
            of_jobs: basis.jobs.iter().map(of_job).collect(),
            of_nodes: basis.nodes.iter().map(|node| place(Group::Class(class(node)))).collect(),
            to_come: vec![vec![Vec::new(); groups.len()]; basis.nights.len()],
            all: vec![0; scenarios],
            spent,
            groups,
        }
    }

    pub(super) fn night(&self, basis: &Basis, index: usize) -> NightForecast {
        let night = &basis.nights[index];
        let line = |name: String, job_id: Option<JobId>, group: usize| {
            let spent = self.spent[index][group];
            CostLine {
                name,
                job_id,
                spent: Money(spent),
                cost: quantiles(&self.to_come[index][group], spent),
            }
        };
        let (mut projects, mut jobs, mut node_classes) = (Vec::new(), Vec::new(), Vec::new());
        for (place, group) in self.groups.iter().enumerate() {
            if self.spent[index][place] == 0 && self.to_come[index][place].is_empty() {
                continue;
            }
            match group {
                Group::Farm => {}
                Group::Project(name) => projects.push(line(name.clone(), None, place)),
                Group::Job(id) => {
                    let open = basis.jobs.iter().find(|open| open.job.id == *id);
                    // Of jobs that are done, only the cost is left.
                    let name = open.map_or_else(|| id.to_string(), |open| open.job.name.clone());
                    jobs.push(line(name, Some(*id), place));
                }
                Group::Class(name) => node_classes.push(line(name.clone(), None, place)),
            }
        }
        let farm = line(String::new(), None, 0);
        NightForecast {
            date: night.date,
            from: night.from,
            until: night.until,
            spent: farm.spent,
            cost: farm.cost,
            projects,
            jobs,
            node_classes,
        }
    }
}

/// Nodes of the same cores, speed and price are a class.
fn class(node: &Node) -> String {
    format!("{} cores of speed {} at {} an hour", node.cores, node.speed, node.price_per_hour)
}
