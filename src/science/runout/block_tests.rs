//! Blocks that slide, stick and turn, against the closed forms of a rigid block.

use super::{
    Contact, Setup, Simulation,
    engine::Engine,
    lanes::Real,
    observe,
    release::Slab,
    scenario::ScenarioName,
    terrain::Terrain,
    test_scenes::{engine, group_2, mean, setup, strong},
};
use crate::progress::Unobserved;

const COSINE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// An elastic block on a slope of 45 degrees, placed in contact: with the stresses that its weight and the friction give it.
fn on_incline<T: Real>(friction: f64, flip: f64) -> Engine<T> {
    let terrain = Terrain::from_profile(&[[-10.0, 30.0], [0.0, 20.0], [30.0, -10.0]], 1.0).unwrap();
    let thickness = 0.5;
    let release = Slab { x_m: 0.0, length_m: 4.0, thickness_m: thickness };
    let setup = Setup { bed_friction: friction, flip, ..setup(terrain, release, strong(), 0.1) };
    let mut engine = engine::<T>(&setup, 9.81);
    let (_, mu) = setup.snow.lame_pa();
    let (bulk, nu) = (setup.snow.bulk_modulus_pa(), setup.snow.poisson_ratio);
    for block in engine.chunks.iter_mut().flat_map(|chunk| &mut chunk.blocks) {
        for k in 0..block.len {
            let x = (f64::from(block.place.column[k]) + block.place.gx[k].f64()) * setup.mesh_m - 10.0;
            let z = (f64::from(block.place.row[k]) + block.place.gz[k].f64()) * setup.mesh_m;
            // weight of the snow above, pressure along the slope of a wide slab, shear that the bed can hold
            let normal = -250.0 * 9.81 * COSINE * (thickness - (x + z - 20.0) * COSINE);
            let along = normal * nu / (1.0 - nu);
            let shear = normal * friction.min(1.0);
            let (isotropic, deviator) = (0.5 * (normal + along) / (2.0 * bulk), 0.5 * (normal - along) / (2.0 * mu));
            // strains of the axes (normal, down the slope), turned by 45 degrees into x and z; b - I is twice the strain
            let mixed = shear / (2.0 * mu);
            block.bxx[k] = T::of(2.0 * (isotropic + mixed));
            block.bzz[k] = T::of(2.0 * (isotropic - mixed));
            block.bxz[k] = T::of(2.0 * deviator);
        }
    }
    engine
}

/// Advances by `steps`; mean time (s), position (m) and speed (m/s) along the slope then.
fn after<T: Real>(engine: &mut Engine<T>, steps: u64) -> [f64; 3] {
    for step in 1..=steps {
        engine.step(step == steps).unwrap();
    }
    let s = observe::snapshot(engine);
    [s.time_s, (mean(&s.x_m) - mean(&s.z_m)) * COSINE, (mean(&s.vx_m_s) - mean(&s.vz_m_s)) * COSINE]
}

/// Steps of half a second.
const HALF_SECOND: u64 = 1087;

/// `x = v t + 1/2 g t^2 (sin - mu cos)`. It is looked at from half a second after the release on: as long as an elastic body
/// on a grid trembles faster (some mm/s to cm/s) than it slides, friction turns round with it, and the block gets ahead by
/// some cm/s.
fn slides_as_a_rigid_block<T: Real>(flip: f64, tolerance: f64) {
    for friction in [0.3, 0.5] {
        let mut engine = on_incline::<T>(friction, flip);
        let [t0, x0, v0] = after(&mut engine, HALF_SECOND);
        let [t1, x1, v1] = after(&mut engine, 2 * HALF_SECOND);
        let (time, acceleration) = (t1 - t0, 9.81 * COSINE * (1.0 - friction));
        let (gain, way) = (acceleration * time, v0 * time + 0.5 * acceleration * time * time);
        assert!(((v1 - v0) / gain - 1.0).abs() < tolerance, "mu {friction}: from {v0} to {v1} m/s");
        assert!(((x1 - x0) / way - 1.0).abs() < tolerance, "mu {friction}: {} for {way} m", x1 - x0);
    }
}

#[test]
fn a_block_slides_down_an_incline_as_a_block_does() {
    slides_as_a_rigid_block::<f64>(0.0, 1e-3);
    slides_as_a_rigid_block::<f32>(0.0, 1e-3);
}

#[test]
fn a_block_slides_as_a_block_with_flip() {
    slides_as_a_rigid_block::<f64>(0.95, 2e-3);
}

#[test]
fn a_block_sticks_where_friction_exceeds_the_slope() {
    let mut engine = on_incline::<f64>(1.5, 0.0);
    // held for a second, until it does not tremble any more
    engine.frame.sticky = true;
    let [.., trembling] = after(&mut engine, 2 * HALF_SECOND);
    assert!(trembling.abs() < 1e-3, "{trembling} m/s");
    engine.frame.sticky = false;
    let [_, x0, _] = after(&mut engine, 0);
    let [_, x1, _] = after(&mut engine, 2 * HALF_SECOND);
    // without friction it would go 3.5 m
    let way = 0.5 * 9.81 * COSINE;
    assert!((x1 - x0).abs() < 1e-3 * way, "creeps by {} m", x1 - x0);
    // and it goes where there is less friction than slope
    engine.frame.friction = 0.5;
    let [_, x2, _] = after(&mut engine, 2 * HALF_SECOND);
    assert!(x2 - x1 > 0.4 * way, "{}", x2 - x1);
}

/// Squared speed at the ends of slope and arc and the way on the flat of a small block: d(v^2)/ds = 2 g (sin phi - mu cos
/// phi) - 2 mu v^2 / R.
fn block_over_arc(way: f64, angle: f64, radius: f64, mu: f64) -> [f64; 3] {
    let slope = 2.0 * 9.81 * (angle.sin() - mu * angle.cos()) * way;
    let mut v2 = slope;
    let steps = 100_000;
    let ds = radius * angle / f64::from(steps);
    for i in 0..steps {
        let phi = angle * (1.0 - (f64::from(i) + 0.5) / f64::from(steps));
        v2 += ds * (2.0 * 9.81 * (phi.sin() - mu * phi.cos()) - 2.0 * mu * v2 / radius);
    }
    [slope, v2, v2 / (2.0 * mu * 9.81)]
}

#[test]
fn a_small_block_crosses_slope_arc_and_flat_as_a_point_does() {
    let angle = 40_f64.to_radians();
    // the design's own figures for Group II: 77.35 m of slope at mid depth
    let [v, after, stop] = block_over_arc((65.0 - 9.0 * angle.sin()) / angle.cos(), angle, 9.0, 0.5);
    assert!((v.sqrt() - 19.85).abs() < 0.02 && (after.sqrt() - 13.45).abs() < 0.02 && (stop - 18.45).abs() < 0.05);

    let terrain = Terrain::slope_arc_flat(40.0, 10.0, -80.0, 60.0).unwrap();
    let release = Slab { x_m: -65.0, length_m: 1.0, thickness_m: 0.4 };
    let setup = setup(terrain, release, strong(), 0.05);
    let mut simulation = Simulation::new(&setup).unwrap();
    let way = (65.0 - 10.0 * angle.sin()) / angle.cos();
    let [_, after, stop] = block_over_arc(way, angle, 9.8, 0.5);
    let mut at_flat = None;
    for frame in 1..=360 {
        simulation.step_until(f64::from(frame) / 24.0, &Unobserved).unwrap();
        let s = simulation.snapshot();
        let (x, v) = (mean(&s.x_m), mean(&s.vx_m_s));
        if x > 0.5 && at_flat.is_none() {
            at_flat = Some((v * v + 2.0 * 0.5 * 9.81 * x).sqrt());
        }
        if x > 0.5 && v.abs() < 0.01 {
            break;
        }
    }
    let v = at_flat.unwrap();
    assert!((v / after.sqrt() - 1.0).abs() < 0.02, "after the arc {v} for {} m/s", after.sqrt());
    let x = mean(&simulation.snapshot().x_m);
    assert!((x / stop - 1.0).abs() < 0.03, "stops at {x} for {stop} m");
}

#[test]
fn a_small_block_keeps_its_energy_on_a_curved_bed_without_friction() {
    let terrain = Terrain::slope_arc_flat(30.0, 20.0, -30.0, 40.0).unwrap();
    let release = Slab { x_m: -18.0, length_m: 1.0, thickness_m: 0.4 };
    let setup = Setup { bed_friction: 0.0, ..setup(terrain, release, strong(), 0.05) };
    let mut simulation = Simulation::new(&setup).unwrap();
    let z = mean(&simulation.snapshot().z_m);
    let mut x = -18.0;
    while x < 5.0 {
        simulation.step_until(simulation.time_s() + 0.05, &Unobserved).unwrap();
        x = mean(&simulation.snapshot().x_m);
    }
    let s = simulation.snapshot();
    let v = mean(&s.vx_m_s).hypot(mean(&s.vz_m_s));
    let expected = (2.0 * 9.81 * (z - mean(&s.z_m))).sqrt();
    assert!((v / expected - 1.0).abs() < 1e-3, "{v} for {expected} m/s");
}

#[test]
fn snow_sticks_to_a_sticky_bed() {
    let setup =
        Setup { contact: Contact::Sticky, bed_friction: 0.0, snow: strong(), ..group_2(ScenarioName::WarmPlug, 0.2) };
    let mut simulation = Simulation::new(&setup).unwrap();
    simulation.step_until(1.0, &Unobserved).unwrap();
    // an elastic slab of 2 m of which only the lowest row is held
    assert!(mean(&simulation.snapshot().x_m) + 65.0 < 0.05, "{}", mean(&simulation.snapshot().x_m));
}
