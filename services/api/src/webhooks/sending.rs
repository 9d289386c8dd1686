//! Sends signed messages, as Standard Webhooks 1.0 describes.
//!
//! The signature is HMAC-SHA256 over `id.timestamp.body`. The key is what follows `whsec_` in the secret, in
//! Base64.

use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use forelight_protocol::Timestamp;
use forelight_store::{DueDelivery, tokens};
use hmac::{Hmac, KeyInit as _, Mac as _};
use reqwest::header::CONTENT_TYPE;
use reqwest::redirect::Policy;
use sha2::Sha256;

/// How long a receiver may take to answer.
const PATIENCE: Duration = Duration::from_secs(10);

const PREFIX: &str = "whsec_";

/// A new secret: 256 bits, in the form that libraries for Standard Webhooks read.
pub(crate) fn new_secret() -> String {
    let key = *blake3::hash(tokens::random().as_bytes()).as_bytes();
    format!("{PREFIX}{}", STANDARD.encode(key))
}

/// Sends messages.
pub(super) struct Sender(reqwest::Client);

impl Sender {
    pub fn new() -> Result<Self, reqwest::Error> {
        let client = reqwest::Client::builder()
            .timeout(PATIENCE)
            // A receiver that has moved is told to the person who added it, not followed to anywhere.
            .redirect(Policy::none())
            .user_agent(concat!("forelight/", env!("CARGO_PKG_VERSION")))
            .build()?;
        Ok(Self(client))
    }

    /// Sends a message. Returns the status of the answer, and what went wrong.
    pub async fn send(&self, delivery: &DueDelivery, now: Timestamp) -> (Option<u16>, Option<String>) {
        let id = delivery.id.to_string();
        let timestamp = now.micros().div_euclid(1_000_000).to_string();
        let request = self
            .0
            .post(&delivery.url)
            .header("webhook-signature", signature(&delivery.secret, &id, &timestamp, &delivery.body))
            .header("webhook-id", id)
            .header("webhook-timestamp", timestamp)
            .header(CONTENT_TYPE, "application/json")
            .body(delivery.body.clone());
        match request.send().await {
            Ok(answer) if answer.status().is_success() => (Some(answer.status().as_u16()), None),
            Ok(answer) => {
                let status = answer.status();
                (Some(status.as_u16()), Some(format!("the receiver answered {status}")))
            }
            Err(error) => (None, Some(in_words(&error.without_url()))),
        }
    }
}

/// An error and its causes, in one line.
fn in_words(error: &reqwest::Error) -> String {
    if error.is_timeout() {
        return format!("no answer within {} seconds", PATIENCE.as_secs());
    }
    let mut words = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(next) = cause {
        words += &format!(": {next}");
        cause = next.source();
    }
    words.chars().filter(|c| !c.is_control()).take(500).collect()
}

fn signature(secret: &str, id: &str, timestamp: &str, body: &str) -> String {
    let key = STANDARD.decode(secret.trim_start_matches(PREFIX)).unwrap_or_default();
    // A key of any length will do.
    let Ok(mut mac) = Hmac::<Sha256>::new_from_slice(&key) else { return String::new() };
    mac.update(format!("{id}.{timestamp}.{body}").as_bytes());
    format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_signed_as_the_standard_says() {
        // The example of Standard Webhooks 1.0.
        let signed = signature(
            "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw",
            "msg_p5jXN8AQM9LWM0D4loKWxJek",
            "1614265330",
            r#"{"test": 2432232314}"#,
        );
        assert_eq!(signed, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
        assert_eq!(STANDARD.decode(&new_secret()[PREFIX.len()..]).unwrap().len(), 32);
        assert_ne!(new_secret(), new_secret());
    }
}
