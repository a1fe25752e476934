//! The process `train-model`: observations of a station in, an evaluated model in the registry out.

use firn_science::forecast::{
    day::{DayRecord, Label, Variable},
    features::FeatureSetId,
    model::{self, FeatureChoice, TrainedModel, TrainingError, TrainingOptions},
    svm::{Grid, KernelFamily},
    verification::ThresholdRule,
};
use firn_science::progress::Progress;
use jiff::{Timestamp, civil::Date};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use utoipa::{
    ToSchema,
    openapi::schema::{Object, ObjectBuilder, Type},
};
use uuid::Uuid;

use super::{Accepted, Description, invalid_inputs};
use crate::{
    domain::{
        date,
        ids::{StationId, new_id},
        job::Job,
        problem::{Code, FieldError, Problem},
        schema,
        station::Station,
    },
    jobs::{link::Output, processes::Failure},
    store::{
        Store,
        models::{ModelRecord, NewModel},
    },
};

/// Its id in every address.
pub const ID: &str = "train-model";

/// The first and last day that a training window can have.
const ALWAYS: (Date, Date) = (Date::constant(0, 1, 1), Date::constant(9999, 12, 31));

/// What to train, from what.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Inputs {
    /// The station whose observations train the model.
    #[schema(schema_with = station_schema)]
    pub station: StationId,
    /// What counts as an avalanche day: `observed` (an avalanche was seen) or `presumed` (seen or judged likely).
    #[schema(value_type = String, pattern = "^(observed|presumed)$", example = "observed")]
    pub label: Label,
    /// Days between the last observation and the day that is forecast: 0 (nowcast) or 1 (tomorrow).
    #[schema(minimum = 0, maximum = 1, example = 0)]
    pub lead: u8,
    /// Feature set: `expert` or `raw-30`; see `/v1/feature-sets`.
    #[serde(default = "default_feature_set")]
    #[schema(value_type = String, pattern = "^(expert|raw-30)$", default = "expert")]
    pub feature_set: FeatureSetId,
    /// Names of the features to read, of that set. Where they were chosen on these days, the evaluation is flattered: name a
    /// `feature_count` to have the choice judged with the rest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_items = 1, max_items = 1000)]
    pub features: Option<Vec<String>>,
    /// How many features to keep, by recursive elimination on the training seasons of every split (Gaussian kernel only).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 1000)]
    pub feature_count: Option<u32>,
    /// A job of the process `select-features` on this station, label, lead and feature set: `feature_count` is then the
    /// number that it proposes, unless that is given too, and the model keeps the curve.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selection: Option<Uuid>,
    /// Kernel of the machine: `gaussian` or `linear`.
    #[serde(default = "default_kernel")]
    #[schema(value_type = String, pattern = "^(gaussian|linear)$", default = "gaussian")]
    pub kernel: KernelFamily,
    /// First day of the training window, YYYY-MM-DD; left out: the first that was observed.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "date::strict_option")]
    #[schema(value_type = Option<String>, format = Date)]
    pub from: Option<Date>,
    /// Last day of the training window, YYYY-MM-DD; left out: the last that was observed.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "date::strict_option")]
    #[schema(value_type = Option<String>, format = Date)]
    pub to: Option<Date>,
    /// Cost of an unnecessary warning divided by the loss of a missed avalanche day, between 0 and 1: warns from that
    /// probability on. Left out: the threshold with the best Peirce skill in the training folds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.01, maximum = 0.99)]
    pub cost_loss_ratio: Option<f64>,
    /// Seed of everything random (the bootstrap over seasons); the same seed gives the same bits.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_u64, default = 0)]
    pub seed: u64,
}

/// The description of a process stands alone: a reference to the schema of a station's name would lead nowhere.
pub(super) fn station_schema() -> Object {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .pattern(Some(StationId::PATTERN))
        .description(Some("The station whose observations train the model."))
        .build()
}

pub(super) fn default_feature_set() -> FeatureSetId {
    FeatureSetId::Expert
}

fn default_kernel() -> KernelFamily {
    KernelFamily::Gaussian
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Train an avalanche-day forecasting model",
        description: "Trains a support vector machine on the observations of a station, evaluates it beside climatology, \
                      persistence, nearest neighbours and logistic regression with every season left out once, and puts \
                      it into the registry of models. The first model of a station and lead becomes its active one.",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "model_id": {"title": "Id of the new model", "schema": {"type": "string", "format": "uuid"}},
            "activated": {"title": "Whether it became the active model of its station", "schema": {"type": "boolean"}},
            "scores": {"title": "Scores of the machine with every season left out once", "schema": {"type": "object"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {"station": "lochaber", "label": "observed", "lead": 0}}),
    }
}

/// Everything that training needs, read from the store.
pub(super) struct Prepared {
    pub(super) station: Station,
    pub(super) days: Vec<DayRecord>,
    pub(super) options: TrainingOptions,
}

/// Checks the inputs against their schema, the station and the training window.
pub(super) async fn accept(store: &Store, inputs: &Value) -> Result<Accepted, Problem> {
    let mut inputs: Inputs = read(inputs)?;
    take_selection(store, &mut inputs).await?;
    let prepared = prepare(store, &inputs).await?;
    let options = prepared.options;
    let days = prepared.days;
    let hash = hash(&inputs, &prepared.station, &days);
    model::check(&days, &options).map_err(|error| refused_window(&error))?;
    let inputs = serde_json::to_value(&inputs).map_err(Problem::internal)?;
    Ok(Accepted { inputs, hash })
}

fn read(inputs: &Value) -> Result<Inputs, Problem> {
    let read: Inputs = schema::read(inputs, "/inputs").map_err(invalid_inputs)?;
    let mut faults = Vec::new();
    if read.lead > 1 {
        faults.push(FieldError::new("/inputs/lead", "out_of_range", "must be 0 (nowcast) or 1 (tomorrow)"));
    }
    if read.cost_loss_ratio.is_some_and(|ratio| !(0.01..=0.99).contains(&ratio)) {
        faults.push(FieldError::new("/inputs/cost_loss_ratio", "out_of_range", "must be from 0.01 to 0.99"));
    }
    if read.seed > 9_007_199_254_740_991 {
        faults.push(FieldError::new("/inputs/seed", "out_of_range", "must be from 0 to 9007199254740991 (2^53 - 1)"));
    }
    if let (Some(from), Some(to)) = (read.from, read.to)
        && from > to
    {
        faults.push(FieldError::new("/inputs/to", "out_of_range", format!("must not be before from, {from}")));
    }
    if read.features.is_some() && (read.feature_count.is_some() || read.selection.is_some()) {
        let detail = "must be left out where a feature_count or a selection is given";
        faults.push(FieldError::new("/inputs/features", "contradiction", detail));
    }
    if read.features.as_ref().is_some_and(|names| names.is_empty() || names.len() > 1000) {
        faults.push(FieldError::new("/inputs/features", "out_of_range", "must be 1 to 1000 names"));
    }
    if read.feature_count.is_some_and(|count| !(1..=1000).contains(&count)) {
        faults.push(FieldError::new("/inputs/feature_count", "out_of_range", "must be from 1 to 1000"));
    }
    if faults.is_empty() { Ok(read) } else { Err(invalid_inputs(faults)) }
}

/// Looks the named selection up, which must be one of the same task, and takes the number that it proposes.
async fn take_selection(store: &Store, inputs: &mut Inputs) -> Result<(), Problem> {
    let Some(job) = inputs.selection else { return Ok(()) };
    let fault = |code: &str, detail: String| invalid_inputs(vec![FieldError::new("/inputs/selection", code, detail)]);
    let record = store.selection(job).await.map_err(Problem::internal)?;
    let record = record.ok_or_else(|| {
        fault("unknown_selection", format!("must be a successful job of the process select-features; {job} is none"))
    })?;
    let found = &record.selection;
    let same = record.station == inputs.station
        && (found.label, found.lead, found.feature_set) == (inputs.label, inputs.lead, inputs.feature_set)
        && found.feature_set_version == inputs.feature_set.version();
    if !same {
        let detail = "must be one of the same station, label, lead, feature set and its version".to_owned();
        return Err(fault("selection_mismatch", detail));
    }
    inputs.feature_count = inputs.feature_count.or_else(|| u32::try_from(found.proposed).ok());
    Ok(())
}

pub(super) async fn prepare(store: &Store, inputs: &Inputs) -> Result<Prepared, Problem> {
    let station = store.station(&inputs.station).await.map_err(Problem::internal)?.ok_or_else(|| {
        let detail =
            format!("there is no station {}; create it with PUT /v1/stations/{}", inputs.station, inputs.station);
        invalid_inputs(vec![FieldError::new("/inputs/station", "unknown_station", detail)])
    })?;
    let (from, to) = (inputs.from.unwrap_or(ALWAYS.0), inputs.to.unwrap_or(ALWAYS.1));
    let days = store.day_records(&station.id, from, to).await.map_err(Problem::internal)?;
    let reported = station.body.variables.clone().unwrap_or_else(|| appearing(&days));
    let options = options(inputs, reported);
    Ok(Prepared { station, days, options })
}

pub(super) fn options(inputs: &Inputs, reported: Vec<Variable>) -> TrainingOptions {
    TrainingOptions {
        label: inputs.label,
        lead: inputs.lead,
        feature_set: inputs.feature_set,
        features: match (&inputs.features, inputs.feature_count) {
            (Some(names), _) => FeatureChoice::Named(names.clone()),
            (None, Some(count)) => FeatureChoice::Eliminated { count: count as usize },
            (None, None) => FeatureChoice::All,
        },
        kernel: inputs.kernel,
        reported,
        seed: inputs.seed,
        grid: Grid::default(),
        threshold: inputs.cost_loss_ratio.map_or(ThresholdRule::Peirce, |ratio| ThresholdRule::CostLoss { ratio }),
    }
}

/// The variables that at least one day has.
fn appearing(days: &[DayRecord]) -> Vec<Variable> {
    Variable::ALL.into_iter().filter(|variable| days.iter().any(|day| day.value(*variable).is_some())).collect()
}

pub(super) fn refused_window(error: &TrainingError) -> Problem {
    let input = match error {
        TrainingError::Feature(_) => Some("/inputs/features"),
        TrainingError::FeatureCount { .. } => Some("/inputs/feature_count"),
        TrainingError::EliminationKernel => Some("/inputs/kernel"),
        _ => None,
    };
    if let Some(pointer) = input {
        return invalid_inputs(vec![FieldError::new(pointer, "invalid_choice", error.to_string())]);
    }
    let pointer = match error {
        TrainingError::OneClass { .. } => "/inputs/label",
        _ => "/inputs/from",
    };
    Problem::field(Code::TrainingWindow, pointer, "training_window", error.to_string())
}

/// SHA-256 (hex) of the inputs and of every value of every day of the window.
pub(super) fn hash(inputs: &Inputs, station: &Station, days: &[DayRecord]) -> String {
    let mut hasher = Sha256::new();
    let text = serde_json::to_string(&(inputs, &station.body.variables)).unwrap_or_default();
    hasher.update(text.as_bytes());
    for day in days {
        hasher.update(day.date.to_string().as_bytes());
        for value in day.values {
            // a missing value must differ from every number: NaN is never stored
            hasher.update(value.unwrap_or(f64::NAN).to_bits().to_le_bytes());
        }
        hasher.update([day.activity as u8]);
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What a worker gets: it has no store.
#[derive(Serialize, Deserialize)]
struct Payload {
    inputs: Inputs,
    synthetic: bool,
    reported: Vec<Variable>,
    input_hash: String,
    version: String,
    days: Vec<DayRecord>,
}

/// What is kept beside the job.
#[derive(Serialize, Deserialize)]
struct Kept {
    station: StationId,
    lead: u8,
    #[serde(default)]
    selection: Option<Uuid>,
    summary: Value,
    machine: Value,
    evaluation: Value,
}

/// The days as they are now: what was edited while the job waited counts, and the provenance says so.
pub(super) async fn payload(store: &Store, job: &Job) -> Result<super::Payload, Problem> {
    let inputs: Inputs = serde_json::from_value(job.inputs.clone()).map_err(Problem::internal)?;
    let Prepared { station, days, options } = prepare(store, &inputs).await?;
    let payload = Payload {
        synthetic: station.synthetic,
        reported: options.reported,
        input_hash: hash(&inputs, &station, &days),
        version: job.version.clone(),
        inputs,
        days,
    };
    let bytes = serde_json::to_vec(&payload).map_err(Problem::internal)?;
    Ok(super::Payload { bytes, input_hash: payload.input_hash })
}

/// Trains and evaluates.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let payload: Payload = serde_json::from_slice(payload).map_err(science)?;
    let options = options(&payload.inputs, payload.reported);
    let trained = model::train(&payload.days, &options, progress).map_err(|error| match error {
        TrainingError::Cancelled => Failure::Cancelled,
        error => Failure::Science(error.to_string()),
    })?;
    let inputs = payload.inputs;
    let provenance = json!({"version": payload.version, "input_hash": payload.input_hash, "seed": inputs.seed});
    let scores = serde_json::to_value(trained.evaluation.scores.svm).map_err(science)?;
    let results = json!({
        "station": inputs.station, "synthetic": payload.synthetic, "scores": scores, "provenance": provenance,
    });
    let kept = Kept {
        station: inputs.station,
        lead: inputs.lead,
        selection: inputs.selection,
        summary: summary(&trained.model, &options.features, payload.synthetic, &provenance, &scores),
        machine: serde_json::to_value(&trained.model).map_err(science)?,
        evaluation: serde_json::to_value(&trained.evaluation).map_err(science)?,
    };
    let keep = serde_json::to_value(&kept).map_err(science)?;
    Ok(Output { results, keep: Some(keep), ..Output::default() })
}

/// The model as the registry keeps it.
pub(super) fn kept(job: Uuid, keep: &Value, now: Timestamp) -> Result<NewModel, serde_json::Error> {
    let kept: Kept = serde_json::from_value(keep.clone())?;
    let record = ModelRecord {
        id: new_id(),
        station: kept.station,
        job,
        lead: kept.lead,
        selection: kept.selection,
        summary: kept.summary,
        created: now,
    };
    Ok(NewModel { record, machine: kept.machine.to_string(), evaluation: kept.evaluation.to_string() })
}

pub(super) fn science(error: impl std::fmt::Display) -> Failure {
    Failure::Science(error.to_string())
}

/// What the registry tells of a model without opening it.
fn summary(model: &TrainedModel, choice: &FeatureChoice, synthetic: bool, provenance: &Value, scores: &Value) -> Value {
    let window = &model.training;
    json!({
        "synthetic": synthetic,
        "training": {
            "label": model.label, "feature_set": model.feature_set, "feature_set_version": model.feature_set_version,
            "features": model.features.len(), "feature_choice": choice_name(choice), "variables": model.reported, "kernel": kernel(model), "c": model.c,
            "gamma": model.gamma, "cross_validated_auc": model.cross_validated_auc, "threshold": model.threshold,
            "threshold_rule": model.threshold_rule, "first": window.first, "last": window.last, "days": window.days,
            "events": window.events, "seasons": window.seasons, "base_rate": model.base_rate,
            "support_vectors": model.support.len(),
        },
        "scores": scores,
        "provenance": provenance,
    })
}

/// How the features were chosen: `named` ones may have been chosen on the very days that score the model.
const fn choice_name(choice: &FeatureChoice) -> &'static str {
    match choice {
        FeatureChoice::All => "all",
        FeatureChoice::Named(_) => "named",
        FeatureChoice::Eliminated { .. } => "eliminated",
    }
}

fn kernel(model: &TrainedModel) -> KernelFamily {
    if model.gamma.is_some() { KernelFamily::Gaussian } else { KernelFamily::Linear }
}
