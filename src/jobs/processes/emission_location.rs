//! The process `emission-location`: a data set of hits of several sensors in, one of located events out.

use firn_science::{
    emission::{
        EmissionError,
        location::events::{self, EventOptions},
    },
    progress::Progress,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    Accepted, Description, Failure, Shelf,
    emission::{self, Made, Unpacked, science},
    invalid_inputs,
};
use crate::{
    domain::{
        dataset::{self, DatasetName, LocationOrigin, Source},
        job::Job,
        problem::{FieldError, Problem},
        schema,
    },
    jobs::link::Output,
};

/// Its id in every address.
pub const ID: &str = "emission-location";

/// Which hits, and how they are grouped and located.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Inputs {
    /// Id of the data set of hits, with `time_s` and `channel`, and with `sensors` in its metadata.
    dataset: Uuid,
    /// Name of the data set of events, 1 to 200 characters; left out: that of the hits with `, located`.
    #[serde(default)]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 200, example = "crystal, located")]
    name: Option<DatasetName>,
    /// How hits are grouped and located.
    #[serde(default)]
    options: EventOptions,
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Group hits into events and locate them",
        description: "Groups the hits of several sensors into events by the time that waves take between them, and locates each \
                      event by least squares on its arrival times, with its covariance. The result is a new data set of \
                      events with coordinates, standard errors, covariances and residuals; the sensors, their delays and the \
                      wave speed are those of the metadata of the data set of hits (docs/emission.md).",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "dataset_id": {"title": "Id of the data set of events", "schema": {"type": "string", "format": "uuid"}},
            "dataset": {"title": "The data set of hits", "schema": {"type": "object"}},
            "summary": {"title": "How many hits were grouped and events located, and how well", "schema": {"type": "object"}},
            "columns": {"title": "The file of its columns; see /v1/datasets/{dataset}/hits", "schema": {"type": "object"}},
            "provenance": {"title": "Version and input hash", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {
            "dataset": "019326f0-0000-7000-8000-000000000000",
            "options": {"dimensions": 3, "speed_m_per_s": 3900.0, "arrival_error_s": 5e-7},
        }}),
    }
}

/// Checks the inputs against their schema and the data set.
pub(super) async fn accept(shelf: Shelf<'_>, inputs: &Value) -> Result<Accepted, Problem> {
    let read: Inputs = schema::read(inputs, "/inputs").map_err(invalid_inputs)?;
    let opened = emission::open(shelf, read.dataset, "/inputs/dataset").await?;
    let checked = events::check(&opened.catalogue()?, &read.options);
    checked.map_err(|error| invalid_inputs(vec![fault(&error)]))?;
    let inputs = serde_json::to_value(&read).map_err(Problem::internal)?;
    Ok(Accepted { hash: emission::hash(&inputs, &[&opened.head]), inputs })
}

/// Where a refusal points: what the metadata hold is no option.
fn fault(error: &EmissionError) -> FieldError {
    match error {
        EmissionError::Option { option: "sensors", .. } => {
            FieldError::new("/inputs/dataset", "out_of_range", error.to_string())
        }
        error => emission::field_error(error, "/inputs/options", "/inputs/dataset"),
    }
}

pub(super) async fn payload(shelf: Shelf<'_>, job: &Job) -> Result<Vec<u8>, Problem> {
    let inputs: Inputs = serde_json::from_value(job.inputs.clone()).map_err(Problem::internal)?;
    let opened = emission::open(shelf, inputs.dataset, "/inputs/dataset").await.map_err(emission::gone)?;
    emission::pack(job, vec![opened])
}

/// Groups and locates.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let unpacked: Unpacked<Inputs> = emission::unpack(payload)?;
    let Unpacked { inputs, heads, catalogues, truths, provenance } = unpacked;
    let (Some(head), Some(catalogue)) = (heads.first(), catalogues.first()) else {
        return Err(Failure::Science("there is no data set".into()));
    };
    let (events, summary) =
        events::locate_events(catalogue, &inputs.options, progress).map_err(|error| match error {
            EmissionError::Cancelled => Failure::Cancelled,
            error => science(error),
        })?;
    let origin = LocationOrigin {
        parent: inputs.dataset,
        parent_sha256: head.sha256.clone(),
        settings: inputs.options,
        summary: summary.clone(),
    };
    let source = Source { format: "located".into(), bytes: 0, sha256: head.sha256.clone() };
    let notes = vec![format!("events of the hits of data set {} ({})", inputs.dataset, head.name)];
    let description =
        dataset::Description { location: Some(origin), ..dataset::Description::of(&events, Vec::new(), notes, source) };
    let name = inputs.name.map_or_else(|| named(&head.name), Ok).map_err(science)?;
    // events of synthetic hits are synthetic too
    let truth = truths.into_iter().next().flatten();
    let results = json!({"dataset": head, "summary": summary, "provenance": provenance});
    Made { name, metadata: events.metadata.clone(), description, truth }.output(&events.into_columns(), results)
}

/// The name of the events of hits: theirs, cut where it would be too long.
fn named(hits: &str) -> Result<DatasetName, impl std::fmt::Display + use<>> {
    const BEHIND: &str = ", located";
    let short: String = hits.chars().take(200 - BEHIND.len()).collect();
    DatasetName::try_from(format!("{short}{BEHIND}"))
}
