//! Animation channels that move no node: without a `target.node`, or of `KHR_animation_pointer`. A reader
//! ignores them (glTF 2.0 specification, section 3.11), but the `gltf` crate refuses their file.

use serde::Deserialize;
use serde_json::Value;
use serde_json::value::RawValue;

#[derive(Deserialize)]
struct Document<'a> {
    #[serde(borrow)]
    animations: Option<&'a RawValue>,
}

/// The document without such channels, and without the animations that have no others. `None` if there are
/// none, or if the document is malformed.
pub(super) fn without_nodeless(json: &[u8]) -> Option<Vec<u8>> {
    let document = Document::deserialize(&mut serde_json::Deserializer::from_slice(json)).ok()?;
    let text = document.animations?.get();
    let mut animations: Vec<Value> = serde_json::from_str(text).ok()?;
    let mut found = false;
    animations.retain_mut(|animation| {
        let channels = animation.get_mut("channels").and_then(Value::as_array_mut);
        channels.is_none_or(|channels| {
            let all = channels.len();
            channels.retain(|channel| !is_nodeless(channel));
            found |= channels.len() < all;
            all == 0 || !channels.is_empty()
        })
    });
    if !found {
        return None;
    }
    let rest = serde_json::to_vec(&animations).ok()?;
    let begin = text.as_ptr() as usize - json.as_ptr() as usize;
    Some([&json[..begin], &rest, &json[begin + text.len()..]].concat())
}

fn is_nodeless(channel: &Value) -> bool {
    channel.get("target").is_some_and(|target| {
        target.is_object() && (target.get("node").is_none_or(Value::is_null) || target["path"] == "pointer")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_of_a_node_are_kept_and_nothing_else_is_touched() {
        let json =
            |animations: &str| format!(r#"{{"a": 1.0000001, "animations": {animations} , "b":[1]}} \0"#);
        let kept = r#"{"channels":[{"sampler":0,"target":{"node":0,"path":"scale"}}]}"#;
        let nodeless = r#"{"target": {"path": "scale"}}"#;
        let pointer = r#"{"target": {"node": 3, "path": "pointer"}}"#;
        let given = json(&format!(r#"[{kept}, {{"channels": [{nodeless}, {pointer}]}}]"#));
        let rest = String::from_utf8(without_nodeless(given.as_bytes()).unwrap()).unwrap();
        assert_eq!(rest, json(&format!("[{kept}]")));
        for same in [json(&format!("[{kept}]")), json("[]"), json("7"), "{".to_owned(), String::new()] {
            assert_eq!(without_nodeless(same.as_bytes()), None, "{same}");
        }
    }
}
