//! `/v1/regions/{region}/forecasts/{date}`: what the models say of a region and of each of its stations.

use axum::{extract::State, response::Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Date, Path, Query},
    forecasts::{ForecastResource, Lead, Weather},
    models::{self, LeadQuery},
    problem::ApiResult,
    respond,
    speaker::{Speaker, before, season_begins},
};
use crate::{
    domain::{
        ids::{Place, RegionId, StationId},
        problem::{Code, Problem},
        region::Region,
    },
    science::forecast::{
        day::{DayRecord, Label},
        model::{Category, Forecast, ForecastError, InputQuality},
        region::mean,
    },
    store::models::ModelRecord,
};

/// How the probability of a region comes about.
const METHOD: &str = "mean of the probabilities that the region's model gives from the observations of each station";

/// Which day of which region.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct RegionDayPath {
    /// Name of the region.
    #[param(inline)]
    pub region: RegionId,
    /// The local day of the stations, YYYY-MM-DD.
    #[param(inline)]
    pub date: Date,
}

/// A forecast of a region, with one of each station.
#[derive(Serialize, ToSchema)]
pub struct RegionForecast {
    /// The region.
    region: RegionId,
    /// True where the model was trained on, or a station has, data that a generator made.
    synthetic: bool,
    /// The day that is forecast.
    date: Date,
    /// Days between the last observation that was used and the day that is forecast.
    lead: u8,
    /// What counts as an avalanche day at a station.
    #[schema(value_type = String, example = "observed")]
    label: Label,
    /// Probability of an avalanche day of the region.
    #[schema(minimum = 0, maximum = 1)]
    probability: f64,
    /// What the probability means against the threshold.
    #[schema(value_type = String, example = "avalanche_day")]
    category: Category,
    /// From this probability on a day counts as an avalanche day of the region.
    #[schema(minimum = 0, maximum = 1)]
    threshold: f64,
    /// How the probability came about.
    method: &'static str,
    /// Stations whose observations it was made from; the others have none of the base day.
    stations_used: usize,
    /// The region's model that said so.
    model_id: Uuid,
    /// True where the stations of the region, or what its avalanche days are, have changed since the model was trained.
    changed_since_training: bool,
    /// Version of firn, SHA-256 of what the model was trained on, and its seed.
    #[schema(value_type = Object)]
    provenance: Value,
    /// Each station of the region, in its order.
    stations: Vec<RegionStationForecast>,
}

/// What the models say of one station of a region.
#[derive(Serialize, ToSchema)]
pub struct RegionStationForecast {
    /// The station.
    station: StationId,
    /// What the region's model makes of its observations: a part of the mean. Null where it has none of the base day.
    regional: Option<RegionalPart>,
    /// Who forecasts for the station: `station` where it has an active model of its own, else `region`.
    made_by: &'static str,
    /// The forecast of the station: of its own avalanche days by its own model, else of those of the region. Null where it has no
    /// observation of the base day.
    forecast: Option<ForecastResource>,
}

/// What the region's model makes of the observations of one station.
#[derive(Serialize, ToSchema)]
pub struct RegionalPart {
    /// Probability of an avalanche day of the region.
    probability: f64,
    /// Decision value of the machine, 0 on its boundary.
    decision_value: f64,
    /// What the inputs lacked.
    inputs: InputQuality,
}

/// Whether the region is still what the model was trained for.
fn has_changed(region: &Region, record: &ModelRecord) -> bool {
    let trained = &record.summary["training"];
    let rule = serde_json::to_value(region.body.avalanche_day).unwrap_or_default();
    record.stations() != region.body.stations || trained["region"]["avalanche_day"] != rule
}

/// The forecast of a day, or none where the station has no observation to make one from.
async fn of_station(
    state: &AppState,
    speaker: &Speaker,
    days: &[DayRecord],
    date: Date,
) -> ApiResult<Option<Forecast>> {
    match speaker.model.forecast(days, date.0) {
        Ok(forecast) => Ok(Some(forecast)),
        Err(ForecastError::NoObservation { .. }) => Ok(None),
        Err(error) => Err(speaker.refuse(state, error).await?.into()),
    }
}

/// The forecast of a region on a day by its active model, and of each of its stations by the station's own active model or,
/// where it has none, by that of the region. It is computed from what is stored now.
#[utoipa::path(get, path = "/v1/regions/{region}/forecasts/{date}", operation_id = "get_region_forecast", tag = "regions",
    params(RegionDayPath, LeadQuery), responses((status = 200, description = "The forecast.", body = RegionForecast)))]
pub async fn get_region_forecast(
    State(state): State<AppState>,
    Path(path): Path<RegionDayPath>,
    Query(query): Query<LeadQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let region = state.region(&path.region).await?;
    let lead = query.lead.0;
    let place = Place::Region(region.id.clone());
    let active = state.store.active_model(&place, lead).await?.ok_or_else(|| models::none_active(&place, lead))?;
    let record = state.store.model(active.model).await?.ok_or_else(|| models::unknown(active.model))?;
    let from = season_begins(before(path.date.0, lead)?);
    let model = state.store.trained_model(record.id).await?.ok_or_else(|| models::unknown(record.id))?;
    let days = state.store.regional_days(&region, model.label, from, path.date.0).await?;
    let (mut stations, mut synthetic) = (Vec::with_capacity(days.len()), record.is_synthetic());
    for (id, days) in region.body.stations.iter().zip(&days) {
        let station_of = state.station(id).await?;
        let speaker = Speaker::of(&state, station_of, Some(region.clone()), &record, lead, Weather::Observed).await?;
        synthetic |= speaker.synthetic;
        stations.push(station(&state, &speaker, days, path.date, Lead(lead)).await?);
    }
    let parts: Vec<f64> = stations.iter().filter_map(|station| Some(station.regional.as_ref()?.probability)).collect();
    if parts.is_empty() {
        let detail = format!("no station of {} has an observation that a forecast of {} needs", region.id, path.date.0);
        return Err(Problem::new(Code::NoObservation, detail).into());
    }
    let probability = mean(&parts);
    let warned = probability >= model.threshold;
    let answer = RegionForecast {
        changed_since_training: has_changed(&region, &record),
        region: region.id,
        synthetic,
        date: path.date,
        lead,
        label: model.label,
        probability,
        category: if warned { Category::AvalancheDay } else { Category::NoAvalancheDay },
        threshold: model.threshold,
        method: METHOD,
        stations_used: parts.len(),
        model_id: record.id,
        provenance: record.summary.get("provenance").cloned().unwrap_or(Value::Null),
        stations,
    };
    respond::resource(&conditions, &answer)
}

/// What the region's model, and the station's own where it has one, make of the days of a station.
async fn station(
    state: &AppState,
    speaker: &Speaker,
    days: &[DayRecord],
    date: Date,
    lead: Lead,
) -> ApiResult<RegionStationForecast> {
    let regional = of_station(state, speaker, days, date).await?;
    let id = speaker.station.id.clone();
    let own = state.store.active_model(&Place::Station(id.clone()), lead.0).await?;
    let (made_by, forecast) = match own {
        Some(own) => {
            let own = Speaker::find(state, &id, lead, Weather::Observed, Some(own.model)).await?;
            let days = own.history(state, date.0, date.0).await?;
            ("station", of_station(state, &own, &days, date).await?.map(|forecast| own.resource(forecast, &days)))
        }
        None => ("region", regional.clone().map(|forecast| speaker.resource(forecast, days))),
    };
    let regional = regional.map(|forecast| RegionalPart {
        probability: forecast.probability,
        decision_value: forecast.decision_value,
        inputs: forecast.inputs,
    });
    Ok(RegionStationForecast { station: id, regional, made_by, forecast })
}
