//! Writes: each for itself, flushed together, and what is left for later.

use forelight_protocol::Role;

use super::*;
use crate::{StoreError, tokens};

#[tokio::test]
async fn the_writer_flushes_every_commit_and_minds_foreign_keys() {
    let farm = Farm::new().await;
    let mut write = farm.store.write().await.unwrap();
    let synchronous: i64 =
        sqlx::query_scalar("PRAGMA synchronous").fetch_one(write.connection().await.unwrap()).await.unwrap();
    let foreign_keys: i64 =
        sqlx::query_scalar("PRAGMA foreign_keys").fetch_one(write.connection().await.unwrap()).await.unwrap();
    let journal: String =
        sqlx::query_scalar("PRAGMA journal_mode").fetch_one(write.connection().await.unwrap()).await.unwrap();
    assert_eq!((synchronous, foreign_keys, journal.as_str()), (2, 1, "wal"));
}

#[tokio::test]
async fn a_writer_that_waits_too_long_for_its_turn_is_told_that_the_database_is_busy_and_readers_never_wait()
{
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let _held = farm.store.write().await.unwrap();
    let (claimed, read) = tokio::join!(farm.store.claim(node.id, TTL, None, at(0)), farm.store.node(node.id));
    assert!(matches!(claimed, Err(StoreError::Busy)), "{claimed:?}");
    assert_eq!(read.unwrap().id, node.id);
}

#[tokio::test(flavor = "multi_thread")]
async fn writes_that_share_a_flush_stand_for_themselves() {
    let farm = Farm::new().await;
    let names = |prefix: &'static str| (0..100).map(move |number| format!("{prefix} {number}"));
    let write = async |store: Store, name: String, keep: bool| {
        let mut write = store.write().await.unwrap();
        sqlx::query("INSERT INTO tokens (hash, name, role, created_at) VALUES (?, ?, 'viewer', 0)")
            .bind(&blake3::hash(name.as_bytes()).as_bytes()[..])
            .bind(name)
            .execute(write.connection().await.unwrap())
            .await
            .unwrap();
        // Dropped half-way, as when a client goes away.
        if keep {
            store.commit(write).await.unwrap()
        }
    };
    let mut writers = tokio::task::JoinSet::new();
    for (kept, dropped) in names("kept").zip(names("dropped")) {
        writers.spawn(write(farm.store.clone(), kept, true));
        writers.spawn(write(farm.store.clone(), dropped, false));
        // One that fails and is rolled back.
        let store = farm.store.clone();
        writers.spawn(async move {
            let refused = store.release(forelight_protocol::LeaseId::new(), 1, at(0)).await;
            assert!(matches!(refused, Err(StoreError::NotFound("lease"))), "{refused:?}");
        });
    }
    writers.join_all().await;
    let kept: i64 = sqlx::query_scalar("SELECT count(*) FROM tokens WHERE name LIKE 'kept %'")
        .fetch_one(farm.store.readers())
        .await
        .unwrap();
    assert_eq!((kept, tokens::count(&farm.store).await.unwrap()), (100, 100));
    // Nothing is left open: another process may write.
    let beside = Store::open_beside(farm.folder.path()).await.unwrap();
    tokens::create(&beside, Role::Viewer, "beside", at(0)).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_commit_that_nobody_waits_for_any_more_is_made_all_the_same() {
    let farm = Farm::new().await;
    for number in 0..20 {
        let create = tokens::create(&farm.store, Role::Viewer, "a screen", at(0));
        // The caller goes away after a moment, at a different place each time.
        let _ = tokio::time::timeout(Duration::from_micros(100 * number), create).await;
    }
    // Whatever became of each, the next write finds the database free.
    let before = tokens::count(&farm.store).await.unwrap();
    tokens::create(&farm.store, Role::Viewer, "the last", at(0)).await.unwrap();
    assert!(tokens::count(&farm.store).await.unwrap() > before);
}

/// Defers the statement that inserts a token of this name.
fn token_later(write: &mut crate::database::Write, name: &'static str) {
    write
        .later("INSERT INTO tokens (hash, name, role, created_at) VALUES (?, ?, 'viewer', 0)")
        .bind(blake3::hash(name.as_bytes()).as_bytes().to_vec())
        .bind(name);
}

async fn names(connection: &mut sqlx::SqliteConnection) -> Vec<String> {
    sqlx::query_scalar("SELECT name FROM tokens ORDER BY name").fetch_all(connection).await.unwrap()
}

#[tokio::test]
async fn what_is_left_for_later_is_done_in_its_order_before_anything_is_asked() {
    let farm = Farm::new().await;
    let mut write = farm.store.write().await.unwrap();
    token_later(&mut write, "first");
    token_later(&mut write, "second");
    write.later("UPDATE tokens SET name = ? WHERE name = ?").bind("third").bind("first");
    assert_eq!(names(write.connection().await.unwrap()).await, ["second", "third"]);
    write.later("DELETE FROM tokens WHERE name = ?").bind("second");
    farm.store.commit(write).await.unwrap();
    let mut dropped = farm.store.write().await.unwrap();
    token_later(&mut dropped, "dropped");
    drop(dropped);
    let mut reader = farm.store.readers().acquire().await.unwrap();
    assert_eq!(names(&mut reader).await, ["third"]);
}

#[tokio::test]
async fn thousands_of_statements_may_be_left_for_later() {
    let farm = Farm::new().await;
    let mut write = farm.store.write().await.unwrap();
    token_later(&mut write, "counted");
    for number in 0..2000i64 {
        write.later("UPDATE tokens SET created_at = created_at * 2 % 1009 + ?").bind(number);
    }
    farm.store.commit(write).await.unwrap();
    let counted: i64 =
        sqlx::query_scalar("SELECT created_at FROM tokens").fetch_one(farm.store.readers()).await.unwrap();
    assert_eq!(counted, (0..2000).fold(0, |sum, number| sum * 2 % 1009 + number), "each once and in order");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_write_of_which_something_left_for_later_fails_leaves_nothing_behind_and_harms_no_other() {
    let farm = Farm::new().await;
    let write = async |store: Store, kept: &'static str| {
        let mut write = store.write().await.unwrap();
        token_later(&mut write, kept);
        store.commit(write).await
    };
    let fail = async |store: Store| {
        let mut write = store.write().await.unwrap();
        token_later(&mut write, "of the failed");
        write.later("INSERT INTO leases (id) VALUES (?)").bind(1);
        token_later(&mut write, "after the fault");
        store.commit(write).await
    };
    let store = || farm.store.clone();
    let (before, failed, after) = tokio::join!(write(store(), "a"), fail(store()), write(store(), "b"));
    before.unwrap();
    after.unwrap();
    assert!(matches!(failed, Err(StoreError::Database(_))), "{failed:?}");
    let mut reader = farm.store.readers().acquire().await.unwrap();
    assert_eq!(names(&mut reader).await, ["a", "b"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_write_that_is_given_up_between_a_question_and_its_answer_harms_no_other() {
    let farm = Farm::new().await;
    let asks = async |store: Store| {
        let mut write = store.write().await?;
        token_later(&mut write, "given up");
        for _ in 0..20 {
            let _: Option<(i64,)> =
                write.ask("SELECT count(*) FROM tokens WHERE created_at > ?").bind(0).first_row().await?;
        }
        token_later(&mut write, "given up as well");
        write.connection().await?;
        std::future::pending::<Result<(), StoreError>>().await
    };
    let mut given_up = tokio::task::JoinSet::new();
    let mut kept = tokio::task::JoinSet::new();
    for number in 0..100u64 {
        let (store, soon) = (farm.store.clone(), Duration::from_micros(50 * (number % 23)));
        given_up.spawn(async move { tokio::time::timeout(soon, asks(store)).await });
        let store = farm.store.clone();
        kept.spawn(async move { tokens::create(&store, Role::Viewer, "kept", at(0)).await });
    }
    for created in kept.join_all().await {
        created.unwrap();
    }
    assert!(given_up.join_all().await.iter().all(Result::is_err), "they wait for ever");
    let mut reader = farm.store.readers().acquire().await.unwrap();
    assert_eq!(names(&mut reader).await, ["kept"; 100]);
}
