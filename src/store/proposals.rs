//! Proposals of retrainings, what became of them, and the days of the calendar on which one was due.

use firn_science::forecast::evaluation::Comparison;
use jiff::{Timestamp, civil::Date, tz::TimeZone};
use sqlx::{FromRow, Row, Sqlite, SqliteConnection, Transaction, sqlite::SqliteRow};
use uuid::Uuid;

use super::{
    Result, Store, StoreError,
    audit::{self, Action, Actor, NewEntry},
    from_json, jobs,
    models::{self, NewModel, read_place},
    parse_timestamp, to_json,
};
use crate::domain::{ids::Place, job::Job, retrain::DayOfYear, station::ZoneName};

/// A proposal as a retraining leaves it.
#[derive(Clone, Debug)]
pub struct NewProposal {
    /// Its id, a UUID version 7.
    pub id: Uuid,
    /// The model that is proposed; its record names the job and the place.
    pub model: NewModel,
    /// The active model that it was compared with.
    pub active: Uuid,
    /// What the comparison says, in words.
    pub recommendation: String,
    /// Both on the same seasons; none where no season could be held out from both.
    pub comparison: Option<Comparison>,
}

/// What became of a proposal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProposalStatus {
    /// Nobody has decided.
    Open,
    /// Its model was made the active one.
    Accepted,
    /// It was turned down.
    Declined,
    /// A newer one took its place before anybody decided.
    Superseded,
}

impl ProposalStatus {
    const ALL: [Self; 4] = [Self::Open, Self::Accepted, Self::Declined, Self::Superseded];

    /// The name in the store and the answers.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Accepted => "accepted",
            Self::Declined => "declined",
            Self::Superseded => "superseded",
        }
    }
}

/// A proposal.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// Its id.
    pub id: Uuid,
    /// The station or region.
    pub place: Place,
    /// Days between the last observation and the day that is forecast.
    pub lead: u8,
    /// The job that made it.
    pub job: Uuid,
    /// The model that is proposed.
    pub model: Uuid,
    /// The active model that it was compared with.
    pub active: Uuid,
    /// What became of it.
    pub status: ProposalStatus,
    /// What the comparison says, in words.
    pub recommendation: String,
    /// Both on the same seasons.
    pub comparison: Option<Comparison>,
    /// When it was made.
    pub created: Timestamp,
    /// When it was decided.
    pub decided: Option<Timestamp>,
    /// By whom.
    pub decided_by: Option<String>,
    /// Why, in the words of who decided.
    pub reason: Option<String>,
}

/// What became of a decision.
#[derive(Clone, Debug, PartialEq)]
pub enum Decided {
    /// It is written.
    Done(Box<Proposal>),
    /// The proposal was decided before, or another one took its place.
    Closed(ProposalStatus),
    /// Another model is active than the one that it was compared with.
    OtherModelActive,
}

struct ProposalRow(Proposal);

impl FromRow<'_, SqliteRow> for ProposalRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read(row: &SqliteRow) -> Result<Proposal> {
    let id = |name: &str| -> Result<Uuid> { row.try_get::<String, _>(name)?.parse().map_err(StoreError::corrupt) };
    let status: String = row.try_get("status")?;
    let known = ProposalStatus::ALL.into_iter().find(|known| known.name() == status);
    Ok(Proposal {
        id: id("id")?,
        place: read_place(row)?,
        lead: row.try_get("lead")?,
        job: id("job")?,
        model: id("model")?,
        active: id("active")?,
        status: known.ok_or_else(|| StoreError::corrupt(status))?,
        recommendation: row.try_get("recommendation")?,
        comparison: row.try_get::<Option<String>, _>("comparison")?.as_deref().map(from_json).transpose()?,
        created: parse_timestamp(row.try_get("created")?)?,
        decided: row.try_get::<Option<String>, _>("decided")?.as_deref().map(parse_timestamp).transpose()?,
        decided_by: row.try_get("decided_by")?,
        reason: row.try_get("reason")?,
    })
}

/// The address of a proposal.
fn path(place: &Place, id: Uuid) -> String {
    format!("{}/proposals/{id}", place.path())
}

/// Keeps a proposed model, which does not become active, with what it was compared with; an open one before it is superseded.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, new: &NewProposal, now: Timestamp) -> Result<()> {
    let record = &new.model.record;
    models::keep(tx, &new.model).await?;
    sqlx::query(
        "UPDATE proposal SET status = 'superseded', decided = ? WHERE station IS ? AND region IS ? AND lead = ? AND status = 'open'",
    )
    .bind(now.to_string())
    .bind(record.place.station().map(|id| id.as_str()))
    .bind(record.place.region().map(|id| id.as_str()))
    .bind(record.lead)
    .execute(&mut **tx)
    .await?;
    sqlx::query(
        "INSERT INTO proposal (id, station, region, lead, job, model, active, status, recommendation, comparison, created)
         VALUES (?, ?, ?, ?, ?, ?, ?, 'open', ?, ?, ?)",
    )
    .bind(new.id.to_string())
    .bind(record.place.station().map(|id| id.as_str()))
    .bind(record.place.region().map(|id| id.as_str()))
    .bind(record.lead)
    .bind(record.job.to_string())
    .bind(record.id.to_string())
    .bind(new.active.to_string())
    .bind(&new.recommendation)
    .bind(new.comparison.as_ref().map(to_json).transpose()?)
    .bind(now.to_string())
    .execute(&mut **tx)
    .await?;
    let entry = NewEntry {
        action: Action::ProposalMade,
        target: &path(&record.place, new.id),
        reason: Some(&new.recommendation),
        before: None,
        after: Some(serde_json::json!({"lead": record.lead, "model_id": record.id, "active_model_id": new.active})),
    };
    audit::write(tx, &Actor::service(now), entry).await
}

async fn find(connection: &mut SqliteConnection, place: &Place, id: Uuid) -> Result<Option<Proposal>> {
    let row: Option<ProposalRow> =
        sqlx::query_as("SELECT * FROM proposal WHERE id = ? AND station IS ? AND region IS ?")
            .bind(id.to_string())
            .bind(place.station().map(|id| id.as_str()))
            .bind(place.region().map(|id| id.as_str()))
            .fetch_optional(connection)
            .await?;
    Ok(row.map(|row| row.0))
}

/// A place that is retrained each year.
#[derive(Clone, Debug)]
pub struct Schedule {
    /// The station or region.
    pub place: Place,
    /// On which day.
    pub yearly: DayOfYear,
    /// Of which zone: the station's, or that of the first station of the region.
    pub zone: TimeZone,
}

/// A day of the calendar on which the model of a place is to be retrained.
#[derive(Clone, Debug)]
pub struct Due {
    /// The station or region.
    pub place: Place,
    /// Days between the last observation and the day that is forecast.
    pub lead: u8,
    /// The local day.
    pub day: Date,
}

impl Store {
    /// Up to `limit` proposals of a place, newest first, older than `before`.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn proposals(&self, place: &Place, before: Option<Uuid>, limit: u32) -> Result<Vec<Proposal>> {
        let rows: Vec<ProposalRow> = sqlx::query_as(
            "SELECT * FROM proposal WHERE station IS ?1 AND region IS ?2 AND (?3 IS NULL OR id < ?3) ORDER BY id DESC LIMIT ?4",
        )
        .bind(place.station().map(|id| id.as_str()))
        .bind(place.region().map(|id| id.as_str()))
        .bind(before.map(|id| id.to_string()))
        .bind(limit)
        .fetch_all(&self.reader)
        .await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// The proposal of that id, if it is one of that place.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn proposal(&self, place: &Place, id: Uuid) -> Result<Option<Proposal>> {
        let mut connection = self.reader.acquire().await?;
        find(&mut connection, place, id).await
    }

    /// Accepts a proposal, whose model becomes the active one, or declines it. An open one alone can be decided; and accepted
    /// only while the model is active that it was compared with.
    ///
    /// # Errors
    /// [`StoreError::Missing`] where there is no such proposal.
    pub async fn decide_proposal(
        &self,
        place: &Place,
        id: Uuid,
        accept: bool,
        reason: Option<&str>,
        actor: &Actor,
    ) -> Result<Decided> {
        let mut tx = self.begin().await?;
        let proposal = find(&mut tx, place, id).await?.ok_or(StoreError::Missing)?;
        if proposal.status != ProposalStatus::Open {
            return Ok(Decided::Closed(proposal.status));
        }
        let target = path(place, id);
        if accept && !models::replace(&mut tx, &proposal, &target, actor).await? {
            return Ok(Decided::OtherModelActive);
        }
        let (status, action) = if accept {
            (ProposalStatus::Accepted, Action::ProposalAccepted)
        } else {
            (ProposalStatus::Declined, Action::ProposalDeclined)
        };
        sqlx::query("UPDATE proposal SET status = ?, decided = ?, decided_by = ?, reason = ? WHERE id = ?")
            .bind(status.name())
            .bind(actor.at.to_string())
            .bind(actor.name.as_deref())
            .bind(reason)
            .bind(id.to_string())
            .execute(&mut *tx)
            .await?;
        let state = |status: ProposalStatus| serde_json::json!({"status": status.name(), "model_id": proposal.model});
        let entry = NewEntry {
            action,
            target: &target,
            reason,
            before: Some(state(ProposalStatus::Open)),
            after: Some(state(status)),
        };
        audit::write(&mut tx, actor, entry).await?;
        let decided = find(&mut tx, place, id).await?.ok_or(StoreError::Missing)?;
        tx.commit().await?;
        Ok(Decided::Done(Box::new(decided)))
    }

    /// Every place that is retrained each year.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn schedules(&self) -> Result<Vec<Schedule>> {
        let rows = sqlx::query(
            "SELECT id AS station, NULL AS region, retrain, timezone FROM station WHERE retrain IS NOT NULL
             UNION ALL
             SELECT NULL, id, retrain, (SELECT timezone FROM station WHERE station.id =
                 (SELECT station FROM region_station WHERE region = region.id ORDER BY position LIMIT 1))
             FROM region WHERE retrain IS NOT NULL",
        )
        .fetch_all(&self.reader)
        .await?;
        let schedule = |row: &SqliteRow| -> Result<Schedule> {
            let zone = row.try_get::<Option<String>, _>("timezone")?;
            let zone = zone.map(ZoneName::try_from).transpose().map_err(StoreError::corrupt)?;
            Ok(Schedule {
                place: read_place(row)?,
                yearly: row.try_get::<String, _>("retrain")?.parse().map_err(StoreError::corrupt)?,
                zone: zone.map_or(TimeZone::UTC, |zone| zone.zone()),
            })
        };
        rows.iter().map(schedule).collect()
    }

    /// Whether a retraining that was due has been taken up.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn is_taken_up(&self, due: &Due) -> Result<bool> {
        let found: Option<i64> =
            sqlx::query_scalar("SELECT 1 FROM retraining WHERE place = ? AND lead = ? AND due = ?")
                .bind(due.place.path())
                .bind(due.lead)
                .bind(due.day.to_string())
                .fetch_optional(&self.reader)
                .await?;
        Ok(found.is_some())
    }

    /// Takes a retraining up that is due: its job and the note that it has one are stored together, or, where another call was
    /// faster, neither. Says whether they were.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where they cannot be stored.
    pub async fn take_up(&self, due: &Due, job: std::result::Result<&Job, &str>, now: Timestamp) -> Result<bool> {
        let mut tx = self.begin().await?;
        let done = sqlx::query(
            "INSERT INTO retraining (place, lead, due, job, refusal, at) VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
        )
        .bind(due.place.path())
        .bind(due.lead)
        .bind(due.day.to_string())
        .bind(job.ok().map(|job| job.id.to_string()))
        .bind(job.err())
        .bind(now.to_string())
        .execute(&mut *tx)
        .await?;
        if done.rows_affected() == 0 {
            return Ok(false);
        }
        if let Ok(job) = job {
            jobs::insert(&mut tx, job).await?;
        }
        tx.commit().await?;
        Ok(true)
    }
}
