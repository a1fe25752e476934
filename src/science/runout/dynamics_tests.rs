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
        flip: 0.0,
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
        for (index, (block, motion)) in chunk.blocks.iter().zip(&chunk.motion).enumerate() {
            // what particles have of their own where FLIP is blended in
            let own = chunk.flip.get(index);
            for k in 0..block.len {
                let x = f64::from(block.place.column[k]) + block.place.gx[k].f64() - 400.0;
                let z = f64::from(block.place.row[k]) + block.place.gz[k].f64();
                let (vx, vz) = own.map_or((motion.vx[k], motion.vz[k]), |own| (own.vx[k], own.vz[k]));
                let (vx, vz) = (vx.f64(), vz.f64());
                out[0] += 1.0;
                out[1] += vx;
                out[2] += vz;
                out[3] += x * vz - z * vx + 0.25 * (motion.lzx[k].f64() - motion.lxz[k].f64());
            }
        }
    }
    out
}

/// A block of random motion before and after 200 steps: how far mass, momenta and angular momentum move, as shares of
/// themselves.
fn drifts<T: Real>(flip: f64) -> [f64; 4] {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    // a uniform motion and a turn, so that the totals are far from 0, and noise that strains the block
    let released = filled([1.0, 0.5], |[x, _]| {
        let mut noise = |size: f64| rng.random_range(-size..size);
        Some(([8.0 + noise(2.0), 20.0 * x - 3.0 + noise(2.0)], [noise(5.0), noise(5.0), 20.0 + noise(5.0), noise(5.0)]))
    });
    let snow = Snow::li_2020(0.5, 0.0, 1.0, 3e3);
    let mut engine = Engine::<T>::new(Frame { flip, ..void(&snow, 0.0) }, &released).unwrap();
    let before = conserved(&engine);
    run(&mut engine, 200);
    let after = conserved(&engine);
    let mass: T = engine.grids.iter().flat_map(|grid| &grid.nodes).fold(T::of(0.0), |sum, node| sum + node[2]);
    assert!((mass.f64() / before[0] - 1.0).abs() < 1e-5, "mass {mass:?} of {}", before[0]);
    assert!(before.iter().all(|total| total.abs() > 1.0), "{before:?}");
    std::array::from_fn(|i| ((after[i] - before[i]) / before[i]).abs())
}

#[test]
fn momentum_and_angular_momentum_are_conserved() {
    let drifts_f64 = drifts::<f64>(0.0);
    assert!(drifts_f64.iter().all(|drift| *drift < 1e-10), "f64: {drifts_f64:?}");
    let drifts_f32 = drifts::<f32>(0.0);
    assert!(drifts_f32.iter().all(|drift| *drift < 1e-5), "f32: {drifts_f32:?}");
}

#[test]
fn a_blend_with_flip_conserves_momentum() {
    for flip in [0.5, 0.95, 1.0] {
        let [mass, x, z, angular] = drifts::<f64>(flip);
        assert!(mass.max(x).max(z) < 1e-10, "{flip}: {mass:e} {x:e} {z:e}");
        // what the grid did not take has no affine part: angular momentum is not exact, as it is in APIC
        println!("{flip}: angular momentum moves by {angular:e}");
        let [mass, x, z, _] = drifts::<f32>(flip);
        assert!(mass.max(x).max(z) < 1e-5, "f32, {flip}: {mass:e} {x:e} {z:e}");
    }
}

#[test]
fn particles_keep_of_their_own_motion_what_flip_says() {
    // neighbours that move against each other: the grid cannot take it
    let remainders = |flip: f64| -> Vec<[f64; 4]> {
        let mut sign = 1.0;
        let released = filled([0.5, 0.5], |_| {
            sign = -sign;
            Some(([0.1 * sign, 0.0], [0.0; 4]))
        });
        let engine = Engine::<f64>::new(Frame { flip, ..void(&strong(), 0.0) }, &released).unwrap();
        let own = engine.chunks.iter().flat_map(|chunk| chunk.blocks.iter().zip(&chunk.flip));
        own.flat_map(|(block, own)| (0..block.len).map(|k| own.get(k))).collect()
    };
    assert!(remainders(0.0).is_empty());
    let (all, half) = (remainders(1.0), remainders(0.5));
    assert_eq!(all.len(), 1600);
    let unit = 0.1 * STEP / MESH;
    for ([vx, _, whole, _], [.., part, _]) in all.into_iter().zip(half) {
        assert!((vx.abs() / unit - 1.0).abs() < 1e-12 && (whole / vx - 1.0).abs() < 0.6, "{whole} of {vx}");
        assert!((part / whole - 0.5).abs() < 1e-12, "{part} of {whole}");
    }
}

#[test]
fn a_block_falls_freely() {
    let released = filled([0.5, 0.5], |_| Some(([0.0; 2], [0.0; 4])));
    for flip in [0.0, 0.95] {
        let mut engine = Engine::<f64>::new(Frame { flip, ..void(&strong(), 9.81) }, &released).unwrap();
        run(&mut engine, 4000);
        let time = 4000.0 * STEP;
        for v in snapshot(&engine).vz_m_s {
            assert!((f64::from(v) / (-9.81 * time) - 1.0).abs() < 1e-6, "{v} m/s after {time} s, FLIP {flip}");
        }
    }
}

#[test]
fn a_spinning_disc_gains_no_energy_and_keeps_it() {
    spins(0.0, 1e-3);
}

#[test]
fn a_spinning_disc_gains_no_energy_with_flip() {
    // angular momentum is not exact then: 0.4 % of the energy goes in twenty turns
    spins(0.95, 5e-3);
}

/// A disc that turns twenty times loses at most this share of its energy and gains none.
fn spins(flip: f64, loss: f64) {
    // one turn a second, for 20 s: the body is stretched by its spin and turns as one
    let omega = std::f64::consts::TAU;
    let released =
        filled([0.5, 0.5], |[x, z]| (x.hypot(z) < 0.5).then_some(([-omega * z, omega * x], [0.0, -omega, omega, 0.0])));
    let mut engine = Engine::<f64>::new(Frame { flip, ..void(&strong(), 0.0) }, &released).unwrap();
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
    assert!(last > (1.0 - loss) * first, "lost {:e} of the energy", 1.0 - last / first);
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
