//! The server as a whole: from settings to a listening socket, and back to a clean end.

use std::{net::SocketAddr, sync::Arc};

use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use crate::{
    api::{self, AppState, auth},
    config::Config,
    jobs::{Jobs, Limits},
    store::{self, Store},
};

/// Whatever keeps the server from starting or running.
pub type ServerError = Box<dyn std::error::Error + Send + Sync>;

/// A server that listens but does not answer yet.
pub struct Server {
    listener: TcpListener,
    state: AppState,
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
        refuse_open_door(&config, &store).await?;
        let limits = Limits { threads: config.compute_threads, slots: config.job_slots, queue: config.max_queue };
        let listener = TcpListener::bind(config.listen)
            .await
            .map_err(|error| format!("{} cannot be listened on: {error}", config.listen))?;
        let jobs = Jobs::start(store.clone(), limits).await?;
        let state = AppState { store, jobs, config: Arc::new(config), stopping: CancellationToken::new() };
        Ok(Self { listener, state, _lock: lock })
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
        let Self { listener, state, _lock } = self;
        let deadline = state.config.shutdown_timeout;
        let router = api::router(state.clone());
        let drained = CancellationToken::new();
        let begin = {
            let (state, stop) = (state.clone(), stop.clone());
            async move {
                stop.cancelled().await;
                state.stopping.cancel();
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
            // side by side, so that both together keep the deadline; clients that hold a connection open must not hold
            // the process
            let answered = tokio::time::timeout(deadline, drained.cancelled());
            let ((), _) = tokio::join!(state.jobs.stop(deadline), answered);
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
        state.store.close().await;
        tracing::info!("stopped");
        Ok(ended?)
    }
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
