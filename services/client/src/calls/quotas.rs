//! Quotas of projects and tokens.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::Request;
use forelight_protocol::{QuotaList, QuotaRequest};
use reqwest::Method;

impl Client {
    /// All quotas, and how much of each is used.
    pub async fn quotas(&self) -> Result<QuotaList, ClientError> {
        self.get("/v1/quotas").await
    }

    /// Sets a quota, or removes it. Returns all of them.
    pub async fn set_quota(&self, quota: &QuotaRequest) -> Result<QuotaList, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/quotas", quota)).await
    }
}
