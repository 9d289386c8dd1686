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
async fn a_second_service_is_refused_though_the_lock_file_was_removed() {
    let farm = Farm::new().await;
    std::fs::remove_file(farm.folder.path().join("service.lock")).unwrap();
    let second = Store::open(farm.folder.path()).await;
    assert!(matches!(second, Err(StoreError::InUse(_))));
}

#[tokio::test]
async fn others_cannot_look_into_the_data_folder() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    drop(Store::open(folder.path()).await.unwrap());
    let mode = folder.path().metadata().unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o700);
}

#[tokio::test]
async fn people_who_use_all_their_connections_make_neither_workers_nor_plans_wait() {
    let farm = Farm::new().await;
    let people = farm.store.for_people();
    let mut held = Vec::new();
    for _ in 0..4 {
        held.push(people.read().await.unwrap());
    }
    let waits = tokio::time::timeout(std::time::Duration::from_millis(50), people.ping());
    assert!(waits.await.is_err(), "there are no more");
    farm.store.ping().await.unwrap();
    farm.store.for_service().ping().await.unwrap();
    let node = farm.node("a").await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    assert!(farm.claim(node.id, at(1)).await.is_some());
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
    assert!(reason.contains("refers to a missing row"), "{reason}");
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
                touch(&store, node.id, at(second)).await;
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
    let principal = tokens::find(&farm.store, &token, at(0)).await.unwrap().unwrap();
    assert_eq!((principal.role, principal.name.as_str()), (Role::Worker, "rack 3"));
    assert_eq!(tokens::find(&farm.store, &token[..token.len() - 1], at(0)).await.unwrap(), None);
    assert_eq!(tokens::find(&farm.store, "", at(0)).await.unwrap(), None);
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
