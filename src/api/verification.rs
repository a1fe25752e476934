//! `/v1/stations/{station}/forecasts/verification`: how what was issued did.

use std::collections::HashMap;

use axum::{extract::State, response::Response};
use jiff::civil;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    AppState,
    extract::{Conditions, Date, Path, Query},
    forecasts::{Lead, Weather},
    problem::ApiResult,
    respond,
    speaker::model_lead,
    stations::StationPath,
};
use crate::{
    domain::{
        ids::{RegionId, StationId},
        problem::{Code, Problem},
    },
    science::forecast::{
        day::{DayRecord, Label},
        issued::{IssuedDay, Said, Verification, verify},
        model::InputQuality,
    },
    store::issued::{ForecasterCall, IssuedForecast},
};

/// The first and last day of a window without ends.
const ALWAYS: (civil::Date, civil::Date) = (civil::Date::constant(0, 1, 1), civil::Date::constant(9999, 12, 31));

/// What to verify.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct VerificationQuery {
    /// First day, YYYY-MM-DD; left out: the first that was issued.
    #[serde(default)]
    #[param(inline)]
    from: Option<Date>,
    /// Last day, YYYY-MM-DD; left out: the last that was issued.
    #[serde(default)]
    #[param(inline)]
    to: Option<Date>,
    /// Days between the last observation and the day that is forecast: 0 (nowcast) or 1.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1, default = 0)]
    lead: Lead,
    /// `forecast`, only with `lead=1`: the forecasts that read a weather forecast of their day.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(observed|forecast)$", default = "observed")]
    weather: Weather,
    /// Only what the model of this region said, judged by the avalanche days of the region; left out: only what was said of
    /// the station's own.
    #[serde(default)]
    #[param(inline)]
    region: Option<RegionId>,
    /// What counts as an avalanche day, `observed` or `presumed`: forecasts of models with the other label are left out.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(observed|presumed)$", default = "observed")]
    label: Option<Label>,
    /// Count what was issued, or called, after its day had ended; that is no forecast.
    #[serde(default)]
    #[param(value_type = Option<bool>, default = false)]
    hindcasts: Option<bool>,
    /// Cost of an unnecessary warning divided by the loss of a missed avalanche day, between 0 and 1: adds the expected cost.
    #[serde(default)]
    #[param(value_type = Option<f64>, minimum = 0.01, maximum = 0.99)]
    cost_loss_ratio: Option<Ratio>,
    /// Seed of the bootstrap over seasons.
    #[serde(default)]
    #[param(value_type = Option<u64>, minimum = 0, maximum = 9_007_199_254_740_991_u64, default = 0)]
    seed: Option<u64>,
}

/// A cost/loss ratio, 0.01 to 0.99.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
struct Ratio(f64);

impl TryFrom<f64> for Ratio {
    type Error = &'static str;

    fn try_from(ratio: f64) -> Result<Self, Self::Error> {
        if (0.01..=0.99).contains(&ratio) { Ok(Self(ratio)) } else { Err("must be from 0.01 to 0.99") }
    }
}

/// How what was issued for a station did.
#[derive(Serialize, ToSchema)]
pub struct VerificationResource {
    /// The station.
    station: StationId,
    /// The region whose avalanche days were forecast; null: the station's own.
    region: Option<RegionId>,
    /// True where the station's data were made by a generator.
    synthetic: bool,
    /// Days between the last observation and the day that is forecast.
    lead: u8,
    /// `forecast` where the weather of each day was a forecast, else `observed`.
    #[schema(value_type = String, example = "observed")]
    weather: Weather,
    /// What counts as an avalanche day.
    #[schema(value_type = String, example = "observed")]
    label: Label,
    /// True where what was said after its day had ended is counted too.
    hindcasts: bool,
    /// Forecasts of the window whose day has no known avalanche activity yet.
    waiting: usize,
    /// The scores.
    #[serde(flatten)]
    verification: Verification,
}

/// How what was issued did, over any window: the model, the forecaster's own calls, persistence and climatology side by side;
/// reliability, ROC, economic value, and signs of drift. A forecast is judged once the avalanche activity of its day is known.
#[utoipa::path(get, path = "/v1/stations/{station}/forecasts/verification", operation_id = "verify_forecasts",
    tag = "forecasts", params(StationPath, VerificationQuery),
    responses((status = 200, description = "The verification.", body = VerificationResource)))]
pub async fn verify_forecasts(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<VerificationQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    model_lead(query.lead.0, query.weather)?;
    let station = state.station(&path.station).await?;
    let (from, to) = (query.from.map_or(ALWAYS.0, |date| date.0), query.to.map_or(ALWAYS.1, |date| date.0));
    if from > to {
        let detail = format!("must not be before from, {from}");
        return Err(Problem::field(Code::InvalidParameter, "/to", "out_of_range", detail).into());
    }
    let (lead, label) = (query.lead.0, query.label.unwrap_or(Label::Observed));
    let (hindcasts, seed) = (query.hindcasts.unwrap_or(false), query.seed.unwrap_or(0));
    let mut issued =
        state.store.issued_forecasts(&station.id, from, to, lead, query.weather == Weather::Forecast).await?;
    issued.retain(|forecast| {
        forecast.label == label && forecast.region == query.region && (hindcasts || !forecast.hindcast)
    });
    let mut calls = state.store.forecaster_calls(&station.id, from, to, lead).await?;
    calls.retain(|call| hindcasts || !call.hindcast);
    let last = issued.last().map_or(from, |forecast| forecast.date);
    let history = history(&state, &station.id, query.region.as_ref(), label, last).await?;
    let cost_loss = query.cost_loss_ratio.map(|ratio| ratio.0);
    let (verification, waiting) = tokio::task::spawn_blocking(move || {
        let days = judged(&issued, &calls, &history, label);
        (verify(&days, &history, label, cost_loss, seed), issued.len() - days.len())
    })
    .await
    .map_err(Problem::internal)?;
    let answer = VerificationResource {
        station: station.id,
        region: query.region,
        synthetic: station.synthetic,
        lead,
        weather: query.weather,
        label,
        hindcasts,
        waiting,
        verification,
    };
    respond::resource(&conditions, &answer)
}

/// The days of the station until `last`; with the avalanche days of a region where that is what was forecast.
async fn history(
    state: &AppState,
    station: &StationId,
    region: Option<&RegionId>,
    label: Label,
    last: civil::Date,
) -> ApiResult<Vec<DayRecord>> {
    let Some(region) = region else { return Ok(state.store.day_records(station, ALWAYS.0, last).await?) };
    let region = state.region(region).await?;
    let days = state.store.regional_days(&region, label, ALWAYS.0, last).await?;
    // every station of a region has all of its days; one that has left it is judged by them as well
    let at = region.body.stations.iter().position(|id| id == station).unwrap_or(0);
    Ok(days.into_iter().nth(at).unwrap_or_default())
}

/// The forecasts whose outcome is known.
fn judged(issued: &[IssuedForecast], calls: &[ForecasterCall], history: &[DayRecord], label: Label) -> Vec<IssuedDay> {
    let calls: HashMap<civil::Date, &ForecasterCall> = calls.iter().map(|call| (call.date, call)).collect();
    let day = |forecast: &IssuedForecast| {
        let at = history.binary_search_by_key(&forecast.date, |day| day.date).ok()?;
        let inputs: InputQuality = serde_json::from_value(forecast.body["inputs"].clone()).unwrap_or_default();
        Some(IssuedDay {
            date: forecast.date,
            event: label.of(history[at].activity)?,
            model: Said { probability: forecast.probability, warned: forecast.warned },
            forecaster: calls.get(&forecast.date).map(|call| Said {
                probability: call.probability.unwrap_or(f64::from(u8::from(call.warned))),
                warned: call.warned,
            }),
            training_base_rate: forecast.base_rate,
            imputed: inputs.imputed,
            out_of_range: inputs.out_of_range,
        })
    };
    issued.iter().filter_map(day).collect()
}
