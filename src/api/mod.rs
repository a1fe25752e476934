//! HTTP: one file a resource, each with its parameters, request, response and handlers; [`router`] lists them all.

mod active_models;
mod audit;
pub mod auth;
mod avalanches;
mod bulletins;
mod dataset_hits;
mod datasets;
mod docs;
pub(crate) mod extract;
mod feature_sets;
mod forecasts;
mod health;
mod imports;
mod issued;
mod job_frames;
mod job_history;
mod job_results;
mod jobs;
mod landing;
pub mod metrics;
mod models;
mod observations;
pub mod openapi;
mod overview;
pub mod problem;
mod processes;
mod proposals;
mod region_forecasts;
mod regions;
mod respond;
mod router;
mod scenarios;
mod selections;
mod speaker;
mod spool;
pub(crate) mod stations;
mod transfers;
mod verification;
mod what_if;

use std::sync::Arc;

pub use router::{document, router};
pub use spool::sweep;

use crate::{
    config::Config,
    domain::problem::{Code, Problem},
    jobs::Desk,
    store::Store,
};

/// What every handler may use.
#[derive(Clone)]
pub struct AppState {
    /// Observations, models and jobs.
    pub store: Store,
    /// Where jobs are accepted and looked after.
    pub desk: Desk,
    /// What is counted for whoever watches the service.
    pub metrics: metrics::Metrics,
    /// The settings in force.
    pub config: Arc<Config>,
    /// Turns of reading files of acoustic emission.
    pub intake: Arc<tokio::sync::Semaphore>,
    /// Streams of events that may be opened besides those that are open.
    pub streams: Arc<tokio::sync::Semaphore>,
    /// Cancelled once the service takes no new work.
    pub stopping: tokio_util::sync::CancellationToken,
}

impl AppState {
    /// The station of that name, or the problem that it is not there.
    async fn station(
        &self,
        id: &crate::domain::ids::StationId,
    ) -> Result<crate::domain::station::Station, problem::ApiError> {
        let station = self.store.station(id).await?;
        station.ok_or_else(|| {
            let detail = format!("there is no station {id}; create it with PUT /v1/stations/{id}");
            Problem::new(Code::UnknownStation, detail).into()
        })
    }

    /// The region of that name, or the problem that it is not there.
    async fn region(
        &self,
        id: &crate::domain::ids::RegionId,
    ) -> Result<crate::domain::region::Region, problem::ApiError> {
        let region = self.store.region(id).await?;
        region.ok_or_else(|| {
            let detail = format!("there is no region {id}; create it with PUT /v1/regions/{id}");
            Problem::new(Code::UnknownRegion, detail).into()
        })
    }
}
