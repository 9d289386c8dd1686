//! Measures the least cost of a claim, a renewal and a completion, as hand-written SQL on a separate
//! database.
//!
//! The database has the farm's schema, constraints, indexes, triggers, pragmas and transactions. So it reads
//! and writes only what keeps the three durable after a power cut. It leaves out the rest of the farm's work,
//! such as estimates, learning about nodes and shared flushes.

use anyhow::{Context, Result, anyhow};
use forelight_protocol::{NodeId, Timestamp};
use rusqlite::{Connection, OptionalExtension as _, Transaction, TransactionBehavior, params};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use uuid::Uuid;

use super::filling::{Images, LEASE, rendered};

/// Numbers of threads to try.
const THREADS: [u32; 3] = [1, 2, 4];

/// A database file, and the best number of threads on it.
pub struct Bare {
    path: PathBuf,
    node: NodeId,
    images: Images,
    result: String,
    /// Best number of threads, set by [`Bare::try_threads`].
    pub threads: u32,
}

impl Bare {
    /// Takes a database that the farm has filled and no longer uses.
    pub fn new(database: &Path, node: NodeId) -> Result<Self> {
        let images = Images::new()?;
        let result = serde_json::to_string(&rendered(images, 0, 1))?;
        Ok(Self { path: database.to_owned(), node, images, result, threads: 1 })
    }

    /// Finds the best number of threads, with `time` for each.
    pub fn try_threads(&mut self, time: Duration) -> Result<()> {
        let mut best = 0.0;
        for threads in THREADS {
            let rate = self.round(threads, time)?;
            if rate > best {
                (best, self.threads) = (rate, threads);
            }
        }
        Ok(())
    }

    /// Calls per second with the best number of threads.
    pub fn best_round(&self, time: Duration) -> Result<f64> {
        self.round(self.threads, time)
    }

    fn round(&self, threads: u32, time: Duration) -> Result<f64> {
        let start = Instant::now();
        let calls: Result<u32> = std::thread::scope(|scope| {
            let workers: Vec<_> = (0..threads).map(|_| scope.spawn(|| self.work(start, time))).collect();
            workers
                .into_iter()
                .map(|worker| worker.join().map_err(|_| anyhow!("a thread of the bench panicked"))?)
                .sum()
        });
        Ok(f64::from(calls?) / start.elapsed().as_secs_f64())
    }

    /// Takes frames one by one until the time is over. Returns the number of calls.
    fn work(&self, start: Instant, time: Duration) -> Result<u32> {
        let mut connection = Connection::open(&self.path)?;
        connection.busy_timeout(Duration::from_secs(5))?;
        connection.execute_batch(
            "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON",
        )?;
        connection.set_prepared_statement_cache_capacity(64);
        let mut calls = 0;
        while start.elapsed() < time {
            let held = self.claim(&mut connection)?;
            self.renew(&mut connection, &held)?;
            self.complete(&mut connection, &held)?;
            calls += 3;
        }
        Ok(calls)
    }

    fn claim(&self, connection: &mut Connection) -> Result<Held> {
        let now = Timestamp::now().micros();
        let write = Write::begin(connection)?;
        write.run(
            "UPDATE nodes SET last_seen_at = max(last_seen_at, ?) WHERE id = ?",
            params![now, self.node()],
        )?;
        let expired =
            "SELECT id FROM leases WHERE state = 'active' AND expires_at <= ? ORDER BY expires_at, id";
        let expired: Option<Vec<u8>> =
            write.0.prepare_cached(expired)?.query_row([now], |row| row.get(0)).optional()?;
        anyhow::ensure!(expired.is_none(), "a lease expired: lower --seconds");
        let next = "SELECT id, job_id, frame, spec FROM tasks INDEXED BY tasks_ready_any WHERE state = 'ready' AND held = 0 AND kind IN ('cache_fill', 'render_part', 'render') \
                    AND held = 0 AND not_before <= ? ORDER BY due_at, priority DESC, job_id, frame, part LIMIT 1";
        let found = write.0.prepare_cached(next)?.query_row([now], |row| {
            Ok((
                row.get::<_, Vec<u8>>(0)?,
                row.get::<_, Vec<u8>>(1)?,
                row.get::<_, i64>(2)?,
                row.get::<_, String>(3)?,
            ))
        });
        let (task, job, frame, spec) = found.optional()?.context("no frames left: lower --rounds")?;
        let taken = "UPDATE tasks SET state = 'leased', fence = fence + 1, progress = 0, node_id = ?, started_at = ? \
                     WHERE id = ? AND state = 'ready' RETURNING fence";
        let fence: i64 =
            write.0.prepare_cached(taken)?.query_row(params![self.node(), now, task], |row| row.get(0))?;
        let lease = Uuid::now_v7().as_bytes().to_vec();
        write.run(
            "INSERT INTO leases (id, task_id, node_id, fence, node_speed, state, granted_at, expires_at) VALUES (?, ?, ?, ?, 1.0, 'active', ?, ?)",
            params![lease, task, self.node(), fence, now, expiry(now)],
        )?;
        write.run("UPDATE jobs SET stage = 'rendering' WHERE id = ? AND state = 'booked'", params![job])?;
        write.event("task_leased", &job, frame, now)?;
        write.run(
            "INSERT INTO idempotency (principal, key, request_hash, status, body, created_at) VALUES (?, ?, ?, 200, ?, ?)",
            params![[0u8; 32], Uuid::now_v7().to_string(), [0u8; 32], spec, now],
        )?;
        write.commit()?;
        Ok(Held { lease, task, job, frame, fence })
    }

    fn renew(&self, connection: &mut Connection, held: &Held) -> Result<()> {
        let now = Timestamp::now().micros();
        let write = Write::begin(connection)?;
        write.check(held)?;
        write.run("UPDATE leases SET expires_at = ? WHERE id = ?", params![expiry(now), held.lease])?;
        write.run(
            "UPDATE nodes SET last_seen_at = max(last_seen_at, ?), paused = 0 WHERE id = ?",
            params![now, self.node()],
        )?;
        write.run("UPDATE tasks SET progress = 0.5 WHERE id = ?", params![held.task])?;
        write.event("task_progress", &held.job, held.frame, now)?;
        write.commit()
    }

    fn complete(&self, connection: &mut Connection, held: &Held) -> Result<()> {
        let now = Timestamp::now().micros();
        let write = Write::begin(connection)?;
        write.check(held)?;
        let hash = *blake3::hash(self.result.as_bytes()).as_bytes();
        write.run(
            "INSERT INTO results (task_id, lease_id, body, body_hash, committed_at) VALUES (?, ?, ?, ?, ?)",
            params![held.task, held.lease, self.result, hash, now],
        )?;
        for image in [self.images.exr, self.images.png] {
            let named = "INSERT INTO result_artifacts (task_id, hash) VALUES (?, ?)";
            write.run(named, params![held.task, image.0])?;
        }
        write.run(
            "UPDATE leases SET state = 'committed', ended_at = ? WHERE id = ?",
            params![now, held.lease],
        )?;
        write.run(
            "UPDATE nodes SET last_seen_at = max(last_seen_at, ?) WHERE id = ?",
            params![now, self.node()],
        )?;
        write.run(
            "UPDATE tasks SET state = 'done', progress = 1, finished_at = ? WHERE id = ?",
            params![now, held.task],
        )?;
        write.event("task_done", &held.job, held.frame, now)?;
        write.run(
            "UPDATE frames SET actual = ?1, actual_work = 1000.0, actual_cpu = 1.0, artifacts = '{}', finished_at = ?2 WHERE job_id = ?3 AND frame = ?4",
            params![self.result, now, held.job, held.frame],
        )?;
        write.run(
            "UPDATE jobs SET stage = 'done', finished_at = ?1 WHERE id = ?2 AND stage = 'rendering' \
             AND NOT EXISTS (SELECT 1 FROM frames WHERE job_id = ?2 AND actual IS NULL AND dropped = 0)",
            params![now, held.job],
        )?;
        write.commit()
    }

    fn node(&self) -> &[u8] {
        self.node.0.as_bytes()
    }
}

/// A frame leased by a thread.
struct Held {
    lease: Vec<u8>,
    task: Vec<u8>,
    job: Vec<u8>,
    frame: i64,
    fence: i64,
}

/// Expiry of a lease granted now.
fn expiry(now: i64) -> i64 {
    now.saturating_add(i64::try_from(LEASE.as_micros()).unwrap_or(i64::MAX))
}

/// A transaction that takes the write lock at its beginning.
struct Write<'c>(Transaction<'c>);

impl<'c> Write<'c> {
    fn begin(connection: &'c mut Connection) -> Result<Self> {
        Ok(Self(connection.transaction_with_behavior(TransactionBehavior::Immediate)?))
    }

    fn run(&self, statement: &str, values: impl rusqlite::Params) -> Result<()> {
        self.0.prepare_cached(statement)?.execute(values)?;
        Ok(())
    }

    /// Checks that the lease is still valid.
    fn check(&self, held: &Held) -> Result<()> {
        let read = "SELECT l.state, l.fence FROM leases l JOIN tasks t ON t.id = l.task_id JOIN nodes n ON n.id = l.node_id WHERE l.id = ?";
        let (state, fence): (String, i64) = self
            .0
            .prepare_cached(read)?
            .query_row(params![held.lease], |row| Ok((row.get(0)?, row.get(1)?)))?;
        anyhow::ensure!(state == "active" && fence == held.fence, "a lease was lost");
        Ok(())
    }

    fn event(&self, kind: &str, job: &[u8], frame: i64, now: i64) -> Result<()> {
        let job_id = Uuid::from_slice(job)?;
        let body = format!(
            r#"{{"id":0,"at":{now},"kind":"{kind}","job_id":"{job_id}","task_kind":"render","frame":{frame}}}"#
        );
        self.run(
            "INSERT INTO events (at, kind, job_id, body) VALUES (?, ?, ?, ?)",
            params![now, kind, job, body],
        )
    }

    fn commit(self) -> Result<()> {
        Ok(self.0.commit()?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::filling::fill;
    use super::*;
    use forelight_protocol::JobState;
    use forelight_store::{JobFilter, JobOrder, Store, StoreError};

    #[tokio::test(flavor = "multi_thread")]
    async fn what_is_written_by_hand_is_what_the_farm_reads_as_frames_that_are_done() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let node = fill(&store, 3, 1).await.unwrap()[0].id;
        store.close().await;
        drop(store);
        let path = folder.path().join(forelight_store::DATABASE);
        let bare = Bare::new(&path, node).unwrap();
        let mut connection = Connection::open(&path).unwrap();
        for _ in 0..3 {
            let held = bare.claim(&mut connection).unwrap();
            bare.renew(&mut connection, &held).unwrap();
            bare.complete(&mut connection, &held).unwrap();
        }
        let none_left = bare.claim(&mut connection).err().unwrap();
        assert!(none_left.to_string().contains("no frames left"), "{none_left}");
        drop(connection);
        // The folder is locked until the last clone of the store is dropped, perhaps in the background.
        let mut store = Store::open(folder.path()).await;
        for _ in 0..200 {
            if !matches!(store, Err(StoreError::InUse(_))) {
                break;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
            store = Store::open(folder.path()).await;
        }
        let jobs = store.unwrap().jobs(&JobFilter::default(), (JobOrder::Newest, None), 10).await.unwrap();
        assert_eq!((jobs[0].state, jobs[0].frames_done), (JobState::Done, 3));
    }
}
