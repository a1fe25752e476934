//! Data sets of acoustic emission: what is said of them here, their columns in the artifact store.

use jiff::Timestamp;
use sqlx::{FromRow, Row, Sqlite, Transaction, sqlite::SqliteRow};
use uuid::Uuid;

use super::{Result, Store, StoreError, from_json, parse_timestamp, to_json};
use crate::domain::dataset::{Dataset, DatasetBody, DatasetName};

struct DatasetRow(Dataset);

impl FromRow<'_, SqliteRow> for DatasetRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read(row: &SqliteRow) -> Result<Dataset> {
    let job: Option<String> = row.try_get("job")?;
    let size: i64 = row.try_get("size")?;
    Ok(Dataset {
        id: row.try_get::<String, _>("id")?.parse().map_err(StoreError::corrupt)?,
        body: DatasetBody {
            name: DatasetName::try_from(row.try_get::<String, _>("name")?).map_err(StoreError::corrupt)?,
            metadata: from_json(row.try_get("metadata")?)?,
        },
        description: from_json(row.try_get("description")?)?,
        truth: row.try_get::<Option<String>, _>("truth")?.as_deref().map(from_json).transpose()?,
        job: job.map(|id| id.parse().map_err(StoreError::corrupt)).transpose()?,
        sha256: row.try_get("sha256")?,
        size: u64::try_from(size).map_err(StoreError::corrupt)?,
        revision: row.try_get("revision")?,
        created: parse_timestamp(row.try_get("created")?)?,
        created_by: row.try_get("created_by")?,
        updated: parse_timestamp(row.try_get("updated")?)?,
    })
}

/// Keeps a data set whose columns lie in the artifact store.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, dataset: &Dataset) -> Result<()> {
    sqlx::query(
        "INSERT INTO dataset (id, name, metadata, description, truth, job, sha256, size, revision, created, created_by, updated)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(dataset.id.to_string())
    .bind(dataset.body.name.as_str())
    .bind(to_json(&dataset.body.metadata)?)
    .bind(to_json(&dataset.description)?)
    .bind(dataset.truth.as_ref().map(to_json).transpose()?)
    .bind(dataset.job.map(|job| job.to_string()))
    .bind(&dataset.sha256)
    .bind(i64::try_from(dataset.size).map_err(StoreError::corrupt)?)
    .bind(dataset.revision)
    .bind(dataset.created.to_string())
    .bind(&dataset.created_by)
    .bind(dataset.updated.to_string())
    .execute(&mut **tx)
    .await?;
    Ok(())
}

async fn find(tx: &mut Transaction<'_, Sqlite>, id: Uuid) -> Result<Dataset> {
    let row: Option<DatasetRow> =
        sqlx::query_as("SELECT * FROM dataset WHERE id = ?").bind(id.to_string()).fetch_optional(&mut **tx).await?;
    row.map(|row| row.0).ok_or(StoreError::Missing)
}

impl Store {
    /// Keeps a data set whose columns lie in the artifact store already.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn insert_dataset(&self, dataset: &Dataset) -> Result<()> {
        let mut tx = self.begin().await?;
        insert(&mut tx, dataset).await?;
        Ok(tx.commit().await?)
    }

    /// The data set of that id.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn dataset(&self, id: Uuid) -> Result<Option<Dataset>> {
        let row: Option<DatasetRow> = sqlx::query_as("SELECT * FROM dataset WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(&self.reader)
            .await?;
        Ok(row.map(|row| row.0))
    }

    /// Up to `limit` data sets, newest first, older than `before`.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn datasets(&self, before: Option<Uuid>, limit: u32) -> Result<Vec<Dataset>> {
        let rows: Vec<DatasetRow> =
            sqlx::query_as("SELECT * FROM dataset WHERE (?1 IS NULL OR id < ?1) ORDER BY id DESC LIMIT ?2")
                .bind(before.map(|id| id.to_string()))
                .bind(limit)
                .fetch_all(&self.reader)
                .await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// Replaces what is said of a data set if `permits` agrees with what was said before; the same again changes nothing.
    ///
    /// # Errors
    /// [`StoreError::Missing`] where there is none, [`StoreError::Precondition`] where `permits` does not agree.
    pub async fn put_dataset(
        &self,
        id: Uuid,
        body: &DatasetBody,
        now: Timestamp,
        permits: impl FnOnce(&Dataset) -> bool,
    ) -> Result<Dataset> {
        let mut tx = self.begin().await?;
        let before = find(&mut tx, id).await?;
        if !permits(&before) {
            return Err(StoreError::Precondition);
        }
        if before.body == *body {
            return Ok(before);
        }
        let after = Dataset { body: body.clone(), revision: before.revision + 1, updated: now, ..before };
        sqlx::query("UPDATE dataset SET name = ?, metadata = ?, revision = ?, updated = ? WHERE id = ?")
            .bind(after.body.name.as_str())
            .bind(to_json(&after.body.metadata)?)
            .bind(after.revision)
            .bind(now.to_string())
            .bind(id.to_string())
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(after)
    }

    /// Removes a data set if `permits` agrees; says which columns lie in the artifact store no more needed.
    ///
    /// # Errors
    /// [`StoreError::Missing`] where there is none, [`StoreError::Precondition`] where `permits` does not agree.
    pub async fn remove_dataset(&self, id: Uuid, permits: impl FnOnce(&Dataset) -> bool) -> Result<Vec<String>> {
        let mut tx = self.begin().await?;
        let before = find(&mut tx, id).await?;
        if !permits(&before) {
            return Err(StoreError::Precondition);
        }
        sqlx::query("DELETE FROM dataset WHERE id = ?").bind(id.to_string()).execute(&mut *tx).await?;
        let others: i64 = sqlx::query_scalar(
            "SELECT (SELECT count(*) FROM dataset WHERE sha256 = ?1) + (SELECT count(*) FROM job_output WHERE sha256 = ?1)
                  + (SELECT count(*) FROM job_piece WHERE sha256 = ?1)",
        )
        .bind(&before.sha256)
        .fetch_one(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(if others == 0 { vec![before.sha256] } else { Vec::new() })
    }
}
