//! Metrics in Prometheus text format.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicU64, Ordering};

use forelight_protocol::DashboardCounts;

#[derive(Debug, Default)]
pub(crate) struct Counter(AtomicU64);

impl Counter {
    pub fn add(&self, number: u64) {
        self.0.fetch_add(number, Ordering::Relaxed);
    }

    fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Counters of the process. Everything else is read from the store.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    /// Responses by the first digit of their status, 1 to 5.
    pub responses: [Counter; 5],
    pub leases_granted: Counter,
    pub leases_lost: Counter,
    pub leases_expired: Counter,
    pub results_committed: Counter,
    pub results_duplicate: Counter,
    pub task_errors: Counter,
    pub plans_stored: Counter,
    pub plans_refused: Counter,
    pub bytes_received: Counter,
}

impl Metrics {
    pub fn count_response(&self, status: u16) {
        if let Some(counter) =
            usize::from(status / 100).checked_sub(1).and_then(|class| self.responses.get(class))
        {
            counter.add(1);
        }
    }

    /// All metrics in Prometheus text format. `room` is free disk space in bytes.
    pub fn render(&self, counts: &DashboardCounts, room: u64) -> String {
        let mut text = String::new();
        let mut family = |name: &str, kind: &str, help: &str, values: &[(String, u64)]| {
            let _ = writeln!(text, "# HELP forelight_{name} {help}\n# TYPE forelight_{name} {kind}");
            for (labels, value) in values {
                let _ = writeln!(text, "forelight_{name}{labels} {value}");
            }
        };
        let plain = |value: u64| vec![(String::new(), value)];
        let state = |name: &str, value: u64| (format!("{{state=\"{name}\"}}"), value);
        let responses: Vec<_> = (1..)
            .zip(&self.responses)
            .map(|(class, counter)| (format!("{{class=\"{class}xx\"}}"), counter.get()))
            .collect();
        family("http_responses_total", "counter", "HTTP responses by class of status.", &responses);
        for (name, help, counter) in [
            ("leases_granted_total", "Tasks handed to workers.", &self.leases_granted),
            ("leases_lost_total", "Refusals of workers whose lease had ended.", &self.leases_lost),
            ("leases_expired_total", "Leases that ran out.", &self.leases_expired),
            ("results_committed_total", "Results committed.", &self.results_committed),
            ("results_duplicate_total", "Results that had been committed before.", &self.results_duplicate),
            ("task_errors_total", "Errors reported by workers.", &self.task_errors),
            ("plans_stored_total", "Plans stored.", &self.plans_stored),
            ("plans_refused_total", "Plans that broke a rule and were refused.", &self.plans_refused),
            ("received_bytes_total", "Bytes of uploads kept.", &self.bytes_received),
        ] {
            family(name, "counter", help, &plain(counter.get()));
        }
        let tasks = counts.tasks;
        family(
            "jobs",
            "gauge",
            "Jobs by state.",
            &[
                state("active", counts.jobs_active),
                state("done", counts.jobs_done),
                state("failed", counts.jobs_failed),
                state("cancelled", counts.jobs_cancelled),
            ],
        );
        family(
            "tasks",
            "gauge",
            "Tasks by state.",
            &[
                state("waiting", tasks.waiting),
                state("ready", tasks.ready),
                state("leased", tasks.leased),
                state("done", tasks.done),
                state("failed", tasks.failed),
                state("cancelled", tasks.cancelled),
            ],
        );
        family("nodes", "gauge", "Nodes.", &plain(counts.nodes));
        family(
            "nodes_alive",
            "gauge",
            "Nodes heard of lately, neither draining nor set aside.",
            &plain(counts.nodes_alive),
        );
        family(
            "room_bytes",
            "gauge",
            "Bytes that can still be written where the farm's data are.",
            &plain(room),
        );
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_has_a_type_for_every_family_and_a_number_on_every_other_line() {
        let metrics = Metrics::default();
        metrics.count_response(404);
        metrics.count_response(999);
        metrics.leases_lost.add(2);
        let text = metrics.render(&DashboardCounts::default(), 7 << 30);
        assert!(text.contains("forelight_http_responses_total{class=\"4xx\"} 1\n"), "{text}");
        assert!(
            text.contains("# TYPE forelight_leases_lost_total counter\nforelight_leases_lost_total 2\n"),
            "{text}"
        );
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let (name, number) = line.rsplit_once(' ').unwrap();
            assert!(name.starts_with("forelight_") && number.parse::<u64>().is_ok(), "{line}");
        }
    }
    #[test]
    fn the_grafana_dashboard_shows_metrics_that_exist() {
        let text = Metrics::default().render(&DashboardCounts::default(), 0);
        let dashboard: serde_json::Value =
            serde_json::from_str(include_str!("../../../deploy/grafana.json")).unwrap();
        let panels = dashboard["panels"].as_array().unwrap();
        let targets = panels.iter().flat_map(|panel| panel["targets"].as_array().unwrap());
        let mut asked = 0;
        for query in targets.map(|target| target["expr"].as_str().unwrap()) {
            for name in query.split(|c: char| c != '_' && !c.is_ascii_alphanumeric()) {
                if name.starts_with("forelight_") {
                    assert!(text.contains(&format!("# TYPE {name} ")), "{name}");
                    asked += 1;
                }
            }
        }
        assert!(asked >= panels.len());
    }
}
