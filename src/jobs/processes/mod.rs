//! What can be executed: one file a process, one list of them.

pub mod train_model;

use serde_json::{Map, Value, json};

use super::runner::{Context, Failure};
use crate::{
    domain::problem::{Code, FieldError, Problem},
    store::Store,
};

/// A process that jobs execute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Process {
    /// Trains and evaluates a model of a station.
    TrainModel,
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
    pub const ALL: [Self; 1] = [Self::TrainModel];

    /// Its id in every address.
    #[must_use]
    pub const fn id(self) -> &'static str {
        match self {
            Self::TrainModel => train_model::ID,
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
            Self::TrainModel => train_model::description(),
        }
    }

    /// Checks inputs as far as that can be done without computing.
    ///
    /// # Errors
    /// A [`Problem`] with a pointer to every field at fault.
    pub async fn accept(self, store: &Store, inputs: &Value) -> Result<Accepted, Problem> {
        match self {
            Self::TrainModel => train_model::accept(store, inputs).await,
        }
    }

    /// Computes a started job and stores its results.
    ///
    /// # Errors
    /// [`Failure`]; the runner ends the job then.
    pub async fn run(self, context: &Context) -> Result<(), Failure> {
        match self {
            Self::TrainModel => train_model::run(context).await,
        }
    }
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
