use std::collections::BTreeMap;

use forelight_protocol::{CostLine, JobId, LedgerLine, Money, NightForecast, Node, NodeId};
use forelight_store::OpenJob;

use super::basis::Basis;
use super::money::quantiles;

#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
enum Group {
    Farm,
    Project(String),
    Job(JobId),
    Class(String),
}

/// Money spent, and future money by scenario, for each night and group.
pub(super) struct Sums {
    groups: Vec<Group>,
    pub of_jobs: Vec<[usize; 2]>,
    pub of_nodes: Vec<usize>,
    pub spent: Vec<Vec<i64>>,
    pub to_come: Vec<Vec<Vec<i64>>>,
    pub all: Vec<i64>,
}

impl Sums {
    pub(super) fn new(basis: &Basis, scenarios: usize) -> Self {
        let nodes: BTreeMap<NodeId, &Node> = basis.nodes.iter().map(|node| (node.id, node)).collect();
        let of_line = |line: &LedgerLine| {
            let node = line.of.and_then(|(_, node)| nodes.get(&node));
            let class = node.map_or_else(|| "nodes that are gone".to_owned(), |node| class(node));
            let groups = [Group::Farm, Group::Project(line.project.clone()), Group::Class(class)];
            groups.into_iter().chain(line.of.map(|(job, _)| Group::Job(job)))
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
                    // Of ended jobs only the cost is known here.
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

fn class(node: &Node) -> String {
    format!("{} cores of speed {} at {} an hour", node.cores, node.speed, node.price_per_hour)
}
