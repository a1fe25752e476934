//! The process `train-model`: observations of a station in, an evaluated model in the registry out.

use firn_science::forecast::{
    day::{DayRecord, Label, Variable},
    features::FeatureSetId,
    model::{self, TrainedModel, TrainingError, TrainingOptions},
    svm::{Grid, KernelFamily},
    verification::ThresholdRule,
};
use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use utoipa::{
    ToSchema,
    openapi::schema::{Object, ObjectBuilder, Type},
};

use super::{Accepted, Description, invalid_inputs};
use crate::{
    clock,
    domain::{
        date,
        ids::{StationId, new_id},
        problem::{Code, FieldError, Problem},
        schema,
        station::Station,
    },
    jobs::runner::{Context, Failure},
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
fn station_schema() -> Object {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .pattern(Some(StationId::PATTERN))
        .description(Some("The station whose observations train the model."))
        .build()
}

fn default_feature_set() -> FeatureSetId {
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
struct Prepared {
    station: Station,
    days: Vec<DayRecord>,
    options: TrainingOptions,
}

/// Checks the inputs against their schema, the station and the training window.
pub(super) async fn accept(store: &Store, inputs: &Value) -> Result<Accepted, Problem> {
    let inputs: Inputs = read(inputs)?;
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
    if faults.is_empty() { Ok(read) } else { Err(invalid_inputs(faults)) }
}

async fn prepare(store: &Store, inputs: &Inputs) -> Result<Prepared, Problem> {
    let station = store.station(&inputs.station).await.map_err(Problem::internal)?.ok_or_else(|| {
        let detail =
            format!("there is no station {}; create it with PUT /v1/stations/{}", inputs.station, inputs.station);
        invalid_inputs(vec![FieldError::new("/inputs/station", "unknown_station", detail)])
    })?;
    let (from, to) = (inputs.from.unwrap_or(ALWAYS.0), inputs.to.unwrap_or(ALWAYS.1));
    let days = store.day_records(&station.id, from, to).await.map_err(Problem::internal)?;
    let reported = station.body.variables.clone().unwrap_or_else(|| appearing(&days));
    let options = TrainingOptions {
        label: inputs.label,
        lead: inputs.lead,
        feature_set: inputs.feature_set,
        kernel: inputs.kernel,
        reported,
        seed: inputs.seed,
        grid: Grid::default(),
        threshold: inputs.cost_loss_ratio.map_or(ThresholdRule::Peirce, |ratio| ThresholdRule::CostLoss { ratio }),
    };
    Ok(Prepared { station, days, options })
}

/// The variables that at least one day has.
fn appearing(days: &[DayRecord]) -> Vec<Variable> {
    Variable::ALL.into_iter().filter(|variable| days.iter().any(|day| day.value(*variable).is_some())).collect()
}

fn refused_window(error: &TrainingError) -> Problem {
    let pointer = match error {
        TrainingError::OneClass { .. } => "/inputs/label",
        _ => "/inputs/from",
    };
    Problem::field(Code::TrainingWindow, pointer, "training_window", error.to_string())
}

/// SHA-256 (hex) of the inputs and of every value of every day of the window.
fn hash(inputs: &Inputs, station: &Station, days: &[DayRecord]) -> String {
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

/// Trains, evaluates and stores the model together with the end of its job.
pub(super) async fn run(context: &Context) -> Result<(), Failure> {
    let inputs: Inputs = serde_json::from_value(context.job.inputs.clone()).map_err(science)?;
    let prepared = prepare(&context.store, &inputs).await.map_err(science)?;
    let station = prepared.station;
    // what was promised at acceptance is what the provenance says; days that were edited while the job waited count
    let input_hash = hash(&inputs, &station, &prepared.days);
    let (days, options) = (prepared.days, prepared.options);
    let trained = context.compute(move |progress| model::train(&days, &options, progress)).await?;
    let trained = trained.map_err(|error| match error {
        TrainingError::Cancelled => Failure::Cancelled,
        error => Failure::Science(error.to_string()),
    })?;

    let provenance = json!({"version": context.job.version, "input_hash": input_hash, "seed": inputs.seed});
    let now = clock::now();
    let id = new_id();
    let scores = serde_json::to_value(trained.evaluation.scores.svm).map_err(science)?;
    let model = NewModel {
        record: ModelRecord {
            id,
            station: station.id.clone(),
            job: context.job.id,
            lead: inputs.lead,
            summary: summary(&trained.model, &station, &provenance, &scores),
            created: now,
        },
        machine: serde_json::to_string(&trained.model).map_err(science)?,
        evaluation: serde_json::to_string(&trained.evaluation).map_err(science)?,
    };
    let results = |activated: bool| {
        json!({"model_id": id, "station": station.id, "synthetic": station.synthetic, "activated": activated,
               "scores": scores, "provenance": provenance})
    };
    context.store.insert_model(&model, results, now).await?;
    Ok(())
}

fn science(error: impl std::fmt::Display) -> Failure {
    Failure::Science(error.to_string())
}

/// What the registry tells of a model without opening it.
fn summary(model: &TrainedModel, station: &Station, provenance: &Value, scores: &Value) -> Value {
    let window = &model.training;
    json!({
        "synthetic": station.synthetic,
        "training": {
            "label": model.label, "feature_set": model.feature_set, "feature_set_version": model.feature_set_version,
            "features": model.features.len(), "variables": model.reported, "kernel": kernel(model), "c": model.c,
            "gamma": model.gamma, "cross_validated_auc": model.cross_validated_auc, "threshold": model.threshold,
            "threshold_rule": model.threshold_rule, "first": window.first, "last": window.last, "days": window.days,
            "events": window.events, "seasons": window.seasons, "base_rate": model.base_rate,
            "support_vectors": model.support.len(),
        },
        "scores": scores,
        "provenance": provenance,
    })
}

fn kernel(model: &TrainedModel) -> KernelFamily {
    if model.gamma.is_some() { KernelFamily::Gaussian } else { KernelFamily::Linear }
}
