//! `/v1/stations/{station}/forecasts/{date}`: forecasts as they were issued, the forecaster's call beside them.

use axum::{extract::State, http::StatusCode, response::Response};
use jiff::{Timestamp, civil};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    auth::Caller,
    avalanches::DayPath,
    extract::{Conditions, Date, JsonBody, Path, Query},
    forecasts::{ForecastResource, Lead, Weather},
    models::LeadQuery,
    problem::ApiResult,
    respond,
    speaker::{Speaker, model_lead},
};
use crate::{
    clock,
    domain::{
        ids::StationId,
        problem::{Code, FieldError, Problem},
        station::Station,
    },
    science::forecast::model::{Category, SimilarDay},
    store::{
        StoreError,
        issued::{ForecasterCall, IssuedForecast},
        stations::Written,
    },
};

/// Similar days that are frozen with a forecast.
const KEPT_SIMILAR_DAYS: usize = 10;

/// Longest note of a call, characters.
const LONGEST_NOTE: usize = 2000;

/// Which of the forecasts of a day.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct IssueQuery {
    /// Days between the last observation that is used and the day that is forecast: 0 (nowcast) or 1.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1, default = 0)]
    lead: Lead,
    /// `forecast`, only with `lead=1`: the one that read the weather forecast of the day in the place of observations. It is issued
    /// beside the one of lead 1 that did not.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(observed|forecast)$", default = "observed")]
    weather: Weather,
}

/// A forecast as it was issued; it never changes.
#[derive(Serialize, ToSchema)]
pub struct IssuedResource {
    /// The station.
    station: StationId,
    /// The day that was forecast.
    #[schema(value_type = String, format = Date)]
    date: civil::Date,
    /// Days between the last observation and that day.
    lead: u8,
    /// `forecast` where the weather of the day was a forecast, else `observed`.
    #[schema(value_type = String, example = "observed")]
    weather: Weather,
    /// The model that spoke.
    model_id: Uuid,
    /// When it was issued.
    issued: Timestamp,
    /// The name of the key that issued it; null where no key was needed.
    issued_by: Option<String>,
    /// True where it was issued after the day had ended: no forecast, and left out of the verification unless asked for.
    hindcast: bool,
    /// The forecast as it was.
    #[schema(value_type = ForecastResource)]
    forecast: Value,
    /// The past days that were nearest to it, the most similar first; none of a forecast that was issued before they were kept.
    #[schema(value_type = Vec<SimilarDay>)]
    similar_days: Value,
    /// What the forecaster said of the day, if anything.
    call: Option<CallResource>,
}

/// The forecaster's own call of a day.
#[derive(Serialize, ToSchema)]
pub struct CallResource {
    /// Whether an avalanche day was forecast.
    warned: bool,
    /// With what probability; null where none was given.
    probability: Option<f64>,
    /// Danger level on the European scale, 1 to 5; null where none was set.
    danger_level: Option<u8>,
    /// In words.
    note: Option<String>,
    /// True where it was made after the day had ended.
    hindcast: bool,
    /// Counts the changes, from 1.
    revision: u32,
    /// When it was made.
    made: Timestamp,
    /// The name of the key that made it; null where no key was needed.
    made_by: Option<String>,
}

impl From<ForecasterCall> for CallResource {
    fn from(call: ForecasterCall) -> Self {
        Self {
            warned: call.warned,
            probability: call.probability,
            danger_level: call.danger_level,
            note: call.note,
            hindcast: call.hindcast,
            revision: call.revision,
            made: call.made,
            made_by: call.made_by,
        }
    }
}

/// A level as any JSON number: 3.0 is the number 3 as well.
fn danger_level<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Option<u8>, D::Error> {
    let Some(given) = Option::<f64>::deserialize(deserializer)? else { return Ok(None) };
    let level = (1..=5).find(|level| f64::from(*level) == given);
    level.map(Some).ok_or_else(|| serde::de::Error::custom("must be a whole number from 1 to 5"))
}

/// What a forecaster says of a day.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CallBody {
    /// Whether an avalanche day is forecast.
    warned: bool,
    /// With what probability, 0 to 1, if that can be said.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 1)]
    probability: Option<f64>,
    /// Danger level on the European scale, 1 to 5, if one is set: the only one that an export states.
    #[serde(default, deserialize_with = "danger_level")]
    #[schema(minimum = 1, maximum = 5)]
    danger_level: Option<u8>,
    /// In words, at most 2000 characters.
    #[serde(default)]
    #[schema(max_length = 2000)]
    note: Option<String>,
}

fn resource(station: &Station, issued: IssuedForecast, call: Option<ForecasterCall>) -> IssuedResource {
    IssuedResource {
        station: station.id.clone(),
        date: issued.date,
        lead: issued.lead,
        weather: if issued.forecast_weather { Weather::Forecast } else { Weather::Observed },
        model_id: issued.model,
        issued: issued.issued,
        issued_by: issued.issued_by,
        hindcast: issued.hindcast,
        forecast: issued.body,
        similar_days: issued.similar_days,
        call: call.map(Into::into),
    }
}

fn tag(issued: &IssuedForecast) -> String {
    format!("\"{}\"", issued.issued.as_millisecond())
}

/// Whether a day of the station has ended.
fn has_ended(station: &Station, date: civil::Date) -> bool {
    clock::today(&station.zone()) > date
}

/// Issues the forecast of a day by the active model: it is frozen as it is now, whatever becomes of observations and models,
/// and is what the verification judges. An issued forecast cannot be issued again.
#[utoipa::path(put, path = "/v1/stations/{station}/forecasts/{date}", operation_id = "issue_forecast", tag = "forecasts",
    params(DayPath, IssueQuery),
    responses((status = 201, description = "The forecast was issued.", body = IssuedResource)))]
pub async fn issue_forecast(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    Query(query): Query<IssueQuery>,
    conditions: Conditions,
    caller: Caller,
) -> ApiResult<Response> {
    let speaker = Speaker::find(&state, &path.station, query.lead, query.weather, None).await?;
    let with_weather = query.weather == Weather::Forecast;
    let before = state.store.issued_forecast(&speaker.station.id, path.date.0, speaker.lead, with_weather).await?;
    if !conditions.permit_write(before.as_ref().map(tag).as_deref()) {
        return Err(StoreError::Precondition.into());
    }
    let forecast = speaker.forecast(&state, path.date.0).await?;
    let history = speaker.history_of(&state, path.date.0).await?;
    let similar_days = match speaker.model.similar_days(&history, path.date.0, KEPT_SIMILAR_DAYS) {
        Ok(days) => serde_json::to_value(days).map_err(Problem::internal)?,
        Err(error) => return Err(speaker.refuse(&state, error).await?.into()),
    };
    let issued = IssuedForecast {
        date: path.date.0,
        lead: speaker.lead,
        forecast_weather: with_weather,
        model: speaker.id,
        region: speaker.region.as_ref().map(|region| region.id.clone()),
        probability: forecast.probability,
        warned: forecast.category == Category::AvalancheDay,
        base_rate: speaker.model.base_rate,
        label: speaker.model.label,
        hindcast: has_ended(&speaker.station, path.date.0),
        body: serde_json::to_value(&forecast).map_err(Problem::internal)?,
        similar_days,
        issued: clock::now(),
        issued_by: caller.name,
    };
    if !state.store.issue_forecast(&speaker.station.id, &issued).await? {
        let detail =
            format!("the forecast of {} with lead {} was issued before and stays as it is", issued.date, issued.lead);
        return Err(Problem::new(Code::ForecastFrozen, detail).into());
    }
    let call = call_of(&state, &speaker.station.id, path.date, speaker.lead).await?;
    let tag = tag(&issued);
    respond::tagged(&Conditions::default(), StatusCode::CREATED, &tag, &resource(&speaker.station, issued, call))
}

async fn call_of(state: &AppState, station: &StationId, date: Date, lead: u8) -> ApiResult<Option<ForecasterCall>> {
    Ok(state.store.forecaster_calls(station, date.0, date.0, lead).await?.pop())
}

/// The forecast of a day as it was issued, with the forecaster's call.
#[utoipa::path(get, path = "/v1/stations/{station}/forecasts/{date}/issued", operation_id = "get_issued_forecast",
    tag = "forecasts", params(DayPath, IssueQuery),
    responses((status = 200, description = "The forecast.", body = IssuedResource)))]
pub async fn get_issued_forecast(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    Query(query): Query<IssueQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    model_lead(query.lead.0, query.weather)?;
    let station = state.station(&path.station).await?;
    let with_weather = query.weather == Weather::Forecast;
    let issued = state.store.issued_forecast(&station.id, path.date.0, query.lead.0, with_weather).await?;
    let issued = issued.ok_or_else(|| {
        let detail = format!("no forecast of {} with lead {} was issued for {}", path.date.0, query.lead.0, station.id);
        Problem::new(Code::NotIssued, detail)
    })?;
    let call = call_of(&state, &station.id, path.date, query.lead.0).await?;
    respond::resource(&conditions, &resource(&station, issued, call))
}

/// Records the forecaster's own call of a day, which is verified beside the model. It may be changed until the day has
/// ended; what is said later counts as a hindcast and is frozen at once.
#[utoipa::path(put, path = "/v1/stations/{station}/forecasts/{date}/call", operation_id = "put_forecaster_call",
    tag = "forecasts", params(DayPath, LeadQuery),
    request_body(content = CallBody, example = json!({"warned": true, "probability": 0.7, "danger_level": 3})),
    responses((status = 200, description = "The call was known; this is it now.", body = CallResource),
              (status = 201, description = "The call is new.", body = CallResource)))]
pub async fn put_forecaster_call(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    Query(query): Query<LeadQuery>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(body): JsonBody<CallBody>,
) -> ApiResult<Response> {
    check(&body)?;
    let station = state.station(&path.station).await?;
    let ended = has_ended(&station, path.date.0);
    let call = ForecasterCall {
        date: path.date.0,
        lead: query.lead.0,
        warned: body.warned,
        probability: body.probability,
        danger_level: body.danger_level,
        note: body.note,
        hindcast: ended,
        revision: 0,
        made: clock::now(),
        made_by: caller.name,
    };
    let mut frozen = false;
    let permits = |before: Option<&ForecasterCall>| {
        frozen = ended && before.is_some();
        let tag = before.map(|before| format!("\"{}\"", before.revision));
        !frozen && conditions.permit_write(tag.as_deref())
    };
    let written = state.store.put_forecaster_call(&station.id, &call, permits).await;
    if frozen {
        let detail = format!("the day {} has ended, and the call that was made of it stays as it is", path.date.0);
        return Err(Problem::new(Code::ForecastFrozen, detail).into());
    }
    let (call, written) = written?;
    let status = if written == Written::Created { StatusCode::CREATED } else { StatusCode::OK };
    let tag = format!("\"{}\"", call.revision);
    respond::tagged(&Conditions::default(), status, &tag, &CallResource::from(call))
}

fn check(body: &CallBody) -> Result<(), Problem> {
    let mut faults = Vec::new();
    if body.probability.is_some_and(|probability| !(0.0..=1.0).contains(&probability)) {
        faults.push(FieldError::new("/probability", "out_of_range", "must be from 0 to 1"));
    }
    if body.note.as_ref().is_some_and(|note| note.chars().count() > LONGEST_NOTE) {
        faults.push(FieldError::new("/note", "too_long", format!("must be at most {LONGEST_NOTE} characters")));
    }
    match faults.first() {
        Some(first) => Err(Problem::new(Code::InvalidBody, first.detail.clone()).with_errors(faults)),
        None => Ok(()),
    }
}
