//! What can be executed: one file a process, one list of them.

pub mod echo;
pub mod runout;
pub mod train_model;

use firn_science::progress::Progress;
use jiff::Timestamp;
use serde_json::{Map, Value, json};
use uuid::Uuid;

use super::{Rules, link::Output};
use crate::{
    domain::{
        job::Job,
        problem::{Code, FieldError, Problem},
    },
    store::{Store, models::NewModel},
};

/// A process that jobs execute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Process {
    /// Gives back what it was given.
    Echo,
    /// Trains and evaluates a model of a station.
    TrainModel,
    /// Simulates the run-out of an avalanche.
    Runout,
}

/// Inputs that were checked in full.
#[derive(Debug)]
pub struct Accepted {
    /// The inputs with every default and the seed filled in.
    pub inputs: Value,
    /// SHA-256 (hex) of the inputs and of the content that they name.
    pub hash: String,
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
    pub const ALL: [Self; 3] = [Self::Echo, Self::TrainModel, Self::Runout];

    /// Its id in every address.
    #[must_use]
    pub const fn id(self) -> &'static str {
        match self {
            Self::Echo => echo::ID,
            Self::TrainModel => train_model::ID,
            Self::Runout => runout::ID,
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
            Self::Runout => runout::description(),
        }
    }

    /// Whether the same inputs always give the same results, so that they need not be computed twice.
    #[must_use]
    pub const fn is_pure(self) -> bool {
        !matches!(self, Self::Echo)
    }

    /// Checks inputs as far as that can be done without computing.
    ///
    /// # Errors
    /// A [`Problem`] with a pointer to every field at fault.
    pub async fn accept(self, store: &Store, rules: &Rules, inputs: &Value) -> Result<Accepted, Problem> {
        match self {
            Self::Echo => echo::accept(inputs),
            Self::TrainModel => train_model::accept(store, inputs).await,
            Self::Runout => runout::accept(inputs, rules.runout_memory_bytes),
        }
    }

    /// Everything that a worker needs to compute a job: it has no store.
    ///
    /// # Errors
    /// A [`Problem`] where the job can no longer be computed.
    pub async fn payload(self, store: &Store, rules: &Rules, job: &Job) -> Result<Vec<u8>, Problem> {
        match self {
            Self::Echo => {
                let is_parent = job.inputs["parts"].as_u64() > Some(0);
                let children =
                    if is_parent { store.ended_children(job.id).await.map_err(Problem::internal)? } else { Vec::new() };
                echo::payload(&job.inputs, children)
            }
            Self::TrainModel => train_model::payload(store, job).await,
            Self::Runout => runout::payload(job, rules.runout_memory_bytes),
        }
    }

    /// Computes a job from its payload: a pure function that reports to `progress`.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn compute(self, payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
        match self {
            Self::Echo => echo::compute(payload, progress),
            Self::TrainModel => train_model::compute(payload, progress),
            Self::Runout => runout::compute(payload, progress),
        }
    }

    /// What a computation wants kept beside its job, in the form in which the store keeps it.
    ///
    /// # Errors
    /// Where it is not what [`Process::compute`] gives.
    pub fn kept(job: Uuid, keep: &Value, now: Timestamp) -> Result<NewModel, serde_json::Error> {
        train_model::kept(job, keep, now)
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
