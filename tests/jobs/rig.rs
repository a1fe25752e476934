//! A desk, an engine and a link to it in this process: what the contract is tried on.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use firn::{
    domain::job::{Job, Labels, Priority, Report, Spent, Wanted},
    jobs::{
        Desk, Rules, Submission, Submitted,
        artifacts::Artifacts,
        caretaker::{self, Keep},
        engine::{Boxed, Engine, local::Local, nats::Nats},
        link::{Assignment, Delivery, JobLink, LinkError, LogLine, Output, Verdict},
        nats_link::{self, NatsLink},
        processes::{Failure, Process},
        worker::{Worker, WorkerOptions},
    },
    science::progress::Progress,
    store::{
        Store,
        jobs::{Answer, JobFilter},
    },
};
use serde_json::Value;
use tempfile::TempDir;
use tokio::sync::Notify;
use tokio_util::sync::{CancellationToken, DropGuard};
use uuid::Uuid;

use crate::{
    processes::{NatsServer, PATIENCE},
    support::app::data_dir,
};

pub struct Rig {
    pub store: Store,
    pub desk: Desk,
    pub engine: Arc<dyn Engine>,
    pub link: Arc<dyn JobLink>,
    /// How long a computation may make no step.
    pub stall: Duration,
    state_begun: Arc<Notify>,
    _stop: DropGuard,
    _data: TempDir,
    _nats: Option<NatsServer>,
}

impl Rig {
    /// Over the embedded engine.
    pub async fn local(lease: Duration) -> Self {
        let engine: Arc<dyn Engine> = Arc::new(Local::default());
        let (store, desk, data) = desk(&engine, lease).await;
        let stop = CancellationToken::new();
        let link: Arc<dyn JobLink> = Arc::new(desk.clone());
        Self::over(store, desk, engine, link, stop, data, None)
    }

    /// Over a NATS server of its own; none where the machine has none.
    pub async fn nats(lease: Duration) -> Option<Self> {
        let server = NatsServer::start()?;
        let nats = Nats::connect(&server.url(), lease).await.expect("the server answers");
        let client = nats.client();
        let engine: Arc<dyn Engine> = Arc::new(nats);
        let (store, desk, data) = desk(&engine, lease).await;
        let stop = CancellationToken::new();
        tokio::spawn(nats_link::serve(client.clone(), desk.clone(), stop.clone()));
        let link: Arc<dyn JobLink> = Arc::new(NatsLink::new(client));
        Some(Self::over(store, desk, engine, link, stop, data, Some(server)))
    }

    fn over(
        store: Store,
        desk: Desk,
        engine: Arc<dyn Engine>,
        link: Arc<dyn JobLink>,
        stop: CancellationToken,
        data: TempDir,
        nats: Option<NatsServer>,
    ) -> Self {
        let keep = Keep { days: 1, bytes: u64::MAX };
        tokio::spawn(caretaker::run(desk.clone(), keep, stop.clone()));
        Self {
            store,
            desk,
            engine,
            link,
            stall: PATIENCE,
            state_begun: Arc::default(),
            _stop: stop.drop_guard(),
            _data: data,
            _nats: nats,
        }
    }

    /// Has an echo accepted.
    pub async fn submit(&self, inputs: Value, priority: u8) -> Uuid {
        let submission = Submission {
            process: Process::Echo,
            inputs,
            labels: Labels::new(),
            wanted: Wanted::default(),
            priority: Priority::try_from(priority).unwrap(),
            submitted_by: None,
            anew: false,
            reservation: None,
        };
        let render = |job: &Job, _: bool| Answer { location: String::new(), body: job.id.to_string().into() };
        match self.desk.submit(submission, render).await.expect("it is accepted") {
            Submitted::New(answer) => answer.body.as_str().unwrap().parse().unwrap(),
            other => panic!("{other:?}"),
        }
    }

    /// The same with states that take so long to be stored.
    pub fn slow_states(&mut self, delay: Duration) {
        let (link, begun) = (Arc::clone(&self.link), Arc::clone(&self.state_begun));
        self.link = Arc::new(Between { link, delay, begun, newer_desk: false });
    }

    /// As if the desk were of another version than the workers.
    pub fn newer_desk(&mut self) {
        let (link, begun) = (Arc::clone(&self.link), Arc::clone(&self.state_begun));
        self.link = Arc::new(Between { link, delay: Duration::ZERO, begun, newer_desk: true });
    }

    /// Waits until a slow state is on its way.
    pub async fn state_on_its_way(&self) {
        tokio::time::timeout(PATIENCE, self.state_begun.notified()).await.expect("a state is saved");
    }

    /// A worker beside the desk that computes otherwise.
    pub fn worker_with(
        &self,
        name: &str,
        slots: usize,
        compute: impl Fn(Process, &[u8], &dyn Progress) -> Result<Output, Failure> + Send + Sync + 'static,
    ) -> Worker {
        let options = WorkerOptions { name: name.into(), threads: 1, slots, stall: self.stall };
        let (engine, link) = (Arc::clone(&self.engine), Arc::clone(&self.link));
        Worker::start_with(engine, link, Arc::new(compute), options).expect("threads")
    }

    /// A worker beside the desk.
    pub fn worker(&self, name: &str, slots: usize) -> Worker {
        let options = WorkerOptions { name: name.into(), threads: 1, slots, stall: self.stall };
        Worker::start(Arc::clone(&self.engine), Arc::clone(&self.link), options).expect("threads")
    }

    pub async fn job(&self, id: Uuid) -> Job {
        self.store.job(id).await.unwrap().expect("the job is there")
    }

    /// Every job, oldest first.
    pub async fn jobs(&self) -> Vec<Job> {
        let mut jobs = self.store.jobs(&JobFilter::default(), firn::clock::now(), 10_000).await.unwrap();
        jobs.reverse();
        jobs
    }

    /// Looks at a job until it is as wanted.
    pub async fn until(&self, id: Uuid, wanted: impl Fn(&Job) -> bool) -> Job {
        let since = Instant::now();
        loop {
            let job = self.job(id).await;
            if wanted(&job) {
                return job;
            }
            assert!(since.elapsed() < PATIENCE, "waited too long for {job:?}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    pub async fn ended(&self, id: Uuid) -> Job {
        self.until(id, |job| job.status.ended()).await
    }
}

async fn desk(engine: &Arc<dyn Engine>, lease: Duration) -> (Store, Desk, TempDir) {
    let data = data_dir();
    let store = Store::open(data.path()).await.expect("the store opens");
    let artifacts = Artifacts::folder(&data.path().join("artifacts")).expect("a folder");
    let desk = Desk::new(
        store.clone(),
        Arc::clone(engine),
        artifacts,
        Rules { most_waiting: 10_000, lease, runout_memory_bytes: 2 << 30 },
    );
    (store, desk, data)
}

/// A link over which states take their time, or behind which there is a desk of another version.
struct Between {
    link: Arc<dyn JobLink>,
    delay: Duration,
    begun: Arc<Notify>,
    newer_desk: bool,
}

impl JobLink for Between {
    fn claim<'a>(&'a self, job: Uuid, worker: &'a str) -> Boxed<'a, Result<Assignment, LinkError>> {
        if self.newer_desk {
            return Box::pin(async { Ok(Assignment::OtherVersion { desk: "99.0.0".into() }) });
        }
        self.link.claim(job, worker)
    }

    fn beat<'a>(&'a self, job: Uuid, attempt: u32, report: &'a Report) -> Boxed<'a, Result<Verdict, LinkError>> {
        self.link.beat(job, attempt, report)
    }

    fn log<'a>(&'a self, job: Uuid, attempt: u32, lines: &'a [LogLine]) -> Boxed<'a, Result<(), LinkError>> {
        self.link.log(job, attempt, lines)
    }

    fn checkpoint<'a>(&'a self, job: Uuid, attempt: u32, bytes: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(async move {
            self.begun.notify_one();
            tokio::time::sleep(self.delay).await;
            self.link.checkpoint(job, attempt, bytes).await
        })
    }

    fn keep<'a>(&'a self, job: Uuid, attempt: u32, piece: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>> {
        self.link.keep(job, attempt, piece)
    }

    fn release(&self, job: Uuid, attempt: u32, spent: Spent) -> Boxed<'_, Result<Verdict, LinkError>> {
        self.link.release(job, attempt, spent)
    }

    fn finish<'a>(
        &'a self,
        job: Uuid,
        attempt: u32,
        delivery: &'a Delivery,
        spent: Spent,
    ) -> Boxed<'a, Result<Verdict, LinkError>> {
        self.link.finish(job, attempt, delivery, spent)
    }
}
