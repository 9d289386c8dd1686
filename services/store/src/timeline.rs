//! What nodes did, and what is booked on them: the rows of a Gantt chart.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{
    Confidence, FrameSet, JobId, JobName, Node, NodeId, SpanKind, TaskKind, TimeSpan, TimelineSpan, Timestamp,
};
use sqlx::SqliteConnection;

use crate::columns::{Id, Time, Word, hex_list};
use crate::database::Store;
use crate::error::Result;
use crate::policy::availability::free_time_of;
use crate::policy::projection::Projection;

/// Spans of one job with at most this time between them are one: a minute, in microseconds.
const TOGETHER: i64 = 60_000_000;

/// A stretch of a node's time that one task takes.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Stretch {
    job: JobId,
    kind: SpanKind,
    frame: Option<u32>,
    start: Timestamp,
    end: Timestamp,
}

/// The spans of some nodes, and the names of the jobs in them.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Spans {
    /// By node, in the order of their starts.
    pub nodes: BTreeMap<NodeId, Vec<TimelineSpan>>,
    /// Each job once.
    pub jobs: Vec<JobName>,
}

/// What a job's bookings cost less or more at other quantiles, as factors of their lengths.
#[derive(Clone, Copy, Debug)]
struct Lengths {
    p50: f64,
    p80: f64,
}

impl Store {
    /// The spans of these nodes between two instants: what was done, what runs, what is expected of the
    /// bookings, and when the nodes are closed.
    pub async fn spans(
        &self,
        nodes: &[Node],
        projection: &Projection,
        (from, to): (Timestamp, Timestamp),
        now: Timestamp,
    ) -> Result<Spans> {
        let mut transaction = self.read().await?;
        let wanted: BTreeSet<NodeId> = nodes.iter().map(|node| node.id).collect();
        let mut stretches: BTreeMap<NodeId, Vec<Stretch>> = BTreeMap::new();
        for (node, stretch) in past(&mut transaction, &wanted, from, to.min(now)).await? {
            stretches.entry(node).or_default().push(stretch);
        }
        for frame in projection.frames.iter().filter(|frame| wanted.contains(&frame.node_id)) {
            if frame.start >= to || frame.end <= from {
                continue;
            }
            let kind = if frame.under_way { SpanKind::Running } else { SpanKind::Booked };
            let (job, number) = (frame.booking.job_id, Some(frame.booking.frame));
            let stretch = Stretch { job, kind, frame: number, start: frame.start, end: frame.end };
            stretches.entry(frame.node_id).or_default().push(stretch);
        }
        for part in projection.cache_parts.iter().filter(|part| wanted.contains(&part.node_id)) {
            if part.start >= to || part.end <= from {
                continue;
            }
            let kind = if part.under_way { SpanKind::Running } else { SpanKind::Booked };
            let job = part.booking.job_id;
            let stretch = Stretch { job, kind, frame: None, start: part.start, end: part.end };
            stretches.entry(part.node_id).or_default().push(stretch);
        }
        let ids: BTreeSet<JobId> = stretches.values().flatten().map(|stretch| stretch.job).collect();
        let (jobs, lengths) = about_jobs(&mut transaction, &ids).await?;
        let mut spans = Spans { nodes: BTreeMap::new(), jobs };
        for node in nodes {
            let of_node = stretches.remove(&node.id).unwrap_or_default();
            let mut merged = merged(of_node, &lengths);
            merged.extend(closed(node, from, to));
            merged.sort_by_key(|span| (span.start, span.end));
            spans.nodes.insert(node.id, merged);
        }
        Ok(spans)
    }
}

/// What nodes did between two instants, and what they do now without a booking.
async fn past(
    connection: &mut SqliteConnection,
    nodes: &BTreeSet<NodeId>,
    from: Timestamp,
    to: Timestamp,
) -> Result<Vec<(NodeId, Stretch)>> {
    let rows = sqlx::query!(
        r#"WITH wanted AS MATERIALIZED (SELECT unhex(value) AS node_id FROM json_each(?1)),
                since AS MATERIALIZED (SELECT node_id, coalesce((SELECT max(e.from_at) FROM ledger e
                    INDEXED BY ledger_by_node WHERE e.node_id = w.node_id AND e.from_at < ?2), ?2) AS at
                    FROM wanted w)
           SELECT d.node_id AS "node_id!: Id", d.job_id, d.from_at, d.until_at, t.frame,
                  t.kind AS "kind!: Word<TaskKind>"
           FROM since CROSS JOIN ledger d INDEXED BY ledger_by_node
                JOIN leases l ON l.id = d.lease_id JOIN tasks t ON t.id = l.task_id
           WHERE d.node_id = since.node_id AND d.from_at < ?3 AND d.from_at >= since.at"#,
        hex_list(nodes.iter().map(|node| node.0)),
        from.micros(),
        to.micros()
    )
    .fetch_all(connection)
    .await?;
    let stretch = |until: Option<Time>, start: Timestamp| match until {
        Some(until) => (SpanKind::Past, Timestamp::from(until)),
        None => (SpanKind::Running, to.max(start)),
    };
    Ok(rows
        .into_iter()
        .filter_map(|row| {
            let start = Timestamp::from(row.from_at);
            let (kind, end) = stretch(row.until_at, start);
            // A frame that is being rendered is among the bookings.
            let is_booked =
                kind == SpanKind::Running && matches!(row.kind.0, TaskKind::Render | TaskKind::RenderPart);
            let is_seen = end > from && !is_booked;
            let stretch = Stretch { job: row.job_id.into(), kind, frame: row.frame, start, end };
            is_seen.then(|| (row.node_id.into(), stretch))
        })
        .collect())
}

/// Names of jobs, and how their bookings' lengths change with the quantile.
async fn about_jobs(
    connection: &mut SqliteConnection,
    ids: &BTreeSet<JobId>,
) -> Result<(Vec<JobName>, BTreeMap<JobId, Lengths>)> {
    let rows = sqlx::query!(
        r#"SELECT id, name, confidence, json_extract(forecast, '$.total.cpu_seconds.p50') AS "p50?: f64",
                  json_extract(forecast, '$.total.cpu_seconds.p80') AS "p80?: f64",
                  json_extract(forecast, '$.total.cpu_seconds.p95') AS "p95?: f64"
           FROM jobs WHERE id IN (SELECT unhex(value) FROM json_each(?)) ORDER BY id"#,
        hex_list(ids.iter().map(|id| id.0))
    )
    .fetch_all(connection)
    .await?;
    let (mut names, mut lengths) = (Vec::with_capacity(ids.len()), BTreeMap::new());
    for row in rows {
        let id = row.id.into();
        names.push(JobName { id, name: row.name });
        if let (Some(p50), Some(p80), Some(p95)) = (row.p50, row.p80, row.p95) {
            let paid = match row.confidence.0 {
                Confidence::P50 => p50,
                Confidence::P80 => p80,
                Confidence::P95 => p95,
            };
            if paid > 0.0 {
                lengths.insert(id, Lengths { p50: p50 / paid, p80: p80 / paid });
            }
        }
    }
    Ok((names, lengths))
}

/// Neighbouring stretches of one job and kind become one span.
fn merged(mut stretches: Vec<Stretch>, lengths: &BTreeMap<JobId, Lengths>) -> Vec<TimelineSpan> {
    stretches.sort_by_key(|stretch| (stretch.start, stretch.end, stretch.job));
    let mut groups: Vec<Vec<Stretch>> = Vec::new();
    for stretch in stretches {
        match groups.last_mut() {
            Some(group) if group.last().is_some_and(|last| belongs(last, &stretch)) => group.push(stretch),
            _ => groups.push(vec![stretch]),
        }
    }
    groups.iter().filter_map(|group| span(group, lengths)).collect()
}

fn belongs(last: &Stretch, next: &Stretch) -> bool {
    let is_same =
        last.job == next.job && last.kind == next.kind && last.frame.is_some() == next.frame.is_some();
    // What runs is shown by itself.
    is_same && last.kind != SpanKind::Running && next.start.micros_since(last.end) <= TOGETHER
}

fn span(group: &[Stretch], lengths: &BTreeMap<JobId, Lengths>) -> Option<TimelineSpan> {
    let (first, last) = group.first().zip(group.last())?;
    let at = |factor: f64| {
        let length = last.end.micros_since(first.start) as f64 * factor;
        first.start.plus_micros(length as i64)
    };
    let known = lengths.get(&first.job).filter(|_| first.kind == SpanKind::Booked);
    Some(TimelineSpan {
        job_id: Some(first.job),
        frames: FrameSet::from_frames(group.iter().filter_map(|stretch| stretch.frame)),
        kind: first.kind,
        start: first.start,
        end: known.map_or(last.end, |lengths| at(lengths.p50)),
        end_p80: known.map(|lengths| at(lengths.p80)),
    })
}

/// When a node is asleep or under maintenance.
fn closed(node: &Node, from: Timestamp, to: Timestamp) -> Vec<TimelineSpan> {
    if node.schedule.is_none() && node.terms.maintenance.is_empty() {
        return Vec::new();
    }
    let mut spans = Vec::new();
    let mut free_until = from;
    for open in free_time_of(node, from, to) {
        let start = Timestamp::from_micros(open.start).min(to);
        if start > free_until {
            spans.push((free_until, start));
        }
        free_until = open.end.map_or(to, Timestamp::from_micros).max(free_until);
    }
    if free_until < to {
        spans.push((free_until, to));
    }
    let is_maintained = |start: Timestamp, end: Timestamp| {
        let overlaps = |span: &TimeSpan| span.start < end && span.end.is_none_or(|span_end| span_end > start);
        node.terms.maintenance.iter().any(overlaps)
    };
    spans
        .into_iter()
        .map(|(start, end)| TimelineSpan {
            job_id: None,
            frames: None,
            kind: if is_maintained(start, end) { SpanKind::Maintenance } else { SpanKind::Asleep },
            start,
            end,
            end_p80: None,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_micros(seconds * 1_000_000)
    }

    #[test]
    fn neighbours_of_one_job_are_one_span_and_a_gap_or_another_job_begins_a_new_one() {
        let (one, other) = (JobId::new(), JobId::new());
        let stretch = |job, kind, frame, start, end| Stretch {
            job,
            kind,
            frame: Some(frame),
            start: at(start),
            end: at(end),
        };
        let booked = SpanKind::Booked;
        let stretches = vec![
            stretch(one, booked, 4, 10, 20),
            stretch(one, booked, 3, 0, 10),
            stretch(one, booked, 9, 20, 30),
            stretch(other, booked, 1, 30, 40),
            stretch(one, booked, 5, 40, 50),
            stretch(one, booked, 6, 200, 210),
            stretch(one, SpanKind::Past, 7, 210, 220),
        ];
        let lengths = BTreeMap::from([(one, Lengths { p50: 0.5, p80: 1.0 })]);
        let spans = merged(stretches, &lengths);
        let shown: Vec<(String, Timestamp, Timestamp, Option<Timestamp>)> = spans
            .iter()
            .map(|span| (span.frames.as_ref().unwrap().to_string(), span.start, span.end, span.end_p80))
            .collect();
        assert_eq!(
            shown,
            [
                ("3-4,9".to_owned(), at(0), at(15), Some(at(30))),
                ("1".to_owned(), at(30), at(40), None),
                ("5".to_owned(), at(40), at(45), Some(at(50))),
                ("6".to_owned(), at(200), at(205), Some(at(210))),
                ("7".to_owned(), at(210), at(220), None),
            ]
        );
    }
}
