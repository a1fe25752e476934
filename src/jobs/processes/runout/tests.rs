//! Runs with their films, whole and interrupted, and what is refused.

use std::{collections::HashMap, sync::Mutex};

use firn_science::runout::{Dump, ParticleState, frames};

use super::{camera::*, *};
use crate::{formats::film, jobs::artifacts::digest};

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
    let large = accept(&json!({"scenario": "group-2", "snow": snow(1.0, 0.0), "mesh_m": 0.001}), MEMORY).unwrap_err();
    assert!(large.errors[0].detail.contains("particles") && large.errors[0].detail.contains("bytes"), "{large}");
    assert!(large.errors[0].detail.contains(MEMORY_SETTING), "{large}");
    // the mesh that two gibibytes allow is refused where the server allows one
    let fine = json!({"scenario": "group-2", "snow": snow(1.0, 0.0), "mesh_m": 0.003});
    assert!(accept(&fine, MEMORY).is_ok() && accept(&fine, MEMORY / 2).is_err());
}

#[test]
fn a_run_that_broke_says_at_which_step_with_the_state_there() {
    let particle = ParticleState {
        id: 7,
        x_m: f64::NAN,
        z_m: 1.5,
        velocity_m_s: [0.25, 0.0],
        elastic: [0.0; 3],
        plastic_strain: -0.125,
        strength_pa: 3e3,
    };
    let dump = Box::new(Dump { offender: particle, neighbours: vec![ParticleState { id: 8, x_m: 2.5, ..particle }] });
    let Failure::Science(said) = failure(RunError::Dynamics(RunoutError::Diverged { step: 42, dump })) else {
        panic!("a broken run is a failure of the computation");
    };
    for part in ["state at step 42", "id: 7", "x_m: NaN", "plastic_strain: -0.125", "id: 8", "x_m: 2.5"] {
        assert!(said.contains(part), "{part} is not in {said}");
    }
}
