//! The four typical flows, or 16 snows of Table 1, as whole runs of Group II.
//!
//! ```text
//! cargo run --release -p firn-science --example runout_scenarios -- flows 0.05
//! cargo run --release -p firn-science --example runout_scenarios -- sweep 0.05
//! ```
//!
//! `flows` prints what the summary says of each of the four flows, as JSON. `sweep` runs M and p0 of Table 1 with beta 0.3
//! and xi 1 and prints scaled v_max over the reach angles.
#![allow(clippy::print_stdout, clippy::expect_used, reason = "a command for people, which may fail loudly")]

use std::time::Instant;

use firn_science::progress::Unobserved;
use firn_science::runout::plan::Plan;
use firn_science::runout::run::{Outcome, run};
use firn_science::runout::scenario::{RunoutInputs, ScenarioName, SnowInputs};

const MEMORY: u64 = 4 << 30;

/// A run, the bytes of its largest frame, and how long it took, s.
fn timed(inputs: RunoutInputs, mesh_m: f64) -> (Outcome, usize, f64) {
    let plan = Plan::new(&RunoutInputs { mesh_m: Some(mesh_m), ..inputs }, MEMORY).expect("inputs of Table 1");
    let mut largest = 0;
    let begun = Instant::now();
    let outcome =
        run(&plan, &Unobserved, &mut |_, frame| largest = largest.max(frame.len())).expect("a run of Table 1");
    (outcome, largest, begun.elapsed().as_secs_f64())
}

fn flows(mesh_m: f64) {
    let names = [ScenarioName::ColdDense, ScenarioName::WarmShear, ScenarioName::SlidingSlab, ScenarioName::WarmPlug];
    for name in names {
        let (outcome, largest, seconds) = timed(RunoutInputs::of_scenario(name, None), mesh_m);
        let mut summary = outcome.summary;
        summary.particle_steps_per_s = Some(summary.steps as f64 * summary.particles as f64 / seconds);
        let text = serde_json::to_string_pretty(&summary).expect("numbers");
        println!("{name:?}: {seconds:.1} s, frames of at most {largest} bytes\n{text}");
    }
}

fn sweep(mesh_m: f64) {
    println!(
        "M,p0_kpa,v_max_scaled,front_v_max,reach_crown,reach_front,reach_com,class,nearest,duration_s,energy_closure"
    );
    for m in [0.1, 0.5, 1.0, 1.5] {
        for p0_kpa in [3.0, 12.0, 21.0, 30.0] {
            let snow = SnowInputs::new(m, 0.3, 1.0, p0_kpa);
            let (outcome, ..) = timed(RunoutInputs::of_scenario(ScenarioName::Group2, Some(snow)), mesh_m);
            let summary = outcome.summary;
            let angles = summary.reach_angle_deg;
            println!(
                "{m},{p0_kpa},{:.4},{:.2},{:.2},{:.2},{:.2},{:?},{:?},{:.2},{:.4}",
                summary.v_max_scaled,
                summary.front_v_max,
                angles.crown,
                angles.front,
                angles.com,
                summary.regime.class,
                summary.regime.nearest,
                summary.duration_s,
                summary.energy_closure,
            );
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mesh_m = arguments.get(1).map_or(0.1, |text| text.parse().expect("a mesh size in m"));
    match arguments.first().map(String::as_str) {
        Some("flows") => flows(mesh_m),
        Some("sweep") => sweep(mesh_m),
        _ => println!("flows or sweep, and a mesh size in m"),
    }
}
