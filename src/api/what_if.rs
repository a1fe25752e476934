//! `/v1/stations/{station}/forecasts/what-if`: what the model would say if the days were otherwise. Nothing is stored.

use axum::{extract::State, response::Response};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Date, JsonBody, Path},
    forecasts::{ForecastResource, Lead, Weather},
    problem::ApiResult,
    respond,
    speaker::{Speaker, model_lead},
    stations::StationPath,
};
use crate::{
    domain::{
        avalanche::ActivitySchema,
        observation::bounds,
        problem::{Code, FieldError, Problem},
    },
    science::forecast::{
        day::{Activity, DayRecord, Variable},
        model::{Change, ForecastError, ResponsePoint, TrainedModel, changed},
    },
};

/// Most points of a response curve.
const MOST_POINTS: u32 = 200;

/// Most days that may be changed.
const MOST_CHANGES: usize = 100;

/// What is to be different.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WhatIfBody {
    /// The day that is forecast, YYYY-MM-DD.
    #[schema(value_type = String, format = Date)]
    date: Date,
    /// Days between the last observation that is used and the day that is forecast: 0 (nowcast) or 1.
    #[serde(default)]
    #[schema(value_type = u8, minimum = 0, maximum = 1, default = 0)]
    lead: Lead,
    /// `forecast`, only with `lead` 1: the active model of lead 0 reads the weather forecast of the day in the place of
    /// observations.
    #[serde(default)]
    #[schema(value_type = String, pattern = "^(observed|forecast)$", default = "observed")]
    weather: Weather,
    /// A model other than the active one; it must be of this station and lead.
    #[serde(default)]
    model_id: Option<Uuid>,
    /// What is different, day by day; at most 100 days, each once.
    #[serde(default)]
    #[schema(max_items = 100)]
    changes: Vec<DayChange>,
    /// The variable whose response is asked for, if any.
    #[serde(default)]
    response: Option<ResponseAsked>,
}

/// What is different on one day.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DayChange {
    /// The day; left out: the base day, the newest whose weather is read. Days after that are not read.
    #[serde(default)]
    #[schema(value_type = Option<String>, format = Date)]
    date: Option<Date>,
    /// New values by the name of their variable, in the units of an observation; null makes it missing.
    #[serde(default)]
    #[schema(value_type = Option<Object>, example = json!({"air_temperature": 2.5, "snow_drift": true, "foot_penetration": null}))]
    values: Option<Map<String, Value>>,
    /// Avalanche activity of the day; that of the base day is never read.
    #[serde(default)]
    #[schema(value_type = Option<ActivitySchema>)]
    avalanche_activity: Option<Activity>,
}

/// The response to one variable on the base day.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ResponseAsked {
    /// Name of the variable.
    #[schema(value_type = String, example = "air_temperature")]
    variable: Variable,
    /// First value, in the unit of the variable; left out: the smallest in training.
    #[serde(default)]
    from: Option<f64>,
    /// Last value; left out: the largest in training.
    #[serde(default)]
    to: Option<f64>,
    /// Points from the first to the last, both included, 2 to 200. A variable that is true or false has two.
    #[serde(default)]
    #[schema(value_type = Option<u32>, minimum = 2, maximum = 200, default = 25)]
    points: Option<Points>,
}

/// A number of points, 2 to 200.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "u32")]
struct Points(u32);

impl TryFrom<u32> for Points {
    type Error = String;

    fn try_from(points: u32) -> Result<Self, Self::Error> {
        if (2..=MOST_POINTS).contains(&points) {
            Ok(Self(points))
        } else {
            Err(format!("must be from 2 to {MOST_POINTS}"))
        }
    }
}

/// What the model says of the days as they are and as they would be.
#[derive(Serialize, ToSchema)]
pub struct WhatIf {
    /// The forecast from what is stored; null where the base day has no observation.
    as_observed: Option<ForecastResource>,
    /// The forecast of the changed days.
    changed: ForecastResource,
    /// Probability of the changed days minus that of the days as they are; null where there is none.
    difference: Option<f64>,
    /// How the forecast of the changed days follows one variable, where that was asked for.
    response: Option<ResponseCurve>,
}

/// How a forecast follows one variable of the base day, all else as in the changed days.
#[derive(Serialize, ToSchema)]
pub struct ResponseCurve {
    /// Name of the variable.
    variable: &'static str,
    /// Its unit; `1` for an index, `bool` for 0 or 1.
    unit: &'static str,
    /// In rising order of the value.
    points: Vec<ResponsePoint>,
}

/// What a model would say if the days were otherwise: changed inputs, and the response curve of one variable. Nothing of it is
/// stored.
#[utoipa::path(post, path = "/v1/stations/{station}/forecasts/what-if", operation_id = "ask_what_if", tag = "forecasts",
    params(StationPath),
    request_body(content = WhatIfBody, example = json!({"date": "2007-02-14",
        "changes": [{"values": {"air_temperature": 2.5, "snow_drift": true}}],
        "response": {"variable": "wind_speed", "from": 0, "to": 30}})),
    responses((status = 200, description = "What the model says.", body = WhatIf)))]
pub async fn ask_what_if(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    JsonBody(body): JsonBody<WhatIfBody>,
) -> ApiResult<Response> {
    let date = body.date.0;
    if let Err(problem) = model_lead(body.lead.0, body.weather) {
        return Err(Problem { code: Code::InvalidBody, ..problem }.into());
    }
    let speaker = Speaker::find(&state, &path.station, body.lead, body.weather, body.model_id).await?;
    let base = speaker
        .model
        .base_date(date)
        .map_err(|error| Problem::field(Code::InvalidBody, "/date", "out_of_range", error.to_string()))?;
    let changes = read_changes(&body.changes, base)?;
    let values = body.response.as_ref().map(|asked| response_values(asked, &speaker.model)).transpose()?;
    let history = speaker.history_of(&state, date).await?;
    let days: Vec<DayRecord> = changed(&history, &changes);
    let after = match speaker.model.forecast(&days, date) {
        Ok(forecast) => forecast,
        Err(error) => return Err(speaker.refuse(&state, error).await?.into()),
    };
    let before = match speaker.model.forecast(&history, date) {
        Ok(forecast) => Some(forecast),
        Err(ForecastError::NoObservation { .. }) => None,
        Err(error) => return Err(Problem::internal(error).into()),
    };
    let response = match (&body.response, values) {
        (Some(asked), Some(values)) => {
            let points = speaker.model.response(&days, date, asked.variable, &values).map_err(Problem::internal)?;
            Some(ResponseCurve { variable: asked.variable.name(), unit: asked.variable.unit(), points })
        }
        _ => None,
    };
    let answer = WhatIf {
        difference: before.as_ref().map(|before| after.probability - before.probability),
        as_observed: before.map(|before| speaker.resource(before, &history)),
        changed: speaker.resource(after, &days),
        response,
    };
    respond::resource(&Conditions::default(), &answer)
}

fn read_changes(changes: &[DayChange], base: jiff::civil::Date) -> Result<Vec<Change>, Problem> {
    let mut faults = Vec::new();
    if changes.len() > MOST_CHANGES {
        faults.push(FieldError::new("/changes", "too_many", format!("must be at most {MOST_CHANGES} days")));
    }
    let mut read: Vec<Change> = Vec::new();
    for (at, change) in changes.iter().enumerate().take(MOST_CHANGES) {
        let date = change.date.map_or(base, |date| date.0);
        if read.iter().any(|earlier| earlier.date == date) {
            faults.push(FieldError::new(
                format!("/changes/{at}/date"),
                "duplicate_day",
                format!("{date} is changed twice"),
            ));
        }
        let mut values = Vec::new();
        for (name, value) in change.values.iter().flatten() {
            match read_value(name, value) {
                Ok(value) => values.push(value),
                Err((code, detail)) => {
                    let name = name.replace('~', "~0").replace('/', "~1");
                    faults.push(FieldError::new(format!("/changes/{at}/values/{name}"), code, detail));
                }
            }
        }
        read.push(Change { date, values, activity: change.avalanche_activity });
    }
    match faults.first() {
        Some(first) => Err(Problem::new(Code::InvalidBody, first.detail.clone()).with_errors(faults)),
        None => Ok(read),
    }
}

/// A variable and its new value, or the rule that it breaks and what would be accepted.
fn read_value(name: &str, value: &Value) -> Result<(Variable, Option<f64>), (&'static str, String)> {
    let variable = Variable::from_name(name).ok_or_else(|| {
        let known: Vec<&str> = Variable::ALL.map(Variable::name).to_vec();
        ("unknown_field", format!("{name} is no variable; there are: {}", known.join(", ")))
    })?;
    let value = match value {
        Value::Null => None,
        Value::Bool(value) if variable.is_boolean() => Some(f64::from(u8::from(*value))),
        Value::Number(number) if !variable.is_boolean() => number.as_f64(),
        _ if variable.is_boolean() => return Err(("wrong_type", "must be true, false or null".to_owned())),
        _ => return Err(("wrong_type", "must be a number or null".to_owned())),
    };
    let bounds = bounds(variable);
    match value {
        Some(value) if !bounds.contain(value) => Err(("out_of_range", format!("must be {bounds}"))),
        value => Ok((variable, value)),
    }
}

fn response_values(asked: &ResponseAsked, model: &TrainedModel) -> Result<Vec<f64>, Problem> {
    let (variable, fault) = (asked.variable, |at: &str, code: &str, detail: String| {
        Problem::field(Code::InvalidBody, format!("/response/{at}"), code, detail)
    });
    if variable.is_boolean() {
        return Ok(vec![0.0, 1.0]);
    }
    let known = model.training_range(variable);
    let end = |given: Option<f64>, known: Option<f64>, at: &str| {
        let value = given.or(known).ok_or_else(|| {
            let detail = format!("must be given: the model was not trained on {} itself", variable.name());
            fault(at, "required", detail)
        })?;
        let bounds = bounds(variable);
        if bounds.contain(value) { Ok(value) } else { Err(fault(at, "out_of_range", format!("must be {bounds}"))) }
    };
    let from = end(asked.from, known.map(|range| range.0), "from")?;
    let to = end(asked.to, known.map(|range| range.1), "to")?;
    if from >= to {
        return Err(fault("to", "out_of_range", format!("must be above from, {from}")));
    }
    let steps = asked.points.map_or(25, |points| points.0) - 1;
    let mut values: Vec<f64> = (0..=steps).map(|k| from + (to - from) * f64::from(k) / f64::from(steps)).collect();
    if let Some(step) = bounds(variable).step {
        values.iter_mut().for_each(|value| *value = (*value / step).round() * step);
        values.dedup();
    }
    Ok(values)
}
