//! The server as a whole: from settings to a listening socket, and back to a clean end.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use tokio::{net::TcpListener, sync::Semaphore};
use tokio_util::sync::CancellationToken;

use crate::{
    api::{self, AppState, auth, metrics::Metrics},
    config::{Config, EngineAddress},
    jobs::{
        Desk, Rules,
        artifacts::Artifacts,
        caretaker::{self, Keep},
        engine::{Engine, local::Local, nats::Nats},
        nats_link::{self, NatsLink},
        worker::{Worker, WorkerOptions},
    },
    store::{self, Store},
};

/// Files of acoustic emission that are read at once: each needs some hundreds of MiB where it is large.
const FILES_AT_ONCE: usize = 2;

/// Whatever keeps the server from starting or running.
pub type ServerError = Box<dyn std::error::Error + Send + Sync>;

/// A server that listens but does not answer yet.
pub struct Server {
    listener: TcpListener,
    state: AppState,
    // in this process, where the engine is the local one
    worker: Option<Worker>,
    // over which workers on other machines ask, where it is not
    questions: Option<async_nats::Client>,
    // held to the end: no second server may work on the same data
    _lock: std::fs::File,
}

impl Server {
    /// Opens the data, takes up the jobs and binds the address.
    ///
    /// # Errors
    /// Where the data directory is in use or not ours, where an address that others can reach has no key, or where the
    /// address cannot be bound.
    pub async fn bind(config: Config) -> Result<Self, ServerError> {
        let lock = store::lock(&config.data_dir)?;
        let store = Store::open(&config.data_dir).await?;
        api::sweep(&config.data_dir)?;
        refuse_open_door(&config, &store).await?;
        let listener = TcpListener::bind(config.listen)
            .await
            .map_err(|error| format!("{} cannot be listened on: {error}", config.listen))?;
        let artifacts = Artifacts::open(&config.artifacts).await?;
        artifacts.claim(store.instance().await?).await?;
        let rules = Rules {
            most_waiting: config.max_queue,
            lease: config.lease,
            runout_memory_bytes: config.runout_memory_bytes,
        };
        let (desk, worker, questions) = match &config.engine {
            EngineAddress::Local => {
                let engine: Arc<dyn Engine> = Arc::new(Local::default());
                let desk = Desk::new(store.clone(), Arc::clone(&engine), artifacts, rules);
                caretaker::take_up(&desk, true).await?;
                let options = WorkerOptions {
                    name: "local".into(),
                    threads: config.compute_threads,
                    slots: config.job_slots,
                    stall: config.stall,
                };
                let worker = Worker::start(engine, Arc::new(desk.clone()), options)?;
                (desk, Some(worker), None)
            }
            EngineAddress::Nats(address) => {
                let engine = Nats::connect(address, config.lease).await?;
                let client = engine.client();
                let desk = Desk::new(store.clone(), Arc::new(engine), artifacts, rules);
                caretaker::take_up(&desk, false).await?;
                (desk, None, Some(client))
            }
        };
        let metrics = Metrics::new()?;
        let state = AppState {
            store,
            desk,
            metrics,
            streams: Arc::new(Semaphore::new(config.max_requests)),
            config: Arc::new(config),
            intake: Arc::new(Semaphore::new(FILES_AT_ONCE)),
            stopping: CancellationToken::new(),
        };
        Ok(Self { listener, state, worker, questions, _lock: lock })
    }

    /// The address that it listens on; with port 0 the system chose one.
    ///
    /// # Errors
    /// Where the system does not say.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// What the handlers work with.
    #[must_use]
    pub const fn state(&self) -> &AppState {
        &self.state
    }

    /// Answers until `stop` is cancelled; then takes no new work, ends the running jobs, answers what is being asked and
    /// closes the database.
    ///
    /// # Errors
    /// Where the socket fails.
    pub async fn run(self, stop: CancellationToken) -> Result<(), ServerError> {
        let Self { listener, state, worker, questions, _lock } = self;
        let keep = Keep { days: state.config.keep_jobs_days, bytes: state.config.keep_jobs_bytes };
        let caretaker = tokio::spawn(caretaker::run(state.desk.clone(), keep, stop.clone()));
        tokio::spawn(state.metrics.clone().upkeep(stop.clone()));
        if let Some(client) = questions {
            tokio::spawn(answer_workers(client, state.desk.clone(), stop.clone()));
        }
        let deadline = state.config.shutdown_timeout;
        let router = api::router(state.clone());
        let drained = CancellationToken::new();
        let begin = {
            let (state, stop) = (state.clone(), stop.clone());
            async move {
                stop.cancelled().await;
                state.stopping.cancel();
                // not ready, and still there to say so
                tokio::time::sleep(state.config.grace.min(deadline / 2)).await;
            }
        };
        let serve = axum::serve(listener, router).with_graceful_shutdown(begin);
        let serve = async {
            let result = serve.await;
            drained.cancel();
            result
        };
        let give_up = async {
            stop.cancelled().await;
            state.desk.close();
            // side by side, so that both together keep the deadline; clients that hold a connection open must not hold
            // the process
            let answered = tokio::time::timeout(deadline, drained.cancelled());
            let work = async {
                if let Some(worker) = &worker {
                    worker.stop(deadline).await;
                }
            };
            let ((), _) = tokio::join!(work, answered);
        };
        tokio::pin!(give_up);
        let mut ended = Ok(());
        tokio::select! {
            result = serve => {
                // also where the socket failed: what runs is ended and written down before that is told
                stop.cancel();
                give_up.await;
                ended = result;
            }
            () = &mut give_up => tracing::warn!("open connections were cut"),
        }
        // it ends with the same token, unless an engine that does not answer holds it up
        let _ = tokio::time::timeout(deadline, caretaker).await;
        state.store.close().await;
        tracing::info!("stopped");
        Ok(ended?)
    }
}

/// Answers workers on other machines as long as the server lives, whatever becomes of the connection.
async fn answer_workers(client: async_nats::Client, desk: Desk, stop: CancellationToken) {
    while !stop.is_cancelled() {
        if let Err(error) = nats_link::serve(client.clone(), desk.clone(), stop.clone()).await {
            tracing::error!(%error, "workers are not heard; trying again");
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }
}

/// Takes jobs of the desk behind a NATS server until `stop`: what `firn worker` does.
///
/// # Errors
/// Where the NATS server does not answer, the system gives no threads, or the desk is of another version.
pub async fn work(
    address: &str,
    options: WorkerOptions,
    deadline: Duration,
    stop: CancellationToken,
) -> Result<(), ServerError> {
    let engine = Arc::new(Nats::connect_to_work(address).await?);
    let link = NatsLink::new(engine.client());
    let worker = Worker::start(Arc::clone(&engine) as Arc<dyn Engine>, Arc::new(link), options)?;
    let fit = tokio::select! {
        () = stop.cancelled() => true,
        () = worker.unfit() => false,
    };
    worker.stop(deadline).await;
    // the tickets that it gave back are on their way
    engine.flush().await;
    tracing::info!(fenced = worker.fenced_results(), "stopped");
    if fit { Ok(()) } else { Err("the server is of another version of firn: workers must be of the same".into()) }
}

/// An address that others can reach needs a key, or the operator's word that it does not.
async fn refuse_open_door(config: &Config, store: &Store) -> Result<(), ServerError> {
    if !auth::keys_needed(config) {
        return Ok(());
    }
    let now = crate::clock::now();
    if store.keys().await?.iter().any(|key| key.is_valid(now)) {
        return Ok(());
    }
    Err(format!(
        "{} can be reached from other machines and there is no key yet: make one with `firn key create --data-dir {} \
         --name NAME --role ROLE`, or start with --allow-anonymous to let everybody read and write",
        config.listen,
        config.data_dir.display()
    )
    .into())
}
