//! Uploaded scene bundles.

use forelight_protocol::{ArtifactHash, Bundle, BundleId, SceneSummary, Timestamp};
use sqlx::sqlite::SqliteRow;

use crate::database::Store;
use crate::decode::{hash, id, json, time, to_json, whole};
use crate::error::StoreError;
use crate::idempotency::{Answered, IdempotencyKey, earlier_answer, record};

/// A bundle that was uploaded and found to be a scene.
#[derive(Clone, PartialEq, Debug)]
pub struct NewBundle {
    /// Its zip file, stored as an artefact.
    pub hash: ArtifactHash,
    /// What is in it.
    pub scene: SceneSummary,
}

const SELECT: &str = "SELECT b.id, b.hash, b.scene, b.created_at, a.size FROM bundles b JOIN artifacts a ON a.hash = b.hash WHERE b.id = ?";

impl Store {
    /// Remembers a bundle.
    pub async fn create_bundle(
        &self,
        new: NewBundle,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Answered<Bundle>, StoreError> {
        let mut write = self.write().await?;
        if let Some(answer) = earlier_answer(&mut write, key).await? {
            return Ok(Answered::Repeated(answer));
        }
        let bundle_id = BundleId::new();
        sqlx::query("INSERT INTO bundles (id, hash, scene, created_at) VALUES (?, ?, ?, ?)")
            .bind(bundle_id.0)
            .bind(&new.hash.0[..])
            .bind(to_json(&new.scene)?)
            .bind(now.micros())
            .execute(write.connection().await?)
            .await?;
        let row = sqlx::query(SELECT).bind(bundle_id.0).fetch_one(write.connection().await?).await?;
        let bundle = decode(&row)?;
        record(&mut write, key, 201, &bundle, now)?;
        self.commit(write).await?;
        Ok(Answered::Fresh(bundle))
    }

    /// A bundle.
    pub async fn bundle(&self, bundle: BundleId) -> Result<Bundle, StoreError> {
        let row = sqlx::query(SELECT).bind(bundle.0).fetch_optional(self.readers()).await?;
        decode(&row.ok_or(StoreError::NotFound("bundle"))?)
    }
}

fn decode(row: &SqliteRow) -> Result<Bundle, StoreError> {
    Ok(Bundle {
        id: BundleId(id(row, "id")?),
        hash: hash(row, "hash")?,
        size: whole(row, "size")?,
        scene: json(row, "scene")?,
        created_at: time(row, "created_at")?,
    })
}
