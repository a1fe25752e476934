//! Whether the process lives and whether it can work.

use axum::{Json, extract::State};
use serde::Serialize;
use utoipa::ToSchema;

use super::{AppState, problem::ApiResult};
use crate::domain::problem::{Code, Problem};

/// The state of the service.
#[derive(Serialize, ToSchema)]
pub struct Health {
    /// `ok`
    #[schema(example = "ok")]
    pub status: &'static str,
    /// The version of firn.
    pub version: &'static str,
}

const OK: Health = Health { status: "ok", version: env!("CARGO_PKG_VERSION") };

/// The process lives.
#[utoipa::path(get, path = "/livez", operation_id = "get_liveness", tag = "service",
    responses((status = 200, description = "The process lives.", body = Health)))]
pub async fn livez() -> Json<Health> {
    Json(OK)
}

/// The service can work: its database can be written and it is not shutting down.
#[utoipa::path(get, path = "/readyz", operation_id = "get_readiness", tag = "service",
    responses((status = 200, description = "The service can work.", body = Health)))]
pub async fn readyz(State(state): State<AppState>) -> ApiResult<Json<Health>> {
    if state.stopping.is_cancelled() {
        return Err(Problem::new(Code::ShuttingDown, "the service is shutting down").into());
    }
    state.store.check().await.map_err(|error| {
        tracing::error!(%error, "the database cannot be written");
        Problem::new(Code::NotReady, "the database cannot be written")
    })?;
    if let Err(error) = state.desk.engine().check().await {
        tracing::error!(%error, "the engine does not answer");
        return Err(Problem::new(Code::NotReady, "the job engine does not answer").into());
    }
    Ok(Json(OK))
}
