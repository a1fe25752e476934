//! `/v1/models`: the registry of what was trained.

use axum::{extract::State, response::Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Path, Query},
    feature_sets::FeatureSetResource,
    forecasts::Lead,
    landing::Link,
    problem::ApiResult,
    respond,
    stations::Limit,
};
use crate::{
    domain::{
        ids::{Place, RegionId, StationId},
        problem::{Code, Problem},
    },
    science::forecast::{evaluation::Evaluation, features::FeatureSet},
    store::models::ModelRecord,
};

/// Which model.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct ModelPath {
    /// Id of the model.
    pub model: Uuid,
}

/// Which models.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ModelsQuery {
    /// Only models of this station.
    #[serde(default)]
    #[param(inline)]
    station: Option<StationId>,
    /// Only models of this region; not together with `station`.
    #[serde(default)]
    #[param(inline)]
    region: Option<RegionId>,
    /// Largest number of models in the answer, 1 to 1000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1000, default = 100)]
    limit: Option<Limit<100, 1000>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    cursor: Option<Uuid>,
}

/// For which lead.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct LeadQuery {
    /// Days between the last observation and the day that is forecast: 0 or 1.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1, default = 0)]
    pub lead: Lead,
}

/// A trained model; it never changes.
#[derive(Serialize, ToSchema)]
pub struct ModelResource {
    /// Id of the model.
    id: Uuid,
    /// The station that it was trained for; null for a model of a region.
    station: Option<StationId>,
    /// The region that it was trained for; null for a model of a station.
    region: Option<RegionId>,
    /// True where it was trained on data that a generator made.
    synthetic: bool,
    /// Days between the last observation and the day that is forecast.
    lead: u8,
    /// The job that trained it.
    job: Uuid,
    /// When it was made.
    created: Timestamp,
    /// What it was trained on and what was chosen: label, feature set and its version, kernel, C, gamma, threshold and how
    /// it was chosen, first and last day, days, events, seasons, base rate, number of support vectors.
    #[schema(value_type = Object)]
    training: Value,
    /// Its scores with every season left out once.
    #[schema(value_type = Object)]
    scores: Value,
    /// Version of firn, SHA-256 of everything that it was trained on, and seed: the same three give the same bits.
    #[schema(value_type = Object)]
    provenance: Value,
    /// Where to go from here.
    links: Vec<Link>,
}

/// A page of models.
#[derive(Serialize, ToSchema)]
pub struct ModelList {
    /// Newest first.
    models: Vec<ModelResource>,
    /// The `cursor` of the next page; null on the last.
    next: Option<Uuid>,
}

/// How good a model is.
#[derive(Serialize, ToSchema)]
pub struct EvaluationResource {
    /// The model.
    model_id: Uuid,
    /// True where it was trained and scored on data that a generator made.
    synthetic: bool,
    /// The scores.
    #[serde(flatten)]
    #[schema(value_type = Evaluation)]
    evaluation: Value,
}

/// The features of a model.
#[derive(Serialize, ToSchema)]
pub struct ModelFeatures {
    /// The model.
    model_id: Uuid,
    /// True where it was trained on data that a generator made.
    synthetic: bool,
    /// The features, in the order of the columns.
    #[serde(flatten)]
    set: FeatureSetResource,
}

impl From<ModelRecord> for ModelResource {
    fn from(record: ModelRecord) -> Self {
        let at = format!("/v1/models/{}", record.id);
        let part = |name: &str| record.summary.get(name).cloned().unwrap_or(Value::Null);
        Self {
            id: record.id,
            synthetic: record.is_synthetic(),
            training: part("training"),
            scores: part("scores"),
            provenance: part("provenance"),
            station: record.place.station().cloned(),
            region: record.place.region().cloned(),
            lead: record.lead,
            job: record.job,
            created: record.created,
            links: {
                let mut links = vec![
                    Link::json(at.clone(), "self", "this document"),
                    Link::json(format!("{at}/evaluation"), "evaluation", "its scores beside those of other models"),
                    Link::json(format!("{at}/features"), "features", "its features"),
                    Link::json(format!("{at}/transfers"), "transfers", "how it did at other stations"),
                ];
                let selection = || Link::json(format!("{at}/selection"), "selection", "how its features were chosen");
                links.extend(record.selection.is_some().then(selection));
                links
            },
        }
    }
}

pub async fn find(state: &AppState, id: Uuid) -> ApiResult<ModelRecord> {
    let model = state.store.model(id).await?;
    model.ok_or_else(|| unknown(id).into())
}

/// 404 for an id of no model.
pub fn unknown(id: Uuid) -> Problem {
    Problem::new(Code::UnknownModel, format!("there is no model {id}; GET /v1/models lists them"))
}

/// 404 for a station or region without an active model of that lead.
pub fn none_active(place: &Place, lead: u8) -> Problem {
    let detail = format!("{place} has no active model of lead {lead}: train one with the process train-model");
    Problem::new(Code::NoActiveModel, detail)
}

/// Lists models, newest first.
#[utoipa::path(get, path = "/v1/models", operation_id = "list_models", tag = "models", params(ModelsQuery),
    responses((status = 200, description = "A page of models.", body = ModelList)))]
pub async fn list_models(
    State(state): State<AppState>,
    Query(query): Query<ModelsQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let limit = Limit::or_default(query.limit);
    let place = match (query.station, query.region) {
        (Some(_), Some(_)) => {
            let detail = "must be left out where a station is named";
            return Err(Problem::field(Code::InvalidParameter, "/region", "contradiction", detail).into());
        }
        (station, region) => station.map(Place::Station).or(region.map(Place::Region)),
    };
    let mut models = state.store.models(place.as_ref(), query.cursor, limit + 1).await?;
    let more = models.len() > limit as usize;
    models.truncate(limit as usize);
    let next = models.last().filter(|_| more).map(|model| model.id);
    let list = ModelList { models: models.into_iter().map(Into::into).collect(), next };
    let mut response = respond::resource(&conditions, &list)?;
    if let Some(cursor) = next {
        let of = match place {
            Some(Place::Station(station)) => format!("&station={station}"),
            Some(Place::Region(region)) => format!("&region={region}"),
            None => String::new(),
        };
        respond::link_next(&mut response, &format!("/v1/models?limit={limit}&cursor={cursor}{of}"));
    }
    Ok(response)
}

/// One model.
#[utoipa::path(get, path = "/v1/models/{model}", operation_id = "get_model", tag = "models", params(ModelPath),
    responses((status = 200, description = "The model.", body = ModelResource)))]
pub async fn get_model(
    State(state): State<AppState>,
    Path(path): Path<ModelPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let model = find(&state, path.model).await?;
    respond::resource(&conditions, &ModelResource::from(model))
}

/// How good a model is, on seasons that were kept from it, beside climatology, persistence, nearest neighbours and
/// logistic regression: `scores` with every season left out once, `per_season`, `reliability`, `forward_chaining` (each
/// season forecast from the ones before it only) and the `bootstrap` over seasons. An undefined score is null.
#[utoipa::path(get, path = "/v1/models/{model}/evaluation", operation_id = "get_model_evaluation", tag = "models",
    params(ModelPath), responses((status = 200, description = "The evaluation.", body = EvaluationResource)))]
pub async fn get_evaluation(
    State(state): State<AppState>,
    Path(path): Path<ModelPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let model = find(&state, path.model).await?;
    let evaluation = state.store.model_evaluation(model.id).await?.ok_or_else(|| unknown(path.model))?;
    let synthetic = model.is_synthetic();
    respond::resource(&conditions, &EvaluationResource { model_id: model.id, synthetic, evaluation })
}

/// The features of a model, in the order of its columns.
#[utoipa::path(get, path = "/v1/models/{model}/features", operation_id = "get_model_features", tag = "models",
    params(ModelPath), responses((status = 200, description = "The features.", body = ModelFeatures)))]
pub async fn get_features(
    State(state): State<AppState>,
    Path(path): Path<ModelPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let record = find(&state, path.model).await?;
    let model = state.store.trained_model(record.id).await?.ok_or_else(|| unknown(path.model))?;
    let all = FeatureSet::new(model.feature_set, &model.reported);
    let set = FeatureSetResource::from(&all.only(&model.features).map_err(Problem::internal)?);
    respond::resource(&conditions, &ModelFeatures { model_id: record.id, synthetic: record.is_synthetic(), set })
}
