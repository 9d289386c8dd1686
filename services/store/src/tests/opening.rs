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
    assert!(matches!(opened, Err(StoreError::Corrupt(_) | StoreError::Database(_))), "it was opened");
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
