//! The life of an attempt: claimed with a lease, kept alive, given back or ended. Its number fences every write, so that
//! a worker that was frozen past its lease can change nothing any more.

use jiff::{SignedDuration, Timestamp};
use sqlx::{Row, Sqlite, Transaction};
use uuid::Uuid;

use super::{children, history, outputs, rows::JobRow, step};
use crate::{
    domain::job::{Event, Exception, Job, Report, Spent, Status},
    store::{
        Result, Store, StoreError, datasets, jobs::Kept, models, parse_timestamp, proposals, selections, to_json,
        transfers,
    },
};

/// What became of the wish to take a job.
#[derive(Clone, Debug)]
pub enum Claim {
    /// It is taken; `checkpoint` is what an earlier attempt saved last.
    Taken {
        /// The job, with the number of this attempt.
        job: Box<Job>,
        /// The state to go on from.
        checkpoint: Option<Vec<u8>>,
        /// Whether the attempt before lost its lease.
        lease_lost: bool,
    },
    /// Another worker has it and its lease holds for so long.
    Busy(SignedDuration),
    /// It has ended or was removed: its ticket is of no more use.
    Over,
    /// It took its worker down too often and was failed now, which brought this about.
    GivenUp(Ended),
}

/// The answer to a sign of life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beat {
    /// Go on.
    Go,
    /// The attempt counts no more: dismissed, ended, or taken over. Stop.
    Stop,
}

/// How a computation ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// With these results and large outputs.
    Successful {
        /// The results document.
        results: serde_json::Value,
        /// Outputs whose bytes are in the artifact store already.
        outputs: Vec<outputs::OutputRecord>,
    },
    /// Without, for this reason.
    Failed(Exception),
    /// It goes on as these jobs, and ends when they have.
    Split(Vec<Job>),
}

/// What ending an attempt brought about.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ended {
    /// Jobs that need a ticket now: new children, or a parent whose children have all ended; with their priority.
    pub to_ticket: Vec<(Uuid, u8, u32)>,
    /// The parent whose progress it changed.
    pub parent: Option<Uuid>,
}

/// A job whose attempts end without a word so often in a row, with no checkpoint between, takes its worker down.
const MOST_LOST_ATTEMPTS: i64 = 5;

impl Store {
    /// Takes a job for `worker` until `lease` from now. A running job can be taken only once its lease has ended; a job
    /// that lost its worker too often in a row is failed instead. `survives`: the worker outlives this machine, so that
    /// its attempt must never be given to another one, not even after a power cut.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn claim_job(
        &self,
        id: Uuid,
        worker: &str,
        now: Timestamp,
        lease: SignedDuration,
        survives: bool,
    ) -> Result<Claim> {
        let mut tx = if survives { self.begin().await? } else { self.begin_lightly().await? };
        let row = sqlx::query(
            "SELECT status, lease_until_ms, lost, waits_for_children, claimed_ms, updated FROM job WHERE id = ?",
        )
        .bind(id.to_string())
        .fetch_optional(&mut *tx)
        .await?;
        let Some(row) = row else { return Ok(Claim::Over) };
        let status = row.try_get::<String, _>("status")?;
        let status = Status::from_name(&status).ok_or_else(|| StoreError::corrupt(status))?;
        if status.ended() || row.try_get::<bool, _>("waits_for_children")? {
            return Ok(Claim::Over);
        }
        let orphaned = status == Status::Running;
        let lease_left = row.try_get::<i64, _>("lease_until_ms")? - now.as_millisecond();
        if orphaned && lease_left >= 0 {
            return Ok(Claim::Busy(SignedDuration::from_millis(lease_left)));
        }
        let lost: i64 = row.try_get::<i64, _>("lost")? + i64::from(orphaned);
        // a parent that is put together is running without a worker, and no attempt of it was lost
        let lease_lost = orphaned && lost > 0;
        if lease_lost {
            // nobody told what it was spent on: it lived at least until its last sign of life
            let last_sign = parse_timestamp(row.try_get("updated")?)?.as_millisecond();
            let compute_ms = u64::try_from(last_sign - row.try_get::<i64, _>("claimed_ms")?).unwrap_or(0);
            spend(&mut tx, id, Spent { compute_ms, ..Spent::default() }).await?;
        }
        if lost >= MOST_LOST_ATTEMPTS {
            let detail = format!("{lost} attempts in a row ended without a word: the job takes its worker down");
            let ended = fail(&mut tx, id, &Exception { code: "crashed-repeatedly".into(), detail }, now).await?;
            tx.commit().await?;
            return Ok(Claim::GivenUp(ended));
        }
        let next = step(&mut tx, id, Event::Claim).await?;
        let job = sqlx::query_as::<_, JobRow>(
            "UPDATE job SET status = ?2, attempt = attempt + 1, lost = ?3, worker = ?4, lease_until_ms = ?5,
                 progress = coalesce((SELECT progress FROM job_checkpoint WHERE job_checkpoint.job = job.id), 0),
                 phase = NULL, rate = NULL, rate_unit = NULL, eta_seconds = NULL,
                 started = coalesce(started, ?6), updated = ?6, claimed_ms = ?7, version = ?8
             WHERE id = ?1 RETURNING *",
        )
        .bind(id.to_string())
        .bind(next.name())
        .bind(lost)
        .bind(worker)
        .bind(after(now, lease))
        .bind(now.to_string())
        .bind(now.as_millisecond())
        // of the firn that computes it, which an upgrade may have changed since it was accepted
        .bind(env!("CARGO_PKG_VERSION"))
        .fetch_one(&mut *tx)
        .await?
        .0;
        let checkpoint = sqlx::query_scalar("SELECT bytes FROM job_checkpoint WHERE job = ?")
            .bind(id.to_string())
            .fetch_optional(&mut *tx)
            .await?;
        history::note(&mut tx, id, "status", &serde_json::json!({"status": next, "attempt": job.attempt})).await?;
        if lease_lost {
            let message = "the attempt before ended without a word: its worker was lost";
            history::log(&mut tx, id, job.attempt - 1, now, "warn", message).await?;
        }
        let from = if checkpoint.is_some() { "from its last checkpoint" } else { "from its beginning" };
        history::log(&mut tx, id, job.attempt, now, "info", &format!("taken by {worker}, {from}")).await?;
        tx.commit().await?;
        Ok(Claim::Taken { job: Box::new(job), checkpoint, lease_lost })
    }

    /// A sign of life of an attempt: prolongs its lease and notes how far it is.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn beat_job(
        &self,
        id: Uuid,
        attempt: u32,
        report: &Report,
        now: Timestamp,
        lease: SignedDuration,
    ) -> Result<Beat> {
        let mut tx = self.begin_lightly().await?;
        let done = sqlx::query(
            "UPDATE job SET lease_until_ms = ?3, progress = max(progress, ?4), phase = ?5, rate = ?6, rate_unit = ?7,
                 eta_seconds = ?8, updated = ?9
             WHERE id = ?1 AND attempt = ?2 AND status = 'running'",
        )
        .bind(id.to_string())
        .bind(attempt)
        .bind(after(now, lease))
        .bind(report.percent.min(99))
        .bind(&report.phase)
        .bind(report.rate)
        .bind(report.rate_unit.as_deref())
        .bind(report.eta_seconds)
        .bind(now.to_string())
        .execute(&mut *tx)
        .await?;
        if done.rows_affected() == 0 {
            return Ok(Beat::Stop);
        }
        let body = serde_json::to_value(report).map_err(StoreError::corrupt)?;
        history::note_progress(&mut tx, id, attempt, &body).await?;
        tx.commit().await?;
        Ok(Beat::Go)
    }

    /// Whether an attempt still counts, without a write.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn is_attempt_current(&self, id: Uuid, attempt: u32) -> Result<Beat> {
        let holds: Option<i64> =
            sqlx::query_scalar("SELECT 1 FROM job WHERE id = ? AND attempt = ? AND status = 'running'")
                .bind(id.to_string())
                .bind(attempt)
                .fetch_optional(&self.reader)
                .await?;
        Ok(if holds.is_some() { Beat::Go } else { Beat::Stop })
    }

    /// Saves the state of an attempt; an attempt that saved something was not lost for nothing.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] where the attempt counts no more.
    pub async fn save_checkpoint(&self, id: Uuid, attempt: u32, bytes: &[u8], now: Timestamp) -> Result<()> {
        let mut tx = self.begin().await?;
        fence(&mut tx, id, attempt).await?;
        sqlx::query(
            "INSERT OR REPLACE INTO job_checkpoint (job, attempt, made, bytes, progress)
             VALUES (?1, ?2, ?3, ?4, (SELECT progress FROM job WHERE id = ?1))",
        )
        .bind(id.to_string())
        .bind(attempt)
        .bind(now.to_string())
        .bind(bytes)
        .execute(&mut *tx)
        .await?;
        sqlx::query("UPDATE job SET lost = 0 WHERE id = ?").bind(id.to_string()).execute(&mut *tx).await?;
        tx.commit().await?;
        Ok(())
    }

    /// Gives a job back unfinished: the next claim goes on from its last checkpoint.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] where the attempt counts no more.
    pub async fn release_job(&self, id: Uuid, attempt: u32, spent: Spent, now: Timestamp) -> Result<()> {
        let mut tx = self.begin().await?;
        fence(&mut tx, id, attempt).await?;
        spend(&mut tx, id, spent).await?;
        let status = step(&mut tx, id, Event::Release).await?;
        sqlx::query(
            "UPDATE job SET status = ?2, lease_until_ms = 0, ticketed_ms = 0, phase = NULL, updated = ?3 WHERE id = ?1",
        )
        .bind(id.to_string())
        .bind(status.name())
        .bind(now.to_string())
        .execute(&mut *tx)
        .await?;
        history::note(&mut tx, id, "status", &serde_json::json!({"status": status, "attempt": attempt})).await?;
        history::log(&mut tx, id, attempt, now, "info", "given back unfinished: its worker stops").await?;
        tx.commit().await?;
        Ok(())
    }

    /// Notes what an attempt computes from, where that is no more what it was when the job was accepted.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] where the attempt counts no more: then nothing is written.
    pub async fn set_input_hash(&self, id: Uuid, attempt: u32, input_hash: &str) -> Result<()> {
        let mut tx = self.begin().await?;
        fence(&mut tx, id, attempt).await?;
        sqlx::query("UPDATE job SET input_hash = ? WHERE id = ?")
            .bind(input_hash)
            .bind(id.to_string())
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(())
    }

    /// Ends an attempt with its outcome, and keeps a model in the same transaction: one is not there without the other.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] where the attempt counts no more: then nothing is written.
    pub async fn finish_job(
        &self,
        id: Uuid,
        attempt: u32,
        outcome: Outcome,
        keep: Option<&Kept>,
        spent: Spent,
        now: Timestamp,
    ) -> Result<Ended> {
        let mut tx = self.begin().await?;
        fence(&mut tx, id, attempt).await?;
        spend(&mut tx, id, spent).await?;
        let ended = match outcome {
            Outcome::Split(jobs) => children::split(&mut tx, (id, attempt), &jobs, now).await?,
            Outcome::Failed(exception) => {
                history::log(&mut tx, id, attempt, now, "error", &exception.detail).await?;
                fail(&mut tx, id, &exception, now).await?
            }
            Outcome::Successful { mut results, outputs } => {
                if let Some(kept) = keep {
                    let mut document = match kept {
                        Kept::Model(model) => {
                            let activated = models::insert(&mut tx, model, now).await?;
                            serde_json::json!({"model_id": model.record.id, "activated": activated})
                        }
                        Kept::Dataset(dataset) => {
                            datasets::insert(&mut tx, dataset).await?;
                            serde_json::json!({"dataset_id": dataset.id})
                        }
                        Kept::Selection(selection) => {
                            selections::insert(&mut tx, selection, now).await?;
                            serde_json::json!({})
                        }
                        Kept::Proposal(proposal) => {
                            proposals::insert(&mut tx, proposal, now).await?;
                            let model = proposal.model.record.id;
                            serde_json::json!({"proposal_id": proposal.id, "model_id": model, "activated": false})
                        }
                        Kept::Transfer(transfer) => {
                            transfers::insert(&mut tx, transfer, now).await?;
                            serde_json::json!({})
                        }
                    };
                    if let (Some(document), serde_json::Value::Object(rest)) = (document.as_object_mut(), results) {
                        document.extend(rest);
                    }
                    results = document;
                }
                outputs::insert(&mut tx, id, &outputs).await?;
                succeed(&mut tx, id, &results, now).await?
            }
        };
        tx.commit().await?;
        Ok(ended)
    }

    /// Makes every running job claimable at once: what a server does at its start whose workers died with it.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn end_all_leases(&self) -> Result<u64> {
        let mut tx = self.begin().await?;
        let done = sqlx::query("UPDATE job SET lease_until_ms = 0, ticketed_ms = 0 WHERE status = 'running'")
            .execute(&mut *tx)
            .await?;
        sqlx::query("UPDATE job SET ticketed_ms = 0 WHERE status = 'accepted'").execute(&mut *tx).await?;
        tx.commit().await?;
        Ok(done.rows_affected())
    }
}

fn after(now: Timestamp, lease: SignedDuration) -> i64 {
    now.as_millisecond().saturating_add(i64::try_from(lease.as_millis()).unwrap_or(i64::MAX))
}

pub(super) async fn fence(tx: &mut Transaction<'_, Sqlite>, id: Uuid, attempt: u32) -> Result<()> {
    let holds: Option<i64> = sqlx::query_scalar(
        "SELECT 1 FROM job WHERE id = ? AND attempt = ? AND status = 'running' AND waits_for_children = 0",
    )
    .bind(id.to_string())
    .bind(attempt)
    .fetch_optional(&mut **tx)
    .await?;
    holds.map(|_| ()).ok_or(StoreError::Fenced)
}

/// Adds to what was spent on a job.
async fn spend(tx: &mut Transaction<'_, Sqlite>, id: Uuid, spent: Spent) -> Result<()> {
    let whole = |ms: u64| i64::try_from(ms).unwrap_or(i64::MAX);
    sqlx::query(
        "UPDATE job SET compute_ms = compute_ms + ?2, states = states + ?3, saving_ms = saving_ms + ?4,
             storing_ms = storing_ms + ?5
         WHERE id = ?1",
    )
    .bind(id.to_string())
    .bind(whole(spent.compute_ms))
    .bind(spent.states)
    .bind(whole(spent.saving_ms))
    .bind(whole(spent.storing_ms))
    .execute(&mut **tx)
    .await?;
    Ok(())
}

async fn succeed(
    tx: &mut Transaction<'_, Sqlite>,
    id: Uuid,
    results: &serde_json::Value,
    now: Timestamp,
) -> Result<Ended> {
    let status = step(tx, id, Event::Succeed).await?;
    sqlx::query(
        "UPDATE job SET status = ?2, progress = 100, results = ?3, message = NULL, exception = NULL, phase = NULL,
             eta_seconds = NULL, finished = ?4, updated = ?4
         WHERE id = ?1",
    )
    .bind(id.to_string())
    .bind(status.name())
    .bind(to_json(results)?)
    .bind(now.to_string())
    .execute(&mut **tx)
    .await?;
    after_the_end(tx, id, status, now).await
}

pub(super) async fn fail(
    tx: &mut Transaction<'_, Sqlite>,
    id: Uuid,
    exception: &Exception,
    now: Timestamp,
) -> Result<Ended> {
    let status = step(tx, id, Event::Fail).await?;
    sqlx::query(
        "UPDATE job SET status = ?2, exception = ?3, message = ?4, phase = NULL, eta_seconds = NULL,
             waits_for_children = 0, finished = ?5, updated = ?5
         WHERE id = ?1",
    )
    .bind(id.to_string())
    .bind(status.name())
    .bind(to_json(exception)?)
    .bind(&exception.detail)
    .bind(now.to_string())
    .execute(&mut **tx)
    .await?;
    after_the_end(tx, id, status, now).await
}

/// An ended job needs no checkpoint, and may be the last child that its parent waits for.
async fn after_the_end(tx: &mut Transaction<'_, Sqlite>, id: Uuid, status: Status, now: Timestamp) -> Result<Ended> {
    sqlx::query("DELETE FROM job_checkpoint WHERE job = ?").bind(id.to_string()).execute(&mut **tx).await?;
    history::note(tx, id, "status", &serde_json::json!({"status": status})).await?;
    children::one_ended(tx, id, now).await
}
