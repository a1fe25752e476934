//! Large outputs: their names and digests here, their bytes in the artifact store.

use sqlx::{FromRow, Row, Sqlite, Transaction, sqlite::SqliteRow};
use uuid::Uuid;

use super::attempts;
use crate::store::{Result, Store, to_json};

/// Jobs that have ended.
const ENDED: &str = "SELECT id FROM job WHERE status IN ('successful', 'failed', 'dismissed')";

/// An output whose bytes lie in the artifact store.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct OutputRecord {
    /// Its name in the results.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// Its length, bytes.
    pub size: u64,
    /// SHA-256 (hex) of its bytes: where they lie.
    pub sha256: String,
}

impl FromRow<'_, SqliteRow> for OutputRecord {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        let size: i64 = row.try_get("size")?;
        Ok(Self {
            name: row.try_get("name")?,
            media_type: row.try_get("media_type")?,
            size: u64::try_from(size).unwrap_or(0),
            sha256: row.try_get("sha256")?,
        })
    }
}

pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, job: Uuid, outputs: &[OutputRecord]) -> Result<()> {
    for output in outputs {
        sqlx::query("INSERT INTO job_output (job, name, media_type, size, sha256) VALUES (?, ?, ?, ?, ?)")
            .bind(job.to_string())
            .bind(&output.name)
            .bind(&output.media_type)
            .bind(i64::try_from(output.size).unwrap_or(i64::MAX))
            .bind(&output.sha256)
            .execute(&mut **tx)
            .await?;
    }
    Ok(())
}

/// Digests that only this job and its children name: theirs go when the job goes. What a data set is made of stays.
pub(super) async fn only_of(tx: &mut Transaction<'_, Sqlite>, job: Uuid) -> Result<Vec<String>> {
    let sql = "WITH named AS (SELECT job, sha256 FROM job_output UNION SELECT job, sha256 FROM job_piece)
               SELECT sha256 FROM named WHERE job IN (SELECT id FROM job WHERE id = ?1 OR parent = ?1)
               EXCEPT SELECT sha256 FROM named WHERE job NOT IN (SELECT id FROM job WHERE id = ?1 OR parent = ?1)
               EXCEPT SELECT sha256 FROM dataset";
    Ok(sqlx::query_scalar(sql).bind(job.to_string()).fetch_all(&mut **tx).await?)
}

impl Store {
    /// The large outputs of a job.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where the database cannot be read.
    pub async fn job_outputs(&self, job: Uuid) -> Result<Vec<OutputRecord>> {
        let sql = "SELECT * FROM job_output WHERE job = ? ORDER BY name";
        Ok(sqlx::query_as(sql).bind(job.to_string()).fetch_all(&self.reader).await?)
    }

    /// Notes that an attempt hands over a piece of an output; to note it again changes nothing.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Fenced`] where the attempt counts no more.
    pub async fn name_piece(&self, job: Uuid, attempt: u32, sha256: &str) -> Result<()> {
        let mut tx = self.begin().await?;
        attempts::fence(&mut tx, job, attempt).await?;
        sqlx::query("INSERT OR IGNORE INTO job_piece (job, sha256) VALUES (?, ?)")
            .bind(job.to_string())
            .bind(sha256)
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(())
    }

    /// Digests of the pieces that a job has handed over.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where the database cannot be read.
    pub async fn job_pieces(&self, job: Uuid) -> Result<Vec<String>> {
        let sql = "SELECT sha256 FROM job_piece WHERE job = ?";
        Ok(sqlx::query_scalar(sql).bind(job.to_string()).fetch_all(&self.reader).await?)
    }

    /// Whether there are pieces of jobs that have ended.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where the database cannot be read.
    pub async fn has_spare_pieces(&self) -> Result<bool> {
        let sql = format!("SELECT EXISTS (SELECT 1 FROM job_piece WHERE job IN ({ENDED}))");
        Ok(sqlx::query_scalar(sqlx::AssertSqlSafe(sql)).fetch_one(&self.reader).await?)
    }

    /// Forgets the pieces of jobs that have ended, and says which of them nothing else names.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where it cannot be stored.
    pub async fn forget_pieces(&self) -> Result<Vec<String>> {
        let mut tx = self.begin().await?;
        let spare = format!(
            "SELECT sha256 FROM job_piece WHERE job IN ({ENDED}) EXCEPT SELECT sha256 FROM job_output
             EXCEPT SELECT sha256 FROM dataset
             EXCEPT SELECT sha256 FROM job_piece WHERE job NOT IN ({ENDED})"
        );
        let digests = sqlx::query_scalar(sqlx::AssertSqlSafe(spare)).fetch_all(&mut *tx).await?;
        let gone = format!("DELETE FROM job_piece WHERE job IN ({ENDED})");
        sqlx::query(sqlx::AssertSqlSafe(gone)).execute(&mut *tx).await?;
        tx.commit().await?;
        Ok(digests)
    }

    /// Those of some digests that no job and no data set names.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where the database cannot be read.
    pub async fn unnamed(&self, digests: &[String]) -> Result<Vec<String>> {
        let sql = "SELECT value FROM json_each(?) EXCEPT SELECT sha256 FROM job_output
                   EXCEPT SELECT sha256 FROM job_piece EXCEPT SELECT sha256 FROM dataset";
        Ok(sqlx::query_scalar(sql).bind(to_json(digests)?).fetch_all(&self.reader).await?)
    }
}
