//! The process `train-model`: observations of a station or region in, an evaluated model in the registry out.

use firn_science::forecast::{
    day::{DayRecord, Label, Variable},
    features::FeatureSetId,
    model::{self, FeatureChoice, Trained, TrainedModel, TrainingError, TrainingOptions},
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
        ids::{Place, RegionId, StationId, new_id},
        job::Job,
        problem::{Code, FieldError, Problem},
        region::{AvalancheDay, Region},
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
    /// The station whose observations train the model; name a station or a region.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = station_schema)]
    pub station: Option<StationId>,
    /// The region whose stations feed the model together; its avalanche days are the region's.
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
        .description(Some("The station whose observations are used; name a station or a region."))
        .build()
}

pub(super) fn region_schema() -> Object {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .pattern(Some(RegionId::PATTERN))
        .description(Some("The region whose stations feed the model together; name a station or a region."))
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
        description: "Trains a support vector machine on the observations of a station, or of all stations of a region, \
                      evaluates it beside climatology, persistence, nearest neighbours and logistic regression with every \
                      season left out once, and puts it into the registry of models. The first model of a station or region \
                      and lead becomes its active one.",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "model_id": {"title": "Id of the new model", "schema": {"type": "string", "format": "uuid"}},
            "activated": {"title": "Whether it became the active model of its station or region", "schema": {"type": "boolean"}},
            "scores": {"title": "Scores of the machine with every season left out once", "schema": {"type": "object"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {"station": "lochaber", "label": "observed", "lead": 0}}),
    }
}

/// Everything that training needs, read from the store.
pub(super) struct Prepared {
    pub(super) place: Place,
    pub(super) region: Option<Region>,
    /// The station, or those of the region in their order.
    pub(super) stations: Vec<Station>,
    /// The days of each station; of a region with its avalanche activity.
    pub(super) days: Vec<Vec<DayRecord>>,
    pub(super) options: TrainingOptions,
}

impl Prepared {
    /// The days of each station, as the science takes them.
    pub(super) fn parts(&self) -> Vec<&[DayRecord]> {
        self.days.iter().map(Vec::as_slice).collect()
    }

    /// Whether any of the days come from a generator.
    pub(super) fn is_synthetic(&self) -> bool {
        self.stations.iter().any(|station| station.synthetic)
    }
}

/// Checks the inputs against their schema, the station or region and the training window.
pub(super) async fn accept(store: &Store, inputs: &Value) -> Result<Accepted, Problem> {
    let mut inputs: Inputs = read(inputs)?;
    take_selection(store, &mut inputs).await?;
    let prepared = prepare(store, &inputs).await?;
    model::check_pooled(&prepared.parts(), &prepared.options).map_err(|error| refused_window(&error))?;
    let hash = hash(&inputs, &prepared);
    let inputs = serde_json::to_value(&inputs).map_err(Problem::internal)?;
    Ok(Accepted { inputs, hash })
}

fn read(inputs: &Value) -> Result<Inputs, Problem> {
    let read: Inputs = read_of_place(inputs)?;
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
    faults.extend(place_fault(read.station.as_ref(), read.region.as_ref()));
    if faults.is_empty() { Ok(read) } else { Err(invalid_inputs(faults)) }
}

/// Reads inputs that name a station or a region: where they cannot be read, that they name neither is said with the rest.
pub(super) fn read_of_place<T: serde::de::DeserializeOwned + ToSchema + 'static>(inputs: &Value) -> Result<T, Problem> {
    schema::read(inputs, "/inputs").map_err(|mut faults| {
        if inputs.is_object() && inputs.get("station").is_none() && inputs.get("region").is_none() {
            faults.extend(place_fault(None, None));
        }
        invalid_inputs(faults)
    })
}

/// What is wrong where not exactly one place is named.
pub(super) fn place_fault(station: Option<&StationId>, region: Option<&RegionId>) -> Option<FieldError> {
    match (station, region) {
        (None, None) => Some(FieldError::new("/inputs/station", "missing", "is missing: name a station or a region")),
        (Some(_), Some(_)) => {
            let detail = "must be left out where a station is named: name a station or a region";
            Some(FieldError::new("/inputs/region", "contradiction", detail))
        }
        _ => None,
    }
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
    let same = record.place.station() == inputs.station.as_ref()
        && record.place.region() == inputs.region.as_ref()
        && (found.label, found.lead, found.feature_set) == (inputs.label, inputs.lead, inputs.feature_set)
        && found.feature_set_version == inputs.feature_set.version();
    if !same {
        let detail = "must be one of the same station or region, label, lead, feature set and its version".to_owned();
        return Err(fault("selection_mismatch", detail));
    }
    inputs.feature_count = inputs.feature_count.or_else(|| u32::try_from(found.proposed).ok());
    Ok(())
}

pub(super) async fn prepare(store: &Store, inputs: &Inputs) -> Result<Prepared, Problem> {
    let (from, to) = (inputs.from.unwrap_or(ALWAYS.0), inputs.to.unwrap_or(ALWAYS.1));
    if let Some(id) = &inputs.region {
        let region = region(store, id).await?;
        let mut stations = Vec::with_capacity(region.body.stations.len());
        for id in &region.body.stations {
            stations.push(station(store, id).await?);
        }
        let days = store.regional_days(&region, inputs.label, from, to).await.map_err(Problem::internal)?;
        let reported = shared(&stations, &days);
        let options = options(inputs, reported);
        return Ok(Prepared { place: Place::Region(id.clone()), region: Some(region), stations, days, options });
    }
    let Some(id) = &inputs.station else {
        return Err(invalid_inputs(place_fault(None, None).into_iter().collect()));
    };
    let station = station(store, id).await?;
    let days = store.day_records(&station.id, from, to).await.map_err(Problem::internal)?;
    let options = options(inputs, reported(&station, &days));
    Ok(Prepared { place: Place::Station(id.clone()), region: None, stations: vec![station], days: vec![days], options })
}

pub(super) async fn station(store: &Store, id: &StationId) -> Result<Station, Problem> {
    store.station(id).await.map_err(Problem::internal)?.ok_or_else(|| {
        let detail = format!("there is no station {id}; create it with PUT /v1/stations/{id}");
        invalid_inputs(vec![FieldError::new("/inputs/station", "unknown_station", detail)])
    })
}

pub(super) async fn region(store: &Store, id: &RegionId) -> Result<Region, Problem> {
    store.region(id).await.map_err(Problem::internal)?.ok_or_else(|| {
        let detail = format!("there is no region {id}; create it with PUT /v1/regions/{id}");
        invalid_inputs(vec![FieldError::new("/inputs/region", "unknown_region", detail)])
    })
}

/// The variables that a station reports: what its owner says, or what its days have.
pub(super) fn reported(station: &Station, days: &[DayRecord]) -> Vec<Variable> {
    station.body.variables.clone().unwrap_or_else(|| appearing(days))
}

/// The variables that every station of a region reports: one that some lack would tell the machine which station it sees.
fn shared(stations: &[Station], days: &[Vec<DayRecord>]) -> Vec<Variable> {
    let each: Vec<Vec<Variable>> = stations.iter().zip(days).map(|(station, days)| reported(station, days)).collect();
    Variable::ALL.into_iter().filter(|variable| each.iter().all(|reported| reported.contains(variable))).collect()
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
pub(super) fn hash(inputs: &Inputs, prepared: &Prepared) -> String {
    let mut hasher = Sha256::new();
    let of_stations = match (&prepared.region, prepared.stations.as_slice()) {
        (None, [station]) => serde_json::to_string(&(inputs, &station.body.variables)),
        (region, stations) => {
            let rule = region.as_ref().map(|region| region.body.avalanche_day);
            let stations: Vec<_> = stations.iter().map(|station| (&station.id, &station.body.variables)).collect();
            serde_json::to_string(&(inputs, rule, stations))
        }
    };
    hasher.update(of_stations.unwrap_or_default().as_bytes());
    prepared.days.iter().for_each(|days| hash_days(&mut hasher, days));
    hex(hasher)
}

pub(super) fn hash_days(hasher: &mut Sha256, days: &[DayRecord]) {
    for day in days {
        hasher.update(day.date.to_string().as_bytes());
        for value in day.values {
            // a missing value must differ from every number: NaN is never stored
            hasher.update(value.unwrap_or(f64::NAN).to_bits().to_le_bytes());
        }
        hasher.update([day.activity as u8]);
    }
}

pub(super) fn hex(hasher: Sha256) -> String {
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What a worker gets: it has no store.
#[derive(Serialize, Deserialize)]
pub(super) struct Payload {
    pub(super) inputs: Inputs,
    pub(super) synthetic: bool,
    reported: Vec<Variable>,
    stations: Vec<StationId>,
    /// The region as it was: its revision, and what its avalanche days are.
    region: Option<(u32, AvalancheDay)>,
    pub(super) input_hash: String,
    version: String,
    days: Vec<Vec<DayRecord>>,
}

impl Payload {
    pub(super) fn parts(&self) -> Vec<&[DayRecord]> {
        self.days.iter().map(Vec::as_slice).collect()
    }

    pub(super) fn options(&self) -> TrainingOptions {
        options(&self.inputs, self.reported.clone())
    }

    pub(super) fn provenance(&self) -> Value {
        json!({"version": self.version, "input_hash": self.input_hash, "seed": self.inputs.seed})
    }
}

/// What is kept beside the job.
#[derive(Serialize, Deserialize)]
pub(super) struct Kept {
    place: Place,
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
    let payload = gather(store, inputs, &job.version).await?;
    let bytes = serde_json::to_vec(&payload).map_err(Problem::internal)?;
    Ok(super::Payload { bytes, input_hash: payload.input_hash })
}

/// What a worker needs for a training.
pub(super) async fn gather(store: &Store, inputs: Inputs, version: &str) -> Result<Payload, Problem> {
    let prepared = prepare(store, &inputs).await?;
    Ok(Payload {
        synthetic: prepared.is_synthetic(),
        input_hash: hash(&inputs, &prepared),
        reported: prepared.options.reported,
        stations: prepared.stations.into_iter().map(|station| station.id).collect(),
        region: prepared.region.map(|region| (region.revision, region.body.avalanche_day)),
        version: version.to_owned(),
        inputs,
        days: prepared.days,
    })
}

/// Trains and evaluates.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let payload: Payload = serde_json::from_slice(payload).map_err(science)?;
    let trained = model::train_pooled(&payload.parts(), &payload.options(), progress).map_err(failed)?;
    let (mut results, kept) = outcome(&payload, &trained)?;
    place_of(&payload.inputs, &mut results);
    let keep = serde_json::to_value(&kept).map_err(science)?;
    Ok(Output { results, keep: Some(keep), ..Output::default() })
}

pub(super) fn failed(error: TrainingError) -> Failure {
    match error {
        TrainingError::Cancelled => Failure::Cancelled,
        error => Failure::Science(error.to_string()),
    }
}

/// Adds the station or region to the results.
fn place_of(inputs: &Inputs, results: &mut Value) {
    if let Some(station) = &inputs.station {
        results["station"] = json!(station);
    }
    if let Some(region) = &inputs.region {
        results["region"] = json!(region);
    }
}

/// The results of a training, and the model to keep.
pub(super) fn outcome(payload: &Payload, trained: &Trained) -> Result<(Value, Kept), Failure> {
    let inputs = &payload.inputs;
    let provenance = payload.provenance();
    let scores = serde_json::to_value(trained.evaluation.scores.svm).map_err(science)?;
    let results = json!({"synthetic": payload.synthetic, "scores": scores, "provenance": provenance});
    let place = match (&inputs.station, &inputs.region) {
        (_, Some(region)) => Place::Region(region.clone()),
        (Some(station), None) => Place::Station(station.clone()),
        (None, None) => return Err(Failure::Science("the inputs name neither a station nor a region".to_owned())),
    };
    let kept = Kept {
        place,
        lead: inputs.lead,
        selection: inputs.selection,
        summary: summary(payload, &trained.model, &provenance, &scores),
        machine: serde_json::to_value(&trained.model).map_err(science)?,
        evaluation: serde_json::to_value(&trained.evaluation).map_err(science)?,
    };
    Ok((results, kept))
}

/// The model as the registry keeps it.
pub(super) fn kept(job: Uuid, keep: &Value, now: Timestamp) -> Result<NewModel, serde_json::Error> {
    let kept: Kept = serde_json::from_value(keep.clone())?;
    let record = ModelRecord {
        id: new_id(),
        place: kept.place,
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
fn summary(payload: &Payload, model: &TrainedModel, provenance: &Value, scores: &Value) -> Value {
    let window = &model.training;
    let mut summary = json!({
        "synthetic": payload.synthetic,
        "inputs": payload.inputs,
        "training": {
            "stations": payload.stations,
            "label": model.label, "feature_set": model.feature_set, "feature_set_version": model.feature_set_version,
            "features": model.features.len(), "feature_choice": choice_name(&payload.options().features), "variables": model.reported, "kernel": kernel(model), "c": model.c,
            "gamma": model.gamma, "cross_validated_auc": model.cross_validated_auc, "threshold": model.threshold,
            "threshold_rule": model.threshold_rule, "first": window.first, "last": window.last, "days": window.days,
            "events": window.events, "seasons": window.seasons, "base_rate": model.base_rate,
            "support_vectors": model.support.len(),
        },
        "scores": scores,
        "provenance": provenance,
    });
    if let Some((revision, avalanche_day)) = &payload.region {
        let (training, day) = (&mut summary["training"], json!(avalanche_day));
        training["station_days"] = json!(window.station_days);
        training["region"] = json!({"revision": revision, "avalanche_day": day});
    }
    summary
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
