//! What can be executed: one file a process, one list of them.

pub mod echo;
mod emission;
pub mod emission_analysis;
pub mod emission_comparison;
pub mod emission_location;
pub mod emission_synthetic;
pub mod evaluate_transfer;
pub mod retrain_model;
pub mod runout;
pub mod select_features;
pub mod train_model;

use firn_science::progress::Progress;
use jiff::Timestamp;
use serde_json::{Map, Value, json};

use super::{artifacts::Artifacts, link::Output};
use crate::{
    domain::{
        job::Job,
        problem::{Code, FieldError, Problem},
    },
    store::{Store, jobs::Kept},
};

/// What a process may read before its job is computed.
#[derive(Clone, Copy)]
pub struct Shelf<'a> {
    /// Observations, models, data sets and jobs.
    pub store: &'a Store,
    /// The columns of data sets.
    pub artifacts: &'a Artifacts,
    /// What a run-out simulation may need, bytes.
    pub runout_memory_bytes: u64,
}

/// A process that jobs execute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Process {
    /// Gives back what it was given.
    Echo,
    /// Trains and evaluates a model of a station.
    TrainModel,
    /// Finds how many features a model of a station takes.
    SelectFeatures,
    /// Scores a model at a station that it was not trained at.
    EvaluateTransfer,
    /// Trains the recipe of the active model on the days there are now, as a proposal.
    RetrainModel,
    /// Simulates the run-out of an avalanche.
    Runout,
    /// Analyses a data set of acoustic emission.
    EmissionAnalysis,
    /// Compares several data sets of acoustic emission.
    EmissionComparison,
    /// Groups the hits of a data set into events and locates them.
    EmissionLocation,
    /// Makes a data set of acoustic emission with known truth.
    EmissionSynthetic,
}

/// Inputs that were checked in full.
#[derive(Debug)]
pub struct Accepted {
    /// The inputs with every default and the seed filled in.
    pub inputs: Value,
    /// SHA-256 (hex) of the inputs and of the content that they name.
    pub hash: String,
}

/// What a worker computes from: it has no store.
#[derive(Debug)]
pub struct Payload {
    /// For [`Process::compute`].
    pub bytes: Vec<u8>,
    /// SHA-256 (hex) of the inputs and of the content that they name, as it is in `bytes`.
    pub input_hash: String,
}

/// What a client needs to know of a process: OGC API - Processes Part 1, section 7.10.
#[derive(Debug)]
pub struct Description {
    /// Its id in every address.
    pub id: &'static str,
    /// In a few words.
    pub title: &'static str,
    /// In a few sentences.
    pub description: &'static str,
    /// JSON Schema of the `inputs` object, self-contained.
    pub inputs: Value,
    /// Name, title and JSON Schema of each output.
    pub outputs: Value,
    /// An execute request that works once the station exists.
    pub example: Value,
}

impl Process {
    /// Every process.
    pub const ALL: [Self; 10] = [
        Self::Echo,
        Self::TrainModel,
        Self::SelectFeatures,
        Self::EvaluateTransfer,
        Self::RetrainModel,
        Self::Runout,
        Self::EmissionAnalysis,
        Self::EmissionComparison,
        Self::EmissionLocation,
        Self::EmissionSynthetic,
    ];

    /// Its id in every address.
    #[must_use]
    pub const fn id(self) -> &'static str {
        match self {
            Self::Echo => echo::ID,
            Self::TrainModel => train_model::ID,
            Self::SelectFeatures => select_features::ID,
            Self::EvaluateTransfer => evaluate_transfer::ID,
            Self::RetrainModel => retrain_model::ID,
            Self::Runout => runout::ID,
            Self::EmissionAnalysis => emission_analysis::ID,
            Self::EmissionComparison => emission_comparison::ID,
            Self::EmissionLocation => emission_location::ID,
            Self::EmissionSynthetic => emission_synthetic::ID,
        }
    }

    /// The process of that id.
    #[must_use]
    pub fn from_id(id: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|process| process.id() == id)
    }

    /// What a client needs to know of it.
    #[must_use]
    pub fn description(self) -> Description {
        match self {
            Self::Echo => echo::description(),
            Self::TrainModel => train_model::description(),
            Self::SelectFeatures => select_features::description(),
            Self::EvaluateTransfer => evaluate_transfer::description(),
            Self::RetrainModel => retrain_model::description(),
            Self::Runout => runout::description(),
            Self::EmissionAnalysis => emission_analysis::description(),
            Self::EmissionComparison => emission_comparison::description(),
            Self::EmissionLocation => emission_location::description(),
            Self::EmissionSynthetic => emission_synthetic::description(),
        }
    }

    /// Whether the same inputs always give the same results, so that they need not be computed twice.
    #[must_use]
    pub const fn is_pure(self) -> bool {
        // each run that makes a data set gives one of its own, which its owner may remove
        !matches!(self, Self::Echo | Self::EmissionLocation | Self::EmissionSynthetic)
    }

    /// Checks inputs as far as that can be done without computing.
    ///
    /// # Errors
    /// A [`Problem`] with a pointer to every field at fault.
    pub async fn accept(self, shelf: Shelf<'_>, inputs: &Value) -> Result<Accepted, Problem> {
        match self {
            Self::Echo => echo::accept(inputs),
            Self::TrainModel => train_model::accept(shelf.store, inputs).await,
            Self::SelectFeatures => select_features::accept(shelf.store, inputs).await,
            Self::EvaluateTransfer => evaluate_transfer::accept(shelf.store, inputs).await,
            Self::RetrainModel => retrain_model::accept(shelf.store, inputs).await,
            Self::Runout => runout::accept(inputs, shelf.runout_memory_bytes),
            Self::EmissionAnalysis => emission_analysis::accept(shelf, inputs).await,
            Self::EmissionComparison => emission_comparison::accept(shelf, inputs).await,
            Self::EmissionLocation => emission_location::accept(shelf, inputs).await,
            Self::EmissionSynthetic => emission_synthetic::accept(inputs),
        }
    }

    /// Everything that a worker needs to compute a job: it has no store.
    ///
    /// # Errors
    /// A [`Problem`] where the job can no longer be computed.
    pub async fn payload(self, shelf: Shelf<'_>, job: &Job) -> Result<Payload, Problem> {
        let bytes = match self {
            Self::Echo => {
                let is_parent = job.inputs["parts"].as_u64() > Some(0);
                let children = if is_parent {
                    shelf.store.ended_children(job.id).await.map_err(Problem::internal)?
                } else {
                    Vec::new()
                };
                echo::payload(&job.inputs, children)
            }
            Self::TrainModel => return train_model::payload(shelf.store, job).await,
            Self::SelectFeatures => return select_features::payload(shelf.store, job).await,
            Self::EvaluateTransfer => return evaluate_transfer::payload(shelf.store, job).await,
            Self::RetrainModel => return retrain_model::payload(shelf.store, job).await,
            Self::Runout => runout::payload(job, shelf.runout_memory_bytes),
            Self::EmissionAnalysis => emission_analysis::payload(shelf, job).await,
            Self::EmissionComparison => emission_comparison::payload(shelf, job).await,
            Self::EmissionLocation => emission_location::payload(shelf, job).await,
            Self::EmissionSynthetic => emission_synthetic::payload(job),
        }?;
        Ok(Payload { bytes, input_hash: job.input_hash.clone() })
    }

    /// Computes a job from its payload: a pure function that reports to `progress`.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn compute(self, payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
        match self {
            Self::Echo => echo::compute(payload, progress),
            Self::TrainModel => train_model::compute(payload, progress),
            Self::SelectFeatures => select_features::compute(payload, progress),
            Self::EvaluateTransfer => evaluate_transfer::compute(payload, progress),
            Self::RetrainModel => retrain_model::compute(payload, progress),
            Self::Runout => runout::compute(payload, progress),
            Self::EmissionAnalysis => emission_analysis::compute(payload, progress),
            Self::EmissionComparison => emission_comparison::compute(payload, progress),
            Self::EmissionLocation => emission_location::compute(payload, progress),
            Self::EmissionSynthetic => emission_synthetic::compute(payload, progress),
        }
    }

    /// What a computation wants kept beside its job, in the form in which the store keeps it.
    ///
    /// # Errors
    /// Where it is not what [`Process::compute`] gives.
    pub fn kept(self, job: &Job, keep: &Value, now: Timestamp) -> Result<Kept, serde_json::Error> {
        match self {
            Self::EmissionLocation | Self::EmissionSynthetic => emission::kept(job, keep, now).map(Kept::Dataset),
            Self::SelectFeatures => {
                select_features::kept(job.id, keep).map(|selection| Kept::Selection(Box::new(selection)))
            }
            Self::EvaluateTransfer => {
                evaluate_transfer::kept(job.id, keep).map(|transfer| Kept::Transfer(Box::new(transfer)))
            }
            Self::RetrainModel => {
                retrain_model::kept(job.id, keep, now).map(|proposal| Kept::Proposal(Box::new(proposal)))
            }
            _ => train_model::kept(job.id, keep, now).map(|model| Kept::Model(Box::new(model))),
        }
    }
}

/// Why a computation has no result.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// It was asked to end.
    #[error("cancelled")]
    Cancelled,
    /// There is none, and why.
    #[error("{0}")]
    Science(String),
}

impl Description {
    /// The inputs as OGC wants them: one description an input, each with its schema.
    #[must_use]
    pub fn input_descriptions(&self) -> Value {
        let required: Vec<&str> =
            self.inputs["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let mut inputs = Map::new();
        for (name, schema) in self.inputs["properties"].as_object().into_iter().flatten() {
            let about = schema.get("description").cloned().unwrap_or_else(|| json!(name));
            let at_least = i32::from(required.contains(&name.as_str()));
            let input = json!({
                "title": name, "description": about, "minOccurs": at_least, "maxOccurs": 1, "schema": schema,
            });
            inputs.insert(name.clone(), input);
        }
        Value::Object(inputs)
    }
}

/// 422 for inputs at fault: no job was made.
#[must_use]
pub fn invalid_inputs(faults: Vec<FieldError>) -> Problem {
    let detail = faults.first().map_or_else(String::new, |first| format!("{} {}", first.pointer, first.detail));
    Problem::new(Code::InvalidInputs, detail).with_errors(faults)
}
