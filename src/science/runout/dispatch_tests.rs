//! The bits of a flow at every width of instructions.

use super::{
    Precision, Setup, Simulation,
    dispatch::{ALLOWED, Level},
    material::FlowRule,
    scenario::ScenarioName,
    test_scenes::{bits, group_2},
};
use crate::progress::Unobserved;

/// A flow to a time, in a thread that may use these instructions.
fn flow(setup: &Setup, time_s: f64, level: Level) -> Vec<u32> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        ALLOWED.set(level);
        let mut simulation = Simulation::new(setup).unwrap();
        simulation.step_until(time_s, &Unobserved).unwrap();
        bits(&simulation)
    })
}

/// FNV-1a of some words.
fn digest(words: &[u32]) -> u64 {
    let mix = |hash: u64, word: &u32| (hash ^ u64::from(*word)).wrapping_mul(0x0100_0000_01b3);
    words.iter().fold(0xcbf2_9ce4_8422_2325, mix)
}

#[test]
fn every_width_of_instructions_gives_the_same_bits() {
    // long enough for snow that flows, breaks and is limited in its affine motion
    let cases = [
        (ScenarioName::ColdDense, Precision::F32, FlowRule::Associative, 0.0, 6.0),
        (ScenarioName::ColdDense, Precision::F64, FlowRule::Associative, 0.0, 6.0),
        (ScenarioName::ColdDense, Precision::F32, FlowRule::Associative, 0.95, 3.0),
        (ScenarioName::WarmShear, Precision::F32, FlowRule::Nacc, 0.0, 4.0),
        (ScenarioName::WarmShear, Precision::F64, FlowRule::AssociativeImplicit, 0.0, 1.0),
    ];
    for (name, precision, flow_rule, flip, time_s) in cases {
        let setup = Setup { precision, flow_rule, flip, ..group_2(name, 0.25) };
        let widest = flow(&setup, time_s, Level::Widest);
        // to be compared with what another machine prints
        println!("{name:?} {precision:?} {flow_rule:?} FLIP {flip}: {:016x}", digest(&widest));
        for level in [Level::Avx2, Level::Baseline] {
            assert!(flow(&setup, time_s, level) == widest, "{name:?} {precision:?} {flow_rule:?}: {level:?}");
        }
    }
}
