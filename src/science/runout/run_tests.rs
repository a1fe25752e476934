//! Whole runs of Group II on a coarse mesh.

use std::collections::BTreeMap;
use std::sync::Mutex;

use rayon::prelude::*;
use serde_json::json;

use super::frames::{Frame, decode};
use super::observables::{Ending, FRAMES_PER_S};
use super::plan::Plan;
use super::regime::RegimeClass;
use super::run::{Outcome, RunError, WORK_UNIT, run};
use super::scenario::{RunoutInputs, ScenarioName, SnowInputs};
use crate::progress::{Progress, Unobserved};

const MEMORY: u64 = 1 << 30;

fn plan(inputs: &RunoutInputs) -> Plan {
    Plan::new(inputs, MEMORY).unwrap()
}

fn flow(name: ScenarioName, mesh_m: f64) -> RunoutInputs {
    RunoutInputs { mesh_m: Some(mesh_m), ..RunoutInputs::of_scenario(name, None) }
}

fn outcome(inputs: &RunoutInputs) -> Outcome {
    run(&plan(inputs), &Unobserved, &mut |_, _| {}).unwrap()
}

/// What holds of every run that comes to rest.
fn check_run(outcome: &Outcome, class: RegimeClass) {
    let summary = &outcome.summary;
    assert_eq!(summary.regime.class, class, "{:?}", summary.regime);
    assert_eq!(summary.ending, Ending::AtRest);
    assert_eq!(summary.particles, 9600);
    assert!(summary.energy_closure < 0.02, "{}", summary.energy_closure);
    // frictionless fall from the top of the block to the flat
    let free_fall =
        (2.0 * super::GRAVITY_M_S2 * (52.793 + 1.0 * 40_f64.to_radians().cos() + 6.0 * 40_f64.to_radians().sin()))
            .sqrt();
    assert!(summary.particle_v_max < 1.15 * free_fall, "{}", summary.particle_v_max);
    let series = &outcome.observations.series;
    for (frame, time) in series.time_s.iter().enumerate() {
        let expected = frame as f64 / FRAMES_PER_S;
        assert!((time - expected) < 4.6e-4 + 1e-9 && time - expected > -1e-9, "{time} is no frame");
    }
}

#[test]
fn a_warm_plug_is_one() {
    check_run(&outcome(&flow(ScenarioName::WarmPlug, 0.1)), RegimeClass::WarmPlug);
}

#[test]
fn a_cold_dense_flow_is_one() {
    check_run(&outcome(&flow(ScenarioName::ColdDense, 0.1)), RegimeClass::ColdDense);
}

#[test]
fn a_warm_shear_flow_is_one() {
    check_run(&outcome(&flow(ScenarioName::WarmShear, 0.1)), RegimeClass::WarmShear);
}

#[test]
fn a_sliding_slab_is_one() {
    check_run(&outcome(&flow(ScenarioName::SlidingSlab, 0.1)), RegimeClass::SlidingSlab);
}

/// What is closer than this share cannot be told from the next snow: it shares a rank.
const TIE: f64 = 0.01;

/// Ranks from 0; values that agree with the smallest of their group to `tie` share the mean of theirs.
fn ranks(values: &[f64], tie: f64) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    while first < order.len() {
        let least = values[order[first]];
        let many = order[first..].iter().take_while(|&&i| values[i] <= least * (1.0 + tie)).count();
        for &i in &order[first..first + many] {
            ranks[i] = first as f64 + (many - 1) as f64 / 2.0;
        }
        first += many;
    }
    ranks
}

/// Spearman's rank correlation, by Pearson's of the ranks, which is what ties need; those of `y` within `tie` are ties.
fn rank_correlation(x: &[f64], y: &[f64], tie: f64) -> f64 {
    let middle = (x.len() - 1) as f64 / 2.0;
    let (x, y) = (ranks(x, 0.0), ranks(y, tie));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - middle) * (b - middle)).sum::<f64>();
    product(&x, &y) / (product(&x, &x) * product(&y, &y)).sqrt()
}

/// The last is `scipy.stats.spearmanr([1, 2, 3, 4, 5], [9, 9, 9, 4, 1])` of SciPy 1.17.1.
#[test]
fn ranks_of_a_falling_row_correlate_by_minus_one() {
    assert_eq!(rank_correlation(&[1.0, 2.0, 5.0], &[3.0, 2.0, 0.0], 0.0), -1.0);
    assert_eq!(rank_correlation(&[1.0, 2.0, 3.0, 4.0], &[1.0, 3.0, 2.0, 4.0], 0.0), 0.8);
    let ties = rank_correlation(&[1.0, 2.0, 3.0, 4.0, 5.0], &[9.0, 9.02, 9.05, 4.0, 1.0], TIE);
    assert!((ties + 0.894_427_190_999_915_9).abs() < 1e-12, "{ties}");
}

/// Scaled v_max of M and p0 of Table 1 with beta 0.3 and xi 1, by rising reach angle (Figures 8 and 9): that of the centre
/// of mass, which does not hang on where single pieces come to rest.
fn two_stages(mesh_m: f64) -> (Vec<f64>, Vec<f64>) {
    let snows = [0.1, 0.5, 1.0, 1.5].map(|m| [3.0, 12.0, 21.0, 30.0].map(|p0| SnowInputs::new(m, 0.3, 1.0, p0)));
    let runs = snows.as_flattened().par_iter().map(|&snow| {
        let group = RunoutInputs::of_scenario(ScenarioName::Group2, Some(snow));
        let summary = outcome(&RunoutInputs { mesh_m: Some(mesh_m), ..group }).summary;
        (summary.reach_angle_deg.com, summary.v_max_scaled)
    });
    let mut points: Vec<(f64, f64)> = runs.collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    println!("{points:.3?}");
    points.into_iter().unzip()
}

/// How far values go from their mean, over it.
fn deviations(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| (value / mean - 1.0).abs()).collect()
}

/// The two stages: `fall` bounds the rank correlation of the eight smaller angles, `plateau` how far a value of the eight
/// others is from their mean. Each row of M lies below the one before, apart from the last two, which are the plateau.
fn check_two_stages(mesh_m: f64, fall: f64, plateau: f64) -> Vec<f64> {
    let (angle, speed) = two_stages(mesh_m);
    let below = |later: usize, earlier: usize| {
        speed[later..later + 4].iter().all(|v| speed[earlier..earlier + 4].iter().all(|w| v < w))
    };
    assert!(below(4, 0) && below(8, 4) && below(12, 4), "{angle:?} {speed:?}");
    let correlation = rank_correlation(&angle[..8], &speed[..8], TIE);
    assert!(correlation < fall, "{correlation}: {angle:?} {speed:?}");
    let deviations = deviations(&speed[8..]);
    assert!(deviations.iter().all(|deviation| *deviation < plateau), "{deviations:?}");
    deviations
}

#[test]
fn scaled_speed_falls_with_the_reach_angle_and_then_levels_off() {
    check_two_stages(0.2, -0.8, 0.03);
}

#[test]
#[ignore = "takes minutes: cargo test --release -p firn-science two_stages -- --ignored"]
fn two_stages_are_clear_at_mesh_0_1() {
    let deviations = check_two_stages(0.1, -0.8, 0.1);
    // one of the eight is off: of M 1.5 with p0 12 kPa a hundredth of the mass flies for a second, without the bed's friction
    let near = deviations.iter().filter(|deviation| **deviation < 0.03).count();
    assert!(near == 7, "{deviations:?}");
}

/// Is stopped after some offers to save the state, and keeps the last state.
struct Interrupted {
    offers_left: Mutex<u32>,
    saved: Mutex<Vec<u8>>,
    resumed: Option<Vec<u8>>,
    reports: Mutex<Vec<f64>>,
    work: Mutex<f64>,
}

impl Interrupted {
    fn after(offers: u32, resumed: Option<Vec<u8>>) -> Self {
        let (saved, reports, work) = (Mutex::default(), Mutex::default(), Mutex::default());
        Self { offers_left: Mutex::new(offers), saved, resumed, reports, work }
    }
}

impl Progress for Interrupted {
    fn report(&self, fraction: f64, _phase: &str) {
        self.reports.lock().unwrap().push(fraction);
    }

    fn cancelled(&self) -> bool {
        *self.offers_left.lock().unwrap() == 0
    }

    fn work(&self, done: f64, unit: &str) {
        assert_eq!(unit, WORK_UNIT);
        *self.work.lock().unwrap() = done;
    }

    fn checkpoint(&self, state: &dyn Fn() -> Vec<u8>) {
        let mut left = self.offers_left.lock().unwrap();
        *left = left.saturating_sub(1);
        if *left == 0 {
            *self.saved.lock().unwrap() = state();
        }
    }

    fn resumed(&self) -> Option<&[u8]> {
        self.resumed.as_deref()
    }
}

fn coarse() -> RunoutInputs {
    RunoutInputs { end_time_s: 2.0, ..flow(ScenarioName::ColdDense, 0.25) }
}

#[test]
fn a_run_that_is_taken_up_again_gives_the_same_bits() {
    let plan = plan(&coarse());
    let mut whole = BTreeMap::new();
    let expected = run(&plan, &Unobserved, &mut |frame, bytes| drop(whole.insert(frame, bytes))).unwrap();
    assert_eq!((expected.summary.ending, whole.len()), (Ending::EndTime, 49));
    let mut frames = BTreeMap::new();
    let first = Interrupted::after(20, None);
    let broken = run(&plan, &first, &mut |frame, bytes| drop(frames.insert(frame, bytes)));
    assert_eq!(broken, Err(RunError::Cancelled));
    assert!(frames.len() < 40 && !first.saved.lock().unwrap().is_empty());
    let second = Interrupted::after(u32::MAX, Some(first.saved.lock().unwrap().clone()));
    let outcome = run(&plan, &second, &mut |frame, bytes| drop(frames.insert(frame, bytes))).unwrap();
    assert_eq!(outcome, expected);
    assert!(frames == whole, "the frames differ");
    // both attempts together did all of the work, and neither counts what the other did
    let both = *first.work.lock().unwrap() + *second.work.lock().unwrap();
    assert_eq!(both, (expected.summary.steps * expected.summary.particles) as f64);
    assert!(second.reports.lock().unwrap().is_sorted());
}

#[test]
fn a_state_of_something_else_begins_at_the_beginning() {
    let plan = plan(&coarse());
    let other = Interrupted::after(u32::MAX, Some(vec![1, 2, 3]));
    let expected = run(&plan, &Unobserved, &mut |_, _| {}).unwrap();
    assert_eq!(run(&plan, &other, &mut |_, _| {}).unwrap(), expected);
}

#[test]
fn frames_show_the_snow_and_are_small() {
    let mut frames: Vec<Vec<u8>> = Vec::new();
    let plan = plan(&coarse());
    run(&plan, &Unobserved, &mut |_, bytes| frames.push(bytes)).unwrap();
    let decoded: Vec<Frame> = frames.iter().map(|bytes| decode(bytes).unwrap()).collect();
    let placed = plan.setup.release.place(&plan.setup.terrain, 0.125).unwrap();
    for particle in 0..placed.x_m.len() {
        assert!((decoded[0].x_m[particle] - placed.x_m[particle]).abs() < 0.006);
        assert!((decoded[0].z_m[particle] - placed.z_m[particle]).abs() < 0.006);
        assert_eq!(decoded[0].speed_m_s[particle], 0.0);
    }
    // 250 KB for 38,400 particles
    let most = frames.iter().map(Vec::len).max().unwrap();
    assert!(most * 38_400 < 250_000 * placed.x_m.len(), "{most}");
}

#[test]
fn a_flow_over_the_edge_of_the_terrain_ends_there() {
    let cliff = json!({
        "terrain": {"profile": [[-60.0, 45.0], [0.0, 0.0], [5.0, 0.0]]},
        "release": {"x_m": -20.0, "length_m": 8.0, "thickness_m": 2.0},
        "snow": {"M": 0.5, "beta": 0.0, "xi": 1, "p0_kpa": 3},
        "bed": {"mu": 0.1}, "mesh_m": 0.25,
    });
    let outcome = outcome(&serde_json::from_value(cliff).unwrap());
    assert_eq!(outcome.summary.ending, Ending::LeftDomain);
    assert!(outcome.summary.front_m > -20.0 && outcome.summary.front_m <= 5.0);
    assert!(outcome.observations.series.time_s.len() > 10);
}

#[test]
fn snow_that_cannot_slide_is_at_rest_at_once() {
    let inputs = json!({
        "terrain": {"profile": [[-60.0, 0.0], [60.0, 0.0]]},
        "release": {"x_m": 0.0, "length_m": 8.0, "thickness_m": 2.0},
        "snow": {"M": 1.5, "beta": 1.0, "xi": 1, "p0_kpa": 100}, "mesh_m": 0.25,
    });
    let summary = outcome(&serde_json::from_value(inputs).unwrap()).summary;
    assert_eq!(summary.ending, Ending::AtRest);
    assert!(summary.duration_s < 5.0 && summary.com_end_m.abs() < 0.1, "{summary:?}");
    assert!(summary.energy_closure < 0.02);
}
