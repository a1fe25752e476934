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

use firn_science::progress::Progress;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use tokio::sync::oneshot;
use tokio_util::{sync::CancellationToken, task::TaskTracker};
use uuid::Uuid;

use super::{
    control::{Control, Unstored},
    engine::{Engine, Lease},
    link::{Assignment, Delivery, JobLink, LinkError, Output, Verdict},
    processes::{Failure, Process},
};
use crate::domain::{
    job::{Exception, Job, Spent},
    problem::Code,
};

/// How often a worker gives a sign of life, and so the longest that a dismissal goes unnoticed.
const BEAT: Duration = Duration::from_millis(250);

/// The longest time between two signs of life that counts as silence of the computation: where it is longer, the worker
/// itself was frozen.
const LONGEST_BEAT: Duration = Duration::from_secs(1);

/// How long a worker waits before it asks an engine or a desk again that did not answer.
const RETRY: Duration = Duration::from_millis(500);

/// A ticket of a job that another worker has comes back not sooner than this.
const SOON: Duration = Duration::from_millis(50);

/// Where a worker computes and how much at once.
#[derive(Clone, Debug)]
pub struct WorkerOptions {
    /// What it is called in the record of its jobs.
    pub name: String,
    /// Threads that one job computes with.
    pub threads: usize,
    /// Jobs at once, each on a pool of its own: on a shared one a job could wait for, or lie buried under, another.
    pub slots: usize,
    /// An attempt whose computation makes no step for so long is failed.
    pub stall: Duration,
}

/// A worker; clones share it.
#[derive(Clone)]
pub struct Worker(Arc<Inner>);

struct Inner {
    engine: Arc<dyn Engine>,
    link: Arc<dyn JobLink>,
    compute: Arc<Compute>,
    options: WorkerOptions,
    running: Mutex<Vec<(Uuid, Arc<Control>)>>,
    stopping: CancellationToken,
    unfit: CancellationToken,
    tasks: TaskTracker,
    fenced: AtomicU64,
}

/// Computes a job from its process and payload.
pub type Compute = dyn Fn(Process, &[u8], &dyn Progress) -> Result<Output, Failure> + Send + Sync;

type Computed = Result<Result<Output, Failure>, Box<dyn std::any::Any + Send>>;

/// Which attempt at which job, and how long its worker may be silent.
#[derive(Clone, Copy)]
struct Attempt {
    id: Uuid,
    number: u32,
    lease: Duration,
}

/// Whether the threads of a slot can compute the next job.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Threads {
    Free,
    Lost,
}

/// How an attempt came to its end in this worker.
enum End {
    Computed(Computed),
    /// The computation made no step; it may still hold its threads.
    Stalled,
}

impl Worker {
    /// Starts to work.
    ///
    /// # Errors
    /// Where the system gives no threads.
    pub fn start(
        engine: Arc<dyn Engine>,
        link: Arc<dyn JobLink>,
        options: WorkerOptions,
    ) -> Result<Self, ThreadPoolBuildError> {
        Self::start_with(engine, link, Arc::new(Process::compute), options)
    }

    /// Starts to work with computations of the caller's instead of the processes' own.
    ///
    /// # Errors
    /// Where the system gives no threads.
    pub fn start_with(
        engine: Arc<dyn Engine>,
        link: Arc<dyn JobLink>,
        compute: Arc<Compute>,
        options: WorkerOptions,
    ) -> Result<Self, ThreadPoolBuildError> {
        let pools = (0..options.slots).map(|_| pool(options.threads)).collect::<Result<Vec<_>, _>>()?;
        let worker = Self(Arc::new(Inner {
            engine,
            link,
            compute,
            options,
            running: Mutex::default(),
            stopping: CancellationToken::new(),
            unfit: CancellationToken::new(),
            tasks: TaskTracker::new(),
            fenced: AtomicU64::new(0),
        }));
        for pool in pools {
            worker.0.tasks.spawn(worker.clone().slot(pool));
        }
        Ok(worker)
    }

    /// Results that came too late to count.
    #[must_use]
    pub fn fenced_results(&self) -> u64 {
        self.0.fenced.load(Ordering::Relaxed)
    }

    /// Waits until the desk turns this worker away, since it is of another version.
    pub async fn unfit(&self) {
        self.0.unfit.cancelled().await;
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

    async fn slot(self, mut threads: ThreadPool) {
        loop {
            let next = tokio::select! {
                // a slot that the end of a paused job frees must not take another
                biased;
                () = self.0.stopping.cancelled() => return,
                next = self.0.engine.next() => next,
            };
            match next {
                Ok(lease) => {
                    if self.serve(lease, &threads).await == Threads::Lost {
                        match pool(self.0.options.threads) {
                            Ok(others) => threads = others,
                            Err(error) => {
                                tracing::error!(%error, "no threads in place of those that a stalled job holds");
                                return;
                            }
                        }
                    }
                }
                Err(error) => {
                    tracing::warn!(%error, "no tickets");
                    tokio::time::sleep(RETRY).await;
                }
            }
        }
    }

    async fn serve(&self, lease: Box<dyn Lease>, threads: &ThreadPool) -> Threads {
        let ticket = lease.ticket();
        match self.0.link.claim(ticket.job, &self.0.options.name).await {
            Ok(Assignment::Taken { job, payload, checkpoint, lease_ms }) => {
                let attempt = Attempt { id: job.id, number: job.attempt, lease: Duration::from_millis(lease_ms) };
                tracing::info!(
                    job = %job.id, process = job.process_id, attempt = job.attempt, resumed = checkpoint.is_some(),
                    "started"
                );
                let control = Arc::new(Control::new(checkpoint));
                let computed = self.compute(threads, &job, payload, &control);
                return self.attempt(lease, attempt, &control, computed).await;
            }
            Ok(Assignment::Busy { retry_ms }) => lease.put_back(Duration::from_millis(retry_ms).max(SOON)).await,
            Ok(Assignment::Over) => lease.done().await,
            Ok(Assignment::OtherVersion { desk }) => {
                let own = env!("CARGO_PKG_VERSION");
                tracing::error!(desk, own, "the server is of another version: no more jobs are taken");
                self.0.unfit.cancel();
                self.0.stopping.cancel();
                lease.put_back(Duration::ZERO).await;
            }
            Err(error) => {
                tracing::warn!(job = %ticket.job, %error, "a job could not be claimed");
                lease.put_back(RETRY).await;
            }
        }
        Threads::Free
    }

    /// Runs the process of a job on the threads of its slot.
    fn compute(
        &self,
        threads: &ThreadPool,
        job: &Job,
        payload: Vec<u8>,
        control: &Arc<Control>,
    ) -> oneshot::Receiver<Computed> {
        let (send, receive) = oneshot::channel();
        let (compute, control) = (Arc::clone(&self.0.compute), Arc::clone(control));
        let process = Process::from_id(&job.process_id);
        threads.spawn(move || {
            let work = || match process {
                Some(process) => compute(process, &payload, control.as_ref()),
                None => Err(Failure::Science("this worker does not know the process: it is of another version".into())),
            };
            // the taker is gone only where the worker is going down or has given the computation up
            let _ = send.send(catch_unwind(AssertUnwindSafe(work)));
        });
        receive
    }

    async fn attempt(
        &self,
        lease: Box<dyn Lease>,
        attempt: Attempt,
        control: &Arc<Control>,
        computed: oneshot::Receiver<Computed>,
    ) -> Threads {
        let id = attempt.id;
        self.running().push((id, Arc::clone(control)));
        if self.0.stopping.is_cancelled() {
            control.pause();
        }
        // the computation ends the other two, which never end by themselves but where it stalls
        let end = tokio::select! {
            biased;
            result = computed => End::Computed(result.unwrap_or_else(|_| Err(Box::new("the pool is gone")))),
            () = self.beats(&*lease, attempt, control) => End::Stalled,
            () = self.stores(attempt, control) => End::Stalled,
        };
        self.running().retain(|(running, held)| *running != id || !Arc::ptr_eq(held, control));

        if control.is_pausing() {
            self.store_last(attempt, control).await;
        }
        let spent = control.spent();
        let (delivery, threads) = match end {
            End::Computed(Ok(Ok(output))) => {
                // what the output names must be there before it
                if !self.store_pieces(&*lease, attempt, control).await {
                    lease.put_back(Duration::ZERO).await;
                    return Threads::Free;
                }
                (Delivery::Finished(output), Threads::Free)
            }
            End::Computed(Ok(Err(Failure::Cancelled))) => {
                self.give_back(lease, attempt, spent, control.is_pausing()).await;
                return Threads::Free;
            }
            End::Computed(Ok(Err(failure))) => {
                (Delivery::Failed(failed(Code::JobFailed, failure.to_string())), Threads::Free)
            }
            End::Computed(Err(panic)) => {
                tracing::error!(job = %id, panic = panic_text(&*panic), "a computation panicked");
                (Delivery::Failed(failed(Code::JobFailed, "the computation panicked".to_owned())), Threads::Free)
            }
            End::Stalled => {
                control.cancel();
                let detail = format!("the computation made no step for {} s", self.0.options.stall.as_secs());
                tracing::error!(job = %id, detail, "a job is given up; its threads are lost until they end by themselves");
                (Delivery::Failed(failed(Code::Stalled, detail)), Threads::Lost)
            }
        };
        self.deliver(&*lease, attempt, &delivery, spent).await;
        lease.done().await;
        threads
    }

    /// Keeps an attempt alive, and ends its computation where it counts no more; returns where that makes no step.
    async fn beats(&self, lease: &dyn Lease, attempt: Attempt, control: &Control) {
        let mut tick = tokio::time::interval(BEAT);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let (mut extended, mut looked, mut silent) = (Instant::now(), Instant::now(), Duration::ZERO);
        // the first tick is at once; a job of a few milliseconds needs no heartbeat
        tick.tick().await;
        loop {
            tick.tick().await;
            silent = if control.has_stepped() { Duration::ZERO } else { silent + looked.elapsed().min(LONGEST_BEAT) };
            looked = Instant::now();
            if silent >= self.0.options.stall {
                return;
            }
            if extended.elapsed() >= attempt.lease / 3 {
                if let Err(error) = lease.extend().await {
                    tracing::warn!(job = %attempt.id, %error, "a lease could not be extended");
                }
                extended = Instant::now();
            }
            let beat = self.0.link.beat(attempt.id, attempt.number, &control.report()).await;
            stop_where_fenced(control, beat, attempt.id);
        }
    }

    /// Stores each piece and each state as soon as it is there, beside the heartbeat: a large one takes its time.
    async fn stores(&self, attempt: Attempt, control: &Control) {
        loop {
            let next = control.next_unstored().await;
            let stored = self.store(attempt, control, &next).await;
            if stored.is_err() {
                // it is not given up: the next try takes this piece, or this state or a newer one
                tokio::time::sleep(RETRY).await;
            }
            stop_where_fenced(control, stored, attempt.id);
        }
    }

    async fn store(&self, attempt: Attempt, control: &Control, next: &Unstored) -> Result<Verdict, LinkError> {
        let begun = Instant::now();
        match next {
            Unstored::Piece(piece) => {
                let verdict = self.0.link.keep(attempt.id, attempt.number, piece).await?;
                control.kept(piece);
                Ok(verdict)
            }
            Unstored::State(bytes) => {
                let verdict = self.0.link.checkpoint(attempt.id, attempt.number, bytes).await?;
                control.stored(bytes, begun.elapsed());
                Ok(verdict)
            }
        }
    }

    /// The last state of an attempt that is given back, after the pieces that it names. Where that fails, the state before
    /// counts: some work is done twice, none is lost.
    async fn store_last(&self, attempt: Attempt, control: &Control) {
        while let Some(piece) = control.piece() {
            if self.store(attempt, control, &Unstored::Piece(piece)).await.is_err() {
                return;
            }
        }
        if let Some(bytes) = control.unsaved() {
            let _ = self.store(attempt, control, &Unstored::State(bytes)).await;
        }
    }

    /// Stores the pieces that are left, however often that takes; false where the worker ends before.
    async fn store_pieces(&self, lease: &dyn Lease, attempt: Attempt, control: &Control) -> bool {
        while let Some(piece) = control.piece() {
            if let Err(error) = self.store(attempt, control, &Unstored::Piece(piece)).await {
                tracing::warn!(job = %attempt.id, %error, "a piece of a result could not be stored; trying again");
                if self.0.stopping.is_cancelled() {
                    return false;
                }
                tokio::time::sleep(RETRY).await;
                let _ = lease.extend().await;
            }
        }
        true
    }

    /// The end of an attempt that was asked to stop: given back where the worker stops, of no more use where the job was
    /// dismissed or taken over.
    async fn give_back(&self, lease: Box<dyn Lease>, attempt: Attempt, spent: Spent, pausing: bool) {
        if !pausing {
            tracing::info!(job = %attempt.id, attempt = attempt.number, "stopped: the attempt counts no more");
            lease.done().await;
            return;
        }
        if let Err(error) = self.0.link.release(attempt.id, attempt.number, spent).await {
            tracing::warn!(job = %attempt.id, %error, "a job could not be given back; it is taken up when its lease ends");
        }
        lease.put_back(Duration::ZERO).await;
    }

    /// Delivers until the desk has answered: a result is not thrown away because a connection was.
    async fn deliver(&self, lease: &dyn Lease, attempt: Attempt, delivery: &Delivery, spent: Spent) {
        let id = attempt.id;
        loop {
            match self.0.link.finish(id, attempt.number, delivery, spent).await {
                Ok(Verdict::Counts) => {
                    tracing::info!(job = %id, attempt = attempt.number, compute_ms = spent.compute_ms, "delivered");
                    return;
                }
                Ok(Verdict::Fenced) => {
                    self.0.fenced.fetch_add(1, Ordering::Relaxed);
                    tracing::warn!(job = %id, attempt = attempt.number, "the result came too late and was refused");
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

/// The threads of one slot.
fn pool(threads: usize) -> Result<ThreadPool, ThreadPoolBuildError> {
    ThreadPoolBuilder::new().num_threads(threads).thread_name(|index| format!("firn-compute-{index}")).build()
}

fn stop_where_fenced(control: &Control, verdict: Result<Verdict, LinkError>, job: Uuid) {
    match verdict {
        Ok(Verdict::Counts) => {}
        Ok(Verdict::Fenced) => control.cancel(),
        Err(error) => tracing::warn!(%job, %error, "no answer to a sign of life"),
    }
}

fn failed(code: Code, detail: String) -> Exception {
    Exception { code: code.slug().into(), detail }
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("?")
}
