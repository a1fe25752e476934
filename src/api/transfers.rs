//! `/v1/models/{model}/transfers`: how a model did at other stations.

use axum::{extract::State, response::Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Path, Query},
    models::{self, ModelPath},
    problem::ApiResult,
    respond,
    stations::Limit,
};
use crate::{domain::ids::StationId, science::forecast::transfer::Transfer, store::transfers::StoredTransfer};

/// Which evaluations.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct TransfersQuery {
    /// Largest number of evaluations in the answer, 1 to 100.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 100, default = 20)]
    limit: Option<Limit<20, 100>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    cursor: Option<Uuid>,
}

/// How a model did at a station that it was not trained at, or on other seasons of its own.
#[derive(Serialize, ToSchema)]
pub struct TransferResource {
    /// The job of the process `evaluate-transfer` that found it.
    job: Uuid,
    /// When it was found.
    created: Timestamp,
    /// The station whose days the model was scored on.
    station: StationId,
    /// True where the model or these days come from a generator.
    synthetic: bool,
    /// The scores.
    #[serde(flatten)]
    transfer: Transfer,
    /// Version of firn, SHA-256 of what was scored, and seed.
    #[schema(value_type = Object)]
    provenance: Value,
}

/// How a model did at other stations.
#[derive(Serialize, ToSchema)]
pub struct TransferList {
    /// The model.
    model_id: Uuid,
    /// Newest first.
    transfers: Vec<TransferResource>,
    /// The `cursor` of the next page; null on the last.
    next: Option<Uuid>,
}

impl From<StoredTransfer> for TransferResource {
    fn from(stored: StoredTransfer) -> Self {
        Self {
            job: stored.job,
            created: stored.created,
            station: stored.record.station,
            synthetic: stored.record.synthetic,
            transfer: stored.record.transfer,
            provenance: stored.record.provenance,
        }
    }
}

/// How a model did at other stations: what the process `evaluate-transfer` found, newest first.
#[utoipa::path(get, path = "/v1/models/{model}/transfers", operation_id = "list_transfers", tag = "models",
    params(ModelPath, TransfersQuery), responses((status = 200, description = "The evaluations.", body = TransferList)))]
pub async fn list_transfers(
    State(state): State<AppState>,
    Path(path): Path<ModelPath>,
    Query(query): Query<TransfersQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let model = models::find(&state, path.model).await?;
    let limit = Limit::or_default(query.limit);
    let mut transfers = state.store.transfers(model.id, query.cursor, limit + 1).await?;
    let more = transfers.len() > limit as usize;
    transfers.truncate(limit as usize);
    let next = transfers.last().filter(|_| more).map(|last| last.job);
    let list = TransferList { model_id: model.id, transfers: transfers.into_iter().map(Into::into).collect(), next };
    let mut response = respond::resource(&conditions, &list)?;
    if let Some(cursor) = next {
        respond::link_next(&mut response, &format!("/v1/models/{}/transfers?limit={limit}&cursor={cursor}", model.id));
    }
    Ok(response)
}
