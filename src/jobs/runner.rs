//! Runs accepted jobs first come, first served, on a rayon pool that requests never wait for.

use std::{
    collections::HashMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU8, Ordering},
    },
    time::Duration,
};

use firn_science::progress::Progress;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_util::{sync::CancellationToken, task::TaskTracker};
use uuid::Uuid;

use super::processes::Process;
use crate::{
    clock,
    domain::{
        ids::new_id,
        job::{Exception, Job, Status},
        problem::{Code, Problem},
    },
    store::{Store, StoreError, jobs::Outcome},
};

/// How often the progress of a running job is written down.
const REPORT_EVERY: Duration = Duration::from_millis(250);

/// How much may run and wait.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Threads of the compute pool.
    pub threads: usize,
    /// Jobs that run at once.
    pub slots: usize,
    /// Jobs that may wait.
    pub queue: u32,
}

/// The jobs of this process; clones share them.
#[derive(Clone)]
pub struct Jobs(Arc<Inner>);

struct Inner {
    store: Store,
    pool: rayon::ThreadPool,
    queue: mpsc::UnboundedSender<Uuid>,
    running: Mutex<HashMap<Uuid, Arc<Control>>>,
    limits: Limits,
    stopping: CancellationToken,
    tasks: TaskTracker,
}

/// What a running job shares with whoever watches it.
#[derive(Debug, Default)]
struct Control {
    cancelled: AtomicBool,
    percent: AtomicU8,
    phase: Mutex<String>,
}

impl Progress for Control {
    fn report(&self, fraction: f64, phase: &str) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0 to 99")]
        let percent = (fraction * 100.0).clamp(0.0, 99.0) as u8;
        self.percent.fetch_max(percent, Ordering::Relaxed);
        let mut known = self.phase.lock().unwrap_or_else(PoisonError::into_inner);
        if *known != phase {
            phase.clone_into(&mut known);
        }
    }

    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

/// Why a job has no results.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// It was asked to end.
    #[error("cancelled")]
    Cancelled,
    /// The computation cannot give a result, and why.
    #[error("{0}")]
    Science(String),
    /// The computation panicked.
    #[error("the computation panicked")]
    Panic,
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// What a process may use while it runs.
pub struct Context {
    /// Which job.
    pub job: Job,
    /// Where its data are.
    pub store: Store,
    control: Arc<Control>,
    jobs: Jobs,
}

impl Context {
    /// Runs `work` on the compute pool and waits for it without blocking the server; `work` reports to its argument.
    ///
    /// # Errors
    /// [`Failure::Panic`] where it panicked.
    pub async fn compute<T: Send + 'static>(
        &self,
        work: impl FnOnce(&dyn Progress) -> T + Send + 'static,
    ) -> Result<T, Failure> {
        let (send, receive) = oneshot::channel();
        let control = Arc::clone(&self.control);
        self.jobs.0.pool.spawn(move || {
            let result = catch_unwind(AssertUnwindSafe(|| work(control.as_ref())));
            // nobody waits any more only where the server is going down: the result has no taker then
            let _ = send.send(result);
        });
        match receive.await {
            Ok(Ok(value)) => Ok(value),
            Ok(Err(_)) | Err(_) => Err(Failure::Panic),
        }
    }
}

impl Jobs {
    /// Starts the runner; jobs that an earlier process left unfinished end as failed with the code `interrupted`.
    ///
    /// # Errors
    /// [`StoreError`] where the store cannot be written; a text where the pool cannot be started.
    pub async fn start(store: Store, limits: Limits) -> Result<Self, Box<dyn std::error::Error + Send + Sync>> {
        let left = store.fail_interrupted_jobs(&interrupted(), clock::now()).await?;
        if left > 0 {
            tracing::warn!(jobs = left, "an earlier process left jobs unfinished; they are failed now");
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(limits.threads)
            .thread_name(|index| format!("firn-compute-{index}"))
            .build()?;
        let (queue, waiting) = mpsc::unbounded_channel();
        let inner = Inner {
            store,
            pool,
            queue,
            running: Mutex::default(),
            limits,
            stopping: CancellationToken::new(),
            tasks: TaskTracker::new(),
        };
        let jobs = Self(Arc::new(inner));
        jobs.0.tasks.spawn(jobs.clone().dispatch(waiting));
        Ok(jobs)
    }

    /// Checks the inputs in full, then accepts the job: once this returns, it is on disk.
    ///
    /// # Errors
    /// A [`Problem`] for the caller; then there is no job.
    pub async fn submit(
        &self,
        process: Process,
        inputs: &serde_json::Value,
        submitted_by: Option<String>,
    ) -> Result<Job, Problem> {
        if self.0.stopping.is_cancelled() {
            return Err(Problem::new(Code::ShuttingDown, "no new jobs are taken"));
        }
        let accepted = process.accept(&self.0.store, inputs).await?;
        if self.0.store.waiting_jobs().await.map_err(Problem::internal)? >= self.0.limits.queue {
            return Err(Problem::new(Code::Overloaded, format!("{} jobs are waiting already", self.0.limits.queue)));
        }
        let now = clock::now();
        let job = Job {
            id: new_id(),
            process_id: process.id().to_owned(),
            status: Status::Accepted,
            progress: 0,
            phase: None,
            message: None,
            exception: None,
            inputs: accepted.inputs,
            input_hash: accepted.hash,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            submitted_by,
            created: now,
            started: None,
            finished: None,
            updated: now,
        };
        self.0.store.insert_job(&job).await.map_err(Problem::internal)?;
        // the dispatcher lives as long as the runner; if it is gone, the next start fails the job as interrupted
        let _ = self.0.queue.send(job.id);
        Ok(job)
    }

    /// Gives up a job that has not ended; its computation stops within a second.
    ///
    /// # Errors
    /// [`StoreError::Transition`] where it has ended, [`StoreError::Missing`] where there is none.
    pub async fn dismiss(&self, id: Uuid) -> Result<(), StoreError> {
        self.0.store.dismiss_job(id, clock::now()).await?;
        if let Some(control) = self.running().get(&id) {
            control.cancelled.store(true, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Takes no new jobs, stops the running ones and marks all unfinished ones as interrupted, within `deadline`.
    pub async fn stop(&self, deadline: Duration) {
        self.0.stopping.cancel();
        for control in self.running().values() {
            control.cancelled.store(true, Ordering::Relaxed);
        }
        self.0.tasks.close();
        if tokio::time::timeout(deadline, self.0.tasks.wait()).await.is_err() {
            tracing::warn!("jobs did not stop in time");
        }
        if let Err(error) = self.0.store.fail_interrupted_jobs(&interrupted(), clock::now()).await {
            tracing::error!(%error, "unfinished jobs could not be marked; the next start does it");
        }
    }

    fn running(&self) -> std::sync::MutexGuard<'_, HashMap<Uuid, Arc<Control>>> {
        self.0.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn dispatch(self, mut waiting: mpsc::UnboundedReceiver<Uuid>) {
        let slots = Arc::new(Semaphore::new(self.0.limits.slots));
        loop {
            let next = async {
                let slot = Arc::clone(&slots).acquire_owned().await;
                (slot, waiting.recv().await)
            };
            tokio::select! {
                // a slot that the end of a cancelled job frees must not start another
                biased;
                () = self.0.stopping.cancelled() => return,
                (slot, id) = next => match (slot, id) {
                    (Ok(slot), Some(id)) => {
                        let jobs = self.clone();
                        self.0.tasks.spawn(async move {
                            jobs.run(id).await;
                            drop(slot);
                        });
                    }
                    _ => return,
                },
            }
        }
    }

    async fn run(&self, id: Uuid) {
        let control = Arc::new(Control::default());
        // known before it is started, so that no dismissal falls between the two
        self.running().insert(id, Arc::clone(&control));
        // asked after it is known: whoever stops the runner sees this job, or this job sees that
        if self.0.stopping.is_cancelled() {
            return;
        }
        if let Err(error) = self.run_started(id, control).await {
            match error {
                StoreError::Transition(_) => tracing::info!(job = %id, "dismissed"),
                error => tracing::error!(job = %id, %error, "the end of a job could not be stored"),
            }
        }
        self.running().remove(&id);
    }

    async fn run_started(&self, id: Uuid, control: Arc<Control>) -> Result<(), StoreError> {
        let store = &self.0.store;
        store.start_job(id, clock::now()).await?;
        let job = store.job(id).await?.ok_or(StoreError::Missing)?;
        let process = Process::from_id(&job.process_id)
            .ok_or_else(|| StoreError::Corrupt(format!("job {id} is of no known process")))?;
        tracing::info!(job = %id, process = process.id(), "started");
        let context = Context { job, store: store.clone(), control: Arc::clone(&control), jobs: self.clone() };
        let reports = tokio::spawn(report(store.clone(), id, Arc::clone(&control)));
        let result = process.run(&context).await;
        reports.abort();
        match result {
            Ok(()) => {
                tracing::info!(job = %id, "successful");
                Ok(())
            }
            Err(Failure::Store(error)) => Err(error),
            Err(failure) => {
                let exception = self.exception(&failure);
                tracing::warn!(job = %id, code = exception.code, detail = exception.detail, "failed");
                store.finish_job(id, &Outcome::Failed(exception), clock::now()).await
            }
        }
    }

    fn exception(&self, failure: &Failure) -> Exception {
        if matches!(failure, Failure::Cancelled) && self.0.stopping.is_cancelled() {
            return interrupted();
        }
        Exception { code: Code::JobFailed.slug().into(), detail: failure.to_string() }
    }
}

fn interrupted() -> Exception {
    let detail = "the service ended before the job did; submit it again";
    Exception { code: Code::Interrupted.slug().into(), detail: detail.into() }
}

/// Writes down how far a job is whenever that has changed, until it is aborted.
async fn report(store: Store, id: Uuid, control: Arc<Control>) {
    let mut written = (0, String::new());
    let mut tick = tokio::time::interval(REPORT_EVERY);
    loop {
        tick.tick().await;
        let phase = control.phase.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let now = (control.percent.load(Ordering::Relaxed), phase);
        if now != written {
            match store.report_progress(id, now.0, &now.1, clock::now()).await {
                Ok(()) => written = now,
                Err(error) => tracing::warn!(job = %id, %error, "progress could not be stored"),
            }
        }
    }
}
