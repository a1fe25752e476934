//! `/v1/stations/{station}/avalanches/{date}`: what avalanches a day had, which is often known later than its weather.

use axum::{extract::State, http::StatusCode, response::Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    AppState,
    auth::Caller,
    extract::{Conditions, Date, JsonBody, Path},
    problem::ApiResult,
    respond,
};
use crate::{
    clock,
    domain::{
        avalanche::{ActivitySchema, AvalancheRecord, AvalancheTrigger, AvalancheType},
        ids::StationId,
        problem::{Code, FieldError, Problem},
        station::Station,
        units::{AvalancheCount, AvalancheSize},
    },
    science::forecast::day::Activity,
    store::{
        observations::{Author, DayWrite, Part, Revised, Revision, StoredDay},
        stations::Written,
    },
};

/// Which day of which station.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct DayPath {
    /// Name of the station.
    #[param(inline)]
    pub station: StationId,
    /// The station's local day, YYYY-MM-DD.
    #[param(inline)]
    pub date: Date,
}

/// The avalanche record of a day.
#[derive(Serialize, ToSchema)]
pub struct AvalancheResource {
    /// Name of the station.
    station: StationId,
    /// The station's local day.
    date: Date,
    /// Whether avalanches were seen, judged likely, ruled out, or nobody could say.
    #[schema(value_type = ActivitySchema)]
    activity: Activity,
    /// Number of avalanches seen.
    count: Option<AvalancheCount>,
    /// Wetness of the snow.
    r#type: Option<AvalancheType>,
    /// What set them off.
    trigger: Option<AvalancheTrigger>,
    /// Size of the largest on the European scale of 1 to 5.
    size: Option<AvalancheSize>,
    /// True where it was made by a generator and never happened.
    synthetic: bool,
    /// Counts the changes, from 1.
    revision: u32,
    /// When it last changed.
    updated: Timestamp,
}

/// An earlier or the present state of what is stored of a day.
#[derive(Serialize, ToSchema)]
pub struct RevisionResource {
    /// Its number, from 1.
    revision: u32,
    /// When it was written.
    recorded: Timestamp,
    /// The name of the key that wrote it; null where no key was needed.
    recorded_by: Option<String>,
    /// The call that brought it: put, json, ndjson, csv, sais or synthetic.
    source: String,
    /// What it said.
    #[schema(value_type = Object)]
    body: serde_json::Value,
}

impl From<Revision> for RevisionResource {
    fn from(revision: Revision) -> Self {
        Self {
            revision: revision.revision,
            recorded: revision.recorded,
            recorded_by: revision.recorded_by,
            source: revision.source,
            body: revision.body,
        }
    }
}

/// Every state of one part of a day, oldest first.
#[derive(Serialize, ToSchema)]
pub struct RevisionList {
    /// Oldest first.
    pub revisions: Vec<RevisionResource>,
}

fn resource(station: Station, date: Date, record: &Revised<AvalancheRecord>) -> AvalancheResource {
    let value = record.value;
    AvalancheResource {
        synthetic: station.synthetic,
        station: station.id,
        date,
        activity: value.activity,
        count: value.count,
        r#type: value.r#type,
        trigger: value.trigger,
        size: value.size,
        revision: record.revision,
        updated: record.updated,
    }
}

fn tag(day: &StoredDay) -> Option<String> {
    day.avalanche.as_ref().map(|record| format!("\"{}\"", record.revision))
}

fn not_recorded(station: &StationId, date: Date) -> Problem {
    Problem::new(Code::NoAvalancheRecord, format!("no avalanche record of {station} on {}", date.0))
}

/// The avalanche record of a day. That nobody recorded any is 404 and not `none`.
#[utoipa::path(get, path = "/v1/stations/{station}/avalanches/{date}", operation_id = "get_avalanches", tag = "observations",
    params(DayPath), responses((status = 200, description = "The record.", body = AvalancheResource)))]
pub async fn get_avalanches(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let station = state.station(&path.station).await?;
    let day = state.store.day(&path.station, path.date.0).await?;
    let record = day.as_ref().and_then(|day| day.avalanche.as_ref());
    let record = record.ok_or_else(|| not_recorded(&path.station, path.date))?;
    let tag = format!("\"{}\"", record.revision);
    respond::tagged(&conditions, StatusCode::OK, &tag, &resource(station, path.date, record))
}

/// Records the avalanches of a day, or corrects the record; every earlier state is kept.
#[utoipa::path(put, path = "/v1/stations/{station}/avalanches/{date}", operation_id = "put_avalanches", tag = "observations",
    params(DayPath),
    request_body(content = AvalancheRecord, example = json!({"activity": "observed", "count": 2, "type": "dry", "trigger": "natural"})),
    responses((status = 200, description = "The record was known; this is it now.", body = AvalancheResource),
              (status = 201, description = "The record is new.", body = AvalancheResource)))]
pub async fn put_avalanches(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    conditions: Conditions,
    caller: Caller,
    JsonBody(record): JsonBody<AvalancheRecord>,
) -> ApiResult<Response> {
    let faults: Vec<FieldError> = record
        .contradictions()
        .into_iter()
        .map(|fault| FieldError::new(format!("/{}", fault.record_field()), "contradiction", fault.to_string()))
        .collect();
    if let Some(first) = faults.first() {
        return Err(Problem::new(Code::InvalidBody, first.detail.clone()).with_errors(faults).into());
    }
    let station = state.station(&path.station).await?;
    let author = Author { name: caller.name, at: clock::now(), source: "put" };
    let write = DayWrite { date: path.date.0, values: None, forecast: false, avalanche: Some(record) };
    let mut known = false;
    let permits = |before: Option<&StoredDay>| {
        let before = before.and_then(tag);
        known = before.is_some();
        conditions.permit_write(before.as_deref())
    };
    let (day, written) = state.store.put_day(&path.station, &write, &author, permits).await?;
    let status = if known || written == Written::Unchanged { StatusCode::OK } else { StatusCode::CREATED };
    let stored = day.avalanche.as_ref().ok_or_else(|| Problem::internal("a record that was just written is gone"))?;
    let tag = format!("\"{}\"", stored.revision);
    respond::tagged(&Conditions::default(), status, &tag, &resource(station, path.date, stored))
}

/// Every state that the avalanche record of a day ever had, oldest first, with who wrote it and when.
#[utoipa::path(get, path = "/v1/stations/{station}/avalanches/{date}/revisions", operation_id = "list_avalanche_revisions",
    tag = "observations", params(DayPath), responses((status = 200, description = "The states.", body = RevisionList)))]
pub async fn list_revisions(
    State(state): State<AppState>,
    Path(path): Path<DayPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    state.station(&path.station).await?;
    let revisions = state.store.revisions(&path.station, path.date.0, Part::Avalanche).await?;
    if revisions.is_empty() {
        return Err(not_recorded(&path.station, path.date).into());
    }
    respond::resource(&conditions, &RevisionList { revisions: revisions.into_iter().map(Into::into).collect() })
}
