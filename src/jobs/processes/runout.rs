//! The process `runout`: a slab of snow on a slope in, its run-out, flow regime and frames out.

use std::{
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use firn_science::{
    progress::Progress,
    runout::{
        GRAVITY_M_S2, RunoutError,
        observables::FRAMES_PER_S,
        plan::{InputError, Plan},
        run::{self, RunError},
        scenario::RunoutInputs,
    },
};
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::{Accepted, Description, Failure, invalid_inputs};
use crate::{
    domain::{
        job::Job,
        problem::{FieldError, Problem},
        schema,
    },
    formats::film,
    jobs::{
        artifacts::digest,
        link::{Artifact, Output},
    },
};

/// Its id in every address.
pub const ID: &str = "runout";

/// The name of the output that holds the frames.
pub const FRAMES: &str = "frames";

/// The setting of the most memory that the particles and the grid of a run may take.
const MEMORY_SETTING: &str = "runout_memory_mib";

/// The most bytes that all frames of a run may take, about.
const FILM_BYTES: f64 = 512e6;
/// Bytes of a piece of the film, at least: pieces are handed over while the run goes on.
const PIECE_BYTES: usize = 1 << 20;
/// Bytes of a packed frame a particle, about.
const FRAME_BYTES_A_PARTICLE: f64 = 3.5;
/// Physical time that a run takes at most, in units of the time scale of its fall, sqrt(H0 / g), about.
const USUAL_DURATION: f64 = 10.0;
/// The frame rates that are chosen from, a second: all divide that of the series.
const FRAME_RATES: [u32; 6] = [24, 12, 8, 4, 2, 1];

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

/// What is saved of a run: its own state, and what it has given of the film.
#[derive(Serialize, Deserialize)]
struct Saved {
    #[serde(with = "serde_bytes")]
    run: Vec<u8>,
    film: Film,
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

/// Keeps some of the frames of a run, also over its interruptions, and counts its work.
struct Camera<'a> {
    progress: &'a dyn Progress,
    /// One frame of so many is kept, and the last.
    every: usize,
    film: Mutex<Film>,
    piece_bytes: usize,
    /// The state of the run that an earlier attempt saved.
    resumed: Option<Vec<u8>>,
    /// Work of this attempt: the bits of an `f64`.
    work: AtomicU64,
}

/// The film of a run so far. Its frames go away in pieces, so that neither the memory nor a saved state holds them.
#[derive(Clone, Default, Serialize, Deserialize)]
struct Film {
    /// Time since release, s, and length of every frame.
    table: Vec<(f64, u64)>,
    /// Digests of the pieces that were handed over.
    pieces: Vec<String>,
    /// The frames since then, one after the other.
    #[serde(with = "serde_bytes")]
    rest: Vec<u8>,
    /// The newest frame, where it is not one of those that are kept.
    newest: Option<(f64, ByteBuf)>,
}

impl Film {
    fn push(&mut self, time_s: f64, frame: &[u8]) {
        self.table.push((time_s, frame.len() as u64));
        self.rest.extend_from_slice(frame);
    }

    /// Hands the frames since the last piece over; false where nobody takes them.
    fn hand_over(&mut self, progress: &dyn Progress) -> bool {
        let name = digest(&self.rest);
        match progress.keep(std::mem::take(&mut self.rest)) {
            Ok(()) => self.pieces.push(name),
            Err(piece) => self.rest = piece,
        }
        self.rest.is_empty()
    }
}

impl<'a> Camera<'a> {
    fn new(plan: &Plan, progress: &'a dyn Progress, piece_bytes: usize) -> Self {
        // what an earlier version saved is of no use, but no reason to fail either
        let saved = progress.resumed().and_then(|bytes| rmp_serde::from_slice::<Saved>(bytes).ok());
        let (resumed, film) = saved.map_or((None, Film::default()), |saved| (Some(saved.run), saved.film));
        Self {
            progress,
            every: FRAMES_PER_S as usize / frames_per_s(plan) as usize,
            film: Mutex::new(film),
            piece_bytes,
            resumed,
            work: AtomicU64::new(0),
        }
    }

    fn film(&self) -> MutexGuard<'_, Film> {
        self.film.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self, number: usize, frame: Vec<u8>) {
        let time_s = number as f64 / FRAMES_PER_S;
        let mut film = self.film();
        if number == 0 {
            // a run that began anew although there was a saved state
            *film = Film::default();
        }
        if !number.is_multiple_of(self.every) {
            film.newest = Some((time_s, ByteBuf::from(frame)));
            return;
        }
        film.newest = None;
        film.push(time_s, &frame);
        if film.rest.len() >= self.piece_bytes {
            // where nobody takes it, the film is held here
            film.hand_over(self.progress);
        }
    }

    /// Particle-steps of this attempt.
    fn work_done(&self) -> f64 {
        f64::from_bits(self.work.load(Ordering::Relaxed))
    }

    fn into_film(self) -> Result<Artifact, Failure> {
        let mut film = self.film.into_inner().unwrap_or_else(PoisonError::into_inner);
        if let Some((time_s, frame)) = film.newest.take() {
            film.push(time_s, &frame);
        }
        let mut bytes = film::head(&film.table);
        if film.pieces.is_empty() {
            bytes.append(&mut film.rest);
        } else if !film.rest.is_empty() && !film.hand_over(self.progress) {
            return Err(science("the last frames were not taken"));
        }
        let (name, media_type) = (FRAMES.into(), "application/octet-stream".into());
        Ok(Artifact { name, media_type, bytes, pieces: film.pieces })
    }
}

impl Progress for Camera<'_> {
    fn report(&self, fraction: f64, phase: &str) {
        self.progress.report(fraction, phase);
    }

    fn cancelled(&self) -> bool {
        self.progress.cancelled()
    }

    fn rate(&self, per_second: f64, unit: &str) {
        self.progress.rate(per_second, unit);
    }

    fn work(&self, done: f64, unit: &str) {
        self.work.store(done.to_bits(), Ordering::Relaxed);
        self.progress.work(done, unit);
    }

    fn checkpoint(&self, state: &dyn Fn() -> Vec<u8>) {
        self.progress.checkpoint(&|| {
            let saved = Saved { run: state(), film: self.film().clone() };
            // bytes and numbers always have this form; without it the next attempt begins at the beginning
            rmp_serde::to_vec(&saved).unwrap_or_default()
        });
    }

    fn keep(&self, piece: Vec<u8>) -> Result<(), Vec<u8>> {
        self.progress.keep(piece)
    }

    fn resumed(&self) -> Option<&[u8]> {
        self.resumed.as_deref()
    }
}

/// Frames kept a second: as many as the film has room for, by the usual duration of a run.
fn frames_per_s(plan: &Plan) -> u32 {
    let duration_s = (USUAL_DURATION * (plan.drop_height_m / GRAVITY_M_S2).sqrt()).min(plan.end_time_s);
    let room = FILM_BYTES / (plan.particles() as f64 * FRAME_BYTES_A_PARTICLE * duration_s);
    FRAME_RATES.into_iter().find(|&rate| f64::from(rate) <= room).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use firn_science::runout::frames;

    use super::*;

    fn quick() -> Value {
        json!({"scenario": "warm-plug", "mesh_m": 0.25, "end_time_s": 1.0})
    }

    const MEMORY: u64 = 2 << 30;

    /// Runs with pieces of this size.
    fn run(inputs: &Value, progress: &dyn Progress, piece_bytes: usize) -> Result<Output, Failure> {
        let inputs = serde_json::from_value(accept(inputs, MEMORY).unwrap().inputs).unwrap();
        let (input_hash, version) = (String::new(), String::new());
        let payload = Payload { inputs, input_hash, version, memory_limit_bytes: MEMORY };
        compute_with(&serde_json::to_vec(&payload).unwrap(), progress, piece_bytes)
    }

    /// Pieces by their digest.
    type Pieces = HashMap<String, Vec<u8>>;

    /// The film as it is stored.
    fn film_of(output: &Output, pieces: &Pieces) -> Vec<u8> {
        let film = output.artifacts.iter().find(|artifact| artifact.name == FRAMES).unwrap();
        film.pieces.iter().fold(film.bytes.clone(), |film, piece| [film, pieces[piece].clone()].concat())
    }

    fn frames_of(film: &[u8]) -> Vec<(f64, Vec<u8>)> {
        let table = film::table_bytes(&film[..film::HEADER_BYTES as usize]).unwrap();
        let entries = film::read_table(&film[table.start as usize..table.end as usize]).unwrap();
        let frame =
            |entry: film::Entry| (entry.time_s, film[entry.bytes.start as usize..entry.bytes.end as usize].to_vec());
        entries.into_iter().map(frame).collect()
    }

    #[test]
    fn a_run_has_its_frames_at_their_times() {
        let output = run(&quick(), &firn_science::progress::Unobserved, PIECE_BYTES).unwrap();
        let film = frames_of(&film_of(&output, &Pieces::new()));
        assert_eq!(film.len(), 25);
        for (number, (time_s, frame)) in film.iter().enumerate() {
            assert!((time_s - number as f64 / 24.0).abs() < 1e-12);
            assert_eq!(
                frames::decode(frame).unwrap().x_m.len() as u64,
                output.results["summary"]["particles"].as_u64().unwrap()
            );
        }
        assert_eq!(output.results["inputs"]["time_step_s"], json!(0.0011));
    }

    /// Saves at every offer, stores pieces, and ends after some offers.
    struct Killer {
        resumed: Option<Vec<u8>>,
        offers_left: Mutex<usize>,
        saved: Mutex<Vec<u8>>,
        pieces: Mutex<Pieces>,
    }

    impl Killer {
        fn after(offers: usize, resumed: Option<Vec<u8>>, pieces: Pieces) -> Self {
            let (offers_left, pieces) = (Mutex::new(offers), Mutex::new(pieces));
            Self { resumed, offers_left, saved: Mutex::default(), pieces }
        }
    }

    impl Progress for Killer {
        fn report(&self, _: f64, _: &str) {}

        fn cancelled(&self) -> bool {
            *self.offers_left.lock().unwrap() == 0
        }

        fn checkpoint(&self, state: &dyn Fn() -> Vec<u8>) {
            let mut left = self.offers_left.lock().unwrap();
            if *left > 0 {
                *left -= 1;
                *self.saved.lock().unwrap() = state();
            }
        }

        fn keep(&self, piece: Vec<u8>) -> Result<(), Vec<u8>> {
            self.pieces.lock().unwrap().insert(digest(&piece), piece);
            Ok(())
        }

        fn resumed(&self) -> Option<&[u8]> {
            self.resumed.as_deref()
        }
    }

    #[test]
    fn a_run_that_was_interrupted_has_the_bits_and_frames_of_one_that_was_not() {
        const PIECE: usize = 3_000;
        let whole = run(&quick(), &firn_science::progress::Unobserved, PIECE).unwrap();
        let film = film_of(&whole, &Pieces::new());
        let (mut resumed, mut pieces) = (None, Pieces::new());
        let parts = loop {
            let killer = Killer::after(9, resumed.take(), std::mem::take(&mut pieces));
            let ended = run(&quick(), &killer, PIECE);
            pieces = killer.pieces.into_inner().unwrap();
            match ended {
                Ok(output) => break output,
                Err(Failure::Cancelled) => {
                    let saved = killer.saved.into_inner().unwrap();
                    let film = rmp_serde::from_slice::<Saved>(&saved).unwrap().film;
                    assert!(film.rest.len() < PIECE && film.pieces.iter().all(|piece| pieces.contains_key(piece)));
                    resumed = Some(saved);
                }
                Err(error) => panic!("{error}"),
            }
        };
        assert!(pieces.len() > 3, "{} bytes in {} pieces", film.len(), pieces.len());
        assert!(film_of(&parts, &pieces) == film, "the films differ");
        let bytes = |output: &Output| output.artifacts[..2].iter().map(|file| file.bytes.clone()).collect::<Vec<_>>();
        assert_eq!(bytes(&parts), bytes(&whole));
        let timeless = |mut output: Output| {
            output.results["summary"]["particle_steps_per_s"] = Value::Null;
            output.results
        };
        assert_eq!(timeless(parts), timeless(whole));
    }

    #[test]
    fn a_large_run_keeps_fewer_frames() {
        let plan = |inputs: Value| Plan::new(&serde_json::from_value(inputs).unwrap(), MEMORY).unwrap();
        let snow = json!({"M": 0.5, "beta": 0, "xi": 1, "p0_kpa": 3});
        assert_eq!(frames_per_s(&plan(json!({"scenario": "group-2", "quality": "quick", "snow": snow}))), 24);
        assert_eq!(frames_per_s(&plan(json!({"scenario": "group-2", "snow": snow}))), 24);
        assert_eq!(frames_per_s(&plan(json!({"scenario": "group-5", "snow": snow}))), 4);
    }

    #[test]
    fn faults_are_named_before_there_is_a_job() {
        let snow = |m: f64, beta: f64| json!({"M": m, "beta": beta, "xi": 1, "p0_kpa": 3});
        let cases = [
            (json!({"scenario": "group-2"}), "/inputs/snow"),
            (json!({"scenario": "group-2", "snow": snow(0.0, 0.0)}), "/inputs/snow/M"),
            (json!({"scenario": "group-2", "snow": snow(1.0, -0.1)}), "/inputs/snow/beta"),
            (json!({"scenario": "group-2", "snow": snow(1.0, 0.0), "time_step_s": 1e-3}), "/inputs/time_step_s"),
            (json!({"scenario": "group-2", "snow": snow(1.0, 0.0), "mesh_m": 0.001}), "/inputs/mesh_m"),
            (json!({"scenario": "group-9", "snow": snow(1.0, 0.0)}), "/inputs/scenario"),
        ];
        for (inputs, pointer) in cases {
            let problem = accept(&inputs, MEMORY).unwrap_err();
            assert_eq!(problem.errors[0].pointer, pointer, "{inputs} {problem}");
        }
        let limit =
            accept(&json!({"scenario": "group-2", "snow": snow(1.0, 0.0), "time_step_s": 1e-3}), MEMORY).unwrap_err();
        assert!(limit.errors[0].detail.contains("at most"), "{limit}");
        let large =
            accept(&json!({"scenario": "group-2", "snow": snow(1.0, 0.0), "mesh_m": 0.001}), MEMORY).unwrap_err();
        assert!(large.errors[0].detail.contains("particles") && large.errors[0].detail.contains("bytes"), "{large}");
        assert!(large.errors[0].detail.contains(MEMORY_SETTING), "{large}");
        // the mesh that two gibibytes allow is refused where the server allows one
        let fine = json!({"scenario": "group-2", "snow": snow(1.0, 0.0), "mesh_m": 0.003});
        assert!(accept(&fine, MEMORY).is_ok() && accept(&fine, MEMORY / 2).is_err());
    }
}
