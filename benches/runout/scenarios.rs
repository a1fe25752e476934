//! The four typical flows, or 16 snows of Table 1, as whole runs of Group II.
//!
//! ```text
//! cargo run --release -p firn-science --example runout_scenarios -- flows 0.05
//! cargo run --release -p firn-science --example runout_scenarios -- sweep 0.05 [FOLDER]
//! cargo run --release -p firn-science --example runout_scenarios -- inputs '{"scenario": "warm-plug", "mesh_m": 0.1}'
//! ```
//!
//! `flows` prints what the summary says of each of the four flows, as JSON. `sweep` runs M and p0 of Table 1 with beta 0.3
//! and xi 1 and prints a line of CSV each: largest speeds over sqrt(g H0), reach angles, and how the run ended; into the
//! folder, if one is given, go summary and series of each run as JSON. `inputs` prints the summary and the series of any run.
#![allow(clippy::print_stdout, clippy::expect_used, reason = "a command for people, which may fail loudly")]

use std::{path::Path, time::Instant};

use firn_science::progress::Unobserved;
use firn_science::runout::plan::Plan;
use firn_science::runout::run::{Outcome, run};
use firn_science::runout::scenario::{RunoutInputs, ScenarioName, SnowInputs};

const MEMORY: u64 = 4 << 30;

/// A run, the bytes of its largest frame, and how long it took, s.
fn timed(inputs: &RunoutInputs) -> (Outcome, usize, f64) {
    let plan = Plan::new(inputs, MEMORY).expect("inputs that are accepted");
    let mut largest = 0;
    let begun = Instant::now();
    let outcome = run(&plan, &Unobserved, &mut |_, frame| largest = largest.max(frame.len())).expect("a run that ends");
    (outcome, largest, begun.elapsed().as_secs_f64())
}

fn flows(mesh_m: f64) {
    let names = [ScenarioName::ColdDense, ScenarioName::WarmShear, ScenarioName::SlidingSlab, ScenarioName::WarmPlug];
    for name in names {
        let (outcome, largest, seconds) =
            timed(&RunoutInputs { mesh_m: Some(mesh_m), ..RunoutInputs::of_scenario(name, None) });
        let mut summary = outcome.summary;
        summary.particle_steps_per_s = Some(summary.steps as f64 * summary.particles as f64 / seconds);
        let text = serde_json::to_string_pretty(&summary).expect("numbers");
        println!("{name:?}: {seconds:.1} s, frames of at most {largest} bytes\n{text}");
    }
}

fn sweep(mesh_m: f64, folder: Option<&Path>) {
    println!(
        "M,p0_kpa,v_max_scaled,com_v_max_scaled,front_v_max_scaled,reach_crown,reach_front,reach_com,class,nearest,ending,\
         duration_s,energy_closure"
    );
    for m in [0.1, 0.5, 1.0, 1.5] {
        for p0_kpa in [3.0, 12.0, 21.0, 30.0] {
            let snow = SnowInputs::new(m, 0.3, 1.0, p0_kpa);
            let group = RunoutInputs::of_scenario(ScenarioName::Group2, Some(snow));
            let (outcome, ..) = timed(&RunoutInputs { mesh_m: Some(mesh_m), ..group });
            let summary = &outcome.summary;
            let (angles, unit) = (summary.reach_angle_deg, summary.v_max / summary.v_max_scaled);
            println!(
                "{m},{p0_kpa},{:.4},{:.4},{:.4},{:.2},{:.2},{:.2},{:?},{:?},{:?},{:.2},{:.4}",
                summary.v_max_scaled,
                summary.com_v_max / unit,
                summary.front_v_max / unit,
                angles.crown,
                angles.front,
                angles.com,
                summary.regime.class,
                summary.regime.nearest,
                summary.ending,
                summary.duration_s,
                summary.energy_closure,
            );
            if let Some(folder) = folder {
                let seen = (summary, &outcome.observations.series);
                let text = serde_json::to_string(&seen).expect("numbers");
                std::fs::write(folder.join(format!("M{m}_p{p0_kpa}.json")), text)
                    .expect("a folder that can be written");
            }
        }
    }
}

fn any(inputs: &str) {
    let (outcome, ..) = timed(&serde_json::from_str(inputs).expect("inputs of a run"));
    println!("{}", serde_json::to_string_pretty(&outcome.summary).expect("numbers"));
    let series = &outcome.observations.series;
    println!("time_s,front_m,com_x_m,com_speed_m_s,v99_m_s,particle_v_max_m_s");
    for (frame, speed) in series.com_speed_m_s().iter().enumerate() {
        let (time, front, com) = (series.time_s[frame], series.front_m[frame], series.com_x_m[frame]);
        let (v99, fastest) = (series.v99_m_s[frame], series.particle_v_max_m_s[frame]);
        println!("{time:.4},{front:.3},{com:.3},{speed:.3},{v99:.3},{fastest:.3}");
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["flows", mesh_m] => flows(mesh_m.parse().expect("a mesh size in m")),
        ["sweep", mesh_m] => sweep(mesh_m.parse().expect("a mesh size in m"), None),
        ["sweep", mesh_m, folder] => sweep(mesh_m.parse().expect("a mesh size in m"), Some(Path::new(folder))),
        ["inputs", inputs] => any(inputs),
        _ => println!("flows or sweep and a mesh size in m, or inputs and JSON"),
    }
}
