//! `/v1/stations/{station}/forecasts`: what the active model says of a day, and which past days speak for it.

use std::{collections::HashMap, sync::Arc};

use axum::{extract::State, response::Response};
use jiff::{ToSpan, civil};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    avalanches::DayPath,
    extract::{Conditions, Date, Path, Query},
    problem::ApiResult,
    respond,
    speaker::{Speaker, season_begins},
    stations::{Limit, StationPath},
};
use crate::{
    domain::{
        avalanche::AvalancheRecord,
        ids::{RegionId, StationId},
        problem::{Code, Problem},
    },
    science::forecast::model::{Category, Explanation, Forecast, ForecastError, InputQuality, SimilarDay},
};

/// Days between the last observation and the day that is forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
// 1.0 is the number 1 as well: JSON has no other integers
#[serde(try_from = "f64")]
pub struct Lead(pub u8);

impl TryFrom<f64> for Lead {
    type Error = &'static str;

    fn try_from(lead: f64) -> Result<Self, Self::Error> {
        match lead {
            0.0 => Ok(Self(0)),
            1.0 => Ok(Self(1)),
            _ => Err("must be 0 (nowcast) or 1 (tomorrow)"),
        }
    }
}

/// What the weather of the day itself is to a forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Weather {
    /// What was observed up to the base day.
    #[default]
    Observed,
    /// The weather forecast of the day stands in for what will be observed.
    Forecast,
}

/// Which forecast of the day.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ForecastQuery {
    /// Days between the last observation that is used and the day that is forecast: 0 (nowcast) or 1.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1, default = 0)]
    lead: Lead,
    /// `forecast`, only with `lead=1`: the active model of lead 0 reads the weather forecast of the day in the place of observations.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(observed|forecast)$", default = "observed")]
    weather: Weather,
    /// A model other than the active one; it must be of this lead, and of this station or a region that it belongs to.
    #[serde(default)]
    model_id: Option<Uuid>,
}

/// Which similar days.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct SimilarQuery {
    /// Days between the last observation that is used and the day that is forecast: 0 (nowcast) or 1.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1, default = 0)]
    lead: Lead,
    /// `forecast`, only with `lead=1`: the active model of lead 0 reads the weather forecast of the day in the place of observations.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(observed|forecast)$", default = "observed")]
    weather: Weather,
    /// A model other than the active one; it must be of this lead, and of this station or a region that it belongs to.
    #[serde(default)]
    model_id: Option<Uuid>,
    /// Largest number of days in the answer, 1 to 1000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1000, default = 10)]
    limit: Option<Limit<10, 1000>>,
}

/// Forecasts of which days.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ForecastsQuery {
    /// First day that is forecast, YYYY-MM-DD; left out: the beginning of the season of `to`.
    #[serde(default)]
    #[param(inline)]
    from: Option<Date>,
    /// Last day that is forecast, YYYY-MM-DD, at most 400 days after `from`; left out: the newest that can be forecast.
    #[serde(default)]
    #[param(inline)]
    to: Option<Date>,
    /// Days between the last observation that is used and the day that is forecast: 0 (nowcast) or 1.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1, default = 0)]
    lead: Lead,
    /// A model other than the active one; it must be of this lead, and of this station or a region that it belongs to.
    #[serde(default)]
    model_id: Option<Uuid>,
}

/// A forecast of one day.
#[derive(Serialize, ToSchema)]
pub struct ForecastResource {
    /// The station.
    pub(super) station: StationId,
    /// The region whose model spoke, as the station has none of its own: the probability is that of an avalanche day of the
    /// region. Null where the station's own model spoke.
    pub(super) region: Option<RegionId>,
    /// True where the station or the model is made of data from a generator: no forecast of a real place.
    pub(super) synthetic: bool,
    /// The day that is forecast.
    pub(super) date: Date,
    /// Days between the last observation that was used and the day that is forecast.
    pub(super) lead: u8,
    /// The newest day of which observations were used.
    pub(super) base_date: Date,
    /// What counts as an avalanche day: `observed` or `presumed`.
    #[schema(value_type = String, example = "observed")]
    pub(super) label: crate::science::forecast::day::Label,
    /// Calibrated probability of an avalanche day.
    #[schema(minimum = 0, maximum = 1)]
    pub(super) probability: f64,
    /// What the probability means against the threshold.
    #[schema(value_type = String, example = "avalanche_day")]
    pub(super) category: Category,
    /// From this probability on a day counts as an avalanche day.
    #[schema(minimum = 0, maximum = 1)]
    pub(super) threshold: f64,
    /// Decision value of the machine, 0 on its boundary.
    pub(super) decision_value: f64,
    /// The model that said so.
    pub(super) model_id: Uuid,
    /// The feature set that the model looks at.
    #[schema(value_type = String, example = "expert")]
    pub(super) feature_set: crate::science::forecast::features::FeatureSetId,
    /// The version of the feature set.
    pub(super) feature_set_version: u32,
    /// What the inputs lacked.
    pub(super) inputs: InputQuality,
    /// Version of firn, SHA-256 of what the model was trained on, and its seed.
    #[schema(value_type = Object)]
    pub(super) provenance: Value,
}

/// Forecasts of a range of days.
#[derive(Serialize, ToSchema)]
pub struct ForecastList {
    /// In the order of the days; a day whose base day has no observation is not in the list.
    forecasts: Vec<ForecastResource>,
}

/// The past days that are nearest to a forecast in the eyes of its machine.
#[derive(Serialize, ToSchema)]
pub struct SimilarDays {
    /// The station.
    station: StationId,
    /// True where the days are those of a generator and never happened.
    synthetic: bool,
    /// The day that is forecast.
    date: Date,
    /// Days between the last observation that was used and the day that is forecast.
    lead: u8,
    /// The model.
    model_id: Uuid,
    /// Most similar first; only days that the machine remembers (its support vectors).
    similar_days: Vec<SimilarDayResource>,
}

/// A past day that is similar, and what avalanches it had.
#[derive(Serialize, ToSchema)]
pub struct SimilarDayResource {
    /// The station whose day it was: another one only where the model is that of a region.
    station: StationId,
    /// The day and what it adds.
    #[serde(flatten)]
    day: SimilarDay,
    /// The avalanche record of that day as it is now; null where there is none.
    avalanches: Option<AvalancheRecord>,
}

/// Why a forecast says what it says.
#[derive(Serialize, ToSchema)]
pub struct ForecastExplanation {
    /// The station.
    station: StationId,
    /// True where the station or the model is made of data from a generator.
    synthetic: bool,
    /// The day that is forecast.
    date: Date,
    /// Days between the last observation that was used and the day that is forecast.
    lead: u8,
    /// The model.
    model_id: Uuid,
    /// The decision value, taken apart.
    #[serde(flatten)]
    explanation: Explanation,
}

/// The forecast of a day by the active model, or by `model_id`. It is computed from what is stored now. A station without an
/// active model of its own is forecast by that of the first of its regions that has one; `region` says so.
#[utoipa::path(get, path = "/v1/stations/{station}/forecasts/{date}", operation_id = "get_forecast", tag = "forecasts",
    params(DayPath, ForecastQuery), responses((status = 200, description = "The forecast.", body = ForecastResource)))]
pub async fn get_forecast(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    Query(query): Query<ForecastQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let speaker = Speaker::find(&state, &path.station, query.lead, query.weather, query.model_id).await?;
    respond::resource(&conditions, &speaker.forecast(&state, path.date.0).await?)
}

/// The forecast of the newest day that can be forecast.
#[utoipa::path(get, path = "/v1/stations/{station}/forecasts/latest", operation_id = "get_latest_forecast", tag = "forecasts",
    params(StationPath, ForecastQuery), responses((status = 200, description = "The forecast.", body = ForecastResource)))]
pub async fn get_latest_forecast(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<ForecastQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let speaker = Speaker::find(&state, &path.station, query.lead, query.weather, query.model_id).await?;
    let date = speaker.newest(&state).await?;
    respond::resource(&conditions, &speaker.forecast(&state, date).await?)
}

/// The forecasts of a range of days: what the model says now of days that have passed. A day that was in the training
/// of the model is not a fair test of it; `/v1/models/{model}/evaluation` is.
#[utoipa::path(get, path = "/v1/stations/{station}/forecasts", operation_id = "list_forecasts", tag = "forecasts",
    params(StationPath, ForecastsQuery), responses((status = 200, description = "The forecasts.", body = ForecastList)))]
pub async fn list_forecasts(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<ForecastsQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    const LONGEST_DAYS: i32 = 400;
    let speaker = Speaker::find(&state, &path.station, query.lead, Weather::Observed, query.model_id).await?;
    let last = match query.to {
        Some(to) => to.0,
        None => speaker.newest(&state).await?,
    };
    let first = match query.from {
        Some(from) => from.0,
        None => season_begins(last),
    };
    let length = (last - first).get_days();
    if !(0..=LONGEST_DAYS).contains(&length) {
        let detail = format!("must be from 0 to {LONGEST_DAYS} days after from, {first}");
        return Err(Problem::field(Code::InvalidParameter, "/to", "out_of_range", detail).into());
    }
    let history = speaker.history(&state, first, last).await?;
    let model = Arc::clone(&speaker.model);
    let forecasts = tokio::task::spawn_blocking(move || {
        let days = first.series(1.day()).take_while(|date| *date <= last);
        let forecast = |date| match model.forecast(&history, date) {
            // a day that cannot be forecast is left out; a model that cannot forecast at all is not
            Err(ForecastError::NoObservation { .. } | ForecastError::NoBaseDay { .. }) => None,
            other => Some(other),
        };
        days.filter_map(forecast).collect::<Result<Vec<Forecast>, _>>()
    })
    .await
    .map_err(Problem::internal)?;
    let forecasts = match forecasts {
        Ok(forecasts) => forecasts,
        Err(error) => return Err(speaker.refuse(&state, error).await?.into()),
    };
    let forecasts = forecasts.into_iter().map(|forecast| speaker.resource(forecast, &[])).collect();
    respond::resource(&conditions, &ForecastList { forecasts })
}

/// Why a forecast says what it says: what each feature adds to the decision value (with the base they add up to it exactly),
/// which features were imputed and with what, and which are outside of their range in training.
#[utoipa::path(get, path = "/v1/stations/{station}/forecasts/{date}/explanation", operation_id = "explain_forecast",
    tag = "forecasts", params(DayPath, ForecastQuery),
    responses((status = 200, description = "The explanation.", body = ForecastExplanation)))]
pub async fn explain_forecast(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    Query(query): Query<ForecastQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let speaker = Speaker::find(&state, &path.station, query.lead, query.weather, query.model_id).await?;
    let history = speaker.history_of(&state, path.date.0).await?;
    let explanation = match speaker.model.explain(&history, path.date.0) {
        Ok(explanation) => explanation,
        Err(error) => return Err(speaker.refuse(&state, error).await?.into()),
    };
    let answer = ForecastExplanation {
        station: speaker.station.id.clone(),
        synthetic: speaker.synthetic,
        date: path.date,
        lead: speaker.lead,
        model_id: speaker.id,
        explanation,
    };
    respond::resource(&conditions, &answer)
}

/// The past days that are nearest to a forecast in the eyes of its machine: their date, what happened, the kernel value,
/// and the signed contribution alpha y k to the decision value. A day of the training may be in its own list, with kernel
/// value 1: with it the contributions of all days add up to the decision value and the offset of the machine.
#[utoipa::path(get, path = "/v1/stations/{station}/forecasts/{date}/similar-days", operation_id = "list_similar_days",
    tag = "forecasts", params(DayPath, SimilarQuery), responses((status = 200, description = "The days.", body = SimilarDays)))]
pub async fn list_similar_days(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    Query(query): Query<SimilarQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let speaker = Speaker::find(&state, &path.station, query.lead, query.weather, query.model_id).await?;
    let history = speaker.history_of(&state, path.date.0).await?;
    let count = Limit::or_default(query.limit) as usize;
    let days = match speaker.model.similar_days(&history, path.date.0, count) {
        Ok(days) => days,
        Err(error) => return Err(speaker.refuse(&state, error).await?.into()),
    };
    let station_of = |day: &SimilarDay| speaker.trained_on.get(day.station).unwrap_or(&speaker.station.id).clone();
    let mut dates: HashMap<StationId, Vec<civil::Date>> = HashMap::new();
    days.iter().for_each(|day| dates.entry(station_of(day)).or_default().push(day.date));
    let mut records = HashMap::new();
    for (station, dates) in dates {
        let of_station = state.store.avalanches_on(&station, &dates).await?;
        records.insert(station, of_station);
    }
    let resource = |day: SimilarDay| {
        let station = station_of(&day);
        let avalanches = records.get(&station).and_then(|of_station| of_station.get(&day.date)).copied();
        SimilarDayResource { station, avalanches, day }
    };
    let similar_days = days.into_iter().map(resource).collect();
    let answer = SimilarDays {
        station: speaker.station.id.clone(),
        synthetic: speaker.synthetic,
        date: path.date,
        lead: speaker.lead,
        model_id: speaker.id,
        similar_days,
    };
    respond::resource(&conditions, &answer)
}
