//! The registry of trained models: a model never changes, what changes is which one is active.

use std::sync::Arc;

use firn_science::forecast::model::TrainedModel;
use jiff::Timestamp;
use sqlx::{FromRow, Row, Sqlite, SqliteConnection, Transaction, sqlite::SqliteRow};
use uuid::Uuid;

use super::{
    Result, Store, StoreError,
    audit::{self, Action, Actor, NewEntry},
    from_json, parse_timestamp,
    proposals::Proposal,
    to_json,
};
use crate::domain::ids::{Place, StationId};

/// A model without its machine and evaluation, which are large and read by themselves.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelRecord {
    /// Its id, a UUID version 7.
    pub id: Uuid,
    /// The station or region that it was trained for.
    pub place: Place,
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

impl ModelRecord {
    /// True where it was trained on days that a generator made.
    #[must_use]
    pub fn is_synthetic(&self) -> bool {
        self.summary.get("synthetic").and_then(serde_json::Value::as_bool).unwrap_or(false)
    }

    /// The stations whose days it was trained on, in the order of the training.
    #[must_use]
    pub fn stations(&self) -> Vec<StationId> {
        match &self.place {
            Place::Station(id) => vec![id.clone()],
            Place::Region(_) => {
                serde_json::from_value(self.summary["training"]["stations"].clone()).unwrap_or_default()
            }
        }
    }

    /// Whether days of that station are among them.
    #[must_use]
    pub fn trained_at(&self, station: &StationId) -> bool {
        self.stations().contains(station)
    }
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
    /// By whom; none for the first model of a place and where no key was needed.
    pub activated_by: Option<String>,
    /// Why, in the words of who did it.
    pub reason: Option<String>,
    /// The activation that a roll-back from here restores; none where there was none before.
    pub back_to: Option<i64>,
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
        place: read_place(row)?,
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

/// The station or the region of a row; every row has one of the two.
pub(super) fn read_place(row: &SqliteRow) -> Result<Place> {
    if let Some(station) = row.try_get::<Option<String>, _>("station")? {
        return Ok(Place::Station(station.parse().map_err(StoreError::corrupt)?));
    }
    Ok(Place::Region(row.try_get::<String, _>("region")?.parse().map_err(StoreError::corrupt)?))
}

fn read_activation(row: &SqliteRow) -> Result<Activation> {
    Ok(Activation {
        model: row.try_get::<String, _>("model")?.parse().map_err(StoreError::corrupt)?,
        activated: parse_timestamp(row.try_get("activated")?)?,
        activated_by: row.try_get("activated_by")?,
        reason: row.try_get("reason")?,
        back_to: row.try_get("back_to")?,
        sequence: row.try_get("sequence")?,
    })
}

/// A change of the active model.
struct Change<'a> {
    place: &'a Place,
    lead: u8,
    model: Uuid,
    reason: Option<&'a str>,
    action: Action,
    before: Option<&'a Activation>,
    back_to: Option<i64>,
}

async fn insert_activation(tx: &mut Transaction<'_, Sqlite>, change: Change<'_>, actor: &Actor) -> Result<Activation> {
    let row = sqlx::query_as::<_, ActivationRow>(
        "INSERT INTO activation (station, region, lead, model, activated, activated_by, reason, back_to)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?) RETURNING *",
    )
    .bind(change.place.station().map(|id| id.as_str()))
    .bind(change.place.region().map(|id| id.as_str()))
    .bind(change.lead)
    .bind(change.model.to_string())
    .bind(actor.at.to_string())
    .bind(actor.name.as_deref())
    .bind(change.reason)
    .bind(change.back_to)
    .fetch_one(&mut **tx)
    .await?;
    let model = |id: Uuid| serde_json::json!({"lead": change.lead, "model_id": id});
    let entry = NewEntry {
        action: change.action,
        target: &format!("{}/active-model", change.place.path()),
        reason: change.reason,
        before: change.before.map(|before| model(before.model)),
        after: Some(model(change.model)),
    };
    audit::write(tx, actor, entry).await?;
    Ok(row.0)
}

const ACTIVE: &str =
    "SELECT * FROM activation WHERE station IS ? AND region IS ? AND lead = ? ORDER BY sequence DESC LIMIT 1";

async fn active(connection: &mut SqliteConnection, place: &Place, lead: u8) -> Result<Option<Activation>> {
    let row: Option<ActivationRow> = sqlx::query_as(ACTIVE)
        .bind(place.station().map(|id| id.as_str()))
        .bind(place.region().map(|id| id.as_str()))
        .bind(lead)
        .fetch_optional(connection)
        .await?;
    Ok(row.map(|row| row.0))
}

/// Keeps a trained model.
pub(super) async fn keep(tx: &mut Transaction<'_, Sqlite>, model: &NewModel) -> Result<()> {
    let record = &model.record;
    sqlx::query(
        "INSERT INTO model (id, station, region, job, lead, selection, summary, machine, evaluation, created)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(record.id.to_string())
    .bind(record.place.station().map(|id| id.as_str()))
    .bind(record.place.region().map(|id| id.as_str()))
    .bind(record.job.to_string())
    .bind(record.lead)
    .bind(record.selection.map(|job| job.to_string()))
    .bind(to_json(&record.summary)?)
    .bind(&model.machine)
    .bind(&model.evaluation)
    .bind(record.created.to_string())
    .execute(&mut **tx)
    .await?;
    Ok(())
}

/// Makes the model of a proposal the active one, if that is still the one that it was compared with; says whether it is.
pub(super) async fn replace(
    tx: &mut Transaction<'_, Sqlite>,
    proposal: &Proposal,
    target: &str,
    actor: &Actor,
) -> Result<bool> {
    let before = active(tx, &proposal.place, proposal.lead).await?;
    let Some(before) = before.filter(|before| before.model == proposal.active) else { return Ok(false) };
    let change = Change {
        place: &proposal.place,
        lead: proposal.lead,
        model: proposal.model,
        reason: Some(&format!("accepted: {target}")),
        action: Action::ModelActivated,
        before: Some(&before),
        back_to: Some(before.sequence),
    };
    insert_activation(tx, change, actor).await?;
    Ok(true)
}

/// Keeps a trained model; makes it active where its place has none of that lead, and says whether it did.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, model: &NewModel, now: Timestamp) -> Result<bool> {
    let record = &model.record;
    keep(tx, model).await?;
    if active(tx, &record.place, record.lead).await?.is_some() {
        return Ok(false);
    }
    let change = Change {
        place: &record.place,
        lead: record.lead,
        model: record.id,
        reason: Some("the first model"),
        action: Action::ModelActivated,
        before: None,
        back_to: None,
    };
    insert_activation(tx, change, &Actor::service(now)).await?;
    Ok(true)
}

impl Store {
    /// The model of that id.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn model(&self, id: Uuid) -> Result<Option<ModelRecord>> {
        let row = sqlx::query_as::<_, ModelRow>(
            "SELECT id, station, region, job, lead, selection, summary, created FROM model WHERE id = ?",
        )
        .bind(id.to_string())
        .fetch_optional(&self.reader)
        .await?;
        Ok(row.map(|row| row.0))
    }

    /// Up to `limit` models, newest first, of one place or of all, older than `before`.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn models(&self, place: Option<&Place>, before: Option<Uuid>, limit: u32) -> Result<Vec<ModelRecord>> {
        let rows = sqlx::query_as::<_, ModelRow>(
            "SELECT id, station, region, job, lead, selection, summary, created FROM model
             WHERE (?1 IS NULL OR station = ?1) AND (?4 IS NULL OR region = ?4) AND (?2 IS NULL OR id < ?2)
             ORDER BY id DESC LIMIT ?3",
        )
        .bind(place.and_then(Place::station).map(|id| id.as_str()))
        .bind(before.map(|id| id.to_string()))
        .bind(limit)
        .bind(place.and_then(Place::region).map(|id| id.as_str()))
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

    /// The active model of a place and lead.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn active_model(&self, place: &Place, lead: u8) -> Result<Option<Activation>> {
        let mut connection = self.reader.acquire().await?;
        active(&mut connection, place, lead).await
    }

    /// Makes a model the active one if `permits` agrees with the one before.
    ///
    /// # Errors
    /// [`StoreError::Precondition`] where it does not.
    pub async fn activate_model(
        &self,
        place: &Place,
        lead: u8,
        model: Uuid,
        reason: Option<&str>,
        actor: &Actor,
        permits: impl FnOnce(Option<&Activation>) -> bool,
    ) -> Result<Activation> {
        let mut tx = self.begin().await?;
        let before = active(&mut tx, place, lead).await?;
        if !permits(before.as_ref()) {
            return Err(StoreError::Precondition);
        }
        if let Some(same) = before.as_ref().filter(|before| before.model == model) {
            return Ok(same.clone());
        }
        let back_to = before.as_ref().map(|before| before.sequence);
        let (action, before) = (Action::ModelActivated, before.as_ref());
        let change = Change { place, lead, model, reason, action, before, back_to };
        let after = insert_activation(&mut tx, change, actor).await?;
        tx.commit().await?;
        Ok(after)
    }

    /// Makes the model active again that was so before the active one; a second roll-back goes back further. `None`, and
    /// nothing changed, where there was none before.
    ///
    /// # Errors
    /// [`StoreError::Precondition`] where `permits` does not agree with the active one.
    pub async fn roll_back_model(
        &self,
        place: &Place,
        lead: u8,
        reason: Option<&str>,
        actor: &Actor,
        permits: impl FnOnce(Option<&Activation>) -> bool,
    ) -> Result<Option<Activation>> {
        let mut tx = self.begin().await?;
        let before = active(&mut tx, place, lead).await?;
        if !permits(before.as_ref()) {
            return Err(StoreError::Precondition);
        }
        let Some(earlier) = before.as_ref().and_then(|before| before.back_to) else { return Ok(None) };
        let earlier: ActivationRow =
            sqlx::query_as("SELECT * FROM activation WHERE sequence = ?").bind(earlier).fetch_one(&mut *tx).await?;
        let Activation { model, back_to, .. } = earlier.0;
        let (action, before) = (Action::ModelRolledBack, before.as_ref());
        let change = Change { place, lead, model, reason, action, before, back_to };
        let after = insert_activation(&mut tx, change, actor).await?;
        tx.commit().await?;
        Ok(Some(after))
    }
}
