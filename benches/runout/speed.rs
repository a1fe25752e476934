//! Particle-steps a second of a run. One line of JSON:
//!
//!     cargo bench -p firn-science --bench runout -- [--regime cold_dense] [--group group-2] [--mesh 0.05]
//!         [--precision f32] [--flip 0] [--from 0] [--steps 1000] [--threads 1] [--state FILE]
//!
//! `--group` is one of Table 1 of Li et al. (2020). `--from` are seconds since release before the clock starts; the state
//! then is read from the file, or left there for the next build to be timed on. The rate is that of all, of the best of ten
//! parts, and, of one thread on Linux, that a second of processor time. The centre of mass
//! at the end shows whether two programs computed the same.
#![expect(clippy::print_stdout, reason = "a bench reports on the terminal")]

use std::{collections::HashMap, error::Error, time::Instant};

use firn_science::progress::Unobserved;
use firn_science::runout::plan::Plan;
use firn_science::runout::scenario::{RunoutInputs, ScenarioName, TransferInputs};
use firn_science::runout::{Precision, Setup, Simulation};

const MEMORY: u64 = 8 << 30;

/// The typical flows by the names that the bench has in common with `taichi_group_2.py`.
const REGIMES: [(&str, ScenarioName); 4] = [
    ("cold_dense", ScenarioName::ColdDense),
    ("warm_shear", ScenarioName::WarmShear),
    ("sliding_slab", ScenarioName::SlidingSlab),
    ("warm_plug", ScenarioName::WarmPlug),
];

fn main() -> Result<(), Box<dyn Error>> {
    // cargo itself adds `--bench`
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let options: HashMap<&str, &str> =
        words.chunks_exact(2).map(|pair| (pair[0].trim_start_matches('-'), pair[1].as_str())).collect();
    let text = |name, default| *options.get(name).unwrap_or(&default);
    let number = |name, default: &'static str| text(name, default).parse::<f64>();
    let precision = if text("precision", "f32") == "f64" { Precision::F64 } else { Precision::F32 };
    let regime = text("regime", "cold_dense");
    let snow = REGIMES.iter().find(|(name, _)| *name == regime).and_then(|(_, flow)| flow.snow());
    let snow = snow.ok_or("no such regime")?;
    let group: ScenarioName = serde_json::from_value(text("group", "group-2").into())?;
    let inputs = RunoutInputs {
        mesh_m: Some(number("mesh", "0.05")?),
        transfer: TransferInputs { flip: number("flip", "0")? },
        precision,
        ..RunoutInputs::of_scenario(group, Some(snow))
    };
    let setup = Plan::new(&inputs, MEMORY).map_err(|faults| format!("{faults:?}"))?.setup;
    let (from, steps) = (number("from", "0")?, number("steps", "1000")?);
    let threads = number("threads", "1")? as usize;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let measured = pool
        .install(|| measure(&setup, from, steps, options.get("state").copied()))
        .map_err(|error| error.to_string())?;
    println!(
        "{{\"code\":\"firn\",\"regime\":\"{regime}\",\"mesh_m\":{},\"precision\":\"{}\",\"threads\":{threads},\
         \"particles\":{},\"from_s\":{from},\"steps\":{},\"particle_steps_per_s\":{:.4e},\"best\":{:.4e},\
         \"of_processor_time\":{:.4e},\"centre_m\":{:?}}}",
        setup.mesh_m,
        text("precision", "f32"),
        measured.particles,
        measured.steps,
        measured.rate,
        measured.best,
        measured.of_processor_time,
        measured.centre_m,
    );
    Ok(())
}

/// What a run did while the clock ran.
struct Measured {
    particles: usize,
    steps: u64,
    /// Particle-steps a second, of all, of the best part, and of the time that this thread was running.
    rate: f64,
    best: f64,
    of_processor_time: f64,
    /// Centre of mass at the end, m.
    centre_m: [f64; 2],
}

/// How long this thread has been running, s; no number where the system does not say.
fn processor_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).map_or(f64::NAN, |ns| ns * 1e-9)
}

/// The run at `from` seconds, out of the file if it is there.
fn begun(setup: &Setup, from: f64, state: Option<&str>) -> Result<Simulation, Box<dyn Error + Send + Sync>> {
    if let Some(saved) = state.and_then(|path| std::fs::read(path).ok()) {
        return Ok(Simulation::resume(setup, &saved)?);
    }
    let mut simulation = Simulation::new(setup)?;
    simulation.step_until(from, &Unobserved)?;
    if let Some(path) = state {
        std::fs::write(path, simulation.checkpoint(setup))?;
    }
    Ok(simulation)
}

fn measure(
    setup: &Setup,
    from: f64,
    steps: f64,
    state: Option<&str>,
) -> Result<Measured, Box<dyn Error + Send + Sync>> {
    let mut simulation = begun(setup, from, state)?;
    let particles = simulation.particles();
    let (start, begun, first, running) = (Instant::now(), simulation.time_s(), simulation.steps(), processor_s());
    let (mut best, mut part_start, mut part_steps) = (0.0_f64, start, first);
    for part in 1..=10 {
        simulation.step_until(begun + steps * setup.time_step_s * f64::from(part) / 10.0, &Unobserved)?;
        let done = (simulation.steps() - part_steps) as f64 * particles as f64;
        best = best.max(done / part_start.elapsed().as_secs_f64());
        (part_start, part_steps) = (Instant::now(), simulation.steps());
    }
    let done = (simulation.steps() - first) as f64 * particles as f64;
    let (rate, of_processor_time) = (done / start.elapsed().as_secs_f64(), done / (processor_s() - running));
    let end = simulation.snapshot();
    let centre_m = [end.x_m, end.z_m].map(|at| at.iter().map(|&at| f64::from(at)).sum::<f64>() / particles as f64);
    Ok(Measured { particles, steps: simulation.steps() - first, rate, best, of_processor_time, centre_m })
}
