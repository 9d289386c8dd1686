//! Images that are still to be written elsewhere.

use forelight_protocol::{RetentionKind, RetentionRule};

use super::*;
use crate::DueOutput;

#[tokio::test]
async fn a_hundred_images_that_cannot_be_written_stand_in_nobodys_way() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let with_output =
        |frames: &str| JobRequest { output: Some("{job}/{frame}.exr".parse().unwrap()), ..request(frames) };
    let stuck = farm.booked_job(with_output("0-99"), node, at(0)).await;
    while let Some(lease) = farm.claim(node, at(1)).await {
        farm.commit(&lease, at(1)).await;
    }
    let due = farm.store.due_outputs(100).await.unwrap();
    assert_eq!(due.len(), 100);
    for (frame, output) in due.iter().enumerate() {
        farm.store.note_output(output, Some("the folder is full"), at(2 + frame as i64)).await.unwrap();
    }
    let later = farm.booked_job(with_output("0-1"), node, at(200)).await;
    while let Some(lease) = farm.claim(node, at(200)).await {
        farm.commit(&lease, at(200)).await;
    }
    let due = farm.store.due_outputs(100).await.unwrap();
    assert_eq!(due.iter().map(|due| due.job).take(3).collect::<Vec<_>>(), [later, later, stuck]);
    assert_eq!(due[2].frame, 0, "the one that waited longest");
    farm.store.note_output(&due[0], None, at(300)).await.unwrap();
    farm.store.note_output(&due[2], Some("the folder is full"), at(300)).await.unwrap();
    let due = farm.store.due_outputs(200).await.unwrap();
    assert_eq!(due.len(), 101);
    assert_eq!((due[0].job, due[1].frame, due[100].frame), (later, 1, 0), "each has its turn");
    // A frame that has another image by now is still due.
    let of_before = DueOutput { content: farm.artifact("an image before").await, ..due[0].clone() };
    farm.store.note_output(&of_before, None, at(301)).await.unwrap();
    assert_eq!(farm.store.due_outputs(1).await.unwrap(), due[..1]);
    let rule = RetentionRule { project: None, kind: RetentionKind::Images, days: Some(1) };
    farm.store.set_retention(&rule, at(302)).await.unwrap();
    // Images that were not written yet stay, however old they are.
    let kept = farm.store.prune(false, at(10 * 86_400)).await.unwrap();
    let images = |pruned: &forelight_protocol::Pruned| {
        pruned.items.iter().find(|item| item.kind == RetentionKind::Images).unwrap().number
    };
    assert_eq!((images(&kept), farm.store.due_outputs(200).await.unwrap().len()), (0, 101));
    for output in &due {
        farm.store.note_output(output, None, at(11 * 86_400)).await.unwrap();
    }
    assert_eq!(images(&farm.store.prune(false, at(12 * 86_400)).await.unwrap()), 2);
    assert_eq!(farm.store.due_outputs(200).await.unwrap(), []);
}
