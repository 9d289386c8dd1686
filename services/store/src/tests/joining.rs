//! One-time tokens.

use forelight_protocol::{JoinRequest, Role};

use super::*;
use crate::{StoreError, token_hash, tokens};

fn join(name: &str, own: &str) -> JoinRequest {
    JoinRequest { node: registration(name), token_hash: token_hash(own) }
}

#[tokio::test]
async fn a_one_time_token_makes_one_node_with_a_token_of_its_own_and_is_burnt() {
    let farm = Farm::new().await;
    let store = &farm.store;
    let made = store.create_join_token("rack 7", 3600 * SECOND, at(0)).await.unwrap();
    assert_eq!(made.expires_at, at(3600));
    assert_eq!(tokens::find(store, &made.token, at(0)).await.unwrap(), None, "it is no bearer token");
    let own = tokens::random();
    let node = store.join(&made.token, &join("rack-7", &own), None, at(1)).await.unwrap();
    let principal = tokens::find(store, &own, at(0)).await.unwrap().unwrap();
    assert_eq!((principal.role, principal.node), (Role::Worker, Some(node.id)));
    // The answer was lost: the same machine asks again.
    assert_eq!(store.join(&made.token, &join("rack-7", &own), None, at(2)).await.unwrap().id, node.id);
    // Under another name, which it would believe to be its own.
    let renamed = store.join(&made.token, &join("rack-9", &own), None, at(2)).await;
    assert!(matches!(&renamed, Err(StoreError::Conflict(why)) if why.contains("rack-7")), "{renamed:?}");
    // Another machine, and one that comes much later.
    let other = tokens::random();
    let Err(StoreError::Conflict(why)) = store.join(&made.token, &join("rack-8", &other), None, at(3)).await
    else {
        panic!()
    };
    assert!(why.contains("was used at"), "{why}");
    assert_eq!(tokens::find(store, &other, at(0)).await.unwrap(), None);
    assert_eq!(store.nodes(None, 10).await.unwrap().len(), 1, "nothing was left behind");
}

#[tokio::test]
async fn unknown_and_expired_one_time_tokens_are_refused() {
    let farm = Farm::new().await;
    let made = farm.store.create_join_token("a", 10 * SECOND, at(0)).await.unwrap();
    for token in [made.token.as_str(), "forelight_0", ""] {
        let refused = farm.store.join(token, &join("a", &tokens::random()), None, at(10)).await;
        assert!(matches!(refused, Err(StoreError::JoinRefused(_))), "{refused:?}");
    }
}

#[tokio::test]
async fn a_machine_that_takes_a_nodes_place_takes_its_token_away() {
    let farm = Farm::new().await;
    let (first, second) = (tokens::random(), tokens::random());
    let mut nodes = Vec::new();
    for own in [&first, &second] {
        let made = farm.store.create_join_token("a", SECOND, at(0)).await.unwrap();
        nodes.push(farm.store.join(&made.token, &join("a", own), None, at(0)).await.unwrap().id);
    }
    assert_eq!(nodes[0], nodes[1]);
    assert_eq!(tokens::find(&farm.store, &first, at(0)).await.unwrap(), None);
    assert!(tokens::find(&farm.store, &second, at(0)).await.unwrap().is_some());
    // Nor can a machine claim the token of another.
    let made = farm.store.create_join_token("b", SECOND, at(0)).await.unwrap();
    let stolen = farm.store.join(&made.token, &join("b", &second), None, at(0)).await;
    assert!(matches!(stolen, Err(StoreError::Conflict(_))), "{stolen:?}");
}

#[tokio::test]
async fn a_one_time_token_made_for_one_machine_does_not_take_the_place_of_another() {
    let farm = Farm::new().await;
    let store = &farm.store;
    let (at_work, newcomer) = (tokens::random(), tokens::random());
    let first = store.create_join_token("rack-1", SECOND, at(0)).await.unwrap();
    let node = store.join(&first.token, &join("rack-1", &at_work), None, at(0)).await.unwrap();
    let other = store.create_join_token("rack-2", SECOND, at(0)).await.unwrap();
    let Err(StoreError::Conflict(why)) =
        store.join(&other.token, &join("rack-1", &newcomer), None, at(0)).await
    else {
        panic!("it took rack-1's place")
    };
    assert!(why.contains("a one-time token made for \"rack-1\""), "{why}");
    assert_eq!(tokens::find(store, &at_work, at(0)).await.unwrap().unwrap().node, Some(node.id));
    assert_eq!(tokens::find(store, &newcomer, at(0)).await.unwrap(), None);
    // Nothing was burnt: it can still join as what it is.
    let second = store.join(&other.token, &join("rack-2", &newcomer), None, at(0)).await.unwrap();
    assert_ne!(second.id, node.id);
}
