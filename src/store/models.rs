//! The registry of trained models: a model never changes, what changes is which one is active.

use std::sync::Arc;

use firn_science::forecast::model::TrainedModel;
use jiff::Timestamp;
use sqlx::{FromRow, Row, Sqlite, Transaction, sqlite::SqliteRow};
use uuid::Uuid;

use super::{Result, Store, StoreError, from_json, parse_timestamp, to_json};
use crate::domain::ids::StationId;

/// A model without its machine and evaluation, which are large and read by themselves.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelRecord {
    /// Its id, a UUID version 7.
    pub id: Uuid,
    /// The station that it was trained for.
    pub station: StationId,
    /// The job that trained it.
    pub job: Uuid,
    /// Days between the last observation and the day that is forecast.
    pub lead: u8,
    /// The job of the feature elimination that it was trained with, if it was.
    pub selection: Option<Uuid>,
    /// What `GET /v1/models/{id}` says of it, apart from the fields above.
    pub summary: serde_json::Value,
    /// When it was made.
    pub created: Timestamp,
}

/// A model as training leaves it.
#[derive(Clone, Debug)]
pub struct NewModel {
    /// The record to keep.
    pub record: ModelRecord,
    /// The trained machine with all that a forecast needs, as JSON.
    pub machine: String,
    /// Its evaluation, as JSON.
    pub evaluation: String,
}

/// Which model is active, and since when.
#[derive(Clone, Debug, PartialEq)]
pub struct Activation {
    /// The model.
    pub model: Uuid,
    /// Since when.
    pub activated: Timestamp,
    /// By whom; none for a station's first model and where no key was needed.
    pub activated_by: Option<String>,
    /// Counts the activations of the whole registry.
    pub sequence: i64,
}

struct ModelRow(ModelRecord);
struct ActivationRow(Activation);

impl FromRow<'_, SqliteRow> for ModelRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read_model(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

impl FromRow<'_, SqliteRow> for ActivationRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read_activation(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read_model(row: &SqliteRow) -> Result<ModelRecord> {
    Ok(ModelRecord {
        id: row.try_get::<String, _>("id")?.parse().map_err(StoreError::corrupt)?,
        station: row.try_get::<String, _>("station")?.parse().map_err(StoreError::corrupt)?,
        job: row.try_get::<String, _>("job")?.parse().map_err(StoreError::corrupt)?,
        lead: row.try_get("lead")?,
        selection: row
            .try_get::<Option<String>, _>("selection")?
            .map(|job| job.parse().map_err(StoreError::corrupt))
            .transpose()?,
        summary: from_json(row.try_get("summary")?)?,
        created: parse_timestamp(row.try_get("created")?)?,
    })
}

fn read_activation(row: &SqliteRow) -> Result<Activation> {
    Ok(Activation {
        model: row.try_get::<String, _>("model")?.parse().map_err(StoreError::corrupt)?,
        activated: parse_timestamp(row.try_get("activated")?)?,
        activated_by: row.try_get("activated_by")?,
        sequence: row.try_get("sequence")?,
    })
}

async fn insert_activation(
    tx: &mut Transaction<'_, Sqlite>,
    station: &StationId,
    lead: u8,
    model: Uuid,
    by: Option<&str>,
    now: Timestamp,
) -> Result<Activation> {
    let row = sqlx::query_as::<_, ActivationRow>(
        "INSERT INTO activation (station, lead, model, activated, activated_by) VALUES (?, ?, ?, ?, ?) RETURNING *",
    )
    .bind(station.as_str())
    .bind(lead)
    .bind(model.to_string())
    .bind(now.to_string())
    .bind(by)
    .fetch_one(&mut **tx)
    .await?;
    Ok(row.0)
}

const ACTIVE: &str = "SELECT * FROM activation WHERE station = ? AND lead = ? ORDER BY sequence DESC LIMIT 1";

/// Keeps a trained model; makes it active where its station has none of that lead, and says whether it did.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, model: &NewModel, now: Timestamp) -> Result<bool> {
    let record = &model.record;
    sqlx::query(
        "INSERT INTO model (id, station, job, lead, selection, summary, machine, evaluation, created)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(record.id.to_string())
    .bind(record.station.as_str())
    .bind(record.job.to_string())
    .bind(record.lead)
    .bind(record.selection.map(|job| job.to_string()))
    .bind(to_json(&record.summary)?)
    .bind(&model.machine)
    .bind(&model.evaluation)
    .bind(record.created.to_string())
    .execute(&mut **tx)
    .await?;
    let active: Option<ActivationRow> =
        sqlx::query_as(ACTIVE).bind(record.station.as_str()).bind(record.lead).fetch_optional(&mut **tx).await?;
    if active.is_some() {
        return Ok(false);
    }
    insert_activation(tx, &record.station, record.lead, record.id, None, now).await?;
    Ok(true)
}

impl Store {
    /// The model of that id.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn model(&self, id: Uuid) -> Result<Option<ModelRecord>> {
        let row = sqlx::query_as::<_, ModelRow>(
            "SELECT id, station, job, lead, selection, summary, created FROM model WHERE id = ?",
        )
        .bind(id.to_string())
        .fetch_optional(&self.reader)
        .await?;
        Ok(row.map(|row| row.0))
    }

    /// Up to `limit` models, newest first, of one station or of all, older than `before`.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn models(
        &self,
        station: Option<&StationId>,
        before: Option<Uuid>,
        limit: u32,
    ) -> Result<Vec<ModelRecord>> {
        let rows = sqlx::query_as::<_, ModelRow>(
            "SELECT id, station, job, lead, selection, summary, created FROM model
             WHERE (?1 IS NULL OR station = ?1) AND (?2 IS NULL OR id < ?2) ORDER BY id DESC LIMIT ?3",
        )
        .bind(station.map(StationId::as_str))
        .bind(before.map(|id| id.to_string()))
        .bind(limit)
        .fetch_all(&self.reader)
        .await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// A model ready to forecast with; read once and then kept in memory, since it never changes.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn trained_model(&self, id: Uuid) -> Result<Option<Arc<TrainedModel>>> {
        if let Some(model) = self.trained.get(&id) {
            return Ok(Some(model));
        }
        let text: Option<String> = sqlx::query_scalar("SELECT machine FROM model WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(&self.reader)
            .await?;
        let Some(text) = text else { return Ok(None) };
        let model: Arc<TrainedModel> = Arc::new(from_json(&text)?);
        self.trained.insert(id, Arc::clone(&model));
        Ok(Some(model))
    }

    /// The evaluation of a model, as JSON.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn model_evaluation(&self, id: Uuid) -> Result<Option<serde_json::Value>> {
        let text: Option<String> = sqlx::query_scalar("SELECT evaluation FROM model WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(&self.reader)
            .await?;
        text.as_deref().map(from_json).transpose()
    }

    /// The active model of a station and lead.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn active_model(&self, station: &StationId, lead: u8) -> Result<Option<Activation>> {
        let row = sqlx::query_as::<_, ActivationRow>(ACTIVE)
            .bind(station.as_str())
            .bind(lead)
            .fetch_optional(&self.reader)
            .await?;
        Ok(row.map(|row| row.0))
    }

    /// Makes a model the active one if `permits` agrees with the one before.
    ///
    /// # Errors
    /// [`StoreError::Precondition`] where it does not.
    pub async fn activate_model(
        &self,
        station: &StationId,
        lead: u8,
        model: Uuid,
        by: Option<&str>,
        now: Timestamp,
        permits: impl FnOnce(Option<&Activation>) -> bool,
    ) -> Result<Activation> {
        let mut tx = self.begin().await?;
        let before: Option<ActivationRow> =
            sqlx::query_as(ACTIVE).bind(station.as_str()).bind(lead).fetch_optional(&mut *tx).await?;
        let before = before.map(|row| row.0);
        if !permits(before.as_ref()) {
            return Err(StoreError::Precondition);
        }
        if let Some(same) = before.filter(|before| before.model == model) {
            return Ok(same);
        }
        let after = insert_activation(&mut tx, station, lead, model, by, now).await?;
        tx.commit().await?;
        Ok(after)
    }
}
