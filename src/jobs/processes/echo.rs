//! The process `echo`: gives back what it was given, after a while if so wished. The standard asks for such a process,
//! to test clients with; our own tests of jobs use it too.

use std::time::{Duration, Instant};

use firn_science::progress::Progress;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use utoipa::ToSchema;

use super::{Accepted, Description, Failure, invalid_inputs};
use crate::{
    domain::{
        problem::{FieldError, Problem},
        schema,
    },
    jobs::link::{Artifact, Output, Part},
    store::jobs::ChildEnd,
};

/// Its id in every address.
pub const ID: &str = "echo";

/// How often it looks whether it shall end.
const STEP: Duration = Duration::from_millis(10);

/// What to give back, and how.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Inputs {
    /// The text to give back, at most 10,000 characters.
    #[schema(max_length = 10_000, example = "hello")]
    pub message: String,
    /// How long to take, s.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 600, default = 0)]
    pub delay_s: f64,
    /// Into how many jobs to split; each gives the message back after the delay, and they run side by side.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 1000, default = 0)]
    pub parts: u32,
    /// Also give back an `attachment` of so many bytes, by reference.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 16_777_216, default = 0)]
    pub attachment_bytes: u32,
    /// Fail at the end instead of giving anything back.
    #[serde(default)]
    #[schema(default = false)]
    pub fail: bool,
}

/// What a worker gets.
#[derive(Serialize, Deserialize)]
struct Payload {
    inputs: Inputs,
    children: Vec<(bool, Value)>,
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Give back what was given",
        description: "Gives the message back, after a delay if so wished: to try out clients, progress, dismissal and \
                      large outputs. It is computed anew each time.",
        inputs: schema::schema_of::<Inputs>(),
        outputs: json!({
            "message": {"title": "The message", "schema": {"type": "string"}},
            "parts": {"title": "What each part gave, in their order", "schema": {"type": "array"}},
            "attachment": {"title": "The attachment, by reference", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {"message": "hello", "delay_s": 0.5}}),
    }
}

pub(super) fn accept(inputs: &Value) -> Result<Accepted, Problem> {
    let read: Inputs = schema::read(inputs, "/inputs").map_err(invalid_inputs)?;
    let mut faults = Vec::new();
    let mut check = |good: bool, name: &str, rule: &str| {
        if !good {
            faults.push(FieldError::new(format!("/inputs/{name}"), "out_of_range", rule));
        }
    };
    check(read.message.chars().count() <= 10_000, "message", "must be at most 10000 characters");
    check((0.0..=600.0).contains(&read.delay_s), "delay_s", "must be from 0 to 600 s");
    check(read.parts <= 1000, "parts", "must be from 0 to 1000");
    check(read.attachment_bytes <= 16_777_216, "attachment_bytes", "must be from 0 to 16777216");
    if !faults.is_empty() {
        return Err(invalid_inputs(faults));
    }
    let inputs = serde_json::to_value(&read).map_err(Problem::internal)?;
    let digest = Sha256::digest(inputs.to_string().as_bytes());
    Ok(Accepted { inputs, hash: digest.iter().map(|byte| format!("{byte:02x}")).collect() })
}

pub(super) fn payload(inputs: &Value, children: Vec<ChildEnd>) -> Result<Vec<u8>, Problem> {
    let inputs: Inputs = serde_json::from_value(inputs.clone()).map_err(Problem::internal)?;
    let children = children
        .into_iter()
        .map(|child| match (child.results, child.exception) {
            (Some(results), _) => (true, results),
            (None, exception) => {
                (false, json!(exception.map_or_else(|| "it was dismissed".to_owned(), |exception| exception.detail)))
            }
        })
        .collect();
    serde_json::to_vec(&Payload { inputs, children }).map_err(Problem::internal)
}

pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    let Payload { inputs, children } =
        serde_json::from_slice(payload).map_err(|error| Failure::Science(error.to_string()))?;
    if inputs.parts > 0 && children.is_empty() {
        let part = json!({"message": inputs.message, "delay_s": inputs.delay_s, "fail": inputs.fail});
        let split = vec![Part { process_id: ID.into(), inputs: part }; inputs.parts as usize];
        return Ok(Output { split, ..Output::default() });
    }
    if inputs.parts == 0 {
        wait(inputs.delay_s, progress)?;
        if inputs.fail {
            return Err(Failure::Science("it was asked to fail".into()));
        }
    } else if let Some((place, (_, why))) = children.iter().enumerate().find(|(_, (good, _))| !good) {
        let why = why.as_str().unwrap_or_default();
        return Err(Failure::Science(format!("part {place} has no result: {why}")));
    }
    let parts: Vec<Value> = children.into_iter().map(|(_, results)| results).collect();
    let mut results = json!({"message": inputs.message});
    if let (Some(object), false) = (results.as_object_mut(), parts.is_empty()) {
        object.insert("parts".into(), Value::Array(parts));
    }
    Ok(Output { results, artifacts: attachment(inputs.attachment_bytes), ..Output::default() })
}

/// Waits; a resumed attempt waits only for what is left.
fn wait(delay_s: f64, progress: &dyn Progress) -> Result<(), Failure> {
    let waited = progress.resumed().and_then(|bytes| Some(f64::from_le_bytes(bytes.try_into().ok()?))).unwrap_or(0.0);
    let begun = Instant::now();
    loop {
        if progress.cancelled() {
            return Err(Failure::Cancelled);
        }
        let elapsed = waited.max(0.0) + begun.elapsed().as_secs_f64();
        if elapsed >= delay_s {
            return Ok(());
        }
        progress.report(elapsed / delay_s, "waiting");
        progress.checkpoint(&|| elapsed.to_le_bytes().to_vec());
        std::thread::sleep(STEP.min(Duration::from_secs_f64(delay_s - elapsed)));
    }
}

fn attachment(bytes: u32) -> Vec<Artifact> {
    if bytes == 0 {
        return Vec::new();
    }
    // every byte can be told from its neighbours, so that a wrong range shows
    let bytes = (0..bytes).map(|at| (at % 251) as u8).collect();
    vec![Artifact {
        name: "attachment".into(),
        media_type: "application/octet-stream".into(),
        bytes,
        pieces: Vec::new(),
    }]
}

#[cfg(test)]
mod tests {
    use firn_science::progress::Unobserved;

    use super::*;

    fn run(inputs: Value, children: Vec<ChildEnd>) -> Result<Output, Failure> {
        let accepted = accept(&inputs).unwrap();
        compute(&payload(&accepted.inputs, children).unwrap(), &Unobserved)
    }

    #[test]
    fn the_message_comes_back() {
        assert_eq!(run(json!({"message": "a"}), vec![]).unwrap().results, json!({"message": "a"}));
    }

    #[test]
    fn parts_are_jobs_of_their_own_without_parts() {
        let output = run(json!({"message": "a", "parts": 3, "delay_s": 0.1}), vec![]).unwrap();
        assert_eq!(output.split.len(), 3);
        assert_eq!(output.split[0].inputs["parts"], Value::Null);
    }

    #[test]
    fn inputs_out_of_range_are_named() {
        let problem = accept(&json!({"message": "a", "delay_s": -1, "parts": 5000})).unwrap_err();
        let pointers: Vec<_> = problem.errors.iter().map(|error| error.pointer.as_str()).collect();
        assert_eq!(pointers, ["/inputs/delay_s", "/inputs/parts"]);
    }
}
