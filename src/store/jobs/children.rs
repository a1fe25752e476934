//! Parents and children: a job that goes on as several others and is put together from what they gave.

use jiff::Timestamp;
use sqlx::{Row, Sqlite, Transaction};
use uuid::Uuid;

use super::{Ended, history, insert};
use crate::{
    domain::job::{Exception, Job, Status},
    store::{Result, Store, StoreError, from_json},
};

/// How a child ended.
#[derive(Clone, Debug, PartialEq)]
pub struct ChildEnd {
    /// The child.
    pub id: Uuid,
    /// How it ended.
    pub status: Status,
    /// Its results, of a successful one.
    pub results: Option<serde_json::Value>,
    /// Why it failed.
    pub exception: Option<Exception>,
}

/// The running job `parent` goes on as `jobs` and waits for them without holding a worker.
pub(super) async fn split(
    tx: &mut Transaction<'_, Sqlite>,
    (parent, attempt): (Uuid, u32),
    jobs: &[Job],
    now: Timestamp,
) -> Result<Ended> {
    for job in jobs {
        insert(tx, job).await?;
    }
    sqlx::query(
        "UPDATE job SET waits_for_children = 1, phase = 'waiting for its children', updated = ?2 WHERE id = ?1",
    )
    .bind(parent.to_string())
    .bind(now.to_string())
    .execute(&mut **tx)
    .await?;
    // a parent has one checkpoint: that it was split
    sqlx::query("DELETE FROM job_checkpoint WHERE job = ?").bind(parent.to_string()).execute(&mut **tx).await?;
    let message = format!("goes on as {} jobs", jobs.len());
    history::log(tx, parent, attempt, now, "info", &message).await?;
    Ok(Ended { parent: None, to_ticket: jobs.iter().map(|job| (job.id, job.priority.get(), 0)).collect() })
}

/// Notes the end of a child at its parent; the last one frees the parent to be taken again and put together.
pub(super) async fn one_ended(tx: &mut Transaction<'_, Sqlite>, child: Uuid, now: Timestamp) -> Result<Ended> {
    let row = sqlx::query(
        "SELECT parent.id AS id, parent.priority AS priority, parent.attempt AS attempt,
                sum(child.status IN ('accepted', 'running')) AS open, count(*) AS many
         FROM job AS me JOIN job AS parent ON parent.id = me.parent JOIN job AS child ON child.parent = parent.id
         WHERE me.id = ? AND parent.waits_for_children = 1 GROUP BY parent.id",
    )
    .bind(child.to_string())
    .fetch_optional(&mut **tx)
    .await?;
    let Some(row) = row else { return Ok(Ended::default()) };
    let id: String = row.try_get("id")?;
    let parent: Uuid = id.parse().map_err(StoreError::corrupt)?;
    let (open, many): (i64, i64) = (row.try_get("open")?, row.try_get("many")?);
    let percent = (many - open) * 99 / many.max(1);
    sqlx::query(
        "UPDATE job SET progress = max(progress, ?2), waits_for_children = ?3, lost = lost - ?6, lease_until_ms = 0,
             ticketed_ms = ?5, updated = ?4
         WHERE id = ?1",
    )
    .bind(&id)
    .bind(percent)
    .bind(i64::from(open > 0))
    .bind(now.to_string())
    .bind(now.as_millisecond())
    // the claim that puts it together finds it running, yet no worker was lost
    .bind(i64::from(open == 0))
    .execute(&mut **tx)
    .await?;
    history::note(tx, parent, "progress", &serde_json::json!({"percent": percent, "open_children": open})).await?;
    if open > 0 {
        return Ok(Ended { parent: Some(parent), ..Ended::default() });
    }
    Ok(Ended { parent: Some(parent), to_ticket: vec![(parent, row.try_get("priority")?, row.try_get("attempt")?)] })
}

impl Store {
    /// How the children of a job ended, in their order; empty where it has none.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn ended_children(&self, parent: Uuid) -> Result<Vec<ChildEnd>> {
        let rows = sqlx::query("SELECT id, status, results, exception FROM job WHERE parent = ? ORDER BY position, id")
            .bind(parent.to_string())
            .fetch_all(&self.reader)
            .await?;
        rows.iter()
            .map(|row| {
                let status: String = row.try_get("status")?;
                Ok(ChildEnd {
                    id: row.try_get::<String, _>("id")?.parse().map_err(StoreError::corrupt)?,
                    status: Status::from_name(&status).ok_or_else(|| StoreError::corrupt(status))?,
                    results: row.try_get::<Option<String>, _>("results")?.as_deref().map(from_json).transpose()?,
                    exception: row.try_get::<Option<String>, _>("exception")?.as_deref().map(from_json).transpose()?,
                })
            })
            .collect()
    }
}
