//! `/v1/stations`: where observations come from.

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
    problem::ApiResult,
    respond,
};
use crate::{
    domain::{
        ids::StationId,
        retrain::Retrain,
        station::{EawsRegion, Station, StationBody, StationName, ZoneName},
        units::{Altitude, Latitude, Longitude},
    },
    store::stations::Written,
};

/// Which station.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct StationPath {
    /// Name of the station.
    #[param(inline)]
    pub station: StationId,
}

/// Which page of the list.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ListQuery {
    /// Largest number of them in the answer, 1 to 1000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1000, default = 100)]
    limit: Option<Limit<100, 1000>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    cursor: Option<String>,
}

impl ListQuery {
    /// The size of the page, and the name after which it begins.
    pub(super) fn page(self) -> (u32, String) {
        (Limit::or_default(self.limit), self.cursor.unwrap_or_default())
    }
}

/// The size of a page, with its default and its largest value.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "u32")]
pub struct Limit<const DEFAULT: u32, const MAX: u32>(u32);

impl<const DEFAULT: u32, const MAX: u32> TryFrom<u32> for Limit<DEFAULT, MAX> {
    type Error = String;

    fn try_from(limit: u32) -> Result<Self, Self::Error> {
        if (1..=MAX).contains(&limit) { Ok(Self(limit)) } else { Err(format!("must be from 1 to {MAX}, not {limit}")) }
    }
}

impl<const DEFAULT: u32, const MAX: u32> Limit<DEFAULT, MAX> {
    /// The limit that was asked for, or the default.
    pub fn or_default(limit: Option<Self>) -> u32 {
        limit.map_or(DEFAULT, |limit| limit.0)
    }
}

/// A station.
#[derive(Serialize, ToSchema)]
pub struct StationResource {
    /// Its name in every address.
    id: StationId,
    /// Name for humans.
    name: StationName,
    /// Latitude, degrees north (WGS 84).
    latitude: Option<Latitude>,
    /// Longitude, degrees east (WGS 84).
    longitude: Option<Longitude>,
    /// Altitude above sea level, m.
    altitude_m: Option<Altitude>,
    /// IANA time zone of the station's local days; null: UTC.
    timezone: Option<ZoneName>,
    /// Id of its region among the European avalanche warning services (EAWS); null: none is named.
    eaws_region: Option<EawsRegion>,
    /// The variables that the station reports; null: whatever its observations contain.
    #[schema(value_type = Option<Vec<String>>)]
    variables: Option<Vec<&'static str>>,
    /// When its models are retrained by themselves, as a proposal; null: on request only.
    retrain: Option<Retrain>,
    /// True for a station whose data were made by a generator: nothing of it was ever observed.
    synthetic: bool,
    /// Counts the changes, from 1.
    revision: u32,
    /// When it was made.
    created: Timestamp,
    /// When it last changed.
    updated: Timestamp,
}

/// A page of stations.
#[derive(Serialize, ToSchema)]
pub struct StationList {
    /// Stations in the order of their names.
    stations: Vec<StationResource>,
    /// The `cursor` of the next page; null on the last.
    next: Option<String>,
}

impl From<Station> for StationResource {
    fn from(station: Station) -> Self {
        let body = station.body;
        Self {
            id: station.id,
            name: body.name,
            latitude: body.latitude,
            longitude: body.longitude,
            altitude_m: body.altitude_m,
            timezone: body.timezone,
            eaws_region: body.eaws_region,
            variables: body.variables.map(|list| list.into_iter().map(|variable| variable.name()).collect()),
            retrain: body.retrain,
            synthetic: station.synthetic,
            revision: station.revision,
            created: station.created,
            updated: station.updated,
        }
    }
}

fn tag(station: &Station) -> String {
    format!("\"{}\"", station.revision)
}

/// Lists the stations.
#[utoipa::path(get, path = "/v1/stations", operation_id = "list_stations", tag = "stations", params(ListQuery),
    responses((status = 200, description = "A page of stations.", body = StationList)))]
pub async fn list_stations(
    State(state): State<AppState>,
    Query(query): Query<ListQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let (limit, after) = query.page();
    let mut stations = state.store.stations(&after, limit + 1).await?;
    let more = stations.len() > limit as usize;
    stations.truncate(limit as usize);
    let next = stations.last().filter(|_| more).map(|last| last.id.to_string());
    let list = StationList { stations: stations.into_iter().map(Into::into).collect(), next };
    let mut response = respond::resource(&conditions, &list)?;
    if let Some(cursor) = &list.next {
        respond::link_next(&mut response, &format!("/v1/stations?limit={limit}&cursor={cursor}"));
    }
    Ok(response)
}

/// One station.
#[utoipa::path(get, path = "/v1/stations/{station}", operation_id = "get_station", tag = "stations", params(StationPath),
    responses((status = 200, description = "The station.", body = StationResource)))]
pub async fn get_station(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let station = state.station(&path.station).await?;
    let tag = tag(&station);
    respond::tagged(&conditions, StatusCode::OK, &tag, &StationResource::from(station))
}

/// Makes a station or replaces what is said of it. Its observations stay.
#[utoipa::path(put, path = "/v1/stations/{station}", operation_id = "put_station", tag = "stations", params(StationPath),
    request_body(content = StationBody, example = json!({"name": "Lochaber", "latitude": 56.8, "longitude": -5.0,
        "altitude_m": 900, "timezone": "Europe/London"})),
    responses((status = 200, description = "The station was known; this is it now.", body = StationResource),
              (status = 201, description = "The station is new.", body = StationResource)))]
pub async fn put_station(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(body): JsonBody<StationBody>,
) -> ApiResult<Response> {
    let permits = |before: Option<&Station>| conditions.permit_write(before.map(tag).as_deref());
    let (station, written) = state.store.put_station(&path.station, &body, false, &caller.actor(), permits).await?;
    let status = if written == Written::Created { StatusCode::CREATED } else { StatusCode::OK };
    let tag = tag(&station);
    let location = format!("/v1/stations/{}", station.id);
    let mut response = respond::tagged(&Conditions::default(), status, &tag, &StationResource::from(station))?;
    if let Ok(location) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}
