//! The process `emission-synthetic`: a description of a test in, a data set with known truth out, which is called synthetic
//! wherever it shows.

use firn_science::{
    emission::{
        EmissionError,
        synthetic::{SyntheticOptions, Truth, synthetic},
    },
    progress::Progress,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use utoipa::ToSchema;

use super::{
    Accepted, Description, Failure,
    emission::{Made, check_seed, field_error, science},
    invalid_inputs,
};
use crate::{
    domain::{
        dataset::{self, DatasetName, Source},
        job::Job,
        problem::{FieldError, Problem},
        schema,
    },
    jobs::link::Output,
};

/// Its id in every address.
pub const ID: &str = "emission-synthetic";

/// Most events of one data set: its columns go from the worker to the store in one piece.
const MOST_EVENTS: usize = 1_000_000;

/// What to make; its members stand side by side in the inputs.
#[derive(ToSchema)]
#[expect(dead_code, reason = "the published form of the inputs, which are read in two parts")]
struct Published {
    /// Name of the data set, 1 to 200 characters.
    #[schema(value_type = String, min_length = 1, max_length = 200, example = "synthetic polycrystal")]
    name: DatasetName,
    /// Seed; the same seed gives the same bits.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_u64, default = 0, required = false)]
    seed: u64,
    #[serde(flatten)]
    options: SyntheticOptions,
}

/// The part of the inputs that is ours.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Own {
    /// Name of the data set, 1 to 200 characters.
    name: DatasetName,
    /// Seed.
    #[serde(default)]
    seed: u64,
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Make a synthetic data set of acoustic emission",
        description: "Makes a catalogue with known truth, for demonstrations and tests: it is no measurement, and is called \
                      synthetic wherever it shows. The truth stands with the data set.",
        inputs: schema::schema_of::<Published>(),
        outputs: json!({
            "dataset_id": {"title": "Id of the new data set", "schema": {"type": "string", "format": "uuid"}},
            "truth": {"title": "What is true of it", "schema": {"type": "object"}},
            "columns": {"title": "The file of its columns; see /v1/datasets/{dataset}/hits", "schema": {"type": "object"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {"name": "synthetic polycrystal", "events": 10_000, "grain_size_mm": 0.87, "seed": 1}}),
    }
}

/// Our part of the inputs, and the rest.
fn split(inputs: &Value) -> Result<(Own, SyntheticOptions), Vec<FieldError>> {
    let mut rest = inputs.as_object().cloned().unwrap_or_default();
    let mut own = serde_json::Map::new();
    for name in ["name", "seed"] {
        if let Some(value) = rest.remove(name) {
            own.insert(name.into(), value);
        }
    }
    let own = schema::read::<Own>(&Value::Object(own), "/inputs");
    let options = schema::read::<SyntheticOptions>(&Value::Object(rest), "/inputs");
    match (own, options) {
        (Ok(own), Ok(options)) => Ok((own, options)),
        (own, options) => Err([own.err(), options.err()].into_iter().flatten().flatten().collect()),
    }
}

fn joined(own: &Own, options: &SyntheticOptions) -> Result<Value, serde_json::Error> {
    let mut inputs = serde_json::to_value(options)?;
    inputs["name"] = serde_json::to_value(&own.name)?;
    inputs["seed"] = json!(own.seed);
    Ok(inputs)
}

/// Checks the inputs against their schema and the generator.
pub(super) fn accept(inputs: &Value) -> Result<Accepted, Problem> {
    let (own, options) = split(inputs).map_err(invalid_inputs)?;
    let mut faults: Vec<FieldError> = check_seed(own.seed).into_iter().collect();
    // a hit a sensor
    let most = if options.hits.is_some() { MOST_EVENTS / 8 } else { MOST_EVENTS };
    if options.events > most {
        let detail = format!("must be 1 to {most}, not {}", options.events);
        faults.push(FieldError::new("/inputs/events", "out_of_range", detail));
    } else if let Err(error) = synthetic(&SyntheticOptions { events: options.events.min(1), ..options.clone() }, 0) {
        faults.push(field_error(&error, "/inputs", "/inputs"));
    }
    if !faults.is_empty() {
        return Err(invalid_inputs(faults));
    }
    let inputs = joined(&own, &options).map_err(Problem::internal)?;
    let digest = Sha256::digest(inputs.to_string().as_bytes());
    Ok(Accepted { inputs, hash: digest.iter().map(|byte| format!("{byte:02x}")).collect() })
}

/// What a worker gets.
#[derive(Serialize, Deserialize)]
struct Payload {
    inputs: Value,
    input_hash: String,
    version: String,
}

pub(super) fn payload(job: &Job) -> Result<Vec<u8>, Problem> {
    let payload =
        Payload { inputs: job.inputs.clone(), input_hash: job.input_hash.clone(), version: job.version.clone() };
    serde_json::to_vec(&payload).map_err(Problem::internal)
}

/// Makes a catalogue.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let payload: Payload = serde_json::from_slice(payload).map_err(science)?;
    let (own, options) = split(&payload.inputs).map_err(|faults| {
        Failure::Science(faults.iter().map(|fault| fault.detail.as_str()).collect::<Vec<_>>().join("; "))
    })?;
    progress.report(0.0, "making events");
    let (catalogue, truth) = synthetic(&options, own.seed).map_err(|error| match error {
        EmissionError::Cancelled => Failure::Cancelled,
        error => science(error),
    })?;
    let truth = truth_of(&truth, &options).map_err(science)?;
    let metadata = catalogue.metadata.clone();
    let source = Source { format: "synthetic".into(), bytes: 0, sha256: payload.input_hash.clone() };
    let note = "made by a generator: no measurement".to_owned();
    let description = dataset::Description::of(&catalogue, Vec::new(), vec![note], source);
    let provenance = json!({"version": payload.version, "input_hash": payload.input_hash, "seed": own.seed});
    let results = json!({"truth": truth, "provenance": provenance});
    let made = Made { name: own.name, metadata, description, truth: Some(truth) };
    made.output(&catalogue.into_columns(), results)
}

/// What is true of the catalogue, and what it was made with.
fn truth_of(truth: &Truth, options: &SyntheticOptions) -> Result<Value, serde_json::Error> {
    let mut value = serde_json::to_value(truth)?;
    value["generator"] = serde_json::to_value(options)?;
    Ok(value)
}
