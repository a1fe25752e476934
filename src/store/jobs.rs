//! Job records. Every change of state is checked by [`crate::domain::job`] inside the transaction that writes it.

use jiff::Timestamp;
use sqlx::{FromRow, Row, Sqlite, Transaction, sqlite::SqliteRow};
use uuid::Uuid;

use super::{Result, Store, StoreError, from_json, parse_timestamp, to_json};
use crate::domain::job::{Event, Exception, Job, Status};

struct JobRow(Job);

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
    Ok(Job {
        id: row.try_get::<String, _>("id")?.parse().map_err(StoreError::corrupt)?,
        process_id: row.try_get("process_id")?,
        status: Status::from_name(&status).ok_or_else(|| StoreError::corrupt(status))?,
        progress: row.try_get("progress")?,
        phase: row.try_get("phase")?,
        message: row.try_get("message")?,
        exception: row.try_get::<Option<String>, _>("exception")?.as_deref().map(from_json).transpose()?,
        inputs: from_json(row.try_get("inputs")?)?,
        input_hash: row.try_get("input_hash")?,
        version: row.try_get("version")?,
        submitted_by: row.try_get("submitted_by")?,
        created: parse_timestamp(row.try_get("created")?)?,
        started: instant("started")?,
        finished: instant("finished")?,
        updated: parse_timestamp(row.try_get("updated")?)?,
    })
}

/// Which jobs a list shows.
#[derive(Clone, Debug, Default)]
pub struct JobFilter {
    /// Only these states; empty: all.
    pub status: Vec<Status>,
    /// Only jobs of these processes; empty: all.
    pub process_id: Vec<String>,
    /// Only jobs made at or after this instant.
    pub created_from: Option<Timestamp>,
    /// Only jobs made at or before this instant.
    pub created_to: Option<Timestamp>,
    /// Only jobs that took (or have taken, while running) at least this long, s.
    pub min_duration_s: Option<f64>,
    /// Only jobs that took (or have taken, while running) at most this long, s.
    pub max_duration_s: Option<f64>,
    /// Only jobs older than this one.
    pub before: Option<Uuid>,
}

/// How a computation ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// With these results.
    Successful(serde_json::Value),
    /// Without, for this reason.
    Failed(Exception),
}

/// Moves a job on by `event`, or says why that cannot be.
async fn step(tx: &mut Transaction<'_, Sqlite>, id: Uuid, event: Event) -> Result<Status> {
    let status: Option<String> = sqlx::query_scalar("SELECT status FROM job WHERE id = ?")
        .bind(id.to_string())
        .fetch_optional(&mut **tx)
        .await?;
    let status = status.ok_or(StoreError::Missing)?;
    let status = Status::from_name(&status).ok_or_else(|| StoreError::corrupt(status))?;
    Ok(status.after(event)?)
}

impl Store {
    /// Accepts a job: once this returns, it is on disk.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn insert_job(&self, job: &Job) -> Result<()> {
        let mut tx = self.begin().await?;
        sqlx::query(
            "INSERT INTO job (id, process_id, status, progress, inputs, input_hash, version, submitted_by, created, updated)
             VALUES (?1, ?2, 'accepted', 0, ?3, ?4, ?5, ?6, ?7, ?7)",
        )
        .bind(job.id.to_string())
        .bind(&job.process_id)
        .bind(to_json(&job.inputs)?)
        .bind(&job.input_hash)
        .bind(&job.version)
        .bind(job.submitted_by.as_deref())
        .bind(job.created.to_string())
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(())
    }

    /// The job of that id.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn job(&self, id: Uuid) -> Result<Option<Job>> {
        let row = sqlx::query_as::<_, JobRow>("SELECT * FROM job WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(&self.reader)
            .await?;
        Ok(row.map(|row| row.0))
    }

    /// The results of a successful job.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn job_results(&self, id: Uuid) -> Result<Option<serde_json::Value>> {
        let text: Option<Option<String>> = sqlx::query_scalar("SELECT results FROM job WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(&self.reader)
            .await?;
        text.flatten().as_deref().map(from_json).transpose()
    }

    /// Up to `limit` jobs, newest first.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn jobs(&self, filter: &JobFilter, now: Timestamp, limit: u32) -> Result<Vec<Job>> {
        let mut query = sqlx::QueryBuilder::<Sqlite>::new("SELECT * FROM job WHERE 1");
        if let Some(before) = filter.before {
            query.push(" AND id < ").push_bind(before.to_string());
        }
        if let Some(from) = filter.created_from {
            query
                .push(" AND unixepoch(created, 'subsec') >= unixepoch(")
                .push_bind(from.to_string())
                .push(", 'subsec')");
        }
        if let Some(to) = filter.created_to {
            query.push(" AND unixepoch(created, 'subsec') <= unixepoch(").push_bind(to.to_string()).push(", 'subsec')");
        }
        let names: Vec<&str> = filter.status.iter().map(|status| status.name()).collect();
        push_list(&mut query, "status", &names);
        push_list(&mut query, "process_id", &filter.process_id);
        for (limit, comparison) in [(filter.min_duration_s, " >= "), (filter.max_duration_s, " <= ")] {
            if let Some(seconds) = limit {
                // to the millisecond that is stored: the difference of two doubles is not exact
                query
                    .push(" AND started IS NOT NULL AND round(unixepoch(coalesce(finished, ")
                    .push_bind(now.to_string());
                query.push("), 'subsec') - unixepoch(started, 'subsec'), 3)").push(comparison).push_bind(seconds);
            }
        }
        query.push(" ORDER BY id DESC LIMIT ").push_bind(limit);
        let rows = query.build_query_as::<JobRow>().fetch_all(&self.reader).await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// How many jobs wait for a slot.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn waiting_jobs(&self) -> Result<u32> {
        Ok(sqlx::query_scalar("SELECT count(*) FROM job WHERE status = 'accepted'").fetch_one(&self.reader).await?)
    }

    /// A runner takes the job.
    ///
    /// # Errors
    /// [`StoreError::Transition`] where it is no longer waiting.
    pub async fn start_job(&self, id: Uuid, now: Timestamp) -> Result<()> {
        let mut tx = self.begin().await?;
        let status = step(&mut tx, id, Event::Start).await?;
        sqlx::query("UPDATE job SET status = ?2, started = ?3, updated = ?3 WHERE id = ?1")
            .bind(id.to_string())
            .bind(status.name())
            .bind(now.to_string())
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(())
    }

    /// Notes how far a running job is; a report that comes late changes nothing.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn report_progress(&self, id: Uuid, progress: u8, phase: &str, now: Timestamp) -> Result<()> {
        let mut tx = self.begin().await?;
        sqlx::query(
            "UPDATE job SET progress = max(progress, ?2), phase = ?3, updated = ?4 WHERE id = ?1 AND status = 'running'",
        )
        .bind(id.to_string())
        .bind(progress)
        .bind(phase)
        .bind(now.to_string())
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(())
    }

    /// Ends a job with its outcome.
    ///
    /// # Errors
    /// [`StoreError::Transition`] where it has ended before.
    pub async fn finish_job(&self, id: Uuid, outcome: &Outcome, now: Timestamp) -> Result<()> {
        let mut tx = self.begin().await?;
        finish(&mut tx, id, outcome, now).await?;
        tx.commit().await?;
        Ok(())
    }

    /// Gives a job up.
    ///
    /// # Errors
    /// [`StoreError::Transition`] where it has ended before, [`StoreError::Missing`] where there is none.
    pub async fn dismiss_job(&self, id: Uuid, now: Timestamp) -> Result<()> {
        let mut tx = self.begin().await?;
        let status = step(&mut tx, id, Event::Dismiss).await?;
        sqlx::query(
            "UPDATE job SET status = ?2, message = 'dismissed on request', finished = ?3, updated = ?3 WHERE id = ?1",
        )
        .bind(id.to_string())
        .bind(status.name())
        .bind(now.to_string())
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(())
    }

    /// Removes a job that has ended.
    ///
    /// # Errors
    /// [`StoreError::Missing`] where there is no ended job of that id.
    pub async fn remove_job(&self, id: Uuid) -> Result<()> {
        let mut tx = self.begin().await?;
        let done = sqlx::query("DELETE FROM job WHERE id = ? AND status IN ('successful', 'failed', 'dismissed')")
            .bind(id.to_string())
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        if done.rows_affected() == 0 { Err(StoreError::Missing) } else { Ok(()) }
    }

    /// Fails every job that an earlier process left waiting or running, and says how many there were.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn fail_interrupted_jobs(&self, exception: &Exception, now: Timestamp) -> Result<usize> {
        let mut tx = self.begin().await?;
        let ids: Vec<String> = sqlx::query_scalar("SELECT id FROM job WHERE status IN ('accepted', 'running')")
            .fetch_all(&mut *tx)
            .await?;
        for id in &ids {
            let id = id.parse().map_err(StoreError::corrupt)?;
            finish(&mut tx, id, &Outcome::Failed(exception.clone()), now).await?;
        }
        tx.commit().await?;
        Ok(ids.len())
    }
}

/// Ends a job inside a transaction that may hold more: a model must not be stored without the end of its job.
pub(super) async fn finish(
    tx: &mut Transaction<'_, Sqlite>,
    id: Uuid,
    outcome: &Outcome,
    now: Timestamp,
) -> Result<()> {
    let (event, progress, results, exception) = match outcome {
        Outcome::Successful(results) => (Event::Succeed, Some(100), Some(to_json(results)?), None),
        Outcome::Failed(exception) => (Event::Fail, None, None, Some(exception)),
    };
    let status = step(tx, id, event).await?;
    sqlx::query(
        "UPDATE job SET status = ?2, progress = coalesce(?3, progress), results = ?4, exception = ?5, message = ?6,
             phase = NULL, finished = ?7, updated = ?7
         WHERE id = ?1",
    )
    .bind(id.to_string())
    .bind(status.name())
    .bind(progress)
    .bind(results)
    .bind(exception.map(to_json).transpose()?)
    .bind(exception.map(|exception| exception.detail.as_str()))
    .bind(now.to_string())
    .execute(&mut **tx)
    .await?;
    Ok(())
}

fn push_list<T: AsRef<str>>(query: &mut sqlx::QueryBuilder<Sqlite>, column: &str, values: &[T]) {
    if values.is_empty() {
        return;
    }
    query.push(" AND ").push(column).push(" IN (");
    let mut list = query.separated(", ");
    for value in values {
        list.push_bind(value.as_ref().to_owned());
    }
    query.push(")");
}
