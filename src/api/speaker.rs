//! Who speaks of a day: which model, of a station or of a region, from which days.

use std::sync::Arc;

use jiff::{ToSpan, civil};
use serde_json::Value;
use uuid::Uuid;

use super::{
    AppState,
    extract::Date,
    forecasts::{ForecastResource, Lead, Weather},
    models,
    problem::ApiResult,
};
use crate::{
    clock,
    domain::{
        ids::{Place, StationId},
        problem::{Code, Problem},
        region::Region,
        station::Station,
    },
    science::forecast::{
        day::{DayRecord, season_of},
        model::{Forecast, ForecastError, TrainedModel},
    },
    store::{models::ModelRecord, observations::StoredDay},
};

/// The model that is to speak, and where its words come from.
pub(super) struct Speaker {
    pub(super) station: Station,
    /// The region whose model it is; none: the station's own.
    pub(super) region: Option<Region>,
    /// Days between the last observation that is read and the day that is forecast.
    pub(super) lead: u8,
    pub(super) weather: Weather,
    pub(super) id: Uuid,
    pub(super) model: Arc<TrainedModel>,
    /// The stations that it was trained on, in the order of the training.
    pub(super) trained_on: Vec<StationId>,
    pub(super) provenance: Value,
    pub(super) synthetic: bool,
}

impl Speaker {
    pub(super) async fn find(
        state: &AppState,
        station: &StationId,
        lead: Lead,
        weather: Weather,
        model: Option<Uuid>,
    ) -> ApiResult<Self> {
        let lead = lead.0;
        let of_model = model_lead(lead, weather)?;
        let station = state.station(station).await?;
        let (id, region) = match model {
            Some(id) => (id, None),
            None => active(state, &station, of_model).await?,
        };
        let record = state.store.model(id).await?.ok_or_else(|| models::unknown(id))?;
        let region = match (&record.place, region) {
            (Place::Region(id), None) => state.store.region(id).await?,
            (_, region) => region,
        };
        let fits = match (&record.place, &region) {
            (Place::Station(id), _) => *id == station.id,
            (Place::Region(_), region) => {
                region.as_ref().is_some_and(|region| region.body.stations.contains(&station.id))
            }
        };
        if !fits || record.lead != of_model {
            let detail = format!(
                "must be a model of lead {of_model}, and of station {} or a region that it belongs to",
                station.id
            );
            return Err(Problem::field(Code::ModelMismatch, "/model_id", "model_mismatch", detail).into());
        }
        Self::of(state, station, region, &record, lead, weather).await
    }

    /// The model of a record, which must be of the station, or of the region that is given, and of the lead of the model
    /// that speaks for `lead` and `weather`.
    pub(super) async fn of(
        state: &AppState,
        station: Station,
        region: Option<Region>,
        record: &ModelRecord,
        lead: u8,
        weather: Weather,
    ) -> ApiResult<Self> {
        let model = state.store.trained_model(record.id).await?.ok_or_else(|| models::unknown(record.id))?;
        let provenance = record.summary.get("provenance").cloned().unwrap_or(Value::Null);
        let synthetic = station.synthetic || record.is_synthetic();
        let (id, trained_on) = (record.id, record.stations());
        Ok(Self { station, region, lead, weather, id, model, trained_on, provenance, synthetic })
    }

    /// What the model reads for the forecasts of `first` to `last`: no feature reaches beyond the edge of a season.
    pub(super) async fn history(
        &self,
        state: &AppState,
        first: civil::Date,
        last: civil::Date,
    ) -> ApiResult<Vec<DayRecord>> {
        let from = season_begins(before(first, self.lead)?);
        let Some(region) = &self.region else {
            return Ok(state.store.day_records(&self.station.id, from, last).await?);
        };
        // the avalanches that a model of a region knows of are those of the region
        let days = state.store.regional_days(region, self.model.label, from, last).await?;
        let mut stations = region.body.stations.iter().zip(days);
        let own = stations.find(|(id, _)| **id == self.station.id);
        Ok(own.map(|(_, days)| days).unwrap_or_default())
    }

    /// What the model reads for the forecast of `date`: with [`Weather::Forecast`] also the weather forecast of that day.
    pub(super) async fn history_of(&self, state: &AppState, date: civil::Date) -> ApiResult<Vec<DayRecord>> {
        let mut history = self.history(state, date, date).await?;
        if self.weather == Weather::Forecast {
            let day = state.store.day(&self.station.id, date).await?;
            let weather = day.as_ref().and_then(StoredDay::forecast_record).ok_or_else(|| {
                let why = match day {
                    Some(day) if day.values.is_some() => "its weather was observed: ask for lead 0",
                    _ => "record it as an observation of that day",
                };
                let detail = format!("{} has no weather forecast of {date}; {why}", self.station.id);
                Problem::new(Code::NoForecastWeather, detail)
            })?;
            history.retain(|day| day.date != date);
            history.push(weather);
        }
        Ok(history)
    }

    /// The forecast as it is answered; `history` is what it was made from.
    pub(super) fn resource(&self, forecast: Forecast, history: &[DayRecord]) -> ForecastResource {
        let mut inputs = forecast.inputs;
        let mut base_date = forecast.base_date;
        if self.weather == Weather::Forecast {
            let day = history.iter().rfind(|day| day.date == forecast.date);
            let read =
                self.model.reported.iter().filter(|variable| day.is_some_and(|day| day.value(**variable).is_some()));
            inputs.forecast_weather = read.map(|variable| variable.name().to_owned()).collect();
            // the newest day that can have been observed
            base_date = base_date.yesterday().unwrap_or(base_date);
        }
        ForecastResource {
            station: self.station.id.clone(),
            region: self.region.as_ref().map(|region| region.id.clone()),
            synthetic: self.synthetic,
            date: Date(forecast.date),
            lead: self.lead,
            base_date: Date(base_date),
            label: self.model.label,
            probability: forecast.probability,
            category: forecast.category,
            threshold: forecast.threshold,
            decision_value: forecast.decision_value,
            model_id: self.id,
            feature_set: self.model.feature_set,
            feature_set_version: self.model.feature_set_version,
            inputs,
            provenance: self.provenance.clone(),
        }
    }

    /// The words for a day that cannot be forecast, with the nearest day that may have been meant.
    pub(super) async fn refuse(&self, state: &AppState, error: ForecastError) -> ApiResult<Problem> {
        let ForecastError::NoObservation { date } = error else {
            return Ok(match error {
                ForecastError::NoBaseDay { .. } => {
                    Problem::field(Code::InvalidParameter, "/date", "out_of_range", error.to_string())
                }
                ForecastError::FeatureSetChanged { .. } => Problem::new(Code::ModelOutdated, error.to_string()),
                error => Problem::internal(error),
            });
        };
        let nearest = state.store.nearest_observation(&self.station.id, &self.model.reported, date).await?;
        let nearest = nearest.map_or_else(
            || "the station has no observations at all".to_owned(),
            |nearest| format!("the nearest day with one is {nearest}"),
        );
        let day = state.store.day(&self.station.id, date).await?;
        let hint = match day.as_ref().and_then(StoredDay::forecast_record) {
            Some(_) if self.lead == 0 => "; its weather forecast is read with lead=1&weather=forecast",
            _ => "",
        };
        let detail = format!(
            "{} has no observation of {date} that the model reads, and a forecast of lead {} needs one; {nearest}{hint}",
            self.station.id, self.lead
        );
        Ok(Problem::new(Code::NoObservation, detail))
    }

    pub(super) async fn forecast(&self, state: &AppState, date: civil::Date) -> ApiResult<ForecastResource> {
        let history = self.history_of(state, date).await?;
        match self.model.forecast(&history, date) {
            Ok(forecast) => Ok(self.resource(forecast, &history)),
            Err(error) => Err(self.refuse(state, error).await?.into()),
        }
    }

    /// The newest day that can be forecast; what was recorded for days to come does not count.
    pub(super) async fn newest(&self, state: &AppState) -> ApiResult<civil::Date> {
        let today = clock::today(&self.station.zone());
        let last = state.store.last_observation(&self.station.id, &self.model.reported, today).await?;
        let last = last.ok_or_else(|| {
            Problem::new(Code::NoObservation, format!("{} has no observation that the model reads", self.station.id))
        })?;
        Ok(last.checked_add(i64::from(self.lead).days()).unwrap_or(last))
    }
}

/// The lead of the models that speak: one that reads the weather of the day itself, be it a forecast, is of lead 0.
pub(super) fn model_lead(lead: u8, weather: Weather) -> Result<u8, Problem> {
    match (lead, weather) {
        (0, Weather::Forecast) => {
            let detail = "forecast goes with lead=1: a forecast of lead 0 is made from what was observed on its day";
            Err(Problem::field(Code::InvalidParameter, "/weather", "contradiction", detail))
        }
        (lead, Weather::Forecast) => Ok(lead - 1),
        (lead, Weather::Observed) => Ok(lead),
    }
}

/// The active model of a station; of one that has none, that of the first of its regions that has.
async fn active(state: &AppState, station: &Station, lead: u8) -> ApiResult<(Uuid, Option<Region>)> {
    let place = Place::Station(station.id.clone());
    if let Some(activation) = state.store.active_model(&place, lead).await? {
        return Ok((activation.model, None));
    }
    for region in state.store.regions_of(&station.id).await? {
        if let Some(activation) = state.store.active_model(&Place::Region(region.id.clone()), lead).await? {
            return Ok((activation.model, Some(region)));
        }
    }
    Err(models::none_active(&place, lead).into())
}

/// The first day of the season of a day.
pub(super) fn season_begins(date: civil::Date) -> civil::Date {
    civil::Date::new(season_of(date), 7, 1).unwrap_or(date)
}

pub(super) fn before(date: civil::Date, days: u8) -> Result<civil::Date, Problem> {
    date.checked_sub(i64::from(days).days()).map_err(|_| {
        let detail = format!("there is no day {days} day(s) before {date}");
        Problem::field(Code::InvalidParameter, "/date", "out_of_range", detail)
    })
}
