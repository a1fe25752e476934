//! The four regimes on Group II of Li et al. (2020) at any mesh: energies, the fastest grain, and what the limiter of affine
//! motion changes. A table in Markdown:
//!
//!     cargo run --release -p firn-science --example runout_verification -- --mesh 0.05 [--end 12] [--regime cold-dense]
#![expect(clippy::print_stdout, reason = "a report for the terminal or a file")]

use std::{collections::HashMap, error::Error, time::Instant};

use firn_science::progress::Unobserved;
use firn_science::runout::plan::Plan;
use firn_science::runout::scenario::{RunoutInputs, ScenarioName};
use firn_science::runout::{
    Advance, GRAVITY_M_S2, LIMITED_ABOVE, LIMITED_BEYOND, RunoutError, Setup, Simulation, snapshot::Snapshot,
};

/// When the limiter's effect on the flow is looked at, s.
const COMPARED_S: f64 = 5.0;

/// How far the slab is moved to see what of a difference is chance: the flow that breaks up is chaotic. m.
const MOVED_M: f64 = 1e-6;

/// Frames a second.
const FRAMES: f64 = 24.0;

const MEMORY: u64 = 8 << 30;

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64
}

/// Centre of mass, and the position along the track below which 99 % of the mass lies, m.
fn places(snapshot: &Snapshot) -> [f64; 2] {
    let mut x = snapshot.x_m.clone();
    x.sort_by(f32::total_cmp);
    [mean(&snapshot.x_m), f64::from(x[(0.99 * x.len() as f64) as usize])]
}

fn fastest(snapshot: &Snapshot) -> f64 {
    std::iter::zip(&snapshot.vx_m_s, &snapshot.vz_m_s).map(|(x, z)| f64::from(x.hypot(*z))).fold(0.0, f64::max)
}

/// What a run shows.
#[derive(Default)]
struct Seen {
    /// Centre of mass and front at the start, at 5 s and at the end, m.
    at_start: [f64; 2],
    at_5: [f64; 2],
    at_end: [f64; 2],
    /// The fastest grain of any frame, m/s, and when it was, s.
    fastest: f64,
    fastest_at: f64,
    /// Largest rise of the energy sum, and what is unexplained at the end, over the released energy.
    rise: f64,
    closure: f64,
    /// Kinetic, bed, plastic and transfer at the end over the released energy.
    shares: [f64; 4],
    time_s: f64,
    steps: u64,
    particles: usize,
    seconds: f64,
}

fn run(setup: &Setup, end_s: f64) -> Result<Seen, RunoutError> {
    let start = Instant::now();
    let mut simulation = Simulation::new(setup)?;
    let first = simulation.energies();
    let (mut lowest, mut rise, mut frame) = (first.total(), 0.0_f64, 0);
    let mut seen = Seen { at_start: places(&simulation.snapshot()), ..Seen::default() };
    while simulation.time_s() < end_s {
        frame += 1;
        let time_s = f64::from(frame) / FRAMES;
        let advance = simulation.step_until(time_s, &Unobserved)?;
        let (snapshot, energies) = (simulation.snapshot(), simulation.energies());
        let speed = fastest(&snapshot);
        if speed > seen.fastest {
            (seen.fastest, seen.fastest_at) = (speed, time_s);
        }
        lowest = lowest.min(energies.total());
        rise = rise.max(energies.total() - lowest);
        seen.at_end = places(&snapshot);
        if time_s <= COMPARED_S {
            seen.at_5 = seen.at_end;
        }
        if frame % 24 == 0 {
            let left = start.elapsed().as_secs_f64();
            eprintln!("{time_s:5.1} s of {end_s} after {left:.0} s: fastest so far {:.2} m/s", seen.fastest);
        }
        if advance != Advance::Reached {
            break;
        }
    }
    let last = simulation.energies();
    let released = first.potential - last.potential;
    seen.rise = rise / released;
    seen.closure = (last.total() - first.total()) / released;
    seen.shares = [last.kinetic + last.affine, last.bed, last.plastic, last.transfer].map(|energy| energy / released);
    (seen.time_s, seen.steps, seen.particles) = (simulation.time_s(), simulation.steps(), simulation.particles());
    seen.seconds = start.elapsed().as_secs_f64();
    Ok(seen)
}

/// Centre and front at 5 s against those of plain APIC, as shares of its way.
fn change(of: &Seen, plain: &Seen) -> String {
    let share = |i: usize| 100.0 * (of.at_5[i] - plain.at_5[i]) / (plain.at_5[i] - plain.at_start[i]);
    format!("{:+.3} %, {:+.3} %", share(0), share(1))
}

/// The row of a regime.
fn row(name: &str, seen: &Seen, plain: &Seen, moved: &Seen, free: f64) -> String {
    let shares = seen.shares.map(|share| format!("{share:.3}")).join(", ");
    format!(
        "| {name} | {:.2} | {:.2}, {:.2} | {} | {} | {:.2}, {:.2} | {:.2} at {:.1} s | {:.3} | {:+.3} % | {:.3} % | {shares} | {} | {:.1e} |",
        seen.time_s,
        seen.at_5[0],
        seen.at_5[1],
        change(seen, plain),
        change(moved, plain),
        seen.at_end[0],
        seen.at_end[1],
        seen.fastest,
        seen.fastest_at,
        seen.fastest / free,
        100.0 * seen.closure,
        100.0 * seen.rise,
        seen.particles,
        seen.steps as f64 * seen.particles as f64 / seen.seconds,
    )
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let options: HashMap<&str, &str> =
        words.chunks_exact(2).map(|pair| (pair[0].trim_start_matches('-'), pair[1].as_str())).collect();
    let mesh: f64 = options.get("mesh").unwrap_or(&"0.1").parse()?;
    let end: f64 = options.get("end").unwrap_or(&"12").parse()?;
    let limit: f64 = options.get("limit").map_or(Ok(LIMITED_ABOVE), |limit| limit.parse())?;
    let beyond: f64 = options.get("beyond").map_or(Ok(LIMITED_BEYOND), |share| share.parse())?;
    // the highest point of the block, above its centre by half its thickness and half its length
    let slope = ScenarioName::Group2.slope();
    let (sine, cosine) = slope.angle_deg.to_radians().sin_cos();
    let top = slope.drop_height_m() + 0.5 * (slope.thickness_m * cosine + slope.length_m * sine);
    let free = (2.0 * GRAVITY_M_S2 * top).sqrt();
    println!(
        "Mesh {mesh} m, f32, limiter above a plastic strain of {limit}; free fall from the block's top {free:.2} m/s.\n"
    );
    println!(
        "| regime | run to (s) | centre, front at 5 s (m) | against plain APIC (share of the way) | plain APIC, slab \
         moved by 1 um | centre, front at the end \
         (m) | fastest grain (m/s) | over free fall | closure | largest rise | kinetic, bed, plastic, transfer | particles | \
         particle-steps/s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    let regimes = [ScenarioName::ColdDense, ScenarioName::WarmShear, ScenarioName::SlidingSlab, ScenarioName::WarmPlug];
    for (regime, name) in regimes.into_iter().zip(["cold-dense", "warm-shear", "sliding-slab", "warm-plug"]) {
        if options.get("regime").is_some_and(|only| *only != name) {
            continue;
        }
        let inputs = RunoutInputs { mesh_m: Some(mesh), ..RunoutInputs::of_scenario(regime, None) };
        let setup = Plan::new(&inputs, MEMORY).map_err(|faults| format!("{faults:?}"))?.setup;
        let mut plain = Setup { limited_above: f64::INFINITY, ..setup.clone() };
        let unmoved = run(&plain, COMPARED_S)?;
        plain.release.x_m += MOVED_M;
        let moved = run(&plain, COMPARED_S)?;
        let seen = run(&Setup { limited_above: limit, limited_beyond: beyond, ..setup }, end)?;
        println!("{}", row(name, &seen, &unmoved, &moved, free));
    }
    Ok(())
}
