//! Accepts jobs, answers the workers and stores what they deliver: the only one that writes job rows.

use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};
use tokio::sync::{RwLock, broadcast};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::{
    artifacts::Artifacts,
    engine::{Boxed, Engine, Ticket},
    link::{Artifact, Assignment, Delivery, JobLink, LinkError, LogLine, Output, Verdict},
    processes::Process,
};
use crate::{
    clock,
    domain::{
        ids::new_id,
        job::{Exception, Job, Labels, Priority, Report, Status},
        problem::{Code, Problem},
    },
    store::{
        Store, StoreError,
        jobs::{Answer, Beat, Claim, Ended, Held, Outcome, Reservation, Retention},
    },
};

/// Progress is written at most this often a job; a sign of life between two writes is only read.
const WRITE_EVERY: Duration = Duration::from_millis(500);

/// An output up to this size stands in the row of the job, bytes.
const LARGEST_INLINE: usize = 256 * 1024;

/// The desk; clones share it.
#[derive(Clone)]
pub struct Desk(Arc<Inner>);

struct Inner {
    store: Store,
    engine: Arc<dyn Engine>,
    artifacts: Artifacts,
    most_waiting: u32,
    stopping: CancellationToken,
    changes: broadcast::Sender<Uuid>,
    written: Mutex<HashMap<Uuid, (Instant, Report)>>,
    fenced: AtomicU64,
    // outputs are stored and named under `read`, no more named and removed under `write`: equal bytes are stored once
    naming: RwLock<()>,
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
    Reused(Box<Job>),
    /// The answer to the same request before.
    Repeated(Answer),
}

impl Desk {
    /// A desk over a store, an engine and a place for large outputs.
    #[must_use]
    pub fn new(store: Store, engine: Arc<dyn Engine>, artifacts: Artifacts, most_waiting: u32) -> Self {
        Self(Arc::new(Inner {
            store,
            engine,
            artifacts,
            most_waiting,
            stopping: CancellationToken::new(),
            changes: broadcast::channel(1024).0,
            written: Mutex::default(),
            fenced: AtomicU64::new(0),
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

    /// Hears of every job that changes; a listener that is too slow hears that it missed some.
    #[must_use]
    pub fn changes(&self) -> broadcast::Receiver<Uuid> {
        self.0.changes.subscribe()
    }

    /// Writes of attempts that did not count any more and were refused.
    #[must_use]
    pub fn fenced_writes(&self) -> u64 {
        self.0.fenced.load(Ordering::Relaxed)
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

    /// Checks the inputs in full, then accepts the job: once this returns, it is on disk. `render` makes the answer that
    /// an idempotency key gives again.
    ///
    /// # Errors
    /// A [`Problem`] for the caller; then there is no job.
    pub async fn submit(
        &self,
        submission: Submission,
        render: impl FnOnce(&Job) -> Answer + Send + 'static,
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
        render: impl FnOnce(&Job) -> Answer,
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
        if !matches!(result, Ok(Submitted::New(_))) {
            // a refusal is not remembered, so that the mended request may use the key; a reused job is found again anyway
            self.0.store.let_key_go(reservation).await.map_err(Problem::internal)?;
        }
        result
    }

    async fn accept(&self, submission: Submission, render: impl FnOnce(&Job) -> Answer) -> Result<Submitted, Problem> {
        let store = &self.0.store;
        let process = submission.process;
        let accepted = process.accept(store, &submission.inputs).await?;
        if process.is_pure() && !submission.anew {
            let version = env!("CARGO_PKG_VERSION");
            let same = store.job_of_input(process.id(), &accepted.hash, version).await.map_err(Problem::internal)?;
            if let Some(job) = same {
                return Ok(Submitted::Reused(Box::new(job)));
            }
        }
        if store.waiting_jobs().await.map_err(Problem::internal)? >= self.0.most_waiting {
            let detail = format!("{} jobs are waiting already; dismiss some or wait", self.0.most_waiting);
            return Err(Problem::new(Code::Overloaded, detail));
        }
        let mut job = new_job(process, accepted.inputs, accepted.hash);
        job.labels = submission.labels;
        job.priority = submission.priority;
        job.submitted_by = submission.submitted_by;
        let answer = render(&job);
        let remembered = submission.reservation.as_ref().map(|reservation| (reservation, &answer));
        store.insert_job(&job, remembered).await.map_err(Problem::internal)?;
        self.changed(job.id);
        self.ticket(&[(job.id, job.priority.get(), 0)]).await;
        Ok(Submitted::New(answer))
    }

    /// Gives up a job that has not ended, and its children; the computation stops within a second.
    ///
    /// # Errors
    /// [`StoreError::Transition`] where it has ended, [`StoreError::Missing`] where there is none.
    pub async fn dismiss(&self, id: Uuid) -> Result<(), StoreError> {
        let (ids, ended) = self.0.store.dismiss_job(id, clock::now()).await?;
        for id in ids {
            self.over(id);
        }
        self.see_to(ended).await;
        Ok(())
    }

    /// Removes a job that has ended.
    ///
    /// # Errors
    /// [`StoreError::Missing`] where there is no ended job of that id.
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

    fn lease(&self) -> SignedDuration {
        SignedDuration::try_from(self.0.engine.lease()).unwrap_or(SignedDuration::from_secs(30))
    }

    fn fenced(&self, error: StoreError) -> Result<Verdict, LinkError> {
        match error {
            StoreError::Fenced | StoreError::Missing | StoreError::Transition(_) => {
                self.0.fenced.fetch_add(1, Ordering::Relaxed);
                Ok(Verdict::Fenced)
            }
            other => Err(LinkError(other.to_string())),
        }
    }

    async fn assign(&self, id: Uuid, worker: &str) -> Result<Assignment, LinkError> {
        let link = |error: StoreError| LinkError(error.to_string());
        let survives = self.0.engine.workers_survive();
        let claim = self.0.store.claim_job(id, worker, clock::now(), self.lease(), survives).await.map_err(link)?;
        self.changed(id);
        let (job, checkpoint) = match claim {
            Claim::Busy => return Ok(Assignment::Busy),
            Claim::Over => return Ok(Assignment::Over),
            Claim::GivenUp(ended) => {
                self.see_to(ended).await;
                return Ok(Assignment::Over);
            }
            Claim::Taken { job, checkpoint } => (job, checkpoint),
        };
        let payload = match Process::from_id(&job.process_id) {
            Some(process) => process.payload(&self.0.store, &job).await,
            None => Err(Problem::new(Code::JobFailed, format!("there is no process {} any more", job.process_id))),
        };
        match payload {
            Ok(payload) => Ok(Assignment::Taken { job, payload, checkpoint }),
            Err(problem) => {
                let exception = Exception { code: problem.code.slug().into(), detail: problem.detail };
                self.end(job.id, job.attempt, Outcome::Failed(exception), None, 0).await.map_err(link)?;
                Ok(Assignment::Over)
            }
        }
    }

    async fn beaten(&self, id: Uuid, attempt: u32, report: &Report) -> Result<Verdict, LinkError> {
        let link = |error: StoreError| LinkError(error.to_string());
        let due = {
            let written = self.0.written.lock().unwrap_or_else(PoisonError::into_inner);
            written.get(&id).is_none_or(|(at, before)| {
                let age = at.elapsed();
                age >= self.0.engine.lease() / 4 || (age >= WRITE_EVERY && before != report)
            })
        };
        let beat = if due {
            let beat = self.0.store.beat_job(id, attempt, report, clock::now(), self.lease()).await.map_err(link)?;
            let mut written = self.0.written.lock().unwrap_or_else(PoisonError::into_inner);
            written.insert(id, (Instant::now(), report.clone()));
            drop(written);
            self.changed(id);
            beat
        } else {
            self.0.store.is_attempt_current(id, attempt).await.map_err(link)?
        };
        if beat == Beat::Go {
            return Ok(Verdict::Counts);
        }
        let newer = self.0.store.job(id).await.map_err(link)?.is_some_and(|job| job.attempt != attempt);
        if newer {
            // not merely dismissed: a worker that was thought lost writes for an attempt that was taken over
            self.0.fenced.fetch_add(1, Ordering::Relaxed);
        } else {
            self.over(id);
        }
        Ok(Verdict::Fenced)
    }

    async fn received(
        &self,
        id: Uuid,
        attempt: u32,
        delivery: &Delivery,
        compute_ms: u64,
    ) -> Result<Verdict, LinkError> {
        let output = match delivery {
            Delivery::Failed(exception) => {
                let outcome = Outcome::Failed(exception.clone());
                return self.verdict(self.end(id, attempt, outcome, None, compute_ms).await);
            }
            Delivery::Finished(output) => output,
        };
        if !output.split.is_empty() {
            return match self.children(id, output).await {
                Ok(jobs) => self.verdict(self.end(id, attempt, Outcome::Split(jobs), None, compute_ms).await),
                Err(problem) => {
                    let exception = Exception { code: problem.code.slug().into(), detail: problem.detail };
                    self.verdict(self.end(id, attempt, Outcome::Failed(exception), None, compute_ms).await)
                }
            };
        }
        let large_outputs = !output.artifacts.is_empty();
        if large_outputs
            && self.0.store.is_attempt_current(id, attempt).await.map_err(|error| LinkError(error.to_string()))?
                == Beat::Stop
        {
            // before its outputs are stored, which nobody would remove
            return self.fenced(StoreError::Fenced);
        }
        let _naming = self.0.naming.read().await;
        let mut outputs = Vec::new();
        let (mut results, large) = apart(&output.results);
        for artifact in output.artifacts.iter().chain(&large) {
            outputs.push(self.0.artifacts.put(artifact).await.map_err(|error| LinkError(error.to_string()))?);
        }
        if let Some(object) = results.as_object_mut() {
            for output in &outputs {
                object.insert(output.name.clone(), reference(id, output));
            }
        }
        let outcome = Outcome::Successful { results, outputs };
        self.verdict(self.end(id, attempt, outcome, output.keep.as_ref(), compute_ms).await)
    }

    fn verdict(&self, ended: Result<(), StoreError>) -> Result<Verdict, LinkError> {
        ended.map_or_else(|error| self.fenced(error), |()| Ok(Verdict::Counts))
    }

    /// The jobs that a job goes on as, each checked like a submission.
    async fn children(&self, parent: Uuid, output: &Output) -> Result<Vec<Job>, Problem> {
        let above = self.0.store.job(parent).await.map_err(Problem::internal)?;
        let above = above.ok_or_else(|| Problem::internal("the parent is gone"))?;
        let mut jobs = Vec::with_capacity(output.split.len());
        for (position, part) in (0..).zip(&output.split) {
            let process = Process::from_id(&part.process_id)
                .ok_or_else(|| Problem::new(Code::NoSuchProcess, format!("there is no process {}", part.process_id)))?;
            let accepted = process.accept(&self.0.store, &part.inputs).await?;
            let mut job = new_job(process, accepted.inputs, accepted.hash);
            job.parent = Some(parent);
            job.position = Some(position);
            job.priority = above.priority;
            job.labels.clone_from(&above.labels);
            job.submitted_by.clone_from(&above.submitted_by);
            jobs.push(job);
        }
        Ok(jobs)
    }

    /// Ends an attempt in the store, with what is kept beside it, and sees to what that brings about.
    async fn end(
        &self,
        id: Uuid,
        attempt: u32,
        outcome: Outcome,
        keep: Option<&Value>,
        compute_ms: u64,
    ) -> Result<(), StoreError> {
        let now = clock::now();
        let (outcome, kept) = match keep.map(|keep| Process::kept(id, keep, now)).transpose() {
            Ok(kept) => (outcome, kept),
            // to deliver it again would not mend it
            Err(error) => {
                (Outcome::Failed(Exception { code: Code::JobFailed.slug().into(), detail: error.to_string() }), None)
            }
        };
        let ended = self.0.store.finish_job(id, attempt, outcome, kept.as_ref(), compute_ms, now).await?;
        self.over(id);
        self.see_to(ended).await;
        Ok(())
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
        priority: Priority::default(),
        parent: None,
        position: None,
        attempt: 0,
        worker: None,
        compute_ms: 0,
        created: now,
        started: None,
        finished: None,
        updated: now,
    }
}

/// How a large output stands in the results document.
fn reference(job: Uuid, output: &crate::store::jobs::OutputRecord) -> Value {
    json!({
        "href": format!("/v1/jobs/{job}/results/{}", output.name),
        "type": output.media_type, "length": output.size, "sha256": output.sha256,
    })
}

/// The results document without its large members, and these as outputs of their own.
fn apart(results: &Value) -> (Value, Vec<Artifact>) {
    let Some(members) = results.as_object() else { return (results.clone(), Vec::new()) };
    let mut small = serde_json::Map::new();
    let mut large = Vec::new();
    for (name, value) in members {
        let text = value.to_string();
        if text.len() <= LARGEST_INLINE {
            small.insert(name.clone(), value.clone());
        } else {
            let (name, media_type) = (name.clone(), "application/json".to_owned());
            large.push(Artifact { name, media_type, bytes: text.into_bytes() });
        }
    }
    (Value::Object(small), large)
}

impl JobLink for Desk {
    fn claim<'a>(&'a self, job: Uuid, worker: &'a str) -> Boxed<'a, Result<Assignment, LinkError>> {
        Box::pin(self.assign(job, worker))
    }

    fn beat<'a>(&'a self, job: Uuid, attempt: u32, report: &'a Report) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.beaten(job, attempt, report))
    }

    fn log<'a>(&'a self, job: Uuid, attempt: u32, lines: &'a [LogLine]) -> Boxed<'a, Result<(), LinkError>> {
        Box::pin(async move {
            let lines: Vec<_> = lines.iter().map(|line| (line.level.clone(), line.message.clone())).collect();
            let stored = self.0.store.append_job_log(job, attempt, &lines, clock::now()).await;
            self.verdict(stored).map(|_| ())
        })
    }

    fn checkpoint<'a>(&'a self, job: Uuid, attempt: u32, bytes: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(async move {
            let saved = self.0.store.save_checkpoint(job, attempt, bytes, clock::now()).await;
            self.verdict(saved)
        })
    }

    fn release(&self, job: Uuid, attempt: u32, compute_ms: u64) -> Boxed<'_, Result<Verdict, LinkError>> {
        Box::pin(async move {
            let released = self.0.store.release_job(job, attempt, compute_ms, clock::now()).await;
            self.over(job);
            self.verdict(released)
        })
    }

    fn finish<'a>(
        &'a self,
        job: Uuid,
        attempt: u32,
        delivery: &'a Delivery,
        compute_ms: u64,
    ) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.received(job, attempt, delivery, compute_ms))
    }
}
