//! Opening, locking, damage, tokens.

use forelight_protocol::Role;

use super::*;
use crate::{StoreError, tokens};

#[tokio::test]
async fn a_data_folder_serves_one_service_at_a_time() {
    let farm = Farm::new().await;
    let second = Store::open(farm.folder.path()).await;
    assert!(matches!(second, Err(StoreError::InUse(_))));
    let beside = Store::open_beside(farm.folder.path()).await.unwrap();
    tokens::create(&beside, Role::Viewer, "a screen", at(0)).await.unwrap();
    assert_eq!(tokens::count(&farm.store).await.unwrap(), 1);
}

#[tokio::test]
async fn a_damaged_database_is_refused_at_the_start() {
    let farm = Farm::new().await;
    for _ in 0..50 {
        farm.job("0-50").await;
    }
    let Farm { folder, store } = farm;
    store.close().await;
    drop(store);
    let path = folder.path().join("forelight.sqlite");
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 8192].fill(0xA5);
    std::fs::write(&path, bytes).unwrap();
    let opened = Store::open(folder.path()).await;
    assert!(matches!(opened, Err(StoreError::Damaged { .. })), "it was opened");
}

#[tokio::test]
async fn a_file_that_is_no_database_is_refused_and_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("forelight.sqlite");
    std::fs::write(&path, "not a database, but long enough to have a header of one hundred bytes".repeat(9))
        .unwrap();
    let before = std::fs::read(&path).unwrap();
    let Err(StoreError::Damaged { path: named, .. }) = Store::open(folder.path()).await else { panic!() };
    assert_eq!((named, std::fs::read(&path).unwrap()), (path.display().to_string(), before));
}

#[tokio::test]
async fn rows_that_refer_to_nothing_are_damage() {
    let farm = Farm::new().await;
    farm.job("0").await;
    let Farm { folder, store } = farm;
    store.close().await;
    drop(store);
    let options = sqlx::sqlite::SqliteConnectOptions::new()
        .filename(folder.path().join("forelight.sqlite"))
        .foreign_keys(false);
    let mut connection = <sqlx::SqliteConnection as sqlx::Connection>::connect_with(&options).await.unwrap();
    sqlx::query("DELETE FROM jobs").execute(&mut connection).await.unwrap();
    sqlx::Connection::close(connection).await.unwrap();
    let Err(StoreError::Damaged { reason, .. }) = Store::open(folder.path()).await else { panic!() };
    assert!(reason.contains("refers to one that is not there"), "{reason}");
}

#[tokio::test]
async fn a_backup_is_whole_while_others_write_and_is_what_a_farm_can_go_on_from() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-5"), node.id, at(0)).await;
    let to = farm.folder.path().join("copy.sqlite");
    // Frames are handed out and delivered all the while.
    let writing = {
        let store = farm.store.clone();
        tokio::spawn(async move {
            for second in 0..200 {
                store.touch_node(node.id, at(second)).await.unwrap();
            }
        })
    };
    let made = crate::backup(farm.folder.path(), &to).await.unwrap();
    writing.await.unwrap();
    assert_eq!((made.jobs, made.bytes), (1, std::fs::metadata(&to).unwrap().len()));
    assert_eq!(made.artifacts, 2);
    assert!(matches!(crate::backup(farm.folder.path(), &to).await, Err(StoreError::Conflict(_))));
    // Another farm goes on from it.
    let restored = tempfile::tempdir().unwrap();
    std::fs::copy(&to, restored.path().join("forelight.sqlite")).unwrap();
    let store = Store::open(restored.path()).await.unwrap();
    assert_eq!(store.job(job).await.unwrap(), farm.store.job(job).await.unwrap());
    assert!(store.claim(node.id, TTL, None, at(300)).await.unwrap().is_some());
    let left: Vec<_> =
        std::fs::read_dir(farm.folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().starts_with('.')), "{left:?}");
}

#[tokio::test]
async fn a_token_is_known_by_its_hash_alone() {
    let farm = Farm::new().await;
    let token = tokens::create(&farm.store, Role::Worker, "rack 3", at(0)).await.unwrap();
    let principal = tokens::find(&farm.store, &token).await.unwrap().unwrap();
    assert_eq!((principal.role, principal.name.as_str()), (Role::Worker, "rack 3"));
    assert_eq!(tokens::find(&farm.store, &token[..token.len() - 1]).await.unwrap(), None);
    assert_eq!(tokens::find(&farm.store, "").await.unwrap(), None);
    farm.store.close().await;
    for file in ["forelight.sqlite", "forelight.sqlite-wal"] {
        let Ok(bytes) = std::fs::read(farm.folder.path().join(file)) else { continue };
        let text = String::from_utf8_lossy(&bytes);
        assert!(!text.contains(&token), "{file} holds the token itself");
    }
}

#[cfg(unix)]
#[tokio::test]
async fn the_database_is_for_its_owner_only() {
    use std::os::unix::fs::PermissionsExt as _;
    let farm = Farm::new().await;
    let mode = std::fs::metadata(farm.folder.path().join("forelight.sqlite")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
}

#[tokio::test]
async fn the_writer_flushes_every_commit_and_minds_foreign_keys() {
    let farm = Farm::new().await;
    let mut write = farm.store.write().await.unwrap();
    let synchronous: i64 =
        sqlx::query_scalar("PRAGMA synchronous").fetch_one(write.connection()).await.unwrap();
    let foreign_keys: i64 =
        sqlx::query_scalar("PRAGMA foreign_keys").fetch_one(write.connection()).await.unwrap();
    let journal: String =
        sqlx::query_scalar("PRAGMA journal_mode").fetch_one(write.connection()).await.unwrap();
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
            .execute(write.connection())
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
        // One that asks for what cannot be, and is rolled back.
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
        // Whoever asked is gone after a moment, at a different place each time.
        let _ = tokio::time::timeout(Duration::from_micros(100 * number), create).await;
    }
    // Whatever became of each, the next write finds the database free.
    let before = tokens::count(&farm.store).await.unwrap();
    tokens::create(&farm.store, Role::Viewer, "the last", at(0)).await.unwrap();
    assert!(tokens::count(&farm.store).await.unwrap() > before);
}
