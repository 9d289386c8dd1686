//! Webhooks.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::Request;
use forelight_protocol::{Delivery, DeliveryPage, Webhook, WebhookId, WebhookList, WebhookRequest};
use reqwest::Method;

impl Client {
    /// Adds a webhook. Its secret is in the answer alone. Repeated, it adds another one.
    pub async fn add_webhook(&self, request: &WebhookRequest) -> Result<Webhook, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/webhooks", request)).await
    }

    /// All webhooks, oldest first.
    pub async fn webhooks(&self) -> Result<Vec<Webhook>, ClientError> {
        let list: WebhookList = self.get("/v1/webhooks").await?;
        Ok(list.items)
    }

    /// Removes a webhook and the list of its deliveries.
    pub async fn remove_webhook(&self, webhook: WebhookId) -> Result<(), ClientError> {
        let path = format!("/v1/webhooks/{webhook}");
        self.transport.send(&Request::new(Method::DELETE, path)).await.map(drop)
    }

    /// Sends a test message to a webhook.
    pub async fn test_webhook(&self, webhook: WebhookId) -> Result<(), ClientError> {
        let path = format!("/v1/webhooks/{webhook}/test");
        self.transport.send(&Request::new(Method::POST, path)).await.map(drop)
    }

    /// What a webhook was and is to be told: the newest, at most 200.
    pub async fn deliveries(&self, webhook: WebhookId, most: u32) -> Result<Vec<Delivery>, ClientError> {
        let page: DeliveryPage =
            self.get(format!("/v1/webhooks/{webhook}/deliveries?page_size={most}")).await?;
        Ok(page.items)
    }
}
