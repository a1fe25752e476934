//! Large outputs: their names and digests here, their bytes in the artifact store.

use sqlx::{FromRow, Row, Sqlite, Transaction, sqlite::SqliteRow};
use uuid::Uuid;

use crate::store::{Result, Store};

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
    let sql = "SELECT DISTINCT sha256 FROM job_output WHERE job IN (SELECT id FROM job WHERE id = ?1 OR parent = ?1)
               EXCEPT SELECT sha256 FROM job_output WHERE job NOT IN (SELECT id FROM job WHERE id = ?1 OR parent = ?1)
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
}
