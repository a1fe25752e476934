//! `/v1/stations/{station}/observations`: days of weather and snowpack, one by one or as a range.

use axum::{
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
};
use jiff::{Timestamp, civil};
use serde::{Deserialize, Serialize};
use utoipa::{
    IntoParams, PartialSchema, ToSchema,
    openapi::{
        RefOr,
        schema::{ObjectBuilder, Schema, Type},
    },
};

use super::{
    AppState,
    auth::Caller,
    avalanches::{DayPath, RevisionList},
    extract::{Conditions, Date, JsonBody, Path, Query, etag},
    problem::ApiResult,
    respond,
    stations::{Limit, StationPath},
};
use crate::{
    clock,
    domain::{
        avalanche::Contradiction,
        ids::StationId,
        observation::{DatedObservation, Observation},
        problem::{Code, FieldError, Problem},
    },
    formats::{observations_csv, smet},
    store::{
        observations::{Author, DayWrite, Part, StoredDay},
        stations::Written,
    },
};

/// Which days.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct RangeQuery {
    /// First day, YYYY-MM-DD; left out: the first there is.
    #[serde(default)]
    #[param(inline)]
    from: Option<Date>,
    /// Last day, YYYY-MM-DD; left out: the last there is.
    #[serde(default)]
    #[param(inline)]
    to: Option<Date>,
    /// Largest number of days in the answer, 1 to 10000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 10000, default = 1000)]
    limit: Option<Limit<1000, 10000>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    #[param(inline)]
    cursor: Option<Date>,
}

/// A day as it is served: the observation with its place and history.
#[derive(Serialize)]
pub struct ObservationResource {
    station: StationId,
    date: civil::Date,
    #[serde(flatten)]
    observation: Observation,
    synthetic: bool,
    revision: u32,
    avalanche_revision: u32,
    updated: Timestamp,
}

impl PartialSchema for ObservationResource {
    /// The fields of what is sent in, and those that the service adds: written here so that they are not listed twice.
    fn schema() -> RefOr<Schema> {
        let RefOr::T(Schema::Object(mut object)) = <DatedObservation as PartialSchema>::schema() else {
            return <DatedObservation as PartialSchema>::schema();
        };
        let string = |about: &str| ObjectBuilder::new().schema_type(Type::String).description(Some(about));
        let count =
            |about: &str| ObjectBuilder::new().schema_type(Type::Integer).minimum(Some(0)).description(Some(about));
        let added: [(&str, ObjectBuilder); 5] = [
            ("station", string("Name of the station.")),
            (
                "synthetic",
                ObjectBuilder::new()
                    .schema_type(Type::Boolean)
                    .description(Some("True where the day was made by a generator and never observed.")),
            ),
            ("revision", count("Counts the changes of weather and snowpack, from 1; 0: nothing of them was recorded.")),
            ("avalanche_revision", count("Counts the changes of the avalanche record, from 1; 0: there is none.")),
            ("updated", string("When the day last changed, RFC 3339 in UTC.")),
        ];
        for (name, schema) in added {
            object.properties.insert(name.to_owned(), schema.into());
            object.required.push(name.to_owned());
        }
        object.additional_properties = None;
        object.description = Some("A day of a station.".to_owned());
        Schema::Object(object).into()
    }
}

impl ToSchema for ObservationResource {
    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        <DatedObservation as ToSchema>::schemas(schemas);
    }
}

/// A page of days.
#[derive(Serialize, ToSchema)]
pub struct ObservationList {
    /// Days in their order; a day without a record is not in the list.
    observations: Vec<ObservationResource>,
    /// The `cursor` of the next page; null on the last.
    next: Option<Date>,
}

impl ObservationResource {
    fn new(station: &StationId, synthetic: bool, day: &StoredDay) -> ApiResult<Self> {
        let stamps = [day.values.as_ref().map(|v| v.updated), day.avalanche.as_ref().map(|a| a.updated)];
        Ok(Self {
            station: station.clone(),
            date: day.date,
            observation: observation(day)?,
            synthetic,
            revision: day.values.as_ref().map_or(0, |values| values.revision),
            avalanche_revision: day.avalanche.as_ref().map_or(0, |record| record.revision),
            updated: stamps.into_iter().flatten().max().unwrap_or_default(),
        })
    }
}

fn observation(day: &StoredDay) -> ApiResult<Observation> {
    let values = day.values.as_ref().map(|values| values.value).unwrap_or_default();
    let avalanche = day.avalanche.as_ref().map(|record| record.value);
    let mut observation = Observation::from_values(&values, avalanche.as_ref()).map_err(Problem::internal)?;
    observation.forecast = Some(day.forecast);
    Ok(observation)
}

/// What was observed of a day; none where all of it is a weather forecast.
fn observed(day: &StoredDay) -> Option<StoredDay> {
    let values = day.values.clone().filter(|_| !day.forecast);
    (values.is_some() || day.avalanche.is_some()).then(|| StoredDay { values, forecast: false, ..day.clone() })
}

fn tag(day: &StoredDay) -> String {
    let values = day.values.as_ref().map_or(0, |values| values.revision);
    let avalanche = day.avalanche.as_ref().map_or(0, |record| record.revision);
    format!("\"{values}.{avalanche}\"")
}

/// The faults of a body whose fields are each possible but not together.
pub fn contradictions(faults: &[Contradiction], prefix: &str) -> Vec<FieldError> {
    let fault = |fault: &Contradiction| {
        FieldError::new(format!("{prefix}/{}", fault.observation_field()), "contradiction", fault.to_string())
    };
    faults.iter().map(fault).collect()
}

fn not_observed(station: &StationId, date: Date) -> Problem {
    Problem::new(Code::NoObservation, format!("no observation of {station} on {}", date.0))
}

/// The days of a range, as JSON or, with `Accept: text/csv`, as the CSV that can be sent in again; with `Accept: text/x-smet` as
/// SMET, which has weather and snow but no avalanches. In JSON a weather forecast is marked by `forecast`; the files have
/// only what was observed.
#[utoipa::path(get, path = "/v1/stations/{station}/observations", operation_id = "list_observations", tag = "observations",
    params(StationPath, RangeQuery),
    responses((status = 200, description = "A page of days.", content((ObservationList = "application/json"), (String = "text/csv"), (String = "text/x-smet")))))]
pub async fn list_observations(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<RangeQuery>,
    conditions: Conditions,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let (csv, as_smet) = (respond::prefers(&headers, "text/csv"), respond::prefers(&headers, "text/x-smet"));
    if csv.is_none() && as_smet.is_none() {
        let detail = "served as application/json, text/csv and text/x-smet";
        return Err(Problem::new(Code::NotAcceptable, detail).into());
    }
    let (csv, as_smet) = (csv.unwrap_or(false), as_smet.unwrap_or(false));
    let station = state.station(&path.station).await?;
    let limit = Limit::or_default(query.limit);
    let from = query.from.map_or(civil::Date::constant(0, 1, 1), |date| date.0);
    let to = query.to.map_or(civil::Date::constant(9999, 12, 31), |date| date.0);
    if from > to {
        let detail = format!("must not be before from, {from}");
        return Err(Problem::field(Code::InvalidParameter, "/to", "out_of_range", detail).into());
    }
    let first = match query.cursor {
        // a cursor that is the last possible day has no day after it, and so the page is empty
        Some(cursor) => cursor.0.tomorrow().unwrap_or(civil::Date::MAX).max(from),
        None => from,
    };
    let mut days = state.store.days(&station.id, first, to, limit + 1).await?;
    let more = days.len() > limit as usize;
    days.truncate(limit as usize);
    let next = days.last().filter(|_| more).map(|day| Date(day.date));
    let mut response = if csv {
        let rows = days.iter().filter_map(observed).map(|day| Ok(observation(&day)?.on(day.date)));
        let rows = rows.collect::<ApiResult<Vec<_>>>()?;
        let body = observations_csv::write(rows).into_bytes();
        let tag = etag(&body);
        let mut response = respond::tagged_bytes(&conditions, StatusCode::OK, tag, "text/csv; charset=utf-8", body);
        if station.synthetic {
            // the columns are those that can be sent in again, so the mark stands where a file gets its name
            let name = HeaderValue::from_static("inline; filename=\"synthetic-observations.csv\"");
            response.headers_mut().insert(header::CONTENT_DISPOSITION, name);
        }
        response
    } else if as_smet {
        let rows: Vec<_> =
            days.iter().filter_map(observed).filter_map(|day| Some((day.date, day.values?.value))).collect();
        let body = smet::write(&station, &rows).into_bytes();
        respond::tagged_bytes(&conditions, StatusCode::OK, etag(&body), "text/x-smet; charset=utf-8", body)
    } else {
        let observations = days
            .iter()
            .map(|day| ObservationResource::new(&station.id, station.synthetic, day))
            .collect::<ApiResult<_>>()?;
        respond::resource(&conditions, &ObservationList { observations, next })?
    };
    if let Some(next) = next {
        let url =
            format!("/v1/stations/{}/observations?from={from}&to={to}&limit={limit}&cursor={}", station.id, next.0);
        respond::link_next(&mut response, &url);
    }
    Ok(response)
}

/// One day.
#[utoipa::path(get, path = "/v1/stations/{station}/observations/{date}", operation_id = "get_observation", tag = "observations",
    params(DayPath), responses((status = 200, description = "The day.", body = ObservationResource)))]
pub async fn get_observation(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let station = state.station(&path.station).await?;
    let day = state.store.day(&station.id, path.date.0).await?;
    let day = day.ok_or_else(|| not_observed(&station.id, path.date))?;
    let resource = ObservationResource::new(&station.id, station.synthetic, &day)?;
    respond::tagged(&conditions, StatusCode::OK, &tag(&day), &resource)
}

/// Records a day or replaces what was recorded of it; sending the same again changes nothing. Weather and snowpack are
/// replaced as a whole; the avalanche record stays as it is unless `avalanche_activity` is given. Every earlier state is
/// kept. Weather of a day still to come is a forecast (`forecast` in the answer): no model is trained on it, only a forecast
/// that is asked for with `weather=forecast` reads it, and the observation of the day replaces it.
#[utoipa::path(put, path = "/v1/stations/{station}/observations/{date}", operation_id = "put_observation", tag = "observations",
    params(DayPath),
    request_body(content = Observation, example = json!({"air_temperature": -3.5, "wind_speed": 12.0, "wind_direction": 230,
        "cloud_cover": 80, "new_snow_index": 6, "rain_at_900m": false, "snow_drift": true, "foot_penetration": 25,
        "snow_temperature": -2.0, "insolation_index": 4, "avalanche_activity": "observed"})),
    responses((status = 200, description = "The day was known; this is it now.", body = ObservationResource),
              (status = 201, description = "The day is new.", body = ObservationResource)))]
pub async fn put_observation(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(observation): JsonBody<Observation>,
) -> ApiResult<Response> {
    let faults = contradictions(&observation.contradictions(), "");
    if let Some(first) = faults.first() {
        return Err(Problem::new(Code::InvalidBody, first.detail.clone()).with_errors(faults).into());
    }
    let station = state.station(&path.station).await?;
    let today = clock::today(&station.zone());
    let forecast = observation
        .is_forecast(path.date.0, today)
        .map_err(|fault| Problem::field(Code::InvalidBody, "/forecast", "contradiction", fault.to_string()))?;
    let (values, avalanche) = (Some(observation.values()), observation.avalanche());
    let write = DayWrite { date: path.date.0, values, forecast, avalanche };
    let author = Author { name: caller.name, at: clock::now(), source: "put" };
    let permits = |before: Option<&StoredDay>| conditions.permit_write(before.map(tag).as_deref());
    let (day, written) = state.store.put_day(&station.id, &write, &author, permits).await?;
    let status = if written == Written::Created { StatusCode::CREATED } else { StatusCode::OK };
    let resource = ObservationResource::new(&station.id, station.synthetic, &day)?;
    let mut response = respond::tagged(&Conditions::default(), status, &tag(&day), &resource)?;
    let location = format!("/v1/stations/{}/observations/{}", station.id, day.date);
    if let Ok(location) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

/// Every state of weather and snowpack that a day ever had, oldest first, with who wrote it and when.
#[utoipa::path(get, path = "/v1/stations/{station}/observations/{date}/revisions", operation_id = "list_observation_revisions",
    tag = "observations", params(DayPath), responses((status = 200, description = "The states.", body = RevisionList)))]
pub async fn list_revisions(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let station = state.station(&path.station).await?;
    let revisions = state.store.revisions(&station.id, path.date.0, Part::Observation).await?;
    if revisions.is_empty() {
        return Err(not_observed(&station.id, path.date).into());
    }
    respond::resource(&conditions, &RevisionList { revisions: revisions.into_iter().map(Into::into).collect() })
}
