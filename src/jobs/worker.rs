//! Takes tickets one a free slot, claims their jobs, computes them on a pool of its own and delivers. It holds no state
//! that matters: killed at any instant, another worker goes on from the last checkpoint.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use tokio::sync::oneshot;
use tokio_util::{sync::CancellationToken, task::TaskTracker};
use uuid::Uuid;

use super::{
    control::Control,
    engine::{Engine, Lease},
    link::{Assignment, Delivery, JobLink, LinkError, Output, Verdict},
    processes::{Failure, Process},
};
use crate::domain::{
    job::{Exception, Job},
    problem::Code,
};

/// How often a worker gives a sign of life, and so the longest that a dismissal goes unnoticed.
const BEAT: Duration = Duration::from_millis(250);

/// How long a worker waits before it asks an engine or a desk again that did not answer.
const RETRY: Duration = Duration::from_millis(500);

/// Where a worker computes and how much at once.
#[derive(Clone, Debug)]
pub struct WorkerOptions {
    /// What it is called in the record of its jobs.
    pub name: String,
    /// Threads of the compute pool.
    pub threads: usize,
    /// Jobs at once; they share the threads.
    pub slots: usize,
}

/// A worker; clones share it.
#[derive(Clone)]
pub struct Worker(Arc<Inner>);

struct Inner {
    engine: Arc<dyn Engine>,
    link: Arc<dyn JobLink>,
    pool: rayon::ThreadPool,
    options: WorkerOptions,
    running: Mutex<Vec<(Uuid, Arc<Control>)>>,
    stopping: CancellationToken,
    tasks: TaskTracker,
    fenced: AtomicU64,
}

type Computed = Result<Result<Output, Failure>, Box<dyn std::any::Any + Send>>;

impl Worker {
    /// Starts to work.
    ///
    /// # Errors
    /// Where the system gives no threads.
    pub fn start(
        engine: Arc<dyn Engine>,
        link: Arc<dyn JobLink>,
        options: WorkerOptions,
    ) -> Result<Self, rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(options.threads)
            .thread_name(|index| format!("firn-compute-{index}"))
            .build()?;
        let slots = options.slots;
        let worker = Self(Arc::new(Inner {
            engine,
            link,
            pool,
            options,
            running: Mutex::default(),
            stopping: CancellationToken::new(),
            tasks: TaskTracker::new(),
            fenced: AtomicU64::new(0),
        }));
        for _ in 0..slots {
            worker.0.tasks.spawn(worker.clone().slot());
        }
        Ok(worker)
    }

    /// Results that came too late to count.
    #[must_use]
    pub fn fenced_results(&self) -> u64 {
        self.0.fenced.load(Ordering::Relaxed)
    }

    /// Takes no more tickets, lets what runs save its state and gives it back, within `deadline`.
    pub async fn stop(&self, deadline: Duration) {
        self.0.stopping.cancel();
        self.0.tasks.close();
        for (_, control) in self.running().iter() {
            control.pause();
        }
        // half of the time for a last checkpoint, then no more waiting for one
        if tokio::time::timeout(deadline / 2, self.0.tasks.wait()).await.is_err() {
            for (_, control) in self.running().iter() {
                control.cancel();
            }
            if tokio::time::timeout(deadline / 2, self.0.tasks.wait()).await.is_err() {
                tracing::warn!("computations did not stop in time; they go on from their last checkpoint elsewhere");
            }
        }
    }

    fn running(&self) -> std::sync::MutexGuard<'_, Vec<(Uuid, Arc<Control>)>> {
        self.0.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn slot(self) {
        loop {
            let next = tokio::select! {
                // a slot that the end of a paused job frees must not take another
                biased;
                () = self.0.stopping.cancelled() => return,
                next = self.0.engine.next() => next,
            };
            match next {
                Ok(lease) => self.serve(lease).await,
                Err(error) => {
                    tracing::warn!(%error, "no tickets");
                    tokio::time::sleep(RETRY).await;
                }
            }
        }
    }

    async fn serve(&self, lease: Box<dyn Lease>) {
        let ticket = lease.ticket();
        match self.0.link.claim(ticket.job, &self.0.options.name).await {
            Ok(Assignment::Taken { job, payload, checkpoint }) => self.attempt(lease, *job, payload, checkpoint).await,
            Ok(Assignment::Busy) => lease.put_back(self.0.engine.lease() / 3).await,
            Ok(Assignment::Over) => lease.done().await,
            Err(error) => {
                tracing::warn!(job = %ticket.job, %error, "a job could not be claimed");
                lease.put_back(RETRY).await;
            }
        }
    }

    async fn attempt(&self, lease: Box<dyn Lease>, job: Job, payload: Vec<u8>, checkpoint: Option<Vec<u8>>) {
        let (id, attempt) = (job.id, job.attempt);
        tracing::info!(job = %id, process = job.process_id, attempt, resumed = checkpoint.is_some(), "started");
        let control = Arc::new(Control::new(checkpoint));
        self.running().push((id, Arc::clone(&control)));
        if self.0.stopping.is_cancelled() {
            control.pause();
        }
        let begun = Instant::now();
        let computed = self.compute(&job, payload, &control);
        let result = self.watch(&*lease, &job, &control, computed).await;
        let compute_ms = u64::try_from(begun.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.running().retain(|(running, held)| *running != id || !Arc::ptr_eq(held, &control));

        if let Some(bytes) = control.take_unsaved()
            && control.is_pausing()
        {
            // where it fails, the checkpoint before counts: some work is done twice, none is lost
            let _ = self.0.link.checkpoint(id, attempt, &bytes).await;
        }
        let delivery = match result {
            Ok(Ok(output)) => Delivery::Finished(output),
            Ok(Err(Failure::Cancelled)) => {
                self.give_back(lease, id, attempt, compute_ms, control.is_pausing()).await;
                return;
            }
            Ok(Err(failure)) => Delivery::Failed(failed(failure.to_string())),
            Err(panic) => {
                tracing::error!(job = %id, panic = panic_text(&*panic), "a computation panicked");
                Delivery::Failed(failed("the computation panicked".to_owned()))
            }
        };
        self.deliver(&*lease, id, attempt, &delivery, compute_ms).await;
        lease.done().await;
    }

    /// Runs the process on the compute pool.
    fn compute(&self, job: &Job, payload: Vec<u8>, control: &Arc<Control>) -> oneshot::Receiver<Computed> {
        let (send, receive) = oneshot::channel();
        let control = Arc::clone(control);
        let process = Process::from_id(&job.process_id);
        self.0.pool.spawn(move || {
            let work = || match process {
                Some(process) => process.compute(&payload, control.as_ref()),
                None => Err(Failure::Science("this worker does not know the process: it is of another version".into())),
            };
            // the taker is gone only where the worker is going down
            let _ = send.send(catch_unwind(AssertUnwindSafe(work)));
        });
        receive
    }

    /// Keeps an attempt alive until it ends, and ends it where it counts no more.
    async fn watch(
        &self,
        lease: &dyn Lease,
        job: &Job,
        control: &Arc<Control>,
        mut computed: oneshot::Receiver<Computed>,
    ) -> Computed {
        let mut tick = tokio::time::interval(BEAT);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let extend_every = self.0.engine.lease() / 3;
        let mut extended = Instant::now();
        // the first tick is at once; a job of a few milliseconds needs no heartbeat
        tick.tick().await;
        loop {
            tokio::select! {
                biased;
                result = &mut computed => {
                    return result.unwrap_or_else(|_| Err(Box::new("the pool is gone")));
                }
                _ = tick.tick() => {}
            }
            if extended.elapsed() >= extend_every {
                if let Err(error) = lease.extend().await {
                    tracing::warn!(job = %job.id, %error, "a lease could not be extended");
                }
                extended = Instant::now();
            }
            let beat = self.0.link.beat(job.id, job.attempt, &control.report()).await;
            stop_where_fenced(control, beat, job.id);
            if let Some(bytes) = control.take_unsaved() {
                let saved = self.0.link.checkpoint(job.id, job.attempt, &bytes).await;
                stop_where_fenced(control, saved, job.id);
            }
        }
    }

    /// The end of an attempt that was asked to stop: given back where the worker stops, of no more use where the job was
    /// dismissed or taken over.
    async fn give_back(&self, lease: Box<dyn Lease>, id: Uuid, attempt: u32, compute_ms: u64, pausing: bool) {
        if !pausing {
            tracing::info!(job = %id, attempt, "stopped: the attempt counts no more");
            lease.done().await;
            return;
        }
        if let Err(error) = self.0.link.release(id, attempt, compute_ms).await {
            tracing::warn!(job = %id, %error, "a job could not be given back; it is taken up when its lease ends");
        }
        lease.put_back(Duration::ZERO).await;
    }

    /// Delivers until the desk has answered: a result is not thrown away because a connection was.
    async fn deliver(&self, lease: &dyn Lease, id: Uuid, attempt: u32, delivery: &Delivery, compute_ms: u64) {
        loop {
            match self.0.link.finish(id, attempt, delivery, compute_ms).await {
                Ok(Verdict::Counts) => {
                    tracing::info!(job = %id, attempt, compute_ms, "delivered");
                    return;
                }
                Ok(Verdict::Fenced) => {
                    self.0.fenced.fetch_add(1, Ordering::Relaxed);
                    tracing::warn!(job = %id, attempt, "the result came too late and was refused");
                    return;
                }
                Err(error) if self.0.stopping.is_cancelled() => {
                    tracing::warn!(job = %id, %error, "a result could not be delivered before the end");
                    return;
                }
                Err(error) => {
                    tracing::warn!(job = %id, %error, "a result could not be delivered; trying again");
                    tokio::time::sleep(RETRY).await;
                    // nobody else shall compute it meanwhile; whether that could be said does not matter
                    let _ = lease.extend().await;
                }
            }
        }
    }
}

fn stop_where_fenced(control: &Control, verdict: Result<Verdict, LinkError>, job: Uuid) {
    match verdict {
        Ok(Verdict::Counts) => {}
        Ok(Verdict::Fenced) => control.cancel(),
        Err(error) => tracing::warn!(%job, %error, "no answer to a sign of life"),
    }
}

fn failed(detail: String) -> Exception {
    Exception { code: Code::JobFailed.slug().into(), detail }
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("?")
}
