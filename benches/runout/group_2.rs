//! Group II of Li et al. (2020), Table 1, and the snow of the four regimes.

use std::error::Error;

use firn_science::runout::{
    Contact, LIMITED_ABOVE, LIMITED_BEYOND, Precision, Setup,
    material::{FlowRule, ShearNorm, Snow},
    release::Slab,
    terrain::Terrain,
};

/// Name and M, beta, xi, p0 (Pa) of each regime.
pub const REGIMES: [(&str, [f64; 4]); 4] = [
    ("cold_dense", [0.5, 0.0, 1.0, 3e3]),
    ("warm_shear", [1.5, 0.3, 1.0, 30e3]),
    ("sliding_slab", [1.5, 0.5, 1.0, 42e3]),
    ("warm_plug", [0.5, 1.0, 0.1, 12e3]),
];

/// Height of the block's centre, `H0 = L0 tan(theta) - (r - h0/2) / cos(theta) + r`, m.
fn centre_m() -> f64 {
    let angle = 40_f64.to_radians();
    65.0 * angle.tan() - 9.0 / angle.cos() + 10.0
}

/// Height of the block's highest point above the flat, m.
#[allow(dead_code, reason = "not every program that includes this file asks")]
pub fn top_m() -> f64 {
    let angle = 40_f64.to_radians();
    centre_m() + angle.cos() + 6.0 * angle.sin()
}

/// The setup in `f32`, `scale` times as large: 2.5 and 4 are Groups IV and V.
pub fn setup([m, beta, xi, p0]: [f64; 4], scale: f64, mesh_m: f64) -> Result<Setup, Box<dyn Error>> {
    let terrain = Terrain::slope_arc_flat(40.0, 10.0 * scale, -85.0 * scale, 260.0 * scale)?;
    let release = Slab::centred(&terrain, [-65.0 * scale, centre_m() * scale], 12.0 * scale, 2.0 * scale);
    Ok(Setup {
        terrain,
        release,
        snow: Snow::li_2020(m, beta, xi, p0),
        bed_friction: 0.5,
        contact: Contact::Separable,
        flow_rule: FlowRule::Associative,
        shear_norm: ShearNorm::VonMises,
        mesh_m,
        time_step_s: 2.3e-4 * mesh_m / 0.05,
        limited_above: LIMITED_ABOVE,
        limited_beyond: LIMITED_BEYOND,
        precision: Precision::F32,
        memory_limit_bytes: 8 << 30,
    })
}
