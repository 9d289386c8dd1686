//! Files named by their hash.

use futures::TryStreamExt as _;

use super::*;
use crate::StoreError;

fn hash_of(content: &str) -> ArtifactHash {
    ArtifactHash(*blake3::hash(content.as_bytes()).as_bytes())
}

fn files_below(folder: &std::path::Path) -> usize {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    entries
        .map(|entry| entry.unwrap().path())
        .map(|path| if path.is_dir() { files_below(&path) } else { 1 })
        .sum()
}

#[tokio::test]
async fn what_is_put_comes_back_and_putting_it_again_changes_nothing() {
    let farm = Farm::new().await;
    let artifacts = farm.store.artifacts();
    let hash = hash_of("hello world");
    let first = artifacts.put(hash, stream(&["hello ", "world"]), 100, at(0)).await.unwrap();
    assert_eq!((first.size, first.existed), (11, false));
    let second = artifacts.put(hash, stream(&["hello world"]), 100, at(0)).await.unwrap();
    assert!(second.existed);
    let farm = farm.restarted().await;
    let reader = farm.store.artifacts().get(hash).await.unwrap();
    let content: Vec<bytes::Bytes> = reader.stream.try_collect().await.unwrap();
    assert_eq!((reader.size, content.concat()), (11, b"hello world".to_vec()));
    assert_eq!(files_below(&farm.folder.path().join("artifacts")), 1);
}

#[tokio::test]
async fn an_empty_file_is_a_file() {
    let farm = Farm::new().await;
    let stored = farm.store.artifacts().put(hash_of(""), stream(&[]), 100, at(0)).await.unwrap();
    assert_eq!(stored.size, 0);
    assert_eq!(farm.store.artifacts().get(hash_of("")).await.unwrap().size, 0);
}

#[tokio::test]
async fn other_bytes_than_announced_too_many_and_broken_off_ones_leave_nothing_behind() {
    let farm = Farm::new().await;
    let artifacts = farm.store.artifacts();
    let wrong = artifacts.put(hash_of("a"), stream(&["b"]), 100, at(0)).await;
    assert!(matches!(wrong, Err(StoreError::HashMismatch { .. })), "{wrong:?}");
    let long = artifacts.put(hash_of("abc"), stream(&["ab", "c"]), 2, at(0)).await;
    assert!(matches!(long, Err(StoreError::TooLarge { limit: 2 })), "{long:?}");
    let broken =
        futures::stream::iter([Ok(bytes::Bytes::from_static(b"a")), Err(std::io::Error::other("reset"))]);
    let broken = artifacts.put(hash_of("ab"), broken, 100, at(0)).await;
    assert!(matches!(broken, Err(StoreError::BrokenOff(_))), "{broken:?}");
    assert!(matches!(artifacts.size(hash_of("a")).await, Err(StoreError::NotFound(_))));
    assert_eq!(files_below(&farm.folder.path().join("artifacts")), 0);
}

#[tokio::test]
async fn uploads_cut_off_by_a_crash_are_cleared_away_at_the_next_start() {
    let farm = Farm::new().await;
    let staged = farm.store.artifacts().stage(stream(&["half a bundle"]), 100).await.unwrap();
    assert!(staged.path().exists());
    // What a crash does not do is to drop things.
    std::mem::forget(staged);
    let farm = farm.restarted().await;
    assert_eq!(files_below(&farm.folder.path().join("artifacts")), 0);
}

#[tokio::test]
async fn a_file_that_was_cut_short_behind_our_back_is_reported_not_served() {
    let farm = Farm::new().await;
    let hash = farm.artifact("some content").await;
    let name = hash.to_string();
    std::fs::write(farm.folder.path().join("artifacts/blake3").join(&name[..2]).join(&name), "some").unwrap();
    assert!(matches!(farm.store.artifacts().get(hash).await, Err(StoreError::Corrupt(_))));
}

#[tokio::test]
async fn what_was_taken_in_and_is_not_kept_is_deleted() {
    let farm = Farm::new().await;
    let staged = farm.store.artifacts().stage(stream(&["a bundle that is no scene"]), 100).await.unwrap();
    let path = staged.path().to_owned();
    assert!(path.exists());
    drop(staged);
    assert!(!path.exists());
}
