//! Collapse of columns of cohesionless snow on a flat bed, against the scaling of granular columns.

use super::{Setup, Simulation, material::Snow, release::Slab, terrain::Terrain, test_scenes::setup};
use crate::progress::Unobserved;

/// Internal friction angle whose tangent is the bed's friction coefficient of 0.5: in the plane `sin phi = M / sqrt 3`.
fn sand() -> Snow {
    let sine = 0.5 / 1.25_f64.sqrt();
    Snow::li_2020(3_f64.sqrt() * sine, 0.0, 1.0, 3e3)
}

/// Half of the width at release, m.
const HALF_M: f64 = 1.0;

/// Run-out of one side, over half of the width at release, of a column `aspect` times as high as that.
fn runout(aspect: f64, mesh_m: f64) -> f64 {
    let terrain = Terrain::from_profile(&[[-60.0, 0.0], [60.0, 0.0]], 1.0).unwrap();
    let release = Slab { x_m: 0.0, length_m: 2.0 * HALF_M, thickness_m: aspect * HALF_M };
    let setup: Setup = setup(terrain, release, sand(), mesh_m);
    let mut simulation = Simulation::new(&setup).unwrap();
    // some five times the time of its fall: nothing moves then
    simulation.step_until(5.0 * (2.0 * aspect * HALF_M / 9.81).sqrt() + 1.0, &Unobserved).unwrap();
    let mut x = simulation.snapshot().x_m;
    x.sort_by(f32::total_cmp);
    let edge = |share: f64| f64::from(x[(share * x.len() as f64) as usize]);
    0.5 * (edge(0.99) - edge(0.01)) / HALF_M - 1.0
}

#[test]
#[ignore]
fn probe() {
    for mesh in [0.1, 0.05] {
        for a in [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0] {
            println!("{mesh} {a} {:.4}", runout(a, mesh));
        }
    }
}
