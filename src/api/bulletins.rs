//! `/v1/stations/{station}/bulletins`: issued forecasts in the form that avalanche warning services exchange.

use axum::{extract::State, response::Response};
use jiff::{ToSpan, civil};
use serde::Deserialize;
use utoipa::IntoParams;

use super::{
    AppState,
    avalanches::DayPath,
    extract::{Conditions, Date, Path, Query},
    forecasts::{Lead, Weather},
    problem::ApiResult,
    respond,
    speaker::model_lead,
    stations::StationPath,
};
use crate::{
    clock,
    domain::{
        problem::{Code, Problem},
        station::Station,
    },
    formats::caaml::{self, Bulletin, Bulletins, LevelSet, ModelForecast},
    store::issued::{ForecasterCall, IssuedForecast},
};

/// Most days of one answer after the first.
const LONGEST_DAYS: i32 = 400;

/// Days before the last that a list has where its beginning is left out.
const A_WEEK: i64 = 6;

/// Which of the forecasts of a day.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct BulletinQuery {
    /// Days between the last observation that was read and the day that was forecast: 0 or 1; left out: whichever was issued
    /// last.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1)]
    lead: Option<Lead>,
    /// `observed`, or `forecast` for a forecast of lead 1 that read a weather forecast of its day; left out: whichever was issued
    /// last.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(observed|forecast)$")]
    weather: Option<Weather>,
    /// Also what was issued, or called, after its day had ended: that is no forecast.
    #[serde(default)]
    #[param(value_type = Option<bool>, default = false)]
    hindcasts: Option<bool>,
}

/// Which days, and which of their forecasts.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct BulletinsQuery {
    /// First day, YYYY-MM-DD; left out: six days before `to`.
    #[serde(default)]
    #[param(inline)]
    from: Option<Date>,
    /// Last day, YYYY-MM-DD, at most 400 days after `from`; left out: tomorrow.
    #[serde(default)]
    #[param(inline)]
    to: Option<Date>,
    /// Days between the last observation that was read and the day that was forecast: 0 or 1; left out: whichever was issued
    /// last.
    #[serde(default)]
    #[param(value_type = Option<u8>, minimum = 0, maximum = 1)]
    lead: Option<Lead>,
    /// `observed`, or `forecast` for forecasts of lead 1 that read a weather forecast of their day; left out: whichever was
    /// issued last.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(observed|forecast)$")]
    weather: Option<Weather>,
    /// Also what was issued, or called, after its day had ended: that is no forecast.
    #[serde(default)]
    #[param(value_type = Option<bool>, default = false)]
    hindcasts: Option<bool>,
}

/// The bulletin of a day as CAAML 6.0, profile BulletinEAWS (JSON): the forecast as it was issued and the danger level that a
/// person set in a call of the same lead; `no_rating` where nobody did. The probability of the model, and all that belongs to
/// it, stands in `customData.firn`.
#[utoipa::path(get, path = "/v1/stations/{station}/bulletins/{date}", operation_id = "get_bulletin", tag = "forecasts",
    params(DayPath, BulletinQuery), responses((status = 200, description = "A collection of one bulletin.", body = Bulletins)))]
pub async fn get_bulletin(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    Query(query): Query<BulletinQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let BulletinQuery { lead, weather, hindcasts } = query;
    let choice = Choice::of(lead, weather, hindcasts)?;
    let station = state.station(&path.station).await?;
    let bulletins = choice.bulletins(&state, &station, path.date.0, path.date.0).await?;
    if bulletins.is_empty() {
        let others = choice.of_which_hindcasts_count().bulletins(&state, &station, path.date.0, path.date.0).await?;
        let hint =
            if others.is_empty() { "" } else { "; one was issued after the day had ended: ask with hindcasts=true" };
        let detail = format!("no forecast of {} was issued for {}{hint}", path.date.0, station.id);
        return Err(Problem::new(Code::NotIssued, detail).into());
    }
    respond::resource(&conditions, &Bulletins { bulletins })
}

/// The bulletins of a range of days as CAAML 6.0, profile BulletinEAWS (JSON), at most one a day: see the bulletin of a day.
#[utoipa::path(get, path = "/v1/stations/{station}/bulletins", operation_id = "list_bulletins", tag = "forecasts",
    params(StationPath, BulletinsQuery),
    responses((status = 200, description = "The bulletins in the order of their days.", body = Bulletins)))]
pub async fn list_bulletins(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<BulletinsQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let choice = Choice::of(query.lead, query.weather, query.hindcasts)?;
    let station = state.station(&path.station).await?;
    let tomorrow = || clock::today(&station.zone()).tomorrow().unwrap_or(civil::Date::MAX);
    let to = query.to.map_or_else(tomorrow, |date| date.0);
    let from = query.from.map_or_else(|| to.checked_sub(A_WEEK.days()).unwrap_or(to), |date| date.0);
    if !(0..=LONGEST_DAYS).contains(&(to - from).get_days()) {
        let detail = format!("must be from 0 to {LONGEST_DAYS} days after from, {from}");
        return Err(Problem::field(Code::InvalidParameter, "/to", "out_of_range", detail).into());
    }
    let bulletins = choice.bulletins(&state, &station, from, to).await?;
    respond::resource(&conditions, &Bulletins { bulletins })
}

/// Which of the forecasts of a day makes its bulletin.
#[derive(Clone, Copy)]
struct Choice {
    lead: Option<u8>,
    weather: Option<Weather>,
    hindcasts: bool,
}

impl Choice {
    fn of(lead: Option<Lead>, weather: Option<Weather>, hindcasts: Option<bool>) -> Result<Self, Problem> {
        if let (Some(lead), Some(weather)) = (lead, weather) {
            model_lead(lead.0, weather)?;
        }
        Ok(Self { lead: lead.map(|lead| lead.0), weather, hindcasts: hindcasts.unwrap_or(false) })
    }

    const fn of_which_hindcasts_count(self) -> Self {
        Self { hindcasts: true, ..self }
    }

    fn holds(&self, issued: &IssuedForecast) -> bool {
        self.lead.is_none_or(|lead| lead == issued.lead)
            && self.weather.is_none_or(|weather| (weather == Weather::Forecast) == issued.forecast_weather)
            && (self.hindcasts || !issued.hindcast)
    }

    /// At most one bulletin a day: that of the forecast which was issued last.
    async fn bulletins(
        &self,
        state: &AppState,
        station: &Station,
        from: civil::Date,
        to: civil::Date,
    ) -> ApiResult<Vec<Bulletin>> {
        let mut issued = state.store.issued_between(&station.id, from, to).await?;
        issued.retain(|issued| self.holds(issued));
        issued.sort_by_key(|issued| (issued.date, issued.issued));
        issued.reverse();
        issued.dedup_by_key(|issued| issued.date);
        issued.reverse();
        let mut calls = Vec::new();
        for lead in [0, 1] {
            calls.extend(state.store.forecaster_calls(&station.id, from, to, lead).await?);
        }
        calls.retain(|call| self.hindcasts || !call.hindcast);
        let of_same =
            |issued: &IssuedForecast| calls.iter().find(|call| (call.date, call.lead) == (issued.date, issued.lead));
        let bulletin = |issued: IssuedForecast| {
            let call = of_same(&issued);
            let level = call.and_then(|call| Some(LevelSet { level: call.danger_level?, made: call.made }));
            caaml::bulletin(station, &state.config.provider, said(station, issued, call), level)
        };
        Ok(issued.into_iter().map(bulletin).collect())
    }
}

fn said(station: &Station, issued: IssuedForecast, call: Option<&ForecasterCall>) -> ModelForecast {
    ModelForecast {
        station: station.id.to_string(),
        synthetic: issued.body["synthetic"].as_bool().unwrap_or(station.synthetic),
        date: issued.date,
        lead: issued.lead,
        weather: if issued.forecast_weather { "forecast" } else { "observed" },
        issued: issued.issued,
        hindcast: issued.hindcast,
        forecast: issued.body,
        similar_days: issued.similar_days,
        called: call.map(|call| call.warned),
        called_probability: call.and_then(|call| call.probability),
    }
}
