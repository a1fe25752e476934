//! Particle-steps a second of a run. One line of JSON:
//!
//!     cargo bench -p firn-science --bench runout -- [--regime cold_dense] [--scale 1] [--mesh 0.05] [--precision f32]
//!         [--from 0] [--steps 1000] [--threads 1]
//!
//! `--scale` 1 is Group II of Li et al. (2020), Table 1; 2.5 and 4 are Groups IV and V. `--from` are seconds since release
//! before the clock starts. The rate is that of the best of ten parts, and of all.
#![expect(clippy::print_stdout, reason = "a bench reports on the terminal")]

use std::{collections::HashMap, error::Error, time::Instant};

use firn_science::progress::Unobserved;
use firn_science::runout::{Precision, RunoutError, Setup, Simulation};

#[path = "group_2.rs"]
mod group_2;

fn main() -> Result<(), Box<dyn Error>> {
    // cargo itself adds `--bench`
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let options: HashMap<&str, &str> =
        words.chunks_exact(2).map(|pair| (pair[0].trim_start_matches('-'), pair[1].as_str())).collect();
    let text = |name, default| *options.get(name).unwrap_or(&default);
    let number = |name, default: &'static str| text(name, default).parse::<f64>();
    let precision = if text("precision", "f32") == "f64" { Precision::F64 } else { Precision::F32 };
    let regime = text("regime", "cold_dense");
    let snow = group_2::REGIMES.iter().find(|(name, _)| *name == regime).ok_or("no such regime")?.1;
    let setup = Setup { precision, ..group_2::setup(snow, number("scale", "1")?, number("mesh", "0.05")?)? };
    let (from, steps) = (number("from", "0")?, number("steps", "1000")?);
    let threads = number("threads", "1")? as usize;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let measured = pool.install(|| measure(&setup, from, steps))?;
    println!(
        "{{\"code\":\"firn\",\"regime\":\"{regime}\",\"mesh_m\":{},\"precision\":\"{}\",\"threads\":{threads},\
         \"particles\":{},\"from_s\":{from},\"steps\":{},\"particle_steps_per_s\":{:.4e},\"best\":{:.4e}}}",
        setup.mesh_m,
        text("precision", "f32"),
        measured.particles,
        measured.steps,
        measured.rate,
        measured.best,
    );
    Ok(())
}

/// What a run did while the clock ran.
struct Measured {
    particles: usize,
    steps: u64,
    /// Particle-steps a second, of all and of the best part.
    rate: f64,
    best: f64,
}

fn measure(setup: &Setup, from: f64, steps: f64) -> Result<Measured, RunoutError> {
    let mut simulation = Simulation::new(setup)?;
    simulation.step_until(from, &Unobserved)?;
    let particles = simulation.particles();
    let (start, begun, first) = (Instant::now(), simulation.time_s(), simulation.steps());
    let (mut best, mut part_start, mut part_steps) = (0.0_f64, start, first);
    for part in 1..=10 {
        simulation.step_until(begun + steps * setup.time_step_s * f64::from(part) / 10.0, &Unobserved)?;
        let done = (simulation.steps() - part_steps) as f64 * particles as f64;
        best = best.max(done / part_start.elapsed().as_secs_f64());
        (part_start, part_steps) = (Instant::now(), simulation.steps());
    }
    let done = (simulation.steps() - first) as f64 * particles as f64;
    let rate = done / start.elapsed().as_secs_f64();
    Ok(Measured { particles, steps: simulation.steps() - first, rate, best })
}
