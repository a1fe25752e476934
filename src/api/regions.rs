//! `/v1/regions`: stations that feed one model.

use axum::{
    extract::State,
    http::{HeaderValue, StatusCode, header},
    response::Response,
};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    AppState,
    auth::Caller,
    extract::{Conditions, JsonBody, Path, Query},
    landing::Link,
    problem::ApiResult,
    respond,
    stations::ListQuery,
};
use crate::{
    domain::{
        ids::{RegionId, StationId},
        problem::{Code, FieldError, Problem},
        region::{AvalancheDay, Region, RegionBody},
        retrain::Retrain,
        station::StationName,
    },
    store::stations::Written,
};

/// Which region.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct RegionPath {
    /// Name of the region.
    #[param(inline)]
    pub region: RegionId,
}

/// A region.
#[derive(Serialize, ToSchema)]
pub struct RegionResource {
    /// Its name in every address.
    id: RegionId,
    /// Name for humans.
    name: StationName,
    /// Its stations.
    stations: Vec<StationId>,
    /// What an avalanche day of the region is.
    avalanche_day: AvalancheDay,
    /// When its models are retrained by themselves, as a proposal; null: on request only.
    retrain: Option<Retrain>,
    /// Counts the changes, from 1.
    revision: u32,
    /// When it was made.
    created: Timestamp,
    /// When it last changed.
    updated: Timestamp,
    /// Where to go from here.
    links: Vec<Link>,
}

/// A page of regions.
#[derive(Serialize, ToSchema)]
pub struct RegionList {
    /// Regions in the order of their names.
    regions: Vec<RegionResource>,
    /// The `cursor` of the next page; null on the last.
    next: Option<String>,
}

impl From<Region> for RegionResource {
    fn from(region: Region) -> Self {
        let at = format!("/v1/regions/{}", region.id);
        Self {
            links: vec![
                Link::json(at.clone(), "self", "this document"),
                Link::json(format!("{at}/active-model"), "active-model", "the model that forecasts for it"),
                Link::json(format!("/v1/models?region={}", region.id), "models", "its models"),
                Link::json(format!("{at}/proposals"), "proposals", "what retrainings propose"),
            ],
            id: region.id,
            name: region.body.name,
            stations: region.body.stations,
            avalanche_day: region.body.avalanche_day,
            retrain: region.body.retrain,
            revision: region.revision,
            created: region.created,
            updated: region.updated,
        }
    }
}

fn tag(region: &Region) -> String {
    format!("\"{}\"", region.revision)
}

/// Lists the regions.
#[utoipa::path(get, path = "/v1/regions", operation_id = "list_regions", tag = "regions", params(ListQuery),
    responses((status = 200, description = "A page of regions.", body = RegionList)))]
pub async fn list_regions(
    State(state): State<AppState>,
    Query(query): Query<ListQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let (limit, after) = query.page();
    let mut regions = state.store.regions(&after, limit + 1).await?;
    let more = regions.len() > limit as usize;
    regions.truncate(limit as usize);
    let next = regions.last().filter(|_| more).map(|last| last.id.to_string());
    let list = RegionList { regions: regions.into_iter().map(Into::into).collect(), next };
    let mut response = respond::resource(&conditions, &list)?;
    if let Some(cursor) = &list.next {
        respond::link_next(&mut response, &format!("/v1/regions?limit={limit}&cursor={cursor}"));
    }
    Ok(response)
}

/// One region.
#[utoipa::path(get, path = "/v1/regions/{region}", operation_id = "get_region", tag = "regions", params(RegionPath),
    responses((status = 200, description = "The region.", body = RegionResource)))]
pub async fn get_region(
    State(state): State<AppState>,
    Path(path): Path<RegionPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let region = state.region(&path.region).await?;
    let tag = tag(&region);
    respond::tagged(&conditions, StatusCode::OK, &tag, &RegionResource::from(region))
}

/// Makes a region of stations that exist, or replaces what is said of it. Its models stay: each says which stations and which
/// rule it was trained with.
#[utoipa::path(put, path = "/v1/regions/{region}", operation_id = "put_region", tag = "regions", params(RegionPath),
    request_body(content = RegionBody, example = json!({"name": "Western Highlands", "stations": ["lochaber", "glencoe"],
        "avalanche_day": {"stations": 1, "quiet": "every_station"}})),
    responses((status = 200, description = "The region was known; this is it now.", body = RegionResource),
              (status = 201, description = "The region is new.", body = RegionResource)))]
pub async fn put_region(
    State(state): State<AppState>,
    Path(path): Path<RegionPath>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(body): JsonBody<RegionBody>,
) -> ApiResult<Response> {
    check(&state, &body).await?;
    let permits = |before: Option<&Region>| conditions.permit_write(before.map(tag).as_deref());
    let (region, written) = state.store.put_region(&path.region, &body, &caller.actor(), permits).await?;
    let status = if written == Written::Created { StatusCode::CREATED } else { StatusCode::OK };
    let (tag, location) = (tag(&region), format!("/v1/regions/{}", region.id));
    let mut response = respond::tagged(&Conditions::default(), status, &tag, &RegionResource::from(region))?;
    if let Ok(location) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

/// That the stations exist, and that there are enough of them for an avalanche day.
async fn check(state: &AppState, body: &RegionBody) -> ApiResult<()> {
    let mut faults = Vec::new();
    for (at, id) in body.stations.iter().enumerate() {
        if state.store.station(id).await?.is_none() {
            let detail = format!("there is no station {id}; create it with PUT /v1/stations/{id}");
            faults.push(FieldError::new(format!("/stations/{at}"), "unknown_station", detail));
        }
    }
    let stations = body.stations.len();
    if body.avalanche_day.stations as usize > stations {
        let detail = format!("must be from 1 to the number of stations, {stations}");
        faults.push(FieldError::new("/avalanche_day/stations", "out_of_range", detail));
    }
    let Some(first) = faults.first() else { return Ok(()) };
    let detail = format!("{} {}", first.pointer, first.detail);
    Err(Problem::new(Code::InvalidBody, detail).with_errors(faults).into())
}
