//! Short work on several threads, with its CPU time: loading a scene, building a tree, writing a file.
//!
//! Hazards of a thread pool for such work: a thread that waits for the pool takes up other work. It then
//! waits for a lock that it holds itself, and counts CPU time of others. So threads are started for one
//! call and end with it. There are as many as the current rayon pool has, since that is what the user
//! allowed. Outside of a pool there is one.

use parking_lot::Mutex;
use rustix::time::{ClockId, Timespec, clock_gettime};
use std::cell::Cell;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::{Builder, ScopedJoinHandle, scope};

thread_local! {
    /// CPU time of threads that have helped this one, nanoseconds.
    static HELPED: Cell<u64> = const { Cell::new(0) };
    /// Whether this thread helps another. It then starts no threads.
    static HELPS: Cell<bool> = const { Cell::new(false) };
}

/// Shares per thread. More shares balance the load better, fewer have less overhead.
const SHARES: usize = 8;

/// Number of threads that work is shared between: those of the current rayon pool.
pub fn count() -> usize {
    let alone = HELPS.get() || rayon::current_thread_index().is_none();
    if alone { 1 } else { rayon::current_num_threads() }
}

/// Calls `f` for each item on up to [`count`] threads, so that each has at least `least` items. Results are
/// in the order of the items.
pub fn map<T: Sync, R: Send>(items: &[T], least: usize, f: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let threads = count().min(items.len() / least.max(1));
    if threads <= 1 {
        return items.iter().map(f).collect();
    }
    let share = items.len().div_ceil(threads * SHARES);
    let next = AtomicUsize::new(0);
    let work = || {
        let mut done: Vec<(usize, Vec<R>)> = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(items) = items.chunks(share).nth(index) else { return done };
            done.push((index, items.iter().map(&f).collect()));
        }
    };
    let mut done = scope(|scope| {
        // If the system gives no thread, there is less help.
        let helper = |_| Builder::new().spawn_scoped(scope, || help(work)).ok();
        let helpers: Vec<_> = (1..threads).map_while(helper).collect();
        let mut done = work();
        helpers.into_iter().for_each(|helper| done.extend(joined(helper)));
        done
    });
    done.sort_unstable_by_key(|&(index, _)| index);
    done.into_iter().flat_map(|(_, results)| results).collect()
}

/// Calls both functions, at the same time if there are two threads.
pub fn join<A, B: Send>(a: impl FnOnce() -> A, b: impl FnOnce() -> B + Send) -> (A, B) {
    if count() <= 1 {
        return (a(), b());
    }
    let waiting = Mutex::new(Some(b));
    let take = || waiting.lock().take();
    scope(|scope| {
        let helper = Builder::new().spawn_scoped(scope, || help(|| take().map(|b| b())));
        let a = a();
        let b = match helper {
            Ok(helper) => joined(helper),
            // The system gives no thread.
            Err(_) => take().map(|b| b()),
        };
        (a, b.unwrap_or_else(|| unreachable!("only one of both takes it")))
    })
}

/// Runs `work` on a helping thread. Returns its result and its CPU time.
fn help<T>(work: impl FnOnce() -> T) -> (T, u64) {
    HELPS.set(true);
    clocked(work)
}

/// The result of a helping thread. Its CPU time counts as that of this thread.
fn joined<T>(helper: ScopedJoinHandle<'_, (T, u64)>) -> T {
    let (done, nanos) = helper.join().unwrap_or_else(|panic| resume_unwind(panic));
    HELPED.set(HELPED.get() + nanos);
    done
}

/// Runs `work`. Returns its result, and its CPU time in nanoseconds: of this thread and of those that [`map`]
/// and [`join`] start. `work` must not wait for a thread pool, because a waiting thread does other work.
pub fn clocked<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let now = || nanos(clock_gettime(ClockId::ThreadCPUTime)) + HELPED.get();
    let start = now();
    let given = work();
    (given, now() - start)
}

/// CPU time of all threads of this process, nanoseconds.
pub fn process_cpu_nanos() -> u64 {
    nanos(clock_gettime(ClockId::ProcessCPUTime))
}

fn nanos(t: Timespec) -> u64 {
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::sync::Barrier;

    fn on<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
    }

    #[test]
    fn results_have_the_order_of_the_items_on_any_number_of_threads() {
        let items: Vec<u32> = (0..1000).collect();
        let expected: Vec<u32> = items.iter().map(|i| i * 3).collect();
        for threads in [1, 2, 3, 7] {
            assert_eq!(on(threads, || map(&items, 1, |i| i * 3)), expected);
            assert_eq!(on(threads, || map(&items[..3], 1, |i| i * 3)), expected[..3]);
        }
        assert!(map(&[] as &[u32], 1, |i| *i).is_empty());
    }

    #[test]
    fn items_are_shared_between_as_many_threads_as_the_pool_has() {
        let threads = Mutex::new(BTreeSet::new());
        let all = Barrier::new(3);
        on(3, || {
            map(&[0, 1, 2], 1, |_| {
                threads.lock().insert(format!("{:?}", std::thread::current().id()));
                all.wait();
                assert!(HELPS.get() == (count() == 1), "a helping thread would start threads");
            });
        });
        assert_eq!(threads.into_inner().len(), 3);
    }

    /// Keeps a thread busy for some milliseconds of CPU time.
    fn busy() -> u64 {
        let start = nanos(clock_gettime(ClockId::ThreadCPUTime));
        while nanos(clock_gettime(ClockId::ThreadCPUTime)) - start < 5_000_000 {}
        nanos(clock_gettime(ClockId::ThreadCPUTime)) - start
    }

    #[test]
    fn the_cpu_time_of_helping_threads_counts_once() {
        on(4, || {
            let (busy_for, counted) = clocked(|| {
                let (one, all) = join(busy, || map(&[(); 3], 1, |()| busy()).iter().sum::<u64>());
                one + all + map(&[(); 4], 1, |()| busy()).iter().sum::<u64>()
            });
            assert!(counted >= busy_for, "{counted} < {busy_for}");
            assert!(counted < 2 * busy_for, "{counted} >= 2 * {busy_for}");
        });
    }

    #[test]
    fn outside_of_a_pool_there_is_one_thread() {
        let caller = std::thread::current().id();
        let threads = map(&[1, 2, 3], 1, |_| std::thread::current().id());
        assert!(count() == 1 && threads.iter().all(|thread| *thread == caller));
        assert_eq!(join(|| 1, || std::thread::current().id()), (1, caller));
    }

    #[test]
    fn a_panic_of_a_helping_thread_is_one_of_the_caller() {
        let panicked = std::panic::catch_unwind(|| {
            on(2, || map(&[1, 2, 3, 4], 1, |i| assert!(*i != 3, "three")));
        });
        assert!(panicked.is_err());
    }
}
