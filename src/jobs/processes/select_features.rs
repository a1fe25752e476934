//! The process `select-features`: observations of a station in, the score of every number of features out.

use firn_science::{
    forecast::{
        day::{DayRecord, Label, Variable},
        features::FeatureSetId,
        model,
        selection::{self, FeatureSelection},
        svm::KernelFamily,
    },
    progress::Progress,
};
use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    Accepted, Description, invalid_inputs,
    train_model::{self, region_schema, station_schema},
};
use crate::{
    domain::{
        date,
        ids::{Place, RegionId, StationId},
        job::Job,
        problem::{FieldError, Problem},
        schema,
    },
    formats::figures::{self, DrawError, ImageFormat},
    jobs::{
        link::{Artifact, Output},
        processes::Failure,
    },
    store::{
        Store,
        selections::{NewSelection, SelectionRecord},
    },
};

/// Its id in every address.
pub const ID: &str = "select-features";

/// On what to find out how many features it takes.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = SelectionInputs)]
pub struct Inputs {
    /// The station whose observations are used; name a station or a region.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = station_schema)]
    pub station: Option<StationId>,
    /// The region whose stations are used together.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = region_schema)]
    pub region: Option<RegionId>,
    /// What counts as an avalanche day: `observed` (an avalanche was seen) or `presumed` (seen or judged likely).
    #[schema(value_type = String, pattern = "^(observed|presumed)$", example = "observed")]
    pub label: Label,
    /// Days between the last observation and the day that is forecast: 0 (nowcast) or 1 (tomorrow).
    #[schema(minimum = 0, maximum = 1, example = 0)]
    pub lead: u8,
    /// Feature set: `expert` or `raw-30`; see `/v1/feature-sets`.
    #[serde(default = "train_model::default_feature_set")]
    #[schema(value_type = String, pattern = "^(expert|raw-30)$", default = "expert")]
    pub feature_set: FeatureSetId,
    /// First day of the window, YYYY-MM-DD; left out: the first that was observed.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "date::strict_option")]
    #[schema(value_type = Option<String>, format = Date)]
    pub from: Option<Date>,
    /// Last day of the window, YYYY-MM-DD; left out: the last that was observed.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "date::strict_option")]
    #[schema(value_type = Option<String>, format = Date)]
    pub to: Option<Date>,
}

impl Inputs {
    /// The training whose features are chosen.
    fn training(&self) -> train_model::Inputs {
        train_model::Inputs {
            station: self.station.clone(),
            region: self.region.clone(),
            label: self.label,
            lead: self.lead,
            feature_set: self.feature_set,
            features: None,
            feature_count: None,
            selection: None,
            kernel: KernelFamily::Gaussian,
            from: self.from,
            to: self.to,
            cost_loss_ratio: None,
            seed: 0,
        }
    }
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Find how many features a forecasting model takes",
        description: "Takes the features of a Gaussian support vector machine out one after the other, always the one whose \
                      loss changes the machine least, and scores what is left on seasons that were held out: the curve of \
                      the score against the number of features, with its spread, and the smallest number within one \
                      standard error of the best. All that is learnt, the order of the features too, is learnt without the \
                      seasons that are scored.",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "curve": {"title": "Score at every number of features", "schema": {"type": "array"}},
            "best": {"title": "Number of features of the highest score", "schema": {"type": "integer"}},
            "proposed": {
                "title": "Smallest number within one standard error of it", "schema": {"type": "integer"},
            },
            "ranking": {"title": "Features, the most useful first", "schema": {"type": "array"}},
            "picture": {"title": "The curve as SVG, by reference", "schema": {"type": "object"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {"station": "lochaber", "label": "observed", "lead": 0}}),
    }
}

/// Checks the inputs against their schema, the station and the window.
pub(super) async fn accept(store: &Store, inputs: &Value) -> Result<Accepted, Problem> {
    let read: Inputs = train_model::read_of_place(inputs)?;
    let mut faults = Vec::new();
    if read.lead > model::LONGEST_LEAD {
        faults.push(FieldError::new("/inputs/lead", "out_of_range", "must be 0 (nowcast) or 1 (tomorrow)"));
    }
    if let (Some(from), Some(to)) = (read.from, read.to)
        && from > to
    {
        faults.push(FieldError::new("/inputs/to", "out_of_range", format!("must not be before from, {from}")));
    }
    faults.extend(train_model::place_fault(read.station.as_ref(), read.region.as_ref()));
    if !faults.is_empty() {
        return Err(invalid_inputs(faults));
    }
    let training = read.training();
    let prepared = train_model::prepare(store, &training).await?;
    model::check_pooled(&prepared.parts(), &prepared.options).map_err(|error| train_model::refused_window(&error))?;
    let hash = train_model::hash(&training, &prepared);
    Ok(Accepted { inputs: serde_json::to_value(&read).map_err(Problem::internal)?, hash })
}

/// What a worker gets: it has no store.
#[derive(Serialize, Deserialize)]
struct Payload {
    inputs: Inputs,
    place: Place,
    synthetic: bool,
    reported: Vec<Variable>,
    input_hash: String,
    version: String,
    days: Vec<Vec<DayRecord>>,
}

/// The days as they are now.
pub(super) async fn payload(store: &Store, job: &Job) -> Result<super::Payload, Problem> {
    let inputs: Inputs = serde_json::from_value(job.inputs.clone()).map_err(Problem::internal)?;
    let training = inputs.training();
    let prepared = train_model::prepare(store, &training).await?;
    let payload = Payload {
        place: prepared.place.clone(),
        synthetic: prepared.is_synthetic(),
        input_hash: train_model::hash(&training, &prepared),
        reported: prepared.options.reported,
        version: job.version.clone(),
        inputs,
        days: prepared.days,
    };
    let bytes = serde_json::to_vec(&payload).map_err(Problem::internal)?;
    Ok(super::Payload { bytes, input_hash: payload.input_hash })
}

/// Eliminates and scores.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let payload: Payload = serde_json::from_slice(payload).map_err(train_model::science)?;
    let options = train_model::options(&payload.inputs.training(), payload.reported);
    let days: Vec<&[DayRecord]> = payload.days.iter().map(Vec::as_slice).collect();
    let selection = selection::select_pooled(&days, &options, progress).map_err(train_model::failed)?;
    let picture = picture(&selection, payload.synthetic).map_err(|error| Failure::Science(error.to_string()))?;
    // nothing of an elimination is drawn by lot: the seed is that of the trainings that it is for
    let seed = payload.inputs.training().seed;
    let record = SelectionRecord {
        place: payload.place,
        synthetic: payload.synthetic,
        selection,
        provenance: json!({"version": payload.version, "input_hash": payload.input_hash, "seed": seed}),
    };
    let results = serde_json::to_value(&record).map_err(train_model::science)?;
    Ok(Output { keep: Some(results.clone()), results, artifacts: vec![picture], ..Output::default() })
}

fn picture(selection: &FeatureSelection, synthetic: bool) -> Result<Artifact, DrawError> {
    let format = ImageFormat::Svg;
    Ok(Artifact {
        name: "picture".to_owned(),
        media_type: format.media_type().to_owned(),
        bytes: figures::of_selection(selection, None, synthetic).draw(format)?,
        ..Artifact::default()
    })
}

/// The selection as the store keeps it.
pub(super) fn kept(job: Uuid, keep: &Value) -> Result<NewSelection, serde_json::Error> {
    Ok(NewSelection { job, record: SelectionRecord::deserialize(keep)? })
}
