//! How a job lies in its row.

use jiff::Timestamp;
use sqlx::{FromRow, Row, sqlite::SqliteRow};

use crate::{
    domain::job::{Job, Priority, Report, Spent, Status},
    store::{Result, StoreError, from_json, parse_timestamp},
};

pub(super) struct JobRow(pub Job);

impl FromRow<'_, SqliteRow> for JobRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read(row: &SqliteRow) -> Result<Job> {
    let instant = |name: &str| -> Result<Option<Timestamp>> {
        row.try_get::<Option<String>, _>(name)?.as_deref().map(parse_timestamp).transpose()
    };
    let status: String = row.try_get("status")?;
    let parent: Option<String> = row.try_get("parent")?;
    Ok(Job {
        id: row.try_get::<String, _>("id")?.parse().map_err(StoreError::corrupt)?,
        process_id: row.try_get("process_id")?,
        status: Status::from_name(&status).ok_or_else(|| StoreError::corrupt(status))?,
        report: Report {
            percent: row.try_get("progress")?,
            phase: row.try_get::<Option<String>, _>("phase")?.unwrap_or_default(),
            rate: row.try_get("rate")?,
            rate_unit: row.try_get("rate_unit")?,
            eta_seconds: row.try_get("eta_seconds")?,
        },
        message: row.try_get("message")?,
        exception: row.try_get::<Option<String>, _>("exception")?.as_deref().map(from_json).transpose()?,
        inputs: from_json(row.try_get("inputs")?)?,
        input_hash: row.try_get("input_hash")?,
        version: row.try_get("version")?,
        submitted_by: row.try_get("submitted_by")?,
        labels: from_json(row.try_get("labels")?)?,
        wanted: row.try_get::<Option<String>, _>("wanted")?.as_deref().map(from_json).transpose()?.unwrap_or_default(),
        priority: Priority::try_from(row.try_get::<u8, _>("priority")?).map_err(StoreError::corrupt)?,
        parent: parent.map(|id| id.parse().map_err(StoreError::corrupt)).transpose()?,
        position: row.try_get("position")?,
        attempt: row.try_get("attempt")?,
        worker: row.try_get("worker")?,
        spent: Spent {
            compute_ms: row.try_get("compute_ms")?,
            states: row.try_get("states")?,
            saving_ms: row.try_get("saving_ms")?,
            storing_ms: row.try_get("storing_ms")?,
        },
        created: parse_timestamp(row.try_get("created")?)?,
        started: instant("started")?,
        finished: instant("finished")?,
        updated: parse_timestamp(row.try_get("updated")?)?,
    })
}
