//! `/v1/stations/{station}/active-model` and that of a region: which model forecasts, and the way back.

use axum::{extract::State, http::StatusCode, response::Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    AppState,
    auth::Caller,
    extract::{Conditions, JsonBody, Path, Query},
    landing::Link,
    models::{self, LeadQuery},
    problem::ApiResult,
    regions::RegionPath,
    respond,
    stations::StationPath,
};
use crate::{
    domain::{
        ids::{Place, RegionId, StationId},
        problem::{Code, Problem},
    },
    store::models::{Activation, ModelRecord},
};

/// Longest reason, characters.
const LONGEST_REASON: usize = 2000;

/// Which model forecasts for a station or region.
#[derive(Serialize, ToSchema)]
pub struct ActiveModel {
    /// The station; null for a region.
    station: Option<StationId>,
    /// The region; null for a station.
    region: Option<RegionId>,
    /// True where the data of the station, or those that the model of the region was trained on, were made by a generator.
    synthetic: bool,
    /// Days between the last observation and the day that is forecast.
    lead: u8,
    /// The model.
    model_id: Uuid,
    /// Since when.
    activated: Timestamp,
    /// The name of the key that activated it; null for a first model and where no key was needed.
    activated_by: Option<String>,
    /// Why, in the words of whoever activated it.
    reason: Option<String>,
    /// Where to go from here.
    links: Vec<Link>,
}

/// The model to make the active one.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ActivateBody {
    /// Id of a model of this place and lead.
    model_id: Uuid,
    /// Why, at most 2000 characters; it stands in the audit.
    #[serde(default)]
    #[schema(max_length = 2000)]
    reason: Option<String>,
}

/// Why the active model is taken back.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RollBackBody {
    /// Why, at most 2000 characters; it stands in the audit.
    #[serde(default)]
    #[schema(max_length = 2000)]
    reason: Option<String>,
}

fn resource(place: &Place, synthetic: bool, lead: u8, activation: Activation) -> ActiveModel {
    ActiveModel {
        station: place.station().cloned(),
        region: place.region().cloned(),
        synthetic,
        lead,
        links: vec![Link::json(format!("/v1/models/{}", activation.model), "model", "the model")],
        model_id: activation.model,
        activated: activation.activated,
        activated_by: activation.activated_by,
        reason: activation.reason,
    }
}

fn tag(activation: &Activation) -> String {
    format!("\"{}\"", activation.sequence)
}

pub(super) fn check_reason(reason: Option<&str>) -> Result<(), Problem> {
    if reason.is_some_and(|reason| reason.chars().count() > LONGEST_REASON) {
        let detail = format!("must be at most {LONGEST_REASON} characters");
        return Err(Problem::field(Code::InvalidBody, "/reason", "out_of_range", detail));
    }
    Ok(())
}

/// The place, or that there is none; with whether its data were made by a generator, as far as it knows by itself.
async fn is_synthetic(state: &AppState, place: &Place) -> ApiResult<bool> {
    match place {
        Place::Station(id) => Ok(state.station(id).await?.synthetic),
        Place::Region(id) => state.region(id).await.map(|_| false),
    }
}

async fn answer(
    state: &AppState,
    conditions: &Conditions,
    place: &Place,
    lead: u8,
    activation: Activation,
) -> ApiResult<Response> {
    let of_place = is_synthetic(state, place).await?;
    let of_model = state.store.model(activation.model).await?.is_some_and(|model| model.is_synthetic());
    // a station says it of itself; a region has only what its model was trained on
    let synthetic = if place.station().is_some() { of_place } else { of_model };
    let tag = tag(&activation);
    respond::tagged(conditions, StatusCode::OK, &tag, &resource(place, synthetic, lead, activation))
}

async fn get(state: &AppState, place: &Place, lead: u8, conditions: &Conditions) -> ApiResult<Response> {
    is_synthetic(state, place).await?;
    let activation = state.store.active_model(place, lead).await?;
    let activation = activation.ok_or_else(|| models::none_active(place, lead))?;
    answer(state, conditions, place, lead, activation).await
}

async fn put(
    state: &AppState,
    place: &Place,
    lead: u8,
    conditions: &Conditions,
    caller: &Caller,
    body: &ActivateBody,
) -> ApiResult<Response> {
    is_synthetic(state, place).await?;
    check_reason(body.reason.as_deref())?;
    let model: Option<ModelRecord> = state.store.model(body.model_id).await?;
    if !model.is_some_and(|model| model.place == *place && model.lead == lead) {
        let list = match place {
            Place::Station(id) => format!("station={id}"),
            Place::Region(id) => format!("region={id}"),
        };
        let detail = format!("must be a model of {place} and lead {lead}; GET /v1/models?{list} lists them");
        return Err(Problem::field(Code::ModelMismatch, "/model_id", "model_mismatch", detail).into());
    }
    let permits = |before: Option<&Activation>| conditions.permit_write(before.map(tag).as_deref());
    let reason = body.reason.as_deref();
    let activation = state.store.activate_model(place, lead, body.model_id, reason, &caller.actor(), permits).await?;
    answer(state, &Conditions::default(), place, lead, activation).await
}

async fn roll_back(
    state: &AppState,
    place: &Place,
    lead: u8,
    conditions: &Conditions,
    caller: &Caller,
    body: &RollBackBody,
) -> ApiResult<Response> {
    is_synthetic(state, place).await?;
    check_reason(body.reason.as_deref())?;
    let permits = |before: Option<&Activation>| conditions.permit_write(before.map(tag).as_deref());
    let reason = body.reason.as_deref();
    let activation = state.store.roll_back_model(place, lead, reason, &caller.actor(), permits).await?;
    let activation = activation.ok_or_else(|| {
        let detail = format!("{place} has no model of lead {lead} that was active before the active one");
        Problem::new(Code::NoEarlierModel, detail)
    })?;
    answer(state, &Conditions::default(), place, lead, activation).await
}

/// Which model forecasts for a station.
#[utoipa::path(get, path = "/v1/stations/{station}/active-model", operation_id = "get_active_model", tag = "models",
    params(StationPath, LeadQuery), responses((status = 200, description = "The active model.", body = ActiveModel)))]
pub async fn get_active_model(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<LeadQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    get(&state, &Place::Station(path.station), query.lead.0, &conditions).await
}

/// Makes a model the one that forecasts for its station; who did it, when and why stands in the audit.
#[utoipa::path(put, path = "/v1/stations/{station}/active-model", operation_id = "put_active_model", tag = "models",
    params(StationPath, LeadQuery), request_body = ActivateBody,
    responses((status = 200, description = "The active model now.", body = ActiveModel)))]
pub async fn put_active_model(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<LeadQuery>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(body): JsonBody<ActivateBody>,
) -> ApiResult<Response> {
    put(&state, &Place::Station(path.station), query.lead.0, &conditions, &caller, &body).await
}

/// Makes the model active again that was so before the active one; a second roll-back goes back further.
#[utoipa::path(post, path = "/v1/stations/{station}/active-model/rollback", operation_id = "roll_back_model", tag = "models",
    params(StationPath, LeadQuery), request_body(content = RollBackBody, example = json!({"reason": "false alarms all week"})),
    responses((status = 200, description = "The active model now.", body = ActiveModel)))]
pub async fn roll_back_model(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<LeadQuery>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(body): JsonBody<RollBackBody>,
) -> ApiResult<Response> {
    roll_back(&state, &Place::Station(path.station), query.lead.0, &conditions, &caller, &body).await
}

/// Which model forecasts for a region, and for those of its stations that have no active model of their own.
#[utoipa::path(get, path = "/v1/regions/{region}/active-model", operation_id = "get_region_model", tag = "regions",
    params(RegionPath, LeadQuery), responses((status = 200, description = "The active model.", body = ActiveModel)))]
pub async fn get_region_model(
    State(state): State<AppState>,
    Path(path): Path<RegionPath>,
    Query(query): Query<LeadQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    get(&state, &Place::Region(path.region), query.lead.0, &conditions).await
}

/// Makes a model the one that forecasts for its region; who did it, when and why stands in the audit.
#[utoipa::path(put, path = "/v1/regions/{region}/active-model", operation_id = "put_region_model", tag = "regions",
    params(RegionPath, LeadQuery), request_body = ActivateBody,
    responses((status = 200, description = "The active model now.", body = ActiveModel)))]
pub async fn put_region_model(
    State(state): State<AppState>,
    Path(path): Path<RegionPath>,
    Query(query): Query<LeadQuery>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(body): JsonBody<ActivateBody>,
) -> ApiResult<Response> {
    put(&state, &Place::Region(path.region), query.lead.0, &conditions, &caller, &body).await
}

/// Makes the model of a region active again that was so before the active one; a second roll-back goes back further.
#[utoipa::path(post, path = "/v1/regions/{region}/active-model/rollback", operation_id = "roll_back_region_model",
    tag = "regions", params(RegionPath, LeadQuery),
    request_body(content = RollBackBody, example = json!({"reason": "false alarms all week"})),
    responses((status = 200, description = "The active model now.", body = ActiveModel)))]
pub async fn roll_back_region_model(
    State(state): State<AppState>,
    Path(path): Path<RegionPath>,
    Query(query): Query<LeadQuery>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(body): JsonBody<RollBackBody>,
) -> ApiResult<Response> {
    roll_back(&state, &Place::Region(path.region), query.lead.0, &conditions, &caller, &body).await
}
