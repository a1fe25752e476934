//! What happened to a job: events that a stream can resume from, a bounded log, and how long all of it is kept.

use jiff::Timestamp;
use sqlx::{Row, Sqlite, Transaction};
use uuid::Uuid;

use super::{attempts::fence, outputs};
use crate::{
    domain::job::Status,
    store::{Result, Store, StoreError, from_json, parse_timestamp, to_json},
};

/// Lines of the log that a job may have; later ones are dropped.
const LONGEST_LOG: i64 = 1000;

/// One event of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct EventRecord {
    /// Its place among the events of all jobs: what a stream resumes after.
    pub sequence: i64,
    /// `status` or `progress`.
    pub kind: String,
    /// What happened.
    pub body: serde_json::Value,
}

/// One line of the log of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct LogRecord {
    /// Its place among the lines of all jobs.
    pub sequence: i64,
    /// Which attempt wrote it.
    pub attempt: u32,
    /// When.
    pub at: Timestamp,
    /// `info`, `warn` or `error`.
    pub level: String,
    /// What.
    pub message: String,
}

/// How long ended jobs are kept.
#[derive(Clone, Copy, Debug)]
pub struct Retention {
    /// Jobs that ended before this instant go.
    pub ended_before: Timestamp,
    /// The oldest ended jobs go until results and outputs need no more than this, bytes.
    pub most_bytes: u64,
}

/// Writes down an event.
pub(super) async fn note(
    tx: &mut Transaction<'_, Sqlite>,
    job: Uuid,
    kind: &str,
    body: &serde_json::Value,
) -> Result<()> {
    sqlx::query("INSERT INTO job_event (job, kind, body) VALUES (?, ?, ?)")
        .bind(job.to_string())
        .bind(kind)
        .bind(to_json(body)?)
        .execute(&mut **tx)
        .await?;
    Ok(())
}

/// Writes a line of the log, within its bound.
pub(super) async fn log(
    tx: &mut Transaction<'_, Sqlite>,
    job: Uuid,
    attempt: u32,
    now: Timestamp,
    level: &str,
    message: &str,
) -> Result<()> {
    sqlx::query(
        "INSERT INTO job_log (job, attempt, at, level, message)
         SELECT ?1, ?2, ?3, ?4, ?5 WHERE (SELECT count(*) FROM job_log WHERE job = ?1) < ?6",
    )
    .bind(job.to_string())
    .bind(attempt)
    .bind(now.to_string())
    .bind(level)
    .bind(message)
    .bind(LONGEST_LOG)
    .execute(&mut **tx)
    .await?;
    Ok(())
}

/// Writes down progress in place of the progress before: who resumes a stream needs only the newest.
pub(super) async fn note_progress(
    tx: &mut Transaction<'_, Sqlite>,
    job: Uuid,
    attempt: u32,
    body: &serde_json::Value,
) -> Result<()> {
    sqlx::query("DELETE FROM job_event WHERE job = ? AND kind = 'progress'")
        .bind(job.to_string())
        .execute(&mut **tx)
        .await?;
    let mut body = body.clone();
    if let Some(object) = body.as_object_mut() {
        object.insert("attempt".into(), attempt.into());
    }
    note(tx, job, "progress", &body).await
}

impl Store {
    /// The events of a job after `after`, oldest first.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn job_events(&self, job: Uuid, after: i64) -> Result<Vec<EventRecord>> {
        let rows =
            sqlx::query("SELECT sequence, kind, body FROM job_event WHERE job = ? AND sequence > ? ORDER BY sequence")
                .bind(job.to_string())
                .bind(after)
                .fetch_all(&self.reader)
                .await?;
        rows.iter()
            .map(|row| {
                Ok(EventRecord {
                    sequence: row.try_get("sequence")?,
                    kind: row.try_get("kind")?,
                    body: from_json(row.try_get("body")?)?,
                })
            })
            .collect()
    }

    /// Adds lines of an attempt to the log of its job, up to its bound.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] where the attempt counts no more.
    pub async fn append_job_log(
        &self,
        job: Uuid,
        attempt: u32,
        lines: &[(String, String)],
        now: Timestamp,
    ) -> Result<()> {
        let mut tx = self.begin().await?;
        fence(&mut tx, job, attempt).await?;
        for (level, message) in lines {
            log(&mut tx, job, attempt, now, level, message).await?;
        }
        tx.commit().await?;
        Ok(())
    }

    /// The log of a job, oldest line first.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn job_log(&self, job: Uuid) -> Result<Vec<LogRecord>> {
        let rows = sqlx::query("SELECT * FROM job_log WHERE job = ? ORDER BY sequence")
            .bind(job.to_string())
            .fetch_all(&self.reader)
            .await?;
        rows.iter()
            .map(|row| {
                Ok(LogRecord {
                    sequence: row.try_get("sequence")?,
                    attempt: row.try_get("attempt")?,
                    at: parse_timestamp(row.try_get("at")?)?,
                    level: row.try_get("level")?,
                    message: row.try_get("message")?,
                })
            })
            .collect()
    }

    /// Removes ended jobs that are too old or too many; says how many, and which outputs are no more needed.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn retire_jobs(&self, retention: Retention) -> Result<(usize, Vec<String>)> {
        let mut tx = self.begin().await?;
        // what a job needs is what it and its children need: they go with it
        let rows = sqlx::query(
            "SELECT job.id AS id, julianday(finished) < julianday(?) AS old,
                    (SELECT sum(length(part.inputs) + coalesce(length(part.results), 0)
                        + coalesce((SELECT sum(size) FROM job_output WHERE job_output.job = part.id), 0))
                     FROM job AS part WHERE part.id = job.id OR part.parent = job.id) AS bytes
             FROM job WHERE status IN (?, ?, ?) AND parent IS NULL ORDER BY id DESC",
        )
        .bind(retention.ended_before.to_string())
        .bind(Status::Successful.name())
        .bind(Status::Failed.name())
        .bind(Status::Dismissed.name())
        .fetch_all(&mut *tx)
        .await?;
        let mut kept_bytes = 0_u64;
        let (mut removed, mut digests) = (0, Vec::new());
        for row in &rows {
            let bytes: i64 = row.try_get("bytes")?;
            kept_bytes += u64::try_from(bytes).unwrap_or(0);
            if row.try_get::<bool, _>("old")? || kept_bytes > retention.most_bytes {
                let id: String = row.try_get("id")?;
                digests.extend(outputs::only_of(&mut tx, id.parse().map_err(StoreError::corrupt)?).await?);
                sqlx::query("DELETE FROM job WHERE id = ?").bind(&id).execute(&mut *tx).await?;
                removed += 1;
            }
        }
        tx.commit().await?;
        Ok((removed, digests))
    }
}
