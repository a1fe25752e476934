//! The process `retrain-model`: the recipe of the active model on all days there are now in, a proposal out.

use firn_science::{
    forecast::{
        evaluation::{Comparison, Difference, Verdict},
        model::{self, FeatureChoice, TrainedModel},
        svm::KernelFamily,
    },
    progress::Progress,
};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    Accepted, Description, invalid_inputs,
    train_model::{self, Inputs as Training, region_schema, science, station_schema},
};
use crate::{
    domain::{
        ids::{Place, RegionId, StationId, new_id},
        job::Job,
        problem::{FieldError, Problem},
        schema,
    },
    jobs::{link::Output, processes::Failure},
    store::{Store, models::ModelRecord, proposals::NewProposal},
};

/// Its id in every address.
pub const ID: &str = "retrain-model";

/// What to retrain.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RetrainingInputs)]
pub struct Inputs {
    /// The station whose active model is retrained; name a station or a region.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = station_schema)]
    pub station: Option<StationId>,
    /// The region whose active model is retrained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = region_schema)]
    pub region: Option<RegionId>,
    /// Days between the last observation and the day that is forecast: 0 (nowcast) or 1 (tomorrow).
    #[serde(default)]
    #[schema(minimum = 0, maximum = 1, default = 0)]
    pub lead: u8,
}

impl Inputs {
    /// Those for a place.
    #[must_use]
    pub fn of(place: &Place, lead: u8) -> Self {
        Self { station: place.station().cloned(), region: place.region().cloned(), lead }
    }
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Retrain the active model on the days there are now",
        description: "Trains the recipe of the active model of a station or region (label, features, kernel, threshold) on all \
                      days from the beginning of its window until now, evaluates it, and compares it with the active model \
                      on the same seasons, each held out from both, with intervals of a paired bootstrap over seasons. The \
                      result is a proposal: nothing changes until somebody accepts it.",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "proposal_id": {"title": "Id of the proposal", "schema": {"type": "string", "format": "uuid"}},
            "model_id": {"title": "Id of the new model", "schema": {"type": "string", "format": "uuid"}},
            "activated": {"title": "Always false: a proposal replaces nothing", "schema": {"type": "boolean"}},
            "recommendation": {"title": "What the comparison says, in words", "schema": {"type": "string"}},
            "comparison": {"title": "Both models on the same seasons", "schema": {"type": ["object", "null"]}},
            "scores": {"title": "Scores of the new model with every season left out once", "schema": {"type": "object"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {"station": "lochaber", "lead": 0}}),
    }
}

/// The active model, and its recipe without an end of the window.
struct Asked {
    active: Uuid,
    seasons: Vec<i16>,
    training: Training,
}

async fn ask(store: &Store, inputs: &Inputs) -> Result<Asked, Problem> {
    let place = match (&inputs.station, &inputs.region) {
        (Some(station), _) => Place::Station(train_model::station(store, station).await?.id),
        (None, Some(region)) => Place::Region(train_model::region(store, region).await?.id),
        (None, None) => return Err(invalid_inputs(train_model::place_fault(None, None).into_iter().collect())),
    };
    let active = store.active_model(&place, inputs.lead).await.map_err(Problem::internal)?.ok_or_else(|| {
        let detail = format!("{place} has no active model of lead {} to retrain: train one first", inputs.lead);
        invalid_inputs(vec![FieldError::new("/inputs/lead", "no_active_model", detail)])
    })?;
    let gone = || Problem::internal("an active model is gone");
    let record = store.model(active.model).await.map_err(Problem::internal)?.ok_or_else(gone)?;
    let model = store.trained_model(active.model).await.map_err(Problem::internal)?.ok_or_else(gone)?;
    Ok(Asked { active: record.id, seasons: model.training.seasons.clone(), training: recipe(&record, &model) })
}

/// The inputs of the training of a model, open to days to come.
fn recipe(record: &ModelRecord, model: &TrainedModel) -> Training {
    let kept = serde_json::from_value::<Training>(record.summary["inputs"].clone()).ok();
    let mut training = kept.unwrap_or_else(|| from_model(record, model));
    // the curve of an earlier selection is not that of these days; its number of features stands in the inputs
    (training.to, training.selection) = (None, None);
    training
}

/// The same for a model of a version that did not keep them.
fn from_model(record: &ModelRecord, model: &TrainedModel) -> Training {
    let choice = record.summary["training"]["feature_choice"].as_str().unwrap_or("all");
    let choice = match choice {
        "named" => FeatureChoice::Named(model.features.clone()),
        "eliminated" => FeatureChoice::Eliminated { count: model.features.len() },
        _ => FeatureChoice::All,
    };
    let (features, feature_count) = match choice {
        FeatureChoice::Named(names) => (Some(names), None),
        FeatureChoice::Eliminated { count } => (None, u32::try_from(count).ok()),
        FeatureChoice::All => (None, None),
    };
    Training {
        station: record.place.station().cloned(),
        region: record.place.region().cloned(),
        label: model.label,
        lead: model.lead,
        feature_set: model.feature_set,
        features,
        feature_count,
        selection: None,
        kernel: if model.gamma.is_some() { KernelFamily::Gaussian } else { KernelFamily::Linear },
        from: None,
        to: None,
        cost_loss_ratio: model.threshold_rule.cost_loss(),
        seed: model.seed,
    }
}

/// Checks the inputs against their schema, the active model and the days.
pub(super) async fn accept(store: &Store, inputs: &Value) -> Result<Accepted, Problem> {
    let read: Inputs = train_model::read_of_place(inputs)?;
    let mut faults = Vec::new();
    if read.lead > model::LONGEST_LEAD {
        faults.push(FieldError::new("/inputs/lead", "out_of_range", "must be 0 (nowcast) or 1 (tomorrow)"));
    }
    faults.extend(train_model::place_fault(read.station.as_ref(), read.region.as_ref()));
    if !faults.is_empty() {
        return Err(invalid_inputs(faults));
    }
    let asked = ask(store, &read).await?;
    let prepared = train_model::prepare(store, &asked.training).await?;
    model::check_pooled(&prepared.parts(), &prepared.options).map_err(|error| train_model::refused_window(&error))?;
    let hash = hash(asked.active, &train_model::hash(&asked.training, &prepared));
    Ok(Accepted { inputs: serde_json::to_value(&read).map_err(Problem::internal)?, hash })
}

/// The same days compared with another active model are another job.
fn hash(active: Uuid, training: &str) -> String {
    format!("{training}-{active}")
}

/// What a worker gets: it has no store.
#[derive(Serialize, Deserialize)]
struct Payload {
    training: train_model::Payload,
    active: Uuid,
    active_seasons: Vec<i16>,
}

/// What is kept beside the job.
#[derive(Serialize, Deserialize)]
struct Kept {
    model: Value,
    active: Uuid,
    recommendation: String,
    comparison: Option<Comparison>,
}

/// The days as they are now.
pub(super) async fn payload(store: &Store, job: &Job) -> Result<super::Payload, Problem> {
    let inputs: Inputs = serde_json::from_value(job.inputs.clone()).map_err(Problem::internal)?;
    let asked = ask(store, &inputs).await?;
    let training = train_model::gather(store, asked.training, &job.version).await?;
    let input_hash = hash(asked.active, &training.input_hash);
    let payload = Payload { training, active: asked.active, active_seasons: asked.seasons };
    Ok(super::Payload { bytes: serde_json::to_vec(&payload).map_err(Problem::internal)?, input_hash })
}

/// Trains, evaluates and compares.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let payload: Payload = serde_json::from_slice(payload).map_err(science)?;
    let training = &payload.training;
    let (trained, comparison) =
        model::retrain(&training.parts(), &training.options(), &payload.active_seasons, progress)
            .map_err(train_model::failed)?;
    let (mut results, model) = train_model::outcome(training, &trained)?;
    let recommendation = recommendation(comparison.as_ref());
    results["recommendation"] = json!(recommendation);
    results["comparison"] = serde_json::to_value(&comparison).map_err(science)?;
    let kept = Kept {
        model: serde_json::to_value(&model).map_err(science)?,
        active: payload.active,
        recommendation,
        comparison,
    };
    Ok(Output { results, keep: Some(serde_json::to_value(&kept).map_err(science)?), ..Output::default() })
}

/// What the comparison says, in words.
fn recommendation(comparison: Option<&Comparison>) -> String {
    let Some(comparison) = comparison else {
        return "No comparison: no season can be held out from the active model, which has too few. Look at the evaluation of \
                the new one."
            .to_owned();
    };
    let (seasons, new) = (comparison.seasons.len(), comparison.new_seasons.len());
    let difference = comparison.difference.auc.map_or_else(String::new, |Difference { estimate, lower, upper }| {
        format!(" The difference in AUC is {estimate:+.3} ({lower:+.3} to {upper:+.3}).")
    });
    match comparison.verdict {
        Verdict::Better => {
            format!("Accept: on {seasons} seasons held out from both the new model is better.{difference}")
        }
        Verdict::Worse => {
            format!("Decline: on {seasons} seasons held out from both the new model is worse.{difference}")
        }
        Verdict::NoDifference if new > 0 => format!(
            "Accept if nothing else speaks against it: on {seasons} seasons held out from both there is no real difference, and \
             the new model knows {new} more season(s).{difference}"
        ),
        Verdict::NoDifference => {
            "Keep the active model: the new one was trained on the same seasons, and nothing is gained.".to_owned()
        }
    }
}

/// The proposal as the store keeps it.
pub(super) fn kept(job: Uuid, keep: &Value, now: Timestamp) -> Result<NewProposal, serde_json::Error> {
    let kept = Kept::deserialize(keep)?;
    Ok(NewProposal {
        id: new_id(),
        model: train_model::kept(job, &kept.model, now)?,
        active: kept.active,
        recommendation: kept.recommendation,
        comparison: kept.comparison,
    })
}
