//! Files named by their hash.

use std::sync::Arc;

use forelight_protocol::EventKind;
use futures::TryStreamExt as _;
use object_store::aws::AmazonS3Builder;
use object_store::memory::InMemory;
use object_store::{ObjectStore, ObjectStoreExt as _, RetryConfig};

use super::*;
use crate::{ArtifactPlace, StoreError};

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
    let reader = farm.store.artifacts().get(hash, at(0)).await.unwrap();
    let content: Vec<bytes::Bytes> = reader.whole().try_collect().await.unwrap();
    assert_eq!((11, content.concat()), (11, b"hello world".to_vec()));
    assert_eq!(files_below(&farm.folder.path().join("artifacts")), 1);
}

#[tokio::test]
async fn an_empty_file_is_a_file() {
    let farm = Farm::new().await;
    let stored = farm.store.artifacts().put(hash_of(""), stream(&[]), 100, at(0)).await.unwrap();
    assert_eq!(stored.size, 0);
    assert_eq!(farm.store.artifacts().get(hash_of(""), at(0)).await.unwrap().size, 0);
}

#[tokio::test]
async fn other_bytes_than_announced_too_many_and_broken_off_ones_leave_nothing_behind() {
    let farm = Farm::new().await;
    let artifacts = farm.store.artifacts();
    let wrong = artifacts.put(hash_of("a"), stream(&["b"]), 100, at(0)).await;
    assert!(matches!(wrong, Err(StoreError::HashMismatch { .. })), "{wrong:?}");
    let long = artifacts.put(hash_of("abc"), stream(&["ab", "c"]), 2, at(0)).await;
    assert!(matches!(long, Err(StoreError::TooLarge { limit: 2 })), "{long:?}");
    let reset = StoreError::BrokenOff("reset".to_owned());
    let broken = futures::stream::iter([Ok(bytes::Bytes::from_static(b"a")), Err(reset)]);
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
    // A crash would not drop values.
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
    assert!(matches!(farm.store.artifacts().get(hash, at(0)).await, Err(StoreError::ArtifactLost { .. })));
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

/// The name of an artefact in the bucket of these tests.
fn object_of(hash: ArtifactHash) -> object_store::path::Path {
    let name = hash.to_string();
    format!("shots/2026/blake3/{}/{name}", &name[..2]).into()
}

#[tokio::test]
async fn in_a_bucket_what_is_put_rests_below_the_prefix_and_comes_back_and_nothing_stays_in_the_data_folder()
{
    let farm = Farm::new().await;
    let bucket = Arc::new(InMemory::new());
    let artifacts = farm.store.artifacts().resting_in(bucket.clone());
    artifacts.probe().await.unwrap();
    // Two parts and a bit, so it is uploaded in parts; and one that is uploaded at once.
    let long: &'static str = Box::leak("0123456789abcdef".repeat((17 << 20) / 16).into_boxed_str());
    for content in [long, "short", ""] {
        let hash = hash_of(content);
        let stored = artifacts.put(hash, stream(&[content]), 20 << 20, at(0)).await.unwrap();
        assert_eq!((stored.size, stored.existed), (content.len() as u64, false));
        let object = bucket.get(&object_of(hash)).await.unwrap().bytes().await.unwrap();
        assert_eq!(object.len(), content.len());
        let reader = artifacts.get(hash, at(0)).await.unwrap();
        let parts: Vec<bytes::Bytes> = reader.whole().try_collect().await.unwrap();
        assert!(parts.concat() == content.as_bytes());
        assert!(artifacts.put(hash, stream(&[content]), 20 << 20, at(0)).await.unwrap().existed);
    }
    assert_eq!(files_below(&farm.folder.path().join("artifacts")), 0);
}

#[tokio::test]
async fn in_a_bucket_what_does_not_come_in_whole_or_is_not_what_was_announced_never_gets_there() {
    let farm = Farm::new().await;
    let bucket = Arc::new(InMemory::new());
    let artifacts = farm.store.artifacts().resting_in(bucket.clone());
    assert!(matches!(
        artifacts.put(hash_of("a"), stream(&["b"]), 100, at(0)).await,
        Err(StoreError::HashMismatch { .. })
    ));
    assert!(matches!(
        artifacts.put(hash_of("abc"), stream(&["ab", "c"]), 2, at(0)).await,
        Err(StoreError::TooLarge { limit: 2 })
    ));
    let objects: Vec<_> = bucket.list(None).try_collect().await.unwrap();
    assert!(objects.is_empty(), "{objects:?}");
    assert_eq!(files_below(&farm.folder.path().join("artifacts")), 0);
}

#[tokio::test]
async fn an_object_that_vanished_or_was_cut_short_is_reported_and_mended_by_the_next_upload() {
    let farm = Farm::new().await;
    let bucket = Arc::new(InMemory::new());
    let artifacts = farm.store.artifacts().resting_in(bucket.clone());
    let hash = hash_of("some content");
    let put = async || artifacts.put(hash, stream(&["some content"]), 100, at(0)).await.unwrap();
    put().await;
    bucket.put(&object_of(hash), "some".into()).await.unwrap();
    assert!(matches!(artifacts.get(hash, at(0)).await, Err(StoreError::ArtifactLost { .. })));
    put().await;
    assert_eq!(artifacts.get(hash, at(0)).await.unwrap().size, 12);
    bucket.delete(&object_of(hash)).await.unwrap();
    assert!(matches!(artifacts.get(hash, at(0)).await, Err(StoreError::ArtifactLost { .. })));
    assert!(put().await.existed);
    assert_eq!(artifacts.get(hash, at(0)).await.unwrap().size, 12);
}

#[tokio::test]
async fn a_bucket_that_does_not_answer_is_away_not_an_error_of_ours_and_no_row_promises_what_it_did_not_take()
{
    let farm = Farm::new().await;
    // A port that was free a moment ago, and that nobody listens on.
    let closed = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let nobody = AmazonS3Builder::new()
        .with_endpoint(format!("http://{closed}"))
        .with_allow_http(true)
        .with_bucket_name("farm")
        .with_access_key_id("key")
        .with_secret_access_key("secret")
        .with_retry(RetryConfig { max_retries: 0, ..RetryConfig::default() })
        .build()
        .unwrap();
    let artifacts = farm.store.artifacts().resting_in(Arc::new(nobody));
    // A service that starts before its bucket does must not stay down.
    artifacts.probe().await.unwrap();
    let put = artifacts.put(hash_of("a"), stream(&["a"]), 100, at(0)).await;
    assert!(matches!(put, Err(StoreError::ArtifactsAway(_))), "{put:?}");
    assert!(matches!(artifacts.size(hash_of("a")).await, Err(StoreError::NotFound(_))));
    assert_eq!(files_below(&farm.folder.path().join("artifacts")), 0);
}

#[tokio::test]
async fn a_farm_with_artefacts_elsewhere_is_not_started_unless_they_were_moved() {
    let farm = Farm::new().await;
    farm.artifact("an image").await;
    farm.store.close().await;
    let (folder, store) = (farm.folder, farm.store);
    drop(store);
    let data = folder.path();
    // Nothing is asked of the bucket before this is settled.
    let bucket: ArtifactPlace = "s3://renders/farm".parse().unwrap();
    let Err(StoreError::ArtifactPlace(reason)) = Store::open_with(data, &bucket, false).await else {
        panic!("it was opened")
    };
    assert!(reason.contains("data-folder") && reason.contains("--artifacts-moved"), "{reason}");
    Store::open_with(data, &ArtifactPlace::DataFolder, false).await.unwrap();
}

#[tokio::test]
async fn a_flipped_bit_is_found_when_it_is_asked_for_told_once_and_mended_by_the_same_bytes() {
    let farm = Farm::new().await;
    let artifacts = farm.store.artifacts();
    // One that is read into memory, and one that is not.
    for length in [100usize, 300_000] {
        let content = "x".repeat(length);
        let content: &'static str = content.leak();
        let hash = hash_of(content);
        let put = async || artifacts.put(hash, stream(&[content]), 1 << 20, at(0)).await.unwrap();
        put().await;
        artifacts.get(hash, at(1)).await.unwrap();
        let name = hash.to_string();
        let path = farm.folder.path().join("artifacts/blake3").join(&name[..2]).join(&name);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[length / 2] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let told = async || {
            let events = farm.store.events_after(None, 0, 1000).await.unwrap();
            let damaged = events.iter().filter(|event| event.kind == EventKind::ArtifactDamaged);
            damaged.filter(|event| event.message.as_ref().unwrap().contains(&name)).count()
        };
        for _ in 0..2 {
            let found = artifacts.get(hash, at(2)).await;
            assert!(matches!(found, Err(StoreError::ArtifactDamaged { .. })));
            assert_eq!(told().await, 1);
        }
        assert!(put().await.existed);
        let part = artifacts.get(hash, at(3)).await.unwrap().part(10..20);
        assert_eq!(part.try_collect::<Vec<_>>().await.unwrap().concat(), content.as_bytes()[10..20]);
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(artifacts.get(hash, at(4)).await, Err(StoreError::ArtifactLost { .. })));
        assert_eq!(told().await, 2, "it was whole in between");
    }
}

#[tokio::test]
async fn a_scrub_goes_through_all_artefacts_in_parts_and_finds_damage_before_anybody_asks() {
    let farm = Farm::new().await;
    let artifacts = farm.store.artifacts();
    let contents = ["a", "bb", "ccc", "dddd", "eeeee"];
    for content in contents {
        artifacts.put(hash_of(content), stream(&[content]), 100, at(0)).await.unwrap();
    }
    let name = hash_of("ccc").to_string();
    std::fs::write(farm.folder.path().join("artifacts/blake3").join(&name[..2]).join(&name), "cXc").unwrap();
    let mut seen = 0;
    let mut damaged = Vec::new();
    loop {
        let part = artifacts.scrub_on(1, at(5)).await.unwrap();
        if part.next.is_none() {
            break;
        }
        assert_eq!(part.artifacts, 1);
        seen += part.artifacts;
        damaged.extend(part.damaged);
    }
    assert_eq!((seen, damaged.len()), (5, 1));
    assert!(damaged[0].contains(&name), "{damaged:?}");
    // A file that cannot be read holds up no other.
    let unreadable = hash_of("bb").to_string();
    let path = farm.folder.path().join("artifacts/blake3").join(&unreadable[..2]).join(&unreadable);
    std::fs::remove_file(&path).unwrap();
    std::os::unix::fs::symlink(&path, &path).unwrap();
    let part = artifacts.scrub_on(u64::MAX, at(6)).await.unwrap();
    assert_eq!((part.artifacts, part.damaged.len()), (5, 2), "{part:?}");
    assert!(part.damaged.iter().any(|one| one.contains("its file cannot be read")), "{part:?}");
    std::fs::remove_file(&path).unwrap();
    artifacts.put(hash_of("bb"), stream(&["bb"]), 100, at(6)).await.unwrap();
    // The next round begins anew, and forgets what is whole again.
    artifacts.put(hash_of("ccc"), stream(&["ccc"]), 100, at(6)).await.unwrap();
    let whole = artifacts.scrub_on(u64::MAX, at(7)).await.unwrap();
    assert_eq!((whole.artifacts, whole.bytes, whole.next), (5, 15, None));
    assert!(whole.damaged.is_empty(), "{:?}", whole.damaged);
}

#[tokio::test]
async fn an_object_in_a_bucket_is_verified_and_a_large_one_lacks_its_end_if_it_has_changed() {
    let farm = Farm::new().await;
    let bucket = Arc::new(InMemory::new());
    let artifacts = farm.store.artifacts().resting_in(bucket.clone());
    let small: &'static str = "small";
    let large: &'static str = "x".repeat(5 << 20).leak();
    for content in [small, large] {
        let hash = hash_of(content);
        artifacts.put(hash, stream(&[content]), 20 << 20, at(0)).await.unwrap();
        let reader = artifacts.get(hash, at(1)).await.unwrap();
        let whole: Vec<bytes::Bytes> = reader.whole().try_collect().await.unwrap();
        assert_eq!(whole.concat(), content.as_bytes());
        let part = artifacts.get(hash, at(1)).await.unwrap().part(1..4);
        assert_eq!(part.try_collect::<Vec<_>>().await.unwrap().concat(), content.as_bytes()[1..4]);
        let mut changed = content.as_bytes().to_vec();
        changed[2] ^= 1;
        bucket.put(&object_of(hash), changed.into()).await.unwrap();
    }
    assert!(matches!(artifacts.get(hash_of(small), at(2)).await, Err(StoreError::ArtifactDamaged { .. })));
    let reader = artifacts.get(hash_of(large), at(2)).await.unwrap();
    let read = reader.whole().try_collect::<Vec<bytes::Bytes>>().await;
    assert!(matches!(read, Err(StoreError::ArtifactDamaged { .. })));
    // Sending the same bytes mends it.
    artifacts.put(hash_of(large), stream(&[large]), 20 << 20, at(3)).await.unwrap();
    let reader = artifacts.get(hash_of(large), at(4)).await.unwrap();
    assert!(reader.whole().try_collect::<Vec<bytes::Bytes>>().await.is_ok());
}
