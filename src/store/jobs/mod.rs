//! Job records. Every change of state is checked by [`crate::domain::job`] inside the transaction that writes it, and
//! every write of a worker is fenced by the number of its attempt.

mod attempts;
mod children;
mod history;
mod idempotency;
mod outputs;
mod rows;

use jiff::Timestamp;
use sqlx::{Row, Sqlite, Transaction};
use uuid::Uuid;

pub use attempts::{Beat, Claim, Ended, Outcome};
pub use children::ChildEnd;
pub use history::{EventRecord, LogRecord, Retention};
pub use idempotency::{Answer, Held, Reservation};
pub use outputs::OutputRecord;
use rows::JobRow;

use super::{
    Result, Store, StoreError, models::NewModel, proposals::NewProposal, selections::NewSelection, to_json,
    transfers::NewTransfer,
};
use crate::domain::{
    dataset::Dataset,
    job::{Event, Job, Status, Wanted},
};

/// What is kept beside a job, in the transaction that ends it.
#[derive(Clone, Debug)]
pub enum Kept {
    /// A trained model.
    Model(Box<NewModel>),
    /// A data set, whose columns are one of the outputs.
    Dataset(Box<Dataset>),
    /// What a feature elimination found.
    Selection(Box<NewSelection>),
    /// A model that a retraining proposes.
    Proposal(Box<NewProposal>),
    /// How a model did at another place.
    Transfer(Box<NewTransfer>),
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
    /// Only jobs with all of these labels.
    pub labels: Vec<(String, String)>,
    /// Only children of this job.
    pub parent: Option<Uuid>,
    /// Only jobs older than this one.
    pub before: Option<Uuid>,
}

/// The jobs of a process that have not ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Queue {
    /// Which process.
    pub process_id: String,
    /// How many wait for a worker.
    pub waiting: u32,
    /// When the job was accepted that waits longest.
    pub oldest: Option<Timestamp>,
    /// How many a worker has, or wait for their children.
    pub running: u32,
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

/// As it stands in the row: nothing where all is wanted, so that the same wish is the same text.
fn wanted(wanted: &Wanted) -> Result<Option<String>> {
    if *wanted == Wanted::default() { Ok(None) } else { to_json(wanted).map(Some) }
}

/// Writes a job that nobody has taken yet.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, job: &Job) -> Result<()> {
    sqlx::query(
        "INSERT INTO job (id, process_id, status, progress, inputs, input_hash, version, submitted_by, labels, priority,
             parent, position, created, updated, ticketed_ms, wanted)
         VALUES (?1, ?2, 'accepted', 0, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?11, ?12, ?13)",
    )
    .bind(job.id.to_string())
    .bind(&job.process_id)
    .bind(to_json(&job.inputs)?)
    .bind(&job.input_hash)
    .bind(&job.version)
    .bind(job.submitted_by.as_deref())
    .bind(to_json(&job.labels)?)
    .bind(job.priority.get())
    .bind(job.parent.map(|id| id.to_string()))
    .bind(job.position)
    .bind(job.created.to_string())
    // its ticket follows at once, and a start issues all tickets again: that saves a second write a job
    .bind(job.created.as_millisecond())
    .bind(wanted(&job.wanted)?)
    .execute(&mut **tx)
    .await?;
    history::note(tx, job.id, "status", &serde_json::json!({"status": Status::Accepted})).await
}

impl Store {
    /// Accepts a job, together with the answer to its idempotency key where there is one: once this returns, both are on
    /// disk.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where they cannot be stored.
    pub async fn insert_job(&self, job: &Job, answer: Option<(&Reservation, &Answer)>) -> Result<()> {
        let mut tx = self.begin().await?;
        insert(&mut tx, job).await?;
        if let Some((reservation, answer)) = answer {
            idempotency::settle(&mut tx, reservation, answer).await?;
        }
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
        text.flatten().as_deref().map(super::from_json).transpose()
    }

    /// The newest successful job with the same process, input hash and version, and the same wish for its outputs: its
    /// results are those of a new one.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn job_of_input(
        &self,
        process_id: &str,
        input_hash: &str,
        version: &str,
        wish: &Wanted,
    ) -> Result<Option<Job>> {
        let row = sqlx::query_as::<_, JobRow>(
            "SELECT * FROM job WHERE input_hash = ? AND process_id = ? AND version = ? AND wanted IS ?
             AND status = 'successful' ORDER BY id DESC LIMIT 1",
        )
        .bind(input_hash)
        .bind(process_id)
        .bind(version)
        .bind(wanted(wish)?)
        .fetch_optional(&self.reader)
        .await?;
        Ok(row.map(|row| row.0))
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
        if let Some(parent) = filter.parent {
            query.push(" AND parent = ").push_bind(parent.to_string());
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
        for (name, value) in &filter.labels {
            query.push(" AND EXISTS (SELECT 1 FROM json_each(job.labels) AS label WHERE label.key = ");
            query.push_bind(name.clone()).push(" AND label.value = ").push_bind(value.clone()).push(")");
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

    /// The queue of each process that has jobs which have not ended.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn job_queues(&self) -> Result<Vec<Queue>> {
        // ids are ordered in time
        let rows = sqlx::query(
            "SELECT process_id, sum(status = 'accepted') AS waiting, sum(status = 'running') AS running,
                    (SELECT created FROM job AS first WHERE first.process_id = job.process_id
                         AND first.status = 'accepted' ORDER BY id LIMIT 1) AS oldest
             FROM job WHERE status IN ('accepted', 'running') GROUP BY process_id",
        )
        .fetch_all(&self.reader)
        .await?;
        rows.iter()
            .map(|row| {
                let oldest: Option<String> = row.try_get("oldest")?;
                Ok(Queue {
                    process_id: row.try_get("process_id")?,
                    waiting: row.try_get("waiting")?,
                    oldest: oldest.as_deref().map(super::parse_timestamp).transpose()?,
                    running: row.try_get("running")?,
                })
            })
            .collect()
    }

    /// How many jobs wait for a worker.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn waiting_jobs(&self) -> Result<u32> {
        Ok(sqlx::query_scalar("SELECT count(*) FROM job WHERE status = 'accepted'").fetch_one(&self.reader).await?)
    }

    /// How many jobs need a ticket: they wait for a worker or one has them.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn jobs_with_tickets(&self) -> Result<u64> {
        let sql = "SELECT count(*) FROM job
                   WHERE status = 'accepted' OR (status = 'running' AND waits_for_children = 0)";
        let many: i64 = sqlx::query_scalar(sql).fetch_one(&self.reader).await?;
        Ok(many.unsigned_abs())
    }

    /// Gives a job up, and with it every child that has not ended; says which jobs that were and what it brought about.
    ///
    /// # Errors
    /// [`StoreError::Transition`] where it has ended before, [`StoreError::Missing`] where there is none.
    pub async fn dismiss_job(&self, id: Uuid, now: Timestamp) -> Result<(Vec<Uuid>, Ended)> {
        let mut tx = self.begin().await?;
        step(&mut tx, id, Event::Dismiss).await?;
        // the parent first, so that it waits for nobody any more when its children end
        let open = "SELECT id FROM job WHERE (id = ?1 OR parent = ?1) AND status IN ('accepted', 'running')
                    ORDER BY id <> ?1";
        let ids: Vec<String> = sqlx::query_scalar(open).bind(id.to_string()).fetch_all(&mut *tx).await?;
        let ids: Vec<Uuid> = ids.iter().map(|id| id.parse().map_err(StoreError::corrupt)).collect::<Result<_>>()?;
        let mut ended = Ended::default();
        for (place, id) in ids.iter().enumerate() {
            let brought = dismiss_one(&mut tx, *id, now).await?;
            if place == 0 {
                // the children's parent is dismissed itself
                ended = brought;
            }
        }
        tx.commit().await?;
        Ok((ids, ended))
    }

    /// Removes a job that has ended, with its children, and says which outputs lie in the artifact store no more needed.
    /// A child goes with its parent alone, which is put together from it and may name its outputs.
    ///
    /// # Errors
    /// [`StoreError::Child`] where it is part of another, [`StoreError::Missing`] where there is no ended job of that id.
    pub async fn remove_job(&self, id: Uuid) -> Result<Vec<String>> {
        let mut tx = self.begin().await?;
        let parent: Option<Option<String>> = sqlx::query_scalar("SELECT parent FROM job WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(&mut *tx)
            .await?;
        if let Some(parent) = parent.flatten() {
            return Err(StoreError::Child(parent.parse().map_err(StoreError::corrupt)?));
        }
        let digests = outputs::only_of(&mut tx, id).await?;
        let done = sqlx::query("DELETE FROM job WHERE id = ? AND status IN ('successful', 'failed', 'dismissed')")
            .bind(id.to_string())
            .execute(&mut *tx)
            .await?;
        if done.rows_affected() == 0 {
            return Err(StoreError::Missing);
        }
        tx.commit().await?;
        Ok(digests)
    }

    /// Jobs that wait and whose ticket is older than `ticketed_before`, or that run with a lease that has ended: what an
    /// engine may have lost. First come, first served within a priority.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn jobs_without_ticket(
        &self,
        ticketed_before: Timestamp,
        now: Timestamp,
        limit: u32,
    ) -> Result<Vec<(Uuid, u8, u32)>> {
        let rows = sqlx::query(
            "SELECT id, priority, attempt FROM job
             WHERE (status = 'accepted' AND ticketed_ms < ?1)
                OR (status = 'running' AND waits_for_children = 0 AND lease_until_ms < ?2 AND ticketed_ms < ?1)
             ORDER BY priority DESC, id LIMIT ?3",
        )
        .bind(ticketed_before.as_millisecond())
        .bind(now.as_millisecond())
        .bind(limit)
        .fetch_all(&self.reader)
        .await?;
        rows.iter()
            .map(|row| {
                let id = row.try_get::<String, _>("id")?.parse().map_err(StoreError::corrupt)?;
                Ok((id, row.try_get("priority")?, row.try_get("attempt")?))
            })
            .collect()
    }

    /// Notes when the tickets of these jobs went to the engine; long ago: they did not.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn mark_ticketed(&self, ids: &[Uuid], now: Timestamp) -> Result<()> {
        let mut tx = self.begin().await?;
        for id in ids {
            sqlx::query("UPDATE job SET ticketed_ms = ? WHERE id = ?")
                .bind(now.as_millisecond())
                .bind(id.to_string())
                .execute(&mut *tx)
                .await?;
        }
        tx.commit().await?;
        Ok(())
    }
}

async fn dismiss_one(tx: &mut Transaction<'_, Sqlite>, id: Uuid, now: Timestamp) -> Result<Ended> {
    let status = step(tx, id, Event::Dismiss).await?;
    // what it was spent on is not told by its worker any more
    sqlx::query(
        "UPDATE job SET compute_ms = compute_ms + max(0, ?2 - claimed_ms)
         WHERE id = ?1 AND status = 'running' AND waits_for_children = 0",
    )
    .bind(id.to_string())
    .bind(now.as_millisecond())
    .execute(&mut **tx)
    .await?;
    sqlx::query(
        "UPDATE job SET status = ?2, message = 'dismissed on request', phase = NULL, waits_for_children = 0,
             finished = ?3, updated = ?3
         WHERE id = ?1",
    )
    .bind(id.to_string())
    .bind(status.name())
    .bind(now.to_string())
    .execute(&mut **tx)
    .await?;
    history::note(tx, id, "status", &serde_json::json!({"status": status})).await?;
    sqlx::query("DELETE FROM job_checkpoint WHERE job = ?").bind(id.to_string()).execute(&mut **tx).await?;
    children::one_ended(tx, id, now).await
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
