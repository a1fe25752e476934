//! The four regimes on Group II of Li et al. (2020) at any mesh: energies, the fastest grain, and what the limiter of affine
//! motion changes. A table in Markdown:
//!
//!     cargo run --release -p firn-science --example runout_verification -- --mesh 0.05 [--end 12] [--regime cold_dense]
#![expect(clippy::print_stdout, reason = "a report for the terminal or a file")]

use std::{collections::HashMap, error::Error, time::Instant};

use firn_science::progress::Unobserved;
use firn_science::runout::{
    Advance, LIMITED_ABOVE, RunoutError, Setup, Simulation,
    snapshot::{Energies, Snapshot},
};

#[path = "group_2.rs"]
mod group_2;

/// When the limiter's effect on the flow is looked at, s.
const COMPARED_S: f64 = 5.0;

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64
}

/// Position along the track below which 99 % of the mass lies, m.
fn front(snapshot: &Snapshot) -> f64 {
    let mut x = snapshot.x_m.clone();
    x.sort_by(f32::total_cmp);
    f64::from(x[(0.99 * x.len() as f64) as usize])
}

fn fastest(snapshot: &Snapshot) -> f64 {
    std::iter::zip(&snapshot.vx_m_s, &snapshot.vz_m_s).map(|(x, z)| f64::from(x.hypot(*z))).fold(0.0, f64::max)
}

fn total(e: &Energies) -> f64 {
    e.kinetic + e.affine + e.potential + e.elastic + e.bed + e.plastic + e.transfer
}

/// What a run shows.
#[derive(Default)]
struct Seen {
    /// Centre of mass and front at 5 s and at the end, m.
    at_5: [f64; 2],
    at_end: [f64; 2],
    /// The fastest grain of any frame, m/s.
    fastest: f64,
    /// Largest rise of the energy sum, and what is unexplained at the end, over the released energy.
    rise: f64,
    closure: f64,
    /// Kinetic, bed, plastic and transfer at the end over the released energy.
    shares: [f64; 4],
    steps: u64,
    particles: usize,
    seconds: f64,
}

fn run(setup: &Setup, end_s: f64) -> Result<Seen, RunoutError> {
    let start = Instant::now();
    let mut simulation = Simulation::new(setup)?;
    let first = simulation.energies();
    let (mut seen, mut lowest, mut rise, mut frame) = (Seen::default(), total(&first), 0.0_f64, 0);
    while simulation.time_s() < end_s {
        frame += 1;
        let advance = simulation.step_until(f64::from(frame) / 24.0, &Unobserved)?;
        let (snapshot, energies) = (simulation.snapshot(), simulation.energies());
        seen.fastest = seen.fastest.max(fastest(&snapshot));
        lowest = lowest.min(total(&energies));
        rise = rise.max(total(&energies) - lowest);
        seen.at_end = [mean(&snapshot.x_m), front(&snapshot)];
        if f64::from(frame) / 24.0 <= COMPARED_S {
            seen.at_5 = seen.at_end;
        }
        if advance != Advance::Reached {
            break;
        }
    }
    let last = simulation.energies();
    let released = first.potential - last.potential;
    seen.rise = rise / released;
    seen.closure = (total(&last) - total(&first)) / released;
    seen.shares = [last.kinetic + last.affine, last.bed, last.plastic, last.transfer].map(|energy| energy / released);
    (seen.steps, seen.particles) = (simulation.steps(), simulation.particles());
    seen.seconds = start.elapsed().as_secs_f64();
    Ok(seen)
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let options: HashMap<&str, &str> =
        words.chunks_exact(2).map(|pair| (pair[0].trim_start_matches('-'), pair[1].as_str())).collect();
    let mesh: f64 = options.get("mesh").unwrap_or(&"0.1").parse()?;
    let end: f64 = options.get("end").unwrap_or(&"12").parse()?;
    let limit: f64 = options.get("limit").map_or(Ok(LIMITED_ABOVE), |limit| limit.parse())?;
    let (top, start) = (group_2::top_m(), [-65.0, -65.0 + 6.0 * 40_f64.to_radians().cos()]);
    let free = (2.0 * 9.81 * top).sqrt();
    println!(
        "Mesh {mesh} m, f32, {end} s, limiter above a plastic strain of {limit}; free fall from the block's top {free:.2} m/s.\n"
    );
    println!(
        "| regime | centre, front at 5 s (m) | of plain APIC (share of the way) | centre, front at the end (m) | fastest grain (m/s) | over free fall | closure | largest rise | kinetic, bed, plastic, transfer | particle-steps/s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for (name, snow) in group_2::REGIMES {
        if options.get("regime").is_some_and(|only| *only != name) {
            continue;
        }
        let setup = Setup { limited_above: limit, ..group_2::setup(snow, 1.0, mesh)? };
        let plain = run(&Setup { limited_above: f64::INFINITY, ..setup.clone() }, COMPARED_S)?;
        let seen = run(&setup, end)?;
        let change: Vec<String> = (0..2)
            .map(|i| format!("{:+.3} %", 100.0 * (seen.at_5[i] - plain.at_5[i]) / (plain.at_5[i] - start[i])))
            .collect();
        println!(
            "| {name} | {:.2}, {:.2} | {} | {:.2}, {:.2} | {:.2} | {:.3} | {:+.3} % | {:.3} % | {:.3}, {:.3}, {:.3}, {:.3} | {:.2e} |",
            seen.at_5[0],
            seen.at_5[1],
            change.join(", "),
            seen.at_end[0],
            seen.at_end[1],
            seen.fastest,
            seen.fastest / free,
            100.0 * seen.closure,
            100.0 * seen.rise,
            seen.shares[0],
            seen.shares[1],
            seen.shares[2],
            seen.shares[3],
            seen.steps as f64 * seen.particles as f64 / seen.seconds,
        );
    }
    Ok(())
}
