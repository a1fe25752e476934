//! The dynamics against conservation laws and closed forms, without or with a simple bed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    engine::{Engine, Frame, Released},
    grid::BedColumn,
    lanes::Real,
    material::{FlowRule, Material, ShearNorm, Snow},
    observe::{energies, snapshot},
    test_scenes::strong,
};

const MESH: f64 = 0.05;
const STEP: f64 = 2.3e-4;

/// Nothing around: no gravity, and a bed far below.
fn void<T: Real>(snow: &Snow, gravity: f64) -> Frame<T> {
    let scale = 4.0 * STEP * STEP / (snow.density_kg_m3 * MESH * MESH);
    Frame {
        mesh_m: MESH,
        time_step_s: STEP,
        origin_m: -20.0,
        bed: vec![BedColumn { row: -1_000_000, nx: T::of(0.0), nz: T::of(1.0) }; 800],
        lowest_m: -1000.0,
        material: Material::new(snow, FlowRule::Associative, ShearNorm::VonMises, scale),
        plastic_strain_at_release: snow.plastic_strain_at_release(),
        density_kg_m3: snow.density_kg_m3,
        particle_area_m2: MESH * MESH / 4.0,
        gravity_m_s2: gravity,
        friction: 0.5,
        sticky: false,
        limited_above: f64::INFINITY,
        limited_beyond: 1.0,
        top_m: 1000.0,
    }
}

/// Particles on the lattice of four a cell wherever `motion` says velocity (m/s) and gradient (1/s) of a position (m).
fn filled(half: [f64; 2], mut motion: impl FnMut([f64; 2]) -> Option<([f64; 2], [f64; 4])>) -> Vec<Released> {
    let count = half.map(|half| (2.0 * half / (0.5 * MESH)).round() as usize);
    let at = |axis: usize, i: usize| -half[axis] + (i as f64 + 0.5) * 0.5 * MESH;
    let points = (0..count[1]).flat_map(|j| (0..count[0]).map(move |i| [at(0, i), at(1, j)]));
    points
        .filter_map(|position_m| {
            let (velocity_m_s, gradient_1_s) = motion(position_m)?;
            Some(Released { position_m, velocity_m_s, gradient_1_s })
        })
        .collect()
}

fn run<T: Real>(engine: &mut Engine<T>, steps: usize) {
    for step in 1..=steps {
        engine.step(step == steps).unwrap();
    }
}

/// Mass, momentum (x, z) and angular momentum, the affine part included, per particle mass, in cells and steps.
fn conserved<T: Real>(engine: &Engine<T>) -> [f64; 4] {
    let mut out = [0.0; 4];
    for chunk in &engine.chunks {
        for (block, motion) in chunk.blocks.iter().zip(&chunk.motion) {
            for k in 0..block.len {
                let x = f64::from(block.place.column[k]) + block.place.gx[k].f64() - 400.0;
                let z = f64::from(block.place.row[k]) + block.place.gz[k].f64();
                let (vx, vz) = (motion.vx[k].f64(), motion.vz[k].f64());
                out[0] += 1.0;
                out[1] += vx;
                out[2] += vz;
                out[3] += x * vz - z * vx + 0.25 * (motion.lzx[k].f64() - motion.lxz[k].f64());
            }
        }
    }
    out
}

/// How far momenta move in 200 steps of a block of random motion, as a share of the largest that there could be.
fn worst_drift<T: Real>() -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    // a uniform motion and a turn, so that the totals are far from 0, and noise that strains the block
    let released = filled([1.0, 0.5], |[x, _]| {
        let mut noise = |size: f64| rng.random_range(-size..size);
        Some(([8.0 + noise(2.0), 20.0 * x - 3.0 + noise(2.0)], [noise(5.0), noise(5.0), 20.0 + noise(5.0), noise(5.0)]))
    });
    let snow = Snow::li_2020(0.5, 0.0, 1.0, 3e3);
    let mut engine = Engine::<T>::new(void(&snow, 0.0), &released).unwrap();
    let before = conserved(&engine);
    run(&mut engine, 200);
    let after = conserved(&engine);
    let mass: T = engine.grids.iter().flat_map(|grid| &grid.nodes).fold(T::of(0.0), |sum, node| sum + node[2]);
    assert!((mass.f64() / before[0] - 1.0).abs() < 1e-5, "mass {mass:?} of {}", before[0]);
    assert!(before.iter().all(|total| total.abs() > 1.0), "{before:?}");
    (0..4).map(|i| ((after[i] - before[i]) / before[i]).abs()).fold(0.0, f64::max)
}

#[test]
fn momentum_and_angular_momentum_are_conserved() {
    let drift = worst_drift::<f64>();
    assert!(drift < 1e-10, "f64: {drift:e}");
    let drift = worst_drift::<f32>();
    assert!(drift < 1e-5, "f32: {drift:e}");
}

#[test]
fn a_block_falls_freely() {
    let released = filled([0.5, 0.5], |_| Some(([0.0; 2], [0.0; 4])));
    let mut engine = Engine::<f64>::new(void(&strong(), 9.81), &released).unwrap();
    run(&mut engine, 4000);
    let time = 4000.0 * STEP;
    for chunk in &engine.chunks {
        for (block, motion) in chunk.blocks.iter().zip(&chunk.motion) {
            for k in 0..block.len {
                let v = motion.vz[k] * MESH / STEP;
                assert!((v / (-9.81 * time) - 1.0).abs() < 1e-6, "{v} m/s after {time} s");
            }
        }
    }
}

#[test]
fn a_spinning_disc_gains_no_energy_and_keeps_it() {
    // one turn a second, for 20 s: the body is stretched by its spin and turns as one
    let omega = std::f64::consts::TAU;
    let released =
        filled([0.5, 0.5], |[x, z]| (x.hypot(z) < 0.5).then_some(([-omega * z, omega * x], [0.0, -omega, omega, 0.0])));
    let mut engine = Engine::<f64>::new(void(&strong(), 0.0), &released).unwrap();
    let total = |engine: &Engine<f64>| {
        let e = energies(engine);
        e.kinetic + e.affine + e.elastic
    };
    let first = total(&engine);
    let mut last = first;
    for second in 1..=20 {
        run(&mut engine, 4348);
        last = total(&engine);
        // elastic ringing moves some 1e-6 of the energy to and fro between the half steps of position and velocity
        assert!(last <= (1.0 + 1e-5) * first, "gained {:e} after {second} s", last / first - 1.0);
    }
    assert!(last > (1.0 - 1e-3) * first, "lost {:e} of the energy", 1.0 - last / first);
}

#[test]
fn a_slab_rings_at_the_speed_of_pressure_waves() {
    // the first mode across a free slab so wide that its middle feels no end in the time: period 2 H / c
    let (half, height) = ([8.0, 1.0], 2.0);
    let mode = std::f64::consts::PI / height;
    let released =
        filled(half, |[_, z]| Some(([0.0, 0.1 * (mode * z).sin()], [0.0, 0.0, 0.0, 0.1 * mode * (mode * z).cos()])));
    let mut engine = Engine::<f32>::new(void(&strong(), 0.0), &released).unwrap();
    // the sign of the motion of the upper half in the middle changes every half period
    let upper = |engine: &Engine<f32>| -> f64 {
        let s = snapshot(engine);
        let middle = (0..s.x_m.len()).filter(|&i| s.x_m[i].abs() < 0.5 && s.z_m[i] > 0.0);
        middle.map(|i| f64::from(s.vz_m_s[i])).sum()
    };
    let (mut crossings, mut before) = (Vec::new(), upper(&engine));
    for step in 1..=330 {
        engine.step(true).unwrap();
        let now = upper(&engine);
        if now * before < 0.0 {
            crossings.push((f64::from(step) - now / (now - before)) * STEP);
        }
        before = now;
    }
    let period = 2.0 * height / strong().wave_speed_m_s();
    assert!((strong().wave_speed_m_s() - 127.1).abs() < 0.05);
    let measured = 2.0 * (crossings[3] - crossings[0]) / 3.0;
    assert!((measured / period - 1.0).abs() < 0.01, "{measured} s for {period} s");
}
