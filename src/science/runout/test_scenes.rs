//! Scenes and measures that several tests share.

use super::{
    Contact, LIMITED_ABOVE, LIMITED_BEYOND, Precision, Setup, Simulation,
    engine::{Engine, Frame, Released},
    lanes::Real,
    material::{FlowRule, ShearNorm, Snow},
    plan::Plan,
    release::Slab,
    scenario::{RunoutInputs, ScenarioName},
    snapshot::Snapshot,
    terrain::Terrain,
};

/// Snow that stays elastic.
pub(super) fn strong() -> Snow {
    Snow::li_2020(1.5, 1.0, 1.0, 1e6)
}

/// Snow on a bed, with all else as Table 1 of Li et al. (2020) has it.
pub(super) fn setup(terrain: Terrain, release: Slab, snow: Snow, mesh_m: f64) -> Setup {
    Setup {
        terrain,
        release,
        snow,
        bed_friction: 0.5,
        contact: Contact::Separable,
        flow_rule: FlowRule::Associative,
        shear_norm: ShearNorm::VonMises,
        mesh_m,
        time_step_s: 2.3e-4 * mesh_m / 0.05,
        limited_above: LIMITED_ABOVE,
        limited_beyond: LIMITED_BEYOND,
        flip: 0.0,
        precision: Precision::F32,
        memory_limit_bytes: 1 << 30,
    }
}

/// A flow of Group II of Li et al. (2020), Table 1.
pub(super) fn group_2(flow: ScenarioName, mesh_m: f64) -> Setup {
    let inputs = RunoutInputs { mesh_m: Some(mesh_m), ..RunoutInputs::of_scenario(flow, None) };
    Plan::new(&inputs, 1 << 30).unwrap().setup
}

/// A setup's dynamics at time 0, in either precision.
pub(super) fn engine<T: Real>(setup: &Setup, gravity_m_s2: f64) -> Engine<T> {
    let placement = setup.placement().unwrap();
    let frame = Frame { gravity_m_s2, ..setup.frame(placement.particle_area_m2) };
    let released: Vec<Released> = std::iter::zip(&placement.x_m, &placement.z_m)
        .map(|(&x, &z)| Released { position_m: [x, z], velocity_m_s: [0.0; 2], gradient_1_s: [0.0; 4] })
        .collect();
    Engine::new(frame, &released).unwrap()
}

pub(super) fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64
}

/// Position along the track below which 99 % of the mass lies, m.
pub(super) fn front(snapshot: &Snapshot) -> f64 {
    let mut x = snapshot.x_m.clone();
    x.sort_by(f32::total_cmp);
    f64::from(x[(0.99 * x.len() as f64) as usize])
}

pub(super) fn speeds(snapshot: &Snapshot) -> impl Iterator<Item = f64> {
    snapshot.vx_m_s.iter().zip(&snapshot.vz_m_s).map(|(vx, vz)| f64::from(vx.hypot(*vz)))
}

/// Every bit of what can be seen.
pub(super) fn bits(simulation: &Simulation) -> Vec<u32> {
    let s = simulation.snapshot();
    let e = simulation.energies();
    let columns = [s.x_m, s.z_m, s.vx_m_s, s.vz_m_s, s.density_kg_m3, s.plastic_strain];
    let energies = [e.kinetic, e.affine, e.potential, e.elastic, e.bed, e.plastic, e.transfer].map(f64::to_bits);
    let energies = energies.iter().flat_map(|bits| [*bits as u32, (bits >> 32) as u32]);
    columns.iter().flatten().map(|value| value.to_bits()).chain(energies).collect()
}
