//! Leases: a worker's claims, renewals, checkpoints and results.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::{Payload, Request, retry_after};
use bytes::Bytes;
use forelight_protocol::{
    ClaimRequest, Lease, LeaseId, ProblemKind, ReleaseRequest, RenewRequest, Renewal, ResultAnswer,
    ResultRequest,
};
use reqwest::{Method, StatusCode};
use std::time::Duration;
use uuid::Uuid;

/// The answer to a claim.
#[derive(Debug, Clone, PartialEq)]
pub enum Claimed {
    /// A task.
    Lease(Box<Lease>),
    /// No task became ready before the request ended.
    Nothing,
    /// The node sleeps by its schedule. The worker must not claim again before this time has passed.
    Asleep(Duration),
}

impl Claimed {
    /// The lease, if there is one.
    pub fn lease(self) -> Option<Lease> {
        match self {
            Self::Lease(lease) => Some(*lease),
            Self::Nothing | Self::Asleep(_) => None,
        }
    }
}

impl Client {
    /// Claims a task. Waits for one as long as the request says.
    ///
    /// If the answer is lost, the same key gets the same lease again. With another key, that lease would stay
    /// unused until it expires.
    pub async fn claim(&self, claim: &ClaimRequest, key: Uuid) -> Result<Claimed, ClientError> {
        let patience = Duration::from_millis(u64::from(claim.wait_ms)) + Duration::from_secs(15);
        let request = Request::json(Method::POST, "/v1/leases", claim).of_worker();
        let request = request.timeout(Some(patience)).with_key(key);
        let (status, headers, body) = self.transport.whole(&request).await?;
        if status == StatusCode::NO_CONTENT {
            return Ok(retry_after(&headers).map_or(Claimed::Nothing, Claimed::Asleep));
        }
        self.transport.parse(&request, status, &body).map(Claimed::Lease)
    }

    /// Renews a lease. One attempt takes at most `patience`.
    pub async fn renew(
        &self,
        lease: LeaseId,
        renewal: &RenewRequest,
        patience: Duration,
    ) -> Result<Renewal, ClientError> {
        let request = Request::json(Method::PATCH, format!("/v1/leases/{lease}"), renewal);
        self.transport.json(&request.timeout(Some(patience))).await
    }

    /// Stores the finished tiles of a frame.
    pub async fn put_checkpoint(&self, lease: LeaseId, fence: u64, tiles: Bytes) -> Result<(), ClientError> {
        let path = format!("/v1/leases/{lease}/checkpoint?fence={fence}");
        self.transport.send(&Request::new(Method::PUT, path).payload(Payload::Bytes(tiles))).await.map(drop)
    }

    /// The finished tiles of the lease's frame from an earlier worker, if there are any.
    pub async fn checkpoint(&self, lease: LeaseId) -> Result<Option<Bytes>, ClientError> {
        match self.bytes(&Request::get(format!("/v1/leases/{lease}/checkpoint")).timeout(None)).await {
            Ok(tiles) => Ok(Some(tiles)),
            Err(error) if error.is(ProblemKind::NotFound) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Reports a task's result or error.
    pub async fn report(&self, lease: LeaseId, result: &ResultRequest) -> Result<ResultAnswer, ClientError> {
        self.transport.json(&Request::json(Method::POST, format!("/v1/leases/{lease}/result"), result)).await
    }

    /// Returns a task unfinished.
    pub async fn release(&self, lease: LeaseId, fence: u64) -> Result<(), ClientError> {
        let path = format!("/v1/leases/{lease}/release");
        self.transport.send(&Request::json(Method::POST, path, &ReleaseRequest { fence })).await.map(drop)
    }
}
