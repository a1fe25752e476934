//! How models did at other places.

use firn_science::forecast::transfer::Transfer;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sqlx::{Row, Sqlite, Transaction};
use uuid::Uuid;

use super::{Result, Store, StoreError, from_json, parse_timestamp, to_json};
use crate::domain::ids::StationId;

/// What one evaluation found, with where it comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TransferRecord {
    /// The model.
    pub model_id: Uuid,
    /// The station whose days it was scored on.
    pub station: StationId,
    /// True where the model or these days come from a generator.
    pub synthetic: bool,
    /// The scores.
    #[serde(flatten)]
    pub transfer: Transfer,
    /// Version of firn, hash of the inputs and seed.
    pub provenance: Value,
}

/// A record to keep under the job that made it.
#[derive(Clone, Debug, PartialEq)]
pub struct NewTransfer {
    /// The job.
    pub job: Uuid,
    /// What it found.
    pub record: TransferRecord,
}

/// A record as it is kept.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredTransfer {
    /// The job that made it.
    pub job: Uuid,
    /// When.
    pub created: Timestamp,
    /// What it found.
    pub record: TransferRecord,
}

pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, new: &NewTransfer, now: Timestamp) -> Result<()> {
    sqlx::query("INSERT INTO transfer (job, model, station, body, created) VALUES (?, ?, ?, ?, ?)")
        .bind(new.job.to_string())
        .bind(new.record.model_id.to_string())
        .bind(new.record.station.as_str())
        .bind(to_json(&new.record)?)
        .bind(now.to_string())
        .execute(&mut **tx)
        .await?;
    Ok(())
}

impl Store {
    /// Up to `limit` evaluations of a model at other places, newest first, of jobs older than `before`.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn transfers(&self, model: Uuid, before: Option<Uuid>, limit: u32) -> Result<Vec<StoredTransfer>> {
        let rows = sqlx::query(
            "SELECT job, body, created FROM transfer WHERE model = ?1 AND (?2 IS NULL OR job < ?2) ORDER BY job DESC LIMIT ?3",
        )
        .bind(model.to_string())
        .bind(before.map(|job| job.to_string()))
        .bind(limit)
        .fetch_all(&self.reader)
        .await?;
        let read = |row: &sqlx::sqlite::SqliteRow| -> Result<StoredTransfer> {
            Ok(StoredTransfer {
                job: row.try_get::<String, _>("job")?.parse().map_err(StoreError::corrupt)?,
                created: parse_timestamp(row.try_get("created")?)?,
                record: from_json(row.try_get("body")?)?,
            })
        };
        rows.iter().map(read).collect()
    }
}
