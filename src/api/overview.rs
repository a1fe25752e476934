//! `/v1/forecasts`: the forecast of every station in one answer.

use axum::{extract::State, response::Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    AppState,
    extract::{Conditions, Date, Query},
    forecasts::{ForecastResource, Lead, Weather},
    problem::{ApiError, ApiResult},
    respond,
    speaker::{Speaker, model_lead},
    stations::Limit,
};
use crate::domain::{
    ids::StationId,
    problem::Problem,
    station::{Station, StationName},
    units::{Altitude, Latitude, Longitude},
};

/// Which forecast of each station.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct OverviewQuery {
    /// The day that is forecast, YYYY-MM-DD; left out: of each station the newest that can be.
    #[serde(default)]
    #[param(inline)]
    date: Option<Date>,
    /// Days between the last observation that is used and the day that is forecast: 0 (nowcast) or 1.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1, default = 0)]
    lead: Lead,
    /// `forecast`, only with `lead=1`: the active model of lead 0 reads the weather forecast of the day in the place of observations.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(observed|forecast)$", default = "observed")]
    weather: Weather,
    /// Largest number of stations in the answer, 1 to 1000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1000, default = 100)]
    limit: Option<Limit<100, 1000>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    cursor: Option<String>,
}

/// A station with its forecast.
#[derive(Serialize, ToSchema)]
pub struct StationForecast {
    /// The station.
    station: StationId,
    /// Its name for humans.
    name: StationName,
    /// Latitude, degrees north (WGS 84).
    latitude: Option<Latitude>,
    /// Longitude, degrees east (WGS 84).
    longitude: Option<Longitude>,
    /// Altitude above sea level, m.
    altitude_m: Option<Altitude>,
    /// True for a station whose data were made by a generator.
    synthetic: bool,
    /// The forecast; null where there is none.
    forecast: Option<ForecastResource>,
    /// Why there is none; null where there is one.
    missing: Option<Missing>,
}

/// Why a station has no forecast.
#[derive(Serialize, ToSchema)]
pub struct Missing {
    /// The code of the problem that asking for this forecast alone would be answered with.
    #[schema(example = "no-active-model")]
    code: &'static str,
    /// In words.
    detail: String,
}

/// A page of stations with their forecasts.
#[derive(Serialize, ToSchema)]
pub struct Overview {
    /// Stations in the order of their names.
    forecasts: Vec<StationForecast>,
    /// The `cursor` of the next page; null on the last.
    next: Option<String>,
}

/// The forecast of every station by its active model, for a map or a list: of one day, or of the newest of each station. A
/// station that cannot be forecast is in the list and says why.
#[utoipa::path(get, path = "/v1/forecasts", operation_id = "list_station_forecasts", tag = "forecasts",
    params(OverviewQuery), responses((status = 200, description = "A page of stations.", body = Overview)))]
pub async fn list_station_forecasts(
    State(state): State<AppState>,
    Query(query): Query<OverviewQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    model_lead(query.lead.0, query.weather)?;
    let limit = Limit::or_default(query.limit);
    let after = query.cursor.unwrap_or_default();
    let mut stations = state.store.stations(&after, limit + 1).await?;
    let more = stations.len() > limit as usize;
    stations.truncate(limit as usize);
    let next = stations.last().filter(|_| more).map(|last| last.id.to_string());
    // side by side: the store has several readers, the machines several cores
    let (date, lead, weather) = (query.date, query.lead, query.weather);
    let tasks: Vec<_> = stations
        .into_iter()
        .map(|station| tokio::spawn(of_station(state.clone(), station, date, lead, weather)))
        .collect();
    let mut forecasts = Vec::with_capacity(tasks.len());
    for task in tasks {
        forecasts.push(task.await.map_err(Problem::internal)??);
    }
    let answer = Overview { forecasts, next };
    let mut response = respond::resource(&conditions, &answer)?;
    if let Some(cursor) = &answer.next {
        let date = date.map_or_else(String::new, |date| format!("&date={}", date.0));
        let weather = if weather == Weather::Forecast { "&weather=forecast" } else { "" };
        let url = format!("/v1/forecasts?lead={}{weather}{date}&limit={limit}&cursor={cursor}", lead.0);
        respond::link_next(&mut response, &url);
    }
    Ok(response)
}

async fn of_station(
    state: AppState,
    station: Station,
    date: Option<Date>,
    lead: Lead,
    weather: Weather,
) -> ApiResult<StationForecast> {
    let (forecast, missing) = match forecast(&state, &station.id, date, lead, weather).await {
        Ok(forecast) => (Some(forecast), None),
        // a refusal is of this station alone; a failure is one of the whole answer
        Err(ApiError(problem)) if problem.code.status() < 500 => {
            (None, Some(Missing { code: problem.code.slug(), detail: problem.detail }))
        }
        Err(failure) => return Err(failure),
    };
    Ok(StationForecast {
        station: station.id,
        name: station.body.name,
        latitude: station.body.latitude,
        longitude: station.body.longitude,
        altitude_m: station.body.altitude_m,
        synthetic: station.synthetic,
        forecast,
        missing,
    })
}

async fn forecast(
    state: &AppState,
    station: &StationId,
    date: Option<Date>,
    lead: Lead,
    weather: Weather,
) -> ApiResult<ForecastResource> {
    let speaker = Speaker::find(state, station, lead, weather, None).await?;
    let date = match date {
        Some(date) => date.0,
        None => speaker.newest(state).await?,
    };
    speaker.forecast(state, date).await
}
