//! Collapse of columns of cohesionless snow on a flat bed, against the scaling of granular columns.

use super::{Simulation, material::Snow, release::Slab, terrain::Terrain, test_scenes::setup};
use crate::progress::Unobserved;

/// Snow without cohesion whose friction angle has the tangent of that of the bed, 0.5: in the plane `sin phi = M / sqrt 3`.
fn sand() -> Snow {
    let sine = 0.5 / 1.25_f64.sqrt();
    Snow::li_2020(3_f64.sqrt() * sine, 0.0, 1.0, 3e3)
}

/// Half of the width at release, m, and cells over it.
const HALF_M: f64 = 3.0;
const CELLS: f64 = 15.0;

/// Run-out of one side, over half of the width at release, of a column `aspect` times as high as that.
fn runout(aspect: f64) -> f64 {
    let terrain = Terrain::from_profile(&[[-120.0, 0.0], [120.0, 0.0]], 1.0).unwrap();
    let release = Slab { x_m: 0.0, length_m: 2.0 * HALF_M, thickness_m: aspect * HALF_M };
    let mut simulation = Simulation::new(&setup(terrain, release, sand(), HALF_M / CELLS)).unwrap();
    // twice as long as such columns take to come to rest (Lube et al. 2005, Phys. Rev. E 72, 041301: 3.3 sqrt(h / g))
    simulation.step_until(6.6 * (aspect * HALF_M / 9.81).sqrt(), &Unobserved).unwrap();
    let mut x = simulation.snapshot().x_m;
    x.sort_by(f32::total_cmp);
    let edge = |share: f64| f64::from(x[(share * x.len() as f64) as usize]);
    0.5 * (edge(0.99) - edge(0.01)) / HALF_M - 1.0
}

/// Balmforth & Kerswell (2005, J. Fluid Mech. 538, 399-428): in a wide channel the run-out over the initial length goes as the
/// aspect ratio to 0.9, give or take 0.1.
#[test]
fn columns_run_out_as_their_aspect_ratio_to_nine_tenths() {
    let aspects = [1.0, 2.0, 5.0, 10.0];
    let points = aspects.map(|aspect: f64| (aspect.ln(), runout(aspect).ln()));
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / points.len() as f64;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let products: f64 = points.iter().map(|point| (point.0 - x) * (point.1 - y)).sum();
    let squares: f64 = points.iter().map(|point| (point.0 - x).powi(2)).sum();
    let exponent = products / squares;
    println!("{exponent}: {:?}", points.map(|point| point.1.exp()));
    assert!((exponent - 0.9).abs() < 0.1, "{exponent}: {points:?}");
}
