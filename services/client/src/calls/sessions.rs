//! Signing people in with a browser.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::Request;
use forelight_protocol::SessionCode;
use reqwest::Method;

impl Client {
    /// A one-time code, with which a browser signs in with the rights of this client's token.
    pub async fn session_code(&self) -> Result<SessionCode, ClientError> {
        self.transport.json(&Request::new(Method::POST, "/v1/sessions/codes")).await
    }
}
