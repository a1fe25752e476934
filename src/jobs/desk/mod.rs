//! Accepts jobs, answers the workers and stores what they deliver: the only one that writes job rows.

mod tally;
mod workers;

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use jiff::Timestamp;
use serde_json::Value;
use tokio::sync::{RwLock, broadcast};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

pub use tally::{Tally, Write};

use super::{
    artifacts::Artifacts,
    engine::{Engine, Ticket},
    link::Artifact,
    processes::{Process, Shelf},
};
use crate::{
    clock,
    domain::{
        dataset::Dataset,
        ids::new_id,
        job::{Job, Labels, Priority, Report, Spent, Status, Wanted},
        problem::{Code, Problem},
    },
    store::{
        Store, StoreError,
        jobs::{Answer, Ended, Held, Reservation, Retention},
        proposals::Due,
    },
};

/// The desk; clones share it.
#[derive(Clone)]
pub struct Desk(Arc<Inner>);

struct Inner {
    store: Store,
    engine: Arc<dyn Engine>,
    artifacts: Artifacts,
    rules: Rules,
    stopping: CancellationToken,
    changes: broadcast::Sender<Uuid>,
    written: Mutex<HashMap<Uuid, (Instant, Report)>>,
    tally: Tally,
    // outputs are stored and named under `read`, no more named and removed under `write`: equal bytes are stored once
    naming: RwLock<()>,
}

/// What the file of the columns of a data set is called among outputs.
pub const COLUMNS: &str = "columns";
/// Its media type.
pub const OCTETS: &str = "application/octet-stream";

/// What the desk keeps to.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// Jobs that may wait; more are refused.
    pub most_waiting: u32,
    /// How long a worker may be silent before its job is given to another.
    pub lease: Duration,
    /// The most memory that the particles and the grid of a run-out may take, bytes.
    pub runout_memory_bytes: u64,
}

/// A wish to have a process executed.
#[derive(Clone, Debug)]
pub struct Submission {
    /// Which process.
    pub process: Process,
    /// The inputs as the caller sent them.
    pub inputs: Value,
    /// Names and values to find the job again.
    pub labels: Labels,
    /// Which outputs are wanted.
    pub wanted: Wanted,
    /// How urgent it is.
    pub priority: Priority,
    /// Who asks.
    pub submitted_by: Option<String>,
    /// Compute anew although the same was computed before.
    pub anew: bool,
    /// The idempotency key.
    pub reservation: Option<Reservation>,
}

/// What became of a [`Submission`].
#[derive(Clone, Debug)]
pub enum Submitted {
    /// A new job.
    New(Answer),
    /// A job that computed the same before.
    Reused(Answer),
    /// The answer to the same request before.
    Repeated(Answer),
}

impl Desk {
    /// A desk over a store, an engine and a place for large outputs.
    #[must_use]
    pub fn new(store: Store, engine: Arc<dyn Engine>, artifacts: Artifacts, rules: Rules) -> Self {
        Self(Arc::new(Inner {
            store,
            engine,
            artifacts,
            rules,
            stopping: CancellationToken::new(),
            changes: broadcast::channel(1024).0,
            written: Mutex::default(),
            tally: Tally::default(),
            naming: RwLock::default(),
        }))
    }

    /// The store of the jobs.
    #[must_use]
    pub fn store(&self) -> &Store {
        &self.0.store
    }

    /// The engine that carries the tickets.
    #[must_use]
    pub fn engine(&self) -> &Arc<dyn Engine> {
        &self.0.engine
    }

    /// Where large outputs lie.
    #[must_use]
    pub fn artifacts(&self) -> &Artifacts {
        &self.0.artifacts
    }

    /// What processes may read.
    fn shelf(&self) -> Shelf<'_> {
        Shelf {
            store: &self.0.store,
            artifacts: &self.0.artifacts,
            runout_memory_bytes: self.0.rules.runout_memory_bytes,
        }
    }

    /// Stores a data set with the file of its columns; once this returns, both are on disk.
    ///
    /// # Errors
    /// [`Problem`] of a failure of ours; then there is no data set.
    pub async fn keep_dataset(&self, mut dataset: Dataset, columns: Vec<u8>) -> Result<Dataset, Problem> {
        let _naming = self.0.naming.read().await;
        let artifact =
            Artifact { name: COLUMNS.into(), media_type: OCTETS.into(), bytes: columns, ..Artifact::default() };
        let stored = self.0.artifacts.put(&artifact).await.map_err(Problem::internal)?;
        (dataset.sha256, dataset.size) = (stored.sha256, stored.size);
        self.0.store.insert_dataset(&dataset).await.map_err(Problem::internal)?;
        Ok(dataset)
    }

    /// Removes a data set if `permits` agrees; jobs that have not begun yet will not find it any more.
    ///
    /// # Errors
    /// [`StoreError::Missing`] where there is none, [`StoreError::Precondition`] where `permits` does not agree.
    pub async fn remove_dataset(&self, id: Uuid, permits: impl FnOnce(&Dataset) -> bool) -> Result<(), StoreError> {
        let _alone = self.0.naming.write().await;
        let digests = self.0.store.remove_dataset(id, permits).await?;
        self.0.artifacts.remove(&digests).await;
        Ok(())
    }

    /// Hears of every job that changes; a listener that is too slow hears that it missed some.
    #[must_use]
    pub fn changes(&self) -> broadcast::Receiver<Uuid> {
        self.0.changes.subscribe()
    }

    /// What was counted since the desk was opened.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.0.tally
    }

    /// Writes of attempts that did not count any more and were refused.
    #[must_use]
    pub fn fenced_writes(&self) -> u64 {
        Write::ALL.into_iter().map(|write| self.0.tally.fenced_writes(write)).sum()
    }

    /// Accepts no more jobs.
    pub fn close(&self) {
        self.0.stopping.cancel();
    }

    /// Cancelled once the desk accepts no more jobs: streams end then.
    #[must_use]
    pub fn closed(&self) -> CancellationToken {
        self.0.stopping.clone()
    }

    /// Checks the inputs in full, then accepts the job: once this returns, it is on disk. `render` makes the answer, which
    /// an idempotency key gives again; it is told whether the job is one that computed the same before.
    ///
    /// # Errors
    /// A [`Problem`] for the caller; then there is no job.
    pub async fn submit(
        &self,
        submission: Submission,
        render: impl FnOnce(&Job, bool) -> Answer + Send + 'static,
    ) -> Result<Submitted, Problem> {
        if self.0.stopping.is_cancelled() {
            return Err(Problem::new(Code::ShuttingDown, "no new jobs are taken"));
        }
        let Some(reservation) = submission.reservation.clone() else {
            return self.accept(submission, render).await;
        };
        // to its end even where the caller hangs up meanwhile: a key that nobody lets go of would be at work for ever
        let desk = self.clone();
        let work = tokio::spawn(async move { desk.accept_under(&reservation, submission, render).await });
        work.await.map_err(Problem::internal)?
    }

    async fn accept_under(
        &self,
        reservation: &Reservation,
        submission: Submission,
        render: impl FnOnce(&Job, bool) -> Answer,
    ) -> Result<Submitted, Problem> {
        match self.0.store.hold_key(reservation, clock::now()).await.map_err(Problem::internal)? {
            Held::Answered(answer) => return Ok(Submitted::Repeated(answer)),
            Held::AtWork => {
                let detail = "the same request with this Idempotency-Key is being accepted; repeat it in a moment";
                return Err(Problem::new(Code::RequestAtWork, detail));
            }
            Held::OtherRequest => {
                let detail = "this Idempotency-Key was sent with another request; use a new key for a new request";
                return Err(Problem::new(Code::KeyReused, detail));
            }
            Held::New => {}
        }
        let result = self.accept(submission, render).await;
        if result.is_err() {
            // a refusal is not remembered, so that the mended request may use the key
            self.0.store.let_key_go(reservation).await.map_err(Problem::internal)?;
        }
        result
    }

    async fn accept(
        &self,
        submission: Submission,
        render: impl FnOnce(&Job, bool) -> Answer,
    ) -> Result<Submitted, Problem> {
        let store = &self.0.store;
        let process = submission.process;
        let accepted = process.accept(self.shelf(), &submission.inputs).await?;
        if process.is_pure() && !submission.anew {
            let version = env!("CARGO_PKG_VERSION");
            let same = store.job_of_input(process.id(), &accepted.hash, version, &submission.wanted).await;
            let same = same.map_err(Problem::internal)?;
            if let Some(job) = same {
                let answer = render(&job, true);
                if let Some(reservation) = &submission.reservation {
                    store.settle_key(reservation, &answer).await.map_err(Problem::internal)?;
                }
                return Ok(Submitted::Reused(answer));
            }
        }
        if store.waiting_jobs().await.map_err(Problem::internal)? >= self.0.rules.most_waiting {
            let detail = format!("{} jobs are waiting already; dismiss some or wait", self.0.rules.most_waiting);
            return Err(Problem::new(Code::Overloaded, detail));
        }
        let mut job = new_job(process, accepted.inputs, accepted.hash);
        job.labels = submission.labels;
        job.wanted = submission.wanted;
        job.priority = submission.priority;
        job.submitted_by = submission.submitted_by;
        let answer = render(&job, false);
        let remembered = submission.reservation.as_ref().map(|reservation| (reservation, &answer));
        store.insert_job(&job, remembered).await.map_err(Problem::internal)?;
        self.changed(job.id);
        self.ticket(&[(job.id, job.priority.get(), 0)]).await;
        Ok(Submitted::New(answer))
    }

    /// Accepts a job that the calendar asks for, once: the job and the note that it was taken up are stored together. False
    /// where it was taken up before.
    ///
    /// # Errors
    /// A [`Problem`] where the inputs cannot be accepted now; then nothing is stored.
    pub async fn submit_due(
        &self,
        process: Process,
        inputs: &Value,
        due: &Due,
        now: Timestamp,
    ) -> Result<bool, Problem> {
        if self.0.stopping.is_cancelled() {
            return Err(Problem::new(Code::ShuttingDown, "no new jobs are taken"));
        }
        let store = &self.0.store;
        let accepted = process.accept(self.shelf(), inputs).await?;
        if store.waiting_jobs().await.map_err(Problem::internal)? >= self.0.rules.most_waiting {
            return Err(Problem::new(Code::Overloaded, "too many jobs are waiting"));
        }
        let mut job = new_job(process, accepted.inputs, accepted.hash);
        job.labels.insert("due".to_owned(), due.day.to_string());
        if !store.take_up(due, Ok(&job), now).await.map_err(Problem::internal)? {
            return Ok(false);
        }
        self.changed(job.id);
        self.ticket(&[(job.id, job.priority.get(), 0)]).await;
        Ok(true)
    }

    /// Gives up a job that has not ended, and its children; the computation stops within a second.
    ///
    /// # Errors
    /// [`StoreError::Transition`] where it has ended, [`StoreError::Missing`] where there is none.
    pub async fn dismiss(&self, id: Uuid) -> Result<(), StoreError> {
        let (ids, ended) = self.0.store.dismiss_job(id, clock::now()).await?;
        self.0.tally.dismissed(ids.len());
        for id in ids {
            self.over(id);
        }
        self.see_to(ended).await;
        Ok(())
    }

    /// Removes a job that has ended.
    ///
    /// # Errors
    /// [`StoreError::Child`] where it is part of another, [`StoreError::Missing`] where there is no ended job of that id.
    pub async fn remove(&self, id: Uuid) -> Result<(), StoreError> {
        let _alone = self.0.naming.write().await;
        let digests = self.0.store.remove_job(id).await?;
        self.0.artifacts.remove(&digests).await;
        Ok(())
    }

    /// Removes ended jobs that are too old or too many; says how many.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn retire(&self, retention: Retention) -> Result<usize, StoreError> {
        let _alone = self.0.naming.write().await;
        let (jobs, digests) = self.0.store.retire_jobs(retention).await?;
        self.0.artifacts.remove(&digests).await;
        Ok(jobs)
    }

    /// Removes the pieces of outputs of jobs that have ended: the outputs are put together, or never will be.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn sweep_pieces(&self) -> Result<(), StoreError> {
        if !self.0.store.has_spare_pieces().await? {
            return Ok(());
        }
        let _alone = self.0.naming.write().await;
        let digests = self.0.store.forget_pieces().await?;
        self.0.artifacts.remove(&digests).await;
        Ok(())
    }

    /// Removes what lies in the artifact store and nobody names: outputs and data sets that were stored when the process was
    /// killed, before their row was. Says how many there were.
    ///
    /// # Errors
    /// [`Problem`] where the store or the database does not answer.
    pub async fn sweep_artifacts(&self) -> Result<usize, Problem> {
        // while nobody waits: what is stored meanwhile is not among them, and what is named meanwhile is looked at again
        let stored = self.0.artifacts.digests().await.map_err(Problem::internal)?;
        let mut removed = 0;
        for some in stored.chunks(1000) {
            if self.0.store.unnamed(some).await.map_err(Problem::internal)?.is_empty() {
                continue;
            }
            let _alone = self.0.naming.write().await;
            let spare = self.0.store.unnamed(some).await.map_err(Problem::internal)?;
            self.0.artifacts.remove(&spare).await;
            removed += spare.len();
        }
        Ok(removed)
    }

    /// Issues tickets; where the engine does not answer, the caretaker issues them later.
    pub async fn ticket(&self, jobs: &[(Uuid, u8, u32)]) {
        if jobs.is_empty() {
            return;
        }
        let tickets: Vec<Ticket> =
            jobs.iter().map(|&(job, priority, attempt)| Ticket { job, priority, attempt }).collect();
        if let Err(error) = self.0.engine.publish(&tickets).await {
            tracing::warn!(%error, jobs = tickets.len(), "tickets could not be issued; they are issued again later");
            let ids: Vec<Uuid> = jobs.iter().map(|(id, ..)| *id).collect();
            if let Err(error) = self.0.store.mark_ticketed(&ids, Timestamp::UNIX_EPOCH).await {
                tracing::warn!(%error, "that tickets are missing could not be noted; they are issued again later still");
            }
        }
    }

    fn changed(&self, id: Uuid) {
        // nobody may be listening
        let _ = self.0.changes.send(id);
    }

    /// A job whose attempt is over.
    fn over(&self, id: Uuid) {
        self.0.written.lock().unwrap_or_else(PoisonError::into_inner).remove(&id);
        self.changed(id);
    }

    async fn see_to(&self, ended: Ended) {
        if let Some(parent) = ended.parent {
            self.changed(parent);
        }
        self.ticket(&ended.to_ticket).await;
    }
}

fn new_job(process: Process, inputs: Value, input_hash: String) -> Job {
    let now = clock::now();
    Job {
        id: new_id(),
        process_id: process.id().to_owned(),
        status: Status::Accepted,
        report: Report::default(),
        message: None,
        exception: None,
        inputs,
        input_hash,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        submitted_by: None,
        labels: Labels::new(),
        wanted: Wanted::default(),
        priority: Priority::default(),
        parent: None,
        position: None,
        attempt: 0,
        worker: None,
        spent: Spent::default(),
        created: now,
        started: None,
        finished: None,
        updated: now,
    }
}
