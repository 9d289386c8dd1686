//! A client of one service. Its calls are in `calls`.

use crate::backoff::Backoff;
use crate::error::ClientError;
use crate::token::Token;
use crate::transport::{Request, Transport, parameters};
use bytes::Bytes;
use forelight_protocol::PageToken;
use serde::de::DeserializeOwned;

/// A client of one service. It is cheap to clone. Clones share their connections.
#[derive(Debug, Clone)]
pub struct Client {
    pub(crate) transport: Transport,
}

impl Client {
    /// A client of the service at `address` (`http://host:port`), with [`Backoff::PATIENT`]. Over TLS, the
    /// service's certificate must lead to one of the system's roots.
    pub fn new(address: &str, token: Option<Token>) -> Result<Self, ClientError> {
        Ok(Self { transport: Transport::new(address, token, None, Backoff::PATIENT)? })
    }

    /// The same, where the service's certificate must lead to one of these, in PEM form.
    pub fn trusting(address: &str, token: Option<Token>, roots: &[u8]) -> Result<Self, ClientError> {
        Ok(Self { transport: Transport::new(address, token, Some(roots), Backoff::PATIENT)? })
    }

    /// The same client with another back-off.
    pub fn with_backoff(&self, backoff: Backoff) -> Self {
        Self { transport: self.transport.with_backoff(backoff) }
    }

    /// The address of the service.
    pub fn address(&self) -> &str {
        self.transport.base()
    }

    /// Succeeds if the service answers and is ready for work.
    pub async fn ready(&self) -> Result<(), ClientError> {
        self.transport.send(&Request::get("/readyz")).await.map(drop)
    }

    pub(crate) async fn get<T: DeserializeOwned>(&self, path: impl Into<String>) -> Result<T, ClientError> {
        self.transport.json(&Request::get(path)).await
    }

    pub(crate) async fn bytes(&self, request: &Request) -> Result<Bytes, ClientError> {
        let response = self.transport.send(request).await?;
        self.transport.body(request, response).await
    }

    /// The items of all pages of a list, as far as these query parameters let them through.
    pub(crate) async fn all_pages<P: DeserializeOwned, T>(
        &self,
        path: &str,
        filters: &[(&str, &str)],
        parts: impl Fn(P) -> (Vec<T>, Option<PageToken>),
    ) -> Result<Vec<T>, ClientError> {
        let mut all = Vec::new();
        let first = format!("{path}?page_size=200{}", parameters(filters));
        let mut page = first.clone();
        loop {
            let (items, next) = parts(self.get(page).await?);
            all.extend(items);
            match next {
                Some(token) => page = format!("{first}&page_token={token}"),
                None => return Ok(all),
            }
        }
    }
}
