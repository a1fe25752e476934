//! What feature eliminations found.

use firn_science::forecast::selection::FeatureSelection;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sqlx::{Sqlite, Transaction};
use uuid::Uuid;

use super::{Result, Store, from_json, to_json};
use crate::domain::ids::Place;

/// What one elimination found, with where it comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SelectionRecord {
    /// The station or region whose days it was made on.
    #[serde(flatten)]
    pub place: Place,
    /// True where these were made by a generator.
    pub synthetic: bool,
    /// The curve, the ranking and the proposal.
    #[serde(flatten)]
    pub selection: FeatureSelection,
    /// Version of firn, hash of the inputs and seed.
    pub provenance: Value,
}

/// A record to keep under the job that made it.
#[derive(Clone, Debug, PartialEq)]
pub struct NewSelection {
    /// The job.
    pub job: Uuid,
    /// What it found.
    pub record: SelectionRecord,
}

pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, new: &NewSelection, now: Timestamp) -> Result<()> {
    sqlx::query("INSERT INTO selection (job, station, region, body, created) VALUES (?, ?, ?, ?, ?)")
        .bind(new.job.to_string())
        .bind(new.record.place.station().map(|id| id.as_str()))
        .bind(new.record.place.region().map(|id| id.as_str()))
        .bind(to_json(&new.record)?)
        .bind(now.to_string())
        .execute(&mut **tx)
        .await?;
    Ok(())
}

impl Store {
    /// What the job of that id found, if it was a feature elimination that ended well.
    ///
    /// # Errors
    /// [`StoreError::Sql`](super::StoreError::Sql) where the database cannot be read.
    pub async fn selection(&self, job: Uuid) -> Result<Option<SelectionRecord>> {
        let text: Option<String> = sqlx::query_scalar("SELECT body FROM selection WHERE job = ?")
            .bind(job.to_string())
            .fetch_optional(&self.reader)
            .await?;
        text.as_deref().map(from_json).transpose()
    }
}
