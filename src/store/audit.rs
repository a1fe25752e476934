//! The audit: who changed what, when and why. It grows only, and each entry is written in the transaction of its change.

use jiff::Timestamp;
use serde_json::Value;
use sqlx::{FromRow, Row, Sqlite, Transaction, sqlite::SqliteRow};

use super::{Result, Store, from_json, parse_timestamp, to_json};

/// Who changes something, when, and on which request.
#[derive(Clone, Debug)]
pub struct Actor {
    /// The name of the key; none where no key was needed, or for the service itself.
    pub name: Option<String>,
    /// The id of the request.
    pub trace: Option<String>,
    /// When.
    pub at: Timestamp,
}

impl Actor {
    /// The service itself, or whoever has its data directory.
    #[must_use]
    pub const fn service(at: Timestamp) -> Self {
        Self { name: None, trace: None, at }
    }
}

/// What was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// A station was made.
    StationCreated,
    /// What is said of a station was changed.
    StationChanged,
    /// A region was made.
    RegionCreated,
    /// What is said of a region was changed.
    RegionChanged,
    /// A model was made the active one.
    ModelActivated,
    /// The model that was active before was made the active one again.
    ModelRolledBack,
    /// A retraining proposed a model.
    ProposalMade,
    /// A proposed model was made the active one.
    ProposalAccepted,
    /// A proposed model was turned down.
    ProposalDeclined,
    /// A key was made.
    KeyCreated,
    /// A key was withdrawn.
    KeyRevoked,
}

impl Action {
    /// The name in the store and the answers.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::StationCreated => "station_created",
            Self::StationChanged => "station_changed",
            Self::RegionCreated => "region_created",
            Self::RegionChanged => "region_changed",
            Self::ModelActivated => "model_activated",
            Self::ModelRolledBack => "model_rolled_back",
            Self::ProposalMade => "proposal_made",
            Self::ProposalAccepted => "proposal_accepted",
            Self::ProposalDeclined => "proposal_declined",
            Self::KeyCreated => "key_created",
            Self::KeyRevoked => "key_revoked",
        }
    }
}

/// An entry to write.
#[derive(Clone, Debug)]
pub(super) struct NewEntry<'a> {
    pub(super) action: Action,
    /// Its address, or `key:ID`.
    pub(super) target: &'a str,
    pub(super) reason: Option<&'a str>,
    pub(super) before: Option<Value>,
    pub(super) after: Option<Value>,
}

/// An entry of the audit.
#[derive(Clone, Debug, PartialEq)]
pub struct AuditEntry {
    /// Its number, rising.
    pub sequence: i64,
    /// When.
    pub at: Timestamp,
    /// Who.
    pub who: Option<String>,
    /// What was done.
    pub action: String,
    /// To what: its address, or `key:ID`.
    pub target: String,
    /// Why, in the words of who did it.
    pub reason: Option<String>,
    /// What was there before.
    pub before: Option<Value>,
    /// What is there after.
    pub after: Option<Value>,
    /// The id of the request.
    pub trace_id: Option<String>,
}

/// Which entries a list shows.
#[derive(Clone, Debug, Default)]
pub struct AuditFilter {
    /// Only of this action.
    pub action: Option<String>,
    /// Only of this target.
    pub target: Option<String>,
    /// Only older than the entry of this number.
    pub before: Option<i64>,
}

struct EntryRow(AuditEntry);

impl FromRow<'_, SqliteRow> for EntryRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read(row: &SqliteRow) -> Result<AuditEntry> {
    let json = |name: &str| -> Result<Option<Value>> {
        row.try_get::<Option<String>, _>(name)?.as_deref().map(from_json).transpose()
    };
    Ok(AuditEntry {
        sequence: row.try_get("sequence")?,
        at: parse_timestamp(row.try_get("at")?)?,
        who: row.try_get("who")?,
        action: row.try_get("action")?,
        target: row.try_get("target")?,
        reason: row.try_get("reason")?,
        before: json("before")?,
        after: json("after")?,
        trace_id: row.try_get("trace_id")?,
    })
}

pub(super) async fn write(tx: &mut Transaction<'_, Sqlite>, actor: &Actor, entry: NewEntry<'_>) -> Result<()> {
    let text = |value: &Option<Value>| value.as_ref().map(to_json).transpose();
    sqlx::query(
        "INSERT INTO audit (at, who, action, target, reason, before, after, trace_id) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(actor.at.to_string())
    .bind(actor.name.as_deref())
    .bind(entry.action.name())
    .bind(entry.target)
    .bind(entry.reason)
    .bind(text(&entry.before)?)
    .bind(text(&entry.after)?)
    .bind(actor.trace.as_deref())
    .execute(&mut **tx)
    .await?;
    Ok(())
}

impl Store {
    /// Up to `limit` entries, newest first.
    ///
    /// # Errors
    /// [`StoreError::Sql`](super::StoreError::Sql) where the database cannot be read.
    pub async fn audit(&self, filter: &AuditFilter, limit: u32) -> Result<Vec<AuditEntry>> {
        let rows = sqlx::query_as::<_, EntryRow>(
            "SELECT * FROM audit WHERE (?1 IS NULL OR sequence < ?1) AND (?2 IS NULL OR action = ?2)
                 AND (?3 IS NULL OR target = ?3) ORDER BY sequence DESC LIMIT ?4",
        )
        .bind(filter.before)
        .bind(filter.action.as_deref())
        .bind(filter.target.as_deref())
        .bind(limit)
        .fetch_all(&self.reader)
        .await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }
}
