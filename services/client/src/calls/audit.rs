//! The audit.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::{Request, parameters};
use bytes::Bytes;
use forelight_protocol::{AuditEntry, AuditPage};

impl Client {
    /// The newest entries that match these parameters of `GET /v1/audit`, at most 200.
    pub async fn newest_audit(
        &self,
        filters: &[(&str, &str)],
        most: u32,
    ) -> Result<Vec<AuditEntry>, ClientError> {
        let page: AuditPage = self.get(format!("/v1/audit?page_size={most}{}", parameters(filters))).await?;
        Ok(page.items)
    }

    /// All entries as a file: `ndjson` or `csv`.
    pub async fn audit_export(&self, format: &str, filters: &[(&str, &str)]) -> Result<Bytes, ClientError> {
        let path = format!("/v1/audit/export?format={format}{}", parameters(filters));
        self.bytes(&Request::get(path).timeout(None)).await
    }
}
