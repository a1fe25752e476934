//! The process `evaluate-transfer`: a model and a station that it was not trained at in, its scores there out.

use firn_science::{
    forecast::{
        day::{DayRecord, Variable},
        model::TrainedModel,
        transfer::{self, Target, TransferError},
    },
    progress::Progress,
};
use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    Accepted, Description, invalid_inputs,
    train_model::{self, hash_days, hex, science, station_schema},
};
use crate::{
    domain::{
        date,
        ids::StationId,
        job::Job,
        problem::{Code, FieldError, Problem},
        schema,
    },
    jobs::{link::Output, processes::Failure},
    store::{
        Store,
        transfers::{NewTransfer, TransferRecord},
    },
};

/// Its id in every address.
pub const ID: &str = "evaluate-transfer";

/// The first and last day of a window without ends.
const ALWAYS: (Date, Date) = (Date::constant(0, 1, 1), Date::constant(9999, 12, 31));

/// Which model to score where.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = TransferInputs)]
pub struct Inputs {
    /// Id of the model.
    pub model: Uuid,
    /// The station whose days it is scored on.
    #[schema(schema_with = station_schema)]
    pub station: StationId,
    /// First day of the window, YYYY-MM-DD; left out: the first that was observed.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "date::strict_option")]
    #[schema(value_type = Option<String>, format = Date)]
    pub from: Option<Date>,
    /// Last day of the window, YYYY-MM-DD; left out: the last that was observed.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "date::strict_option")]
    #[schema(value_type = Option<String>, format = Date)]
    pub to: Option<Date>,
    /// Seed of the bootstrap over seasons; the same seed gives the same bits.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_u64, default = 0)]
    pub seed: u64,
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Score a forecasting model at another station",
        description: "Forecasts every day of a station with a model that was trained elsewhere, with its own threshold, and \
                      scores it beside models of that station itself, each season forecast by the others: climatology, \
                      persistence, nearest neighbours and logistic regression. Says which variables the station does not \
                      report, how often features leave their range in training, and how base rate and calibration differ. \
                      Seasons on which the model was trained at that station are left out.",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "scores": {"title": "Scores of the model and of the station's own", "schema": {"type": "object"}},
            "per_season": {"title": "The same season by season", "schema": {"type": "array"}},
            "bootstrap": {"title": "Intervals, 95 % of bootstraps over seasons", "schema": {"type": ["object", "null"]}},
            "not_reported": {"title": "Variables that are imputed on every day", "schema": {"type": "array"}},
            "drift": {"title": "How the station differs from the training, with warnings", "schema": {"type": "object"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {"model": "0198f2a0-0000-7000-8000-000000000000", "station": "glencoe"}}),
    }
}

/// What a worker gets: it has no store.
#[derive(Serialize, Deserialize)]
struct Payload {
    inputs: Inputs,
    model: TrainedModel,
    synthetic: bool,
    reported: Vec<Variable>,
    trained_on: Vec<i16>,
    /// The region whose avalanche days the model forecasts.
    region: Option<String>,
    input_hash: String,
    version: String,
    days: Vec<DayRecord>,
}

impl Payload {
    fn target(&self) -> Target<'_> {
        Target { days: &self.days, reported: &self.reported, trained_on: &self.trained_on }
    }
}

async fn gather(store: &Store, inputs: Inputs, version: &str) -> Result<Payload, Problem> {
    let unknown = || {
        let detail = format!("there is no model {}; GET /v1/models lists them", inputs.model);
        invalid_inputs(vec![FieldError::new("/inputs/model", "unknown_model", detail)])
    };
    let record = store.model(inputs.model).await.map_err(Problem::internal)?.ok_or_else(unknown)?;
    let model = store.trained_model(inputs.model).await.map_err(Problem::internal)?.ok_or_else(unknown)?;
    let station = train_model::station(store, &inputs.station).await?;
    let (from, to) = (inputs.from.unwrap_or(ALWAYS.0), inputs.to.unwrap_or(ALWAYS.1));
    let days = store.day_records(&station.id, from, to).await.map_err(Problem::internal)?;
    let at_home = record.trained_at(&station.id);
    let mut hasher = Sha256::new();
    hasher.update(serde_json::to_string(&(&inputs, &station.body.variables)).unwrap_or_default().as_bytes());
    hash_days(&mut hasher, &days);
    Ok(Payload {
        synthetic: station.synthetic || record.is_synthetic(),
        reported: train_model::reported(&station, &days),
        trained_on: if at_home { model.training.seasons.clone() } else { Vec::new() },
        region: record.place.region().map(ToString::to_string),
        model: TrainedModel::clone(&model),
        input_hash: hex(hasher),
        version: version.to_owned(),
        inputs,
        days,
    })
}

/// Checks the inputs against their schema, the model, the station and whether a day can be scored.
pub(super) async fn accept(store: &Store, inputs: &Value) -> Result<Accepted, Problem> {
    let read: Inputs = schema::read(inputs, "/inputs").map_err(invalid_inputs)?;
    let mut faults = Vec::new();
    if read.seed > 9_007_199_254_740_991 {
        faults.push(FieldError::new("/inputs/seed", "out_of_range", "must be from 0 to 9007199254740991 (2^53 - 1)"));
    }
    if let (Some(from), Some(to)) = (read.from, read.to)
        && from > to
    {
        faults.push(FieldError::new("/inputs/to", "out_of_range", format!("must not be before from, {from}")));
    }
    if !faults.is_empty() {
        return Err(invalid_inputs(faults));
    }
    let inputs = serde_json::to_value(&read).map_err(Problem::internal)?;
    let payload = gather(store, read, "").await?;
    transfer::check(&payload.model, payload.target()).map_err(|error| refused(&error))?;
    Ok(Accepted { inputs, hash: payload.input_hash })
}

fn refused(error: &TransferError) -> Problem {
    let pointer = match error {
        TransferError::Model(_) => "/inputs/model",
        _ => "/inputs/from",
    };
    Problem::field(Code::TrainingWindow, pointer, "nothing_to_score", error.to_string())
}

/// The days as they are now.
pub(super) async fn payload(store: &Store, job: &Job) -> Result<super::Payload, Problem> {
    let inputs: Inputs = serde_json::from_value(job.inputs.clone()).map_err(Problem::internal)?;
    let payload = gather(store, inputs, &job.version).await?;
    let bytes = serde_json::to_vec(&payload).map_err(Problem::internal)?;
    Ok(super::Payload { bytes, input_hash: payload.input_hash })
}

/// Forecasts and scores.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let payload: Payload = serde_json::from_slice(payload).map_err(science)?;
    let seed = payload.inputs.seed;
    let mut transfer =
        transfer::evaluate(&payload.model, payload.target(), seed, progress).map_err(|error| match error {
            TransferError::Cancelled => Failure::Cancelled,
            error => Failure::Science(error.to_string()),
        })?;
    if let Some(region) = &payload.region {
        transfer.drift.warnings.push(format!(
            "event: the model forecasts avalanche days of the region {region} and is scored on those of the station alone"
        ));
    }
    let record = TransferRecord {
        model_id: payload.inputs.model,
        station: payload.inputs.station,
        synthetic: payload.synthetic,
        transfer,
        provenance: json!({"version": payload.version, "input_hash": payload.input_hash, "seed": seed}),
    };
    let results = serde_json::to_value(&record).map_err(science)?;
    Ok(Output { keep: Some(results.clone()), results, ..Output::default() })
}

/// The evaluation as the store keeps it.
pub(super) fn kept(job: Uuid, keep: &Value) -> Result<NewTransfer, serde_json::Error> {
    Ok(NewTransfer { job, record: TransferRecord::deserialize(keep)? })
}
