//! Uploaded scene bundles.

use forelight_protocol::{ArtifactHash, AuditAction, Bundle, BundleId, SceneSummary, Timestamp};
use sqlx::SqliteConnection;

use crate::audit::{Deed, note};
use crate::columns::Json;
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::idempotency::{Answered, IdempotencyKey, earlier_answer, record};
use crate::quotas::{QuotaOf, check_storage};
use crate::writing::run;

/// An uploaded bundle that contains a valid scene.
#[derive(Clone, PartialEq, Debug)]
pub struct NewBundle {
    /// Its zip file, stored as an artefact.
    pub hash: ArtifactHash,
    /// Its content.
    pub scene: SceneSummary,
}

impl Store {
    /// Stores a bundle.
    pub async fn create_bundle(
        &self,
        new: NewBundle,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Answered<Bundle>> {
        let mut write = self.write().await?;
        if let Some(answer) = earlier_answer(&mut write, key).await? {
            return Ok(Answered::Repeated(answer));
        }
        let uploader = write.actor().map(|actor| actor.name.clone());
        if let Some(uploader) = &uploader {
            // Other uploads may have come in since the quota was checked.
            let size = sqlx::query_scalar!(
                r#"SELECT size AS "size!: u64" FROM artifacts WHERE hash = ?"#,
                &new.hash.0[..]
            );
            let size = size.fetch_optional(write.connection().await?).await?;
            let size = size.ok_or(StoreError::NotFound("artifact"))?;
            check_storage(write.connection().await?, QuotaOf::Token(uploader), size).await?;
        }
        let bundle_id = BundleId::new();
        run!(
            write,
            "INSERT INTO bundles (id, hash, scene, created_at, uploaded_by) VALUES (?, ?, ?, ?, ?)",
            bundle_id.0,
            &new.hash.0[..],
            Json(&new.scene),
            now.micros(),
            uploader
        );
        let bundle = read(write.connection().await?, bundle_id).await?;
        let detail = serde_json::json!({"hash": bundle.hash, "size": bundle.size});
        note(&mut write, Deed::new(AuditAction::BundleUploaded, bundle_id), Some(&detail), now);
        record(&mut write, key, 201, &bundle, now);
        self.commit(write).await?;
        Ok(Answered::Fresh(bundle))
    }

    /// A bundle.
    pub async fn bundle(&self, bundle: BundleId) -> Result<Bundle> {
        read(&mut *self.readers().acquire().await?, bundle).await
    }
}

async fn read(connection: &mut SqliteConnection, bundle: BundleId) -> Result<Bundle> {
    let bundle = sqlx::query_as!(
        Bundle,
        "SELECT b.id, a.hash, b.scene, b.created_at, a.size FROM bundles b \
         JOIN artifacts a ON a.hash = b.hash WHERE b.id = ?",
        bundle.0
    )
    .fetch_optional(connection)
    .await?;
    bundle.ok_or(StoreError::NotFound("bundle"))
}
