//! The bed and what is laid on it, against geometry.

use std::f64::consts::FRAC_PI_2;

use proptest::prelude::*;

use super::release::{ReleaseError, Slab};
use super::terrain::{SMOOTHING_M, Terrain, TerrainError};

/// Group II of Table 1.
fn group_two() -> Terrain {
    Terrain::slope_arc_flat(40.0, 10.0, -100.0, 200.0).unwrap()
}

fn close(left: f64, right: f64, tolerance: f64) {
    assert!((left - right).abs() <= tolerance, "{left} is not {right}");
}

#[test]
fn the_ideal_slope_has_the_heights_of_its_three_parts() {
    let terrain = group_two();
    let (sine, cosine) = 40_f64.to_radians().sin_cos();
    for x in [0.0, 1e-9, 17.0, 199.0] {
        assert_eq!(terrain.height_m(x), 0.0);
    }
    for x in [-0.1, -1.0, -3.0, -6.4] {
        close(terrain.height_m(x), 10.0 - f64::sqrt(100.0 - x * x), 1e-13);
    }
    for x in [-10.0, -65.0, -99.9] {
        close(terrain.height_m(x), 10.0 * (1.0 - cosine) + (-10.0 * sine - x) * sine / cosine, 1e-12);
    }
    assert_eq!(terrain.extent_m(), (-100.0, 200.0));
    assert_eq!(terrain.lowest_m(), 0.0);
}

#[test]
fn normals_of_the_ideal_slope_are_exact() {
    let terrain = group_two();
    let (sine, cosine) = 40_f64.to_radians().sin_cos();
    for depth in [-0.3, -0.05, 0.0, 0.05, 1.0, 4.0] {
        let [x, z] = terrain.normal(50.0, depth);
        assert_eq!((x, z), (0.0, 1.0));
        let [x, z] = terrain.normal(-65.0 + depth * sine, terrain.height_m(-65.0) + depth * cosine);
        close(x, sine, 1e-15);
        close(z, cosine, 1e-15);
        for degrees in [0.5_f64, 10.0, 25.0, 39.5] {
            let (sine, cosine) = degrees.to_radians().sin_cos();
            let radius = 10.0 - depth;
            let foot = terrain.project(-radius * sine, 10.0 - radius * cosine);
            close(foot.normal[0], sine, 1e-14);
            close(foot.normal[1], cosine, 1e-14);
            close(foot.distance_m, depth, 1e-13);
            close(foot.x_m, -10.0 * sine, 1e-13);
            close(foot.curvature_1_m, 0.1, 1e-15);
        }
    }
}

#[test]
fn arc_length_is_that_of_lines_and_a_circle() {
    let terrain = group_two();
    let (sine, cosine) = 40_f64.to_radians().sin_cos();
    let slope = (100.0 - 10.0 * sine) / cosine;
    let arc = 10.0 * 40_f64.to_radians();
    close(terrain.arc_length_m(-10.0 * sine), slope, 1e-12);
    close(terrain.arc_length_m(0.0), slope + arc, 1e-12);
    close(terrain.arc_length_m(-10.0 * 20_f64.to_radians().sin()), slope + 0.5 * arc, 1e-12);
    close(terrain.length_m(), slope + arc + 200.0, 1e-12);
    let middle = terrain.at_arc_length(slope + 0.5 * arc);
    close(middle.x_m, -10.0 * 20_f64.to_radians().sin(), 1e-13);
    close(middle.tangent()[1], -20_f64.to_radians().sin(), 1e-14);
}

#[test]
fn a_profile_of_three_points_becomes_the_ideal_slope() {
    // an arc of radius r that turns by theta touches both of its tangents r tan(theta / 2) from their corner
    let touch = 10.0 * 20_f64.to_radians().tan();
    let top = [-100.0, (100.0 - touch) * 40_f64.to_radians().tan()];
    let rounded = Terrain::from_profile(&[top, [-touch, 0.0], [200.0, 0.0]], touch).unwrap();
    let ideal = group_two();
    for step in 0..3000 {
        let x = -100.0 + 0.1 * f64::from(step);
        close(rounded.height_m(x), ideal.height_m(x), 1e-12);
        close(rounded.arc_length_m(x), ideal.arc_length_m(x), 1e-11);
        let (left, right) = (rounded.project(x, 1.0), ideal.project(x, 1.0));
        close(left.normal[0], right.normal[0], 1e-13);
        close(left.distance_m, right.distance_m, 1e-12);
    }
}

#[test]
fn a_ridge_curves_the_other_way_and_a_hollow_has_its_lowest_point() {
    let terrain = Terrain::from_profile(&[[-100.0, 0.0], [0.0, 100.0], [100.0, 0.0], [200.0, 100.0]], 10.0).unwrap();
    let crest = terrain.project(0.0, 120.0);
    close(crest.x_m, 0.0, 1e-12);
    // half of the turn is 45 degrees: the arc of radius 10 has its centre at 100 - 10 sqrt 2
    close(crest.z_m, 110.0 - 10.0 * std::f64::consts::SQRT_2, 1e-12);
    close(crest.curvature_1_m, -0.1, 1e-15);
    close(terrain.project(100.0, -5.0).curvature_1_m, 0.1, 1e-15);
    assert_eq!(terrain.lowest_m(), 0.0);
    let hollow = Terrain::from_profile(&[[0.0, 100.0], [100.0, 0.0], [200.0, 100.0]], 10.0).unwrap();
    close(hollow.lowest_m(), 10.0 * std::f64::consts::SQRT_2 - 10.0, 1e-12);
}

#[test]
fn points_that_make_no_bed_are_named() {
    let profile = |points: &[[f64; 2]]| Terrain::from_profile(points, SMOOTHING_M);
    assert_eq!(profile(&[[0.0, 1.0]]), Err(TerrainError::Points { found: 1 }));
    assert_eq!(profile(&[]), Err(TerrainError::Points { found: 0 }));
    let back = [[0.0, 9.0], [5.0, 6.0], [5.0, 5.0], [4.0, 4.0]];
    assert_eq!(profile(&back), Err(TerrainError::NotIncreasing { index: 2, x_m: 5.0, previous_m: 5.0 }));
    for bad in [f64::NAN, f64::INFINITY, 20_001.0] {
        assert_eq!(profile(&[[0.0, 0.0], [1.0, bad]]), Err(TerrainError::Coordinate { index: 1 }));
        assert_eq!(profile(&[[0.0, 0.0], [bad, 1.0]]), Err(TerrainError::Coordinate { index: 1 }));
    }
    assert_eq!(profile(&[[0.0, 0.0], [1.0, 0.0], [2.0, 6.0]]), Err(TerrainError::TooSteep { index: 2 }));
    let rough = Terrain::from_profile(&[[0.0, 0.0], [1.0, 0.0]], f64::NAN);
    assert!(matches!(rough, Err(TerrainError::Smoothing { .. })));
    for (angle, radius, top, end) in [
        (0.0, 10.0, -100.0, 200.0),
        (81.0, 10.0, -100.0, 9.0),
        (40.0, 0.0, -100.0, 9.0),
        (40.0, 10.0, -6.0, 9.0),
        (40.0, 10.0, -100.0, 0.0),
        (f64::NAN, 10.0, -100.0, 9.0),
        (40.0, f64::INFINITY, -100.0, 9.0),
    ] {
        let refused = Terrain::slope_arc_flat(angle, radius, top, end);
        assert!(matches!(refused, Err(TerrainError::IdealSlope { .. })), "{angle} {radius} {top} {end}");
    }
}

#[test]
fn a_slab_touches_the_bed_and_is_filled_evenly() {
    let terrain = group_two();
    let slab = Slab::centred(&terrain, [-65.0, 52.793], 12.0, 2.0);
    let placed = slab.place(&terrain, 0.05).unwrap();
    assert_eq!(placed.x_m.len(), 240 * 40);
    close(placed.particle_area_m2, 0.0025, 1e-15);
    let heights: Vec<f64> =
        placed.x_m.iter().zip(&placed.z_m).map(|(&x, &z)| terrain.project(x, z).distance_m).collect();
    close(heights.iter().copied().fold(f64::INFINITY, f64::min), 0.025, 1e-10);
    close(heights.iter().copied().fold(0.0, f64::max), 1.975, 1e-10);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    close(mean(&placed.x_m), -65.0, 1e-3);
    close(mean(&placed.z_m), 52.793, 1e-3);
    let [x, z] = slab.centre_m(&terrain);
    close(mean(&placed.x_m), x, 1e-9);
    close(mean(&placed.z_m), z, 1e-9);
    let gap = (placed.x_m[1] - placed.x_m[0]).hypot(placed.z_m[1] - placed.z_m[0]);
    close(gap, 0.05, 1e-10);
    // 6 m up the slope from the foot of the centre
    let crown = slab.crown_m(&terrain);
    close(crown[0], slab.x_m - 6.0 * 40_f64.to_radians().cos(), 1e-10);
    close(crown[1], terrain.height_m(crown[0]), 1e-10);
}

#[test]
fn a_slab_in_a_hollow_keeps_its_density() {
    // a quarter of a circle of radius 20: rows above the bed are shorter, and have fewer particles
    let touch = 20.0;
    let terrain = Terrain::from_profile(&[[-60.0, 60.0], [0.0, 0.0], [60.0, 60.0]], touch).unwrap();
    let radius = touch;
    let slab = Slab { x_m: 0.0, length_m: 10.0, thickness_m: 2.0 };
    let placed = slab.place(&terrain, 0.05).unwrap();
    let turn = 10.0 / radius;
    let area = 0.5 * turn * (radius * radius - (radius - 2.0) * (radius - 2.0));
    close(placed.particle_area_m2 * placed.x_m.len() as f64, area, 1e-9);
    let lower = placed.x_m.iter().zip(&placed.z_m).filter(|&(&x, &z)| terrain.project(x, z).distance_m < 1.0).count();
    let lower_area = 0.5 * turn * (radius * radius - (radius - 1.0) * (radius - 1.0));
    close(lower as f64 * placed.particle_area_m2, lower_area, 0.002 * lower_area);
    let thick = Slab { thickness_m: 11.0, ..slab }.place(&terrain, 0.05);
    assert!(matches!(thick, Err(ReleaseError::TooThick { most_m, .. }) if (most_m - 10.0).abs() < 1e-9));
}

#[test]
fn a_slab_that_cannot_lie_there_is_refused() {
    let terrain = group_two();
    let slab = Slab { x_m: -65.0, length_m: 12.0, thickness_m: 2.0 };
    assert_eq!(slab.check(&terrain, 0.025), Ok(()));
    for x_m in [-95.0, -101.0, 195.0, 1e6] {
        let off = Slab { x_m, ..slab }.check(&terrain, 0.025);
        assert!(matches!(off, Err(ReleaseError::OffTerrain { .. })), "{x_m}");
    }
    for (length_m, thickness_m, spacing) in [
        (0.0, 2.0, 0.025),
        (12.0, f64::NAN, 0.025),
        (12.0, -1.0, 0.025),
        (12.0, 0.04, 0.025),
        (12.0, 2.0, f64::NAN),
        (12.0, 2.0, 0.0),
        (f64::INFINITY, 2.0, 0.1),
    ] {
        let none = Slab { length_m, thickness_m, ..slab }.check(&terrain, spacing);
        assert!(matches!(none, Err(ReleaseError::Size { .. })), "{length_m} {thickness_m} {spacing}");
    }
}

/// Profiles that go anywhere, with steps from 10 cm to 30 m.
fn profiles() -> impl Strategy<Value = Vec<[f64; 2]>> {
    let steps = prop::collection::vec((0.1_f64..30.0, -70_f64..70.0), 1..20);
    steps.prop_map(|steps| {
        let mut points = vec![[-50.0, 300.0]];
        for (along, degrees) in steps {
            let [x, z] = points[points.len() - 1];
            points.push([x + along, z + along * degrees.to_radians().tan()]);
        }
        points
    })
}

proptest! {
    #[test]
    fn arc_length_and_position_are_inverse(points in profiles(), share in 0.0_f64..1.0) {
        let terrain = Terrain::from_profile(&points, SMOOTHING_M).unwrap();
        let s = share * terrain.length_m();
        let point = terrain.at_arc_length(s);
        prop_assert!((terrain.arc_length_m(point.x_m) - s).abs() < 1e-6);
        prop_assert!((terrain.height_m(point.x_m) - point.z_m).abs() < 1e-8);
        prop_assert!((point.normal[0].hypot(point.normal[1]) - 1.0).abs() < 1e-12 && point.normal[1] > 0.0);
    }

    #[test]
    fn nothing_of_the_bed_is_nearer_than_the_projection(points in profiles(), x in -60.0_f64..400.0, up in -30.0_f64..30.0) {
        let terrain = Terrain::from_profile(&points, SMOOTHING_M).unwrap();
        let z = terrain.height_m(x) + up;
        let foot = terrain.project(x, z);
        let away = (foot.x_m - x).hypot(foot.z_m - z);
        prop_assert!((foot.distance_m.abs() - away).abs() < 1e-7, "the foot is not below along the normal");
        prop_assert!(up.abs() < 1e-6 || foot.distance_m.signum() == up.signum());
        for step in 0..2000 {
            let at = x - 31.0 + 0.031 * f64::from(step);
            prop_assert!((at - x).hypot(terrain.height_m(at) - z) > away - 1e-9);
        }
    }

    #[test]
    fn the_bed_has_no_step_and_no_kink(points in profiles(), share in 0.0_f64..1.0) {
        let terrain = Terrain::from_profile(&points, SMOOTHING_M).unwrap();
        let (s, step) = (share * terrain.length_m(), 1e-7);
        let (here, there) = (terrain.at_arc_length(s), terrain.at_arc_length(s + step));
        prop_assert!((there.x_m - here.x_m).hypot(there.z_m - here.z_m) < 1.01 * step);
        // the sharpest arc turns by 140 degrees over 5 cm
        let turned = there.normal[0].atan2(there.normal[1]) - here.normal[0].atan2(here.normal[1]);
        prop_assert!(turned.abs() < 2.0 * FRAC_PI_2 * 100.0 * step);
        prop_assert!(terrain.lowest_m() <= here.z_m + 1e-9);
    }
}
