//! The process `runout`: a slab of snow on a slope in, its run-out, flow regime and frames out.

mod camera;
#[cfg(test)]
mod tests;

use std::time::Instant;

use camera::Camera;
use firn_science::{
    progress::Progress,
    runout::{
        RunoutError,
        plan::{InputError, Plan},
        run::{self, RunError},
        scenario::RunoutInputs,
    },
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::{Accepted, Description, Failure, invalid_inputs};
use crate::{
    domain::{
        job::Job,
        problem::{FieldError, Problem},
        schema,
    },
    jobs::link::{Artifact, Output},
};

/// Its id in every address.
pub const ID: &str = "runout";

/// The name of the output that holds the frames.
pub const FRAMES: &str = "frames";

/// The setting of the most memory that the particles and the grid of a run may take.
const MEMORY_SETTING: &str = "runout_memory_mib";

/// Bytes of a piece of the film, at least: pieces are handed over while the run goes on.
const PIECE_BYTES: usize = 1 << 20;

/// What this model leaves out, said beside every result.
const LIMITS: [&str; 3] = [
    "two dimensions: no lateral spreading, every quantity is a metre of width",
    "dense flow only: no powder cloud, no entrainment of snow on the way",
    "fronts of fragmenting flows are chaotic: a different mesh moves them by some 15 %",
];

/// What a worker gets.
#[derive(Serialize, Deserialize)]
struct Payload {
    inputs: RunoutInputs,
    input_hash: String,
    version: String,
    memory_limit_bytes: u64,
}

/// What a client needs to know of the process.
#[must_use]
pub fn description() -> Description {
    Description {
        id: ID,
        title: "Simulate the run-out of a snow avalanche",
        description: "Releases a slab of snow on a slope and follows it until it rests, by a two-dimensional material \
                      point method with cohesive Cam clay (after Li, Sovilla, Jiang & Gaume 2020). Scenarios are listed \
                      at /v1/scenarios; any profile serves as terrain.",
        inputs: schema::schema_of::<RunoutInputs>(),
        outputs: json!({
            "summary": {"title": "The run in a few numbers", "schema": {"type": "object"}},
            "series": {"title": "Front, centre of mass, speeds, energies and shape at 24 frames a second", "schema": {"type": "object"}},
            "profiles": {"title": "Flow depth and velocity along the track and over the depth, granules and surges, every half second", "schema": {"type": "object"}},
            "frames": {"title": "Every particle at some frames a second; see /v1/jobs/{jobID}/frames", "schema": {"type": "object"}},
            "inputs": {"title": "The inputs with everything filled in", "schema": {"type": "object"}},
            "limits": {"title": "What the model leaves out", "schema": {"type": "array"}},
            "provenance": {"title": "Version, input hash and seed", "schema": {"type": "object"}},
        }),
        example: json!({"inputs": {
            "scenario": "group-2", "quality": "quick", "snow": {"M": 0.5, "beta": 0.0, "xi": 1.0, "p0_kpa": 3.0},
        }}),
    }
}

/// Checks the inputs against their schema, the model, the terrain and the memory.
pub(super) fn accept(inputs: &Value, memory_limit_bytes: u64) -> Result<Accepted, Problem> {
    let read: RunoutInputs = schema::read(inputs, "/inputs").map_err(invalid_inputs)?;
    let plan = Plan::new(&read, memory_limit_bytes)
        .map_err(|faults| invalid_inputs(faults.iter().map(field_error).collect()))?;
    let inputs = serde_json::to_value(&plan.inputs).map_err(Problem::internal)?;
    let digest = Sha256::digest(inputs.to_string().as_bytes());
    Ok(Accepted { inputs, hash: digest.iter().map(|byte| format!("{byte:02x}")).collect() })
}

fn field_error(error: &InputError) -> FieldError {
    let code = match error {
        InputError::OutOfRange { .. } | InputError::TimeStep { .. } => "out_of_range",
        InputError::Missing { .. } => "missing",
        InputError::Beside { .. } => "exclusive",
        InputError::Terrain(_) => "terrain",
        InputError::Release(_) => "release",
        InputError::TooLarge { .. } => "too_large",
    };
    let detail = match error {
        InputError::TooLarge { .. } => format!("{error} (the setting {MEMORY_SETTING} of the server)"),
        _ => error.to_string(),
    };
    FieldError::new(format!("/inputs{}", error.pointer()), code, detail)
}

/// What a worker needs: nothing that the job does not already say.
pub(super) fn payload(job: &Job, memory_limit_bytes: u64) -> Result<Vec<u8>, Problem> {
    let inputs = serde_json::from_value(job.inputs.clone()).map_err(Problem::internal)?;
    let (input_hash, version) = (job.input_hash.clone(), job.version.clone());
    let payload = Payload { inputs, input_hash, version, memory_limit_bytes };
    serde_json::to_vec(&payload).map_err(Problem::internal)
}

/// Simulates.
pub(super) fn compute(payload: &[u8], progress: &dyn Progress) -> Result<Output, Failure> {
    compute_with(payload, progress, PIECE_BYTES)
}

fn compute_with(payload: &[u8], progress: &dyn Progress, piece_bytes: usize) -> Result<Output, Failure> {
    let payload: Payload = serde_json::from_slice(payload).map_err(science)?;
    let plan = Plan::new(&payload.inputs, payload.memory_limit_bytes).map_err(|faults| {
        let faults: Vec<String> = faults.iter().map(|fault| format!("{} {fault}", fault.pointer())).collect();
        Failure::Science(faults.join("; "))
    })?;
    let camera = Camera::new(&plan, progress, piece_bytes);
    let begun = Instant::now();
    let mut outcome = run::run(&plan, &camera, &mut |number, frame| camera.take(number, frame)).map_err(failure)?;
    let seconds = begun.elapsed().as_secs_f64();
    outcome.summary.particle_steps_per_s = (seconds > 0.0).then(|| camera.work_done() / seconds);
    let film = camera.into_film()?;
    let artifacts = vec![
        json_artifact("series", &outcome.observations.series)?,
        json_artifact(
            "profiles",
            &json!({
                "depth": outcome.observations.depth_profiles,
                "velocity": outcome.observations.velocity_profiles,
                "pieces": outcome.observations.pieces,
            }),
        )?,
        film,
    ];
    let results = json!({
        "summary": outcome.summary,
        "inputs": plan.inputs,
        "limits": LIMITS,
        "provenance": {"version": payload.version, "input_hash": payload.input_hash, "seed": payload.inputs.seed},
    });
    Ok(Output { results, artifacts, ..Output::default() })
}

fn json_artifact(name: &str, value: &impl Serialize) -> Result<Artifact, Failure> {
    let bytes = serde_json::to_vec(value).map_err(science)?;
    Ok(Artifact { name: name.into(), media_type: "application/json".into(), bytes, pieces: Vec::new() })
}

fn science(error: impl std::fmt::Display) -> Failure {
    Failure::Science(error.to_string())
}

/// A run that broke says where, with the state there.
fn failure(error: RunError) -> Failure {
    match error {
        RunError::Cancelled => Failure::Cancelled,
        RunError::Dynamics(RunoutError::Diverged { step, ref dump }) => {
            Failure::Science(format!("{error}; state at step {step}: {dump:?}"))
        }
        error => Failure::Science(error.to_string()),
    }
}
