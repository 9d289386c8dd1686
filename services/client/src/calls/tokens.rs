//! Bearer tokens.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::Request;
use forelight_protocol::{NewToken, RotateRequest, Token, TokenChange, TokenId, TokenPage, TokenRequest};
use reqwest::Method;

impl Client {
    /// Makes a token. Repeated, it makes another one.
    pub async fn create_token(&self, request: &TokenRequest) -> Result<NewToken, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/tokens", request)).await
    }

    /// All tokens, oldest first.
    pub async fn tokens(&self) -> Result<Vec<Token>, ClientError> {
        self.all_pages("/v1/tokens", &[], |page: TokenPage| (page.items, page.next_page_token)).await
    }

    /// Changes a token's name or end.
    pub async fn change_token(&self, token: TokenId, change: &TokenChange) -> Result<Token, ClientError> {
        self.transport.json(&Request::json(Method::PATCH, format!("/v1/tokens/{token}"), change)).await
    }

    /// Replaces a token by a new one.
    pub async fn rotate_token(
        &self,
        token: TokenId,
        request: &RotateRequest,
    ) -> Result<NewToken, ClientError> {
        let path = format!("/v1/tokens/{token}/rotate");
        self.transport.json(&Request::json(Method::POST, path, request)).await
    }

    /// Revokes a token at once.
    pub async fn revoke_token(&self, token: TokenId) -> Result<(), ClientError> {
        self.transport.send(&Request::new(Method::DELETE, format!("/v1/tokens/{token}"))).await.map(drop)
    }
}
