//! Scenarios against Table 1 of Li et al. (2020), and what of inputs is refused.

use serde_json::{Value, json};

use super::plan::{InputError, Plan};
use super::regime::Indicators;
use super::release::ReleaseError;
use super::scenario::{Quality, RunoutInputs, ScenarioName, SnowInputs};
use super::terrain::TerrainError;
use super::{Contact, Precision};

const MEMORY: u64 = 4 << 30;

fn inputs(value: Value) -> RunoutInputs {
    serde_json::from_value(value).unwrap()
}

fn group_two() -> Value {
    json!({"scenario": "group-2", "snow": {"M": 0.5, "beta": 0.3, "xi": 1, "p0_kpa": 12}})
}

/// The group with some fields changed.
fn with(change: Value) -> Value {
    let mut inputs = group_two();
    let fields = inputs.as_object_mut().unwrap();
    for (name, value) in change.as_object().unwrap() {
        fields.insert(name.clone(), value.clone());
    }
    inputs
}

fn plan(value: Value) -> Plan {
    Plan::new(&inputs(value), MEMORY).unwrap()
}

fn faults(value: Value) -> Vec<InputError> {
    Plan::new(&inputs(value), MEMORY).unwrap_err()
}

fn slope() -> Value {
    json!({"profile": [[-120.0, 90.0], [0.0, 0.0], [300.0, 0.0]]})
}

fn on_slope(release: Value) -> Value {
    json!({"terrain": slope(), "release": release, "snow": {"M": 0.5, "beta": 0.3, "xi": 1, "p0_kpa": 12}})
}

#[test]
fn groups_have_the_heights_of_table_1() {
    let heights = [37.135, 52.793, 73.462, 131.98, 211.17];
    for (group, height) in ScenarioName::ALL.into_iter().zip(heights) {
        let slope = group.slope();
        assert!((slope.drop_height_m() - height).abs() < 0.005 * (height / 100.0_f64).max(0.1), "{group:?}");
        let terrain = slope.terrain().unwrap();
        let [x, z] = slope.slab(&terrain).centre_m(&terrain);
        assert!((x + slope.distance_m).abs() < 1e-9 && (z - slope.drop_height_m()).abs() < 1e-9);
    }
}

#[test]
fn groups_have_their_numbers_of_particles() {
    for (group, particles) in [("group-2", 38_400), ("group-4", 240_000), ("group-5", 614_400)] {
        let plan = plan(with(json!({"scenario": group, "mesh_m": 0.05})));
        assert_eq!(plan.particles(), particles);
        let placed = plan.setup.release.place(&plan.setup.terrain, 0.5 * plan.setup.mesh_m).unwrap();
        assert_eq!(placed.x_m.len() as u64, particles);
    }
}

#[test]
fn what_is_left_out_is_that_of_table_1() {
    let plan = plan(group_two());
    assert_eq!((plan.setup.mesh_m, plan.setup.time_step_s), (0.05, 2.3e-4));
    assert_eq!((plan.setup.bed_friction, plan.setup.contact), (0.5, Contact::Separable));
    let snow = plan.setup.snow;
    assert_eq!((snow.density_kg_m3, snow.youngs_modulus_pa, snow.poisson_ratio), (250.0, 3e6, 0.3));
    assert_eq!((snow.friction, snow.cohesion, snow.hardening, snow.strength_pa), (0.5, 0.3, 1.0, 12_000.0));
    assert_eq!((plan.end_time_s, plan.setup.precision), (60.0, Precision::F32));
    assert_eq!(plan.setup.flip, 0.0);
    // the centre's way down the slope is (65 - 9 sin 40) / cos 40 m; half of it
    let half = 0.5 * (65.0 - 9.0 * 40_f64.to_radians().sin());
    assert!((plan.mid_slope_m - (half - 65.0)).abs() < 1e-12);
    assert_eq!(plan.indicators, Indicators::new(&snow, 2.0, 0.5));
}

#[test]
fn a_plan_of_its_own_filled_inputs_is_the_same() {
    for value in [group_two(), with(json!({"quality": "quick", "seed": 7})), json!({"scenario": "warm-plug"})] {
        let first = plan(value);
        let text = serde_json::to_string(&first.inputs).unwrap();
        assert_eq!(Plan::new(&serde_json::from_str(&text).unwrap(), MEMORY).unwrap(), first);
    }
}

#[test]
fn quality_is_a_share_of_the_thickness() {
    for (quality, mesh) in [("default", 0.05), ("scaled", 5.0 / 40.0), ("quick", 5.0 / 20.0)] {
        let plan = plan(with(json!({"scenario": "group-4", "quality": quality})));
        assert_eq!(plan.setup.mesh_m, mesh);
    }
    // 0.5 * 0.1 / sqrt(3e6 / 250) = 4.564e-4
    assert_eq!(plan(with(json!({"quality": "quick"}))).setup.time_step_s, 4.6e-4);
    let thin = plan(on_slope(json!({"x_m": -60.0, "length_m": 12.0, "thickness_m": 0.1})));
    assert_eq!(thin.setup.mesh_m, 0.025);
}

#[test]
fn the_usual_time_step_keeps_the_limit_of_stiff_snow() {
    // pressure waves are faster than sqrt(E / rho) by sqrt((1 - nu) / ((1 + nu) (1 - 2 nu))): by 11.9 at nu = 0.4976
    let snow = json!({"M": 0.5, "beta": 0.3, "xi": 1, "p0_kpa": 12, "poisson_ratio": 0.499});
    let plan = plan(with(json!({"snow": snow})));
    let limit = plan.setup.time_step_limit_s();
    assert!(plan.setup.time_step_s <= limit && plan.setup.time_step_s > 0.9 * limit);
}

#[test]
fn typical_flows_bring_their_snow() {
    let expected = [
        ("cold-dense", [0.5, 0.0, 1.0, 3e3]),
        ("warm-shear", [1.5, 0.3, 1.0, 30e3]),
        ("sliding-slab", [1.5, 0.5, 1.0, 42e3]),
        ("warm-plug", [0.5, 1.0, 0.1, 12e3]),
    ];
    for (name, [m, beta, xi, p0]) in expected {
        let snow = plan(json!({"scenario": name})).setup.snow;
        assert_eq!([snow.friction, snow.cohesion, snow.hardening, snow.strength_pa], [m, beta, xi, p0]);
    }
    let own = with(json!({"scenario": "warm-plug"}));
    assert_eq!(faults(own), [InputError::Beside { pointer: "/snow", beside: "scenario" }]);
}

#[test]
fn numbers_outside_of_the_model_are_named() {
    let snow = |name: &str, value: f64| {
        let mut snow = json!({"M": 0.5, "beta": 0.3, "xi": 1, "p0_kpa": 12});
        snow[name] = json!(value);
        json!({"snow": snow})
    };
    let cases = [
        ("/snow/M", snow("M", 0.0)),
        ("/snow/beta", snow("beta", -0.1)),
        ("/snow/xi", snow("xi", 0.0)),
        ("/snow/p0_kpa", snow("p0_kpa", 0.0)),
        ("/snow/poisson_ratio", snow("poisson_ratio", 0.5)),
        ("/snow/density_kg_m3", snow("density_kg_m3", 0.0)),
        ("/snow/youngs_modulus_mpa", snow("youngs_modulus_mpa", -3.0)),
        ("/bed/mu", json!({"bed": {"mu": -0.5}})),
        ("/transfer/flip", json!({"transfer": {"flip": 1.01}})),
        ("/transfer/flip", json!({"transfer": {"flip": -0.1}})),
        ("/mesh_m", json!({"mesh_m": 0.0})),
        ("/mesh_m", json!({"mesh_m": 0.51})),
        ("/time_step_s", json!({"time_step_s": 0.0})),
        ("/time_step_s", json!({"time_step_s": 1e-3})),
        ("/end_time_s", json!({"end_time_s": 0.0})),
        ("/end_time_s", json!({"end_time_s": 601.0})),
        ("/seed", json!({"seed": 1_u64 << 53})),
        ("/quality", json!({"quality": "quick", "mesh_m": 0.1})),
        ("/scenario", json!({"scenario": null})),
        ("/snow", json!({"snow": null})),
        ("/terrain", json!({"terrain": slope()})),
        ("/release", json!({"release": {"x_m": 0.0, "length_m": 12.0, "thickness_m": 2.0}})),
    ];
    for (pointer, change) in cases {
        let found: Vec<String> = faults(with(change.clone())).iter().map(InputError::pointer).collect();
        assert_eq!(found, [pointer], "{change}");
    }
    let two = faults(with(json!({"end_time_s": -1.0, "bed": {"mu": 11.0}, "snow": null})));
    let pointers: Vec<String> = two.iter().map(InputError::pointer).collect();
    assert_eq!(pointers, ["/end_time_s", "/bed/mu", "/snow"]);
}

#[test]
fn a_time_step_over_the_limit_is_told_the_limit() {
    let found = faults(with(json!({"time_step_s": 4e-4})));
    let [InputError::TimeStep { time_step_s, limit_s }] = found.as_slice() else { panic!("{found:?}") };
    assert_eq!(*time_step_s, 4e-4);
    // sqrt((lambda + 2 mu) / rho) = 127.1 m/s
    assert!((limit_s - 0.05 / 127.1).abs() < 1e-6);
    assert!(found[0].to_string().contains("at most 0.00039"), "{}", found[0]);
}

#[test]
fn a_mesh_over_the_memory_limit_is_told_particles_and_bytes() {
    let found = faults(with(json!({"mesh_m": 0.001})));
    let [InputError::TooLarge { mesh_m, particles, bytes, limit_bytes }] = found.as_slice() else {
        panic!("{found:?}")
    };
    assert_eq!((*mesh_m, *particles, *limit_bytes), (0.001, 96_000_000, MEMORY));
    assert!(*bytes > 96_000_000 * 60, "{bytes}");
    assert!(found[0].to_string().contains("96000000 particles"));
}

#[test]
fn a_slab_on_a_profile_is_checked_against_it() {
    let flow = plan(on_slope(json!({"x_m": -80.0, "length_m": 12.0, "thickness_m": 2.0})));
    // the slope of 3:4 puts the centre 1 m above its foot along (3, 4) / 5, and the lowest point is the flat
    assert!((flow.drop_height_m - (60.0 + 0.8)).abs() < 1e-9);
    assert!((flow.mid_slope_m - (-80.0 + 0.5 * 60.8 / 0.75)).abs() < 0.1);
    let off = faults(on_slope(json!({"x_m": -118.0, "length_m": 12.0, "thickness_m": 2.0})));
    assert!(matches!(off.as_slice(), [InputError::Release(ReleaseError::OffTerrain { .. })]));
    assert_eq!(off[0].pointer(), "/release");
    let thin = faults(on_slope(json!({"x_m": -80.0, "length_m": 12.0, "thickness_m": 0.0})));
    assert!(matches!(thin.as_slice(), [InputError::Release(ReleaseError::Size { .. })]));
    let mut back = on_slope(json!({"x_m": -80.0, "length_m": 12.0, "thickness_m": 2.0}));
    back["terrain"]["profile"] = json!([[0.0, 5.0], [10.0, 0.0], [9.0, 0.0]]);
    let found = faults(back);
    assert!(matches!(found.as_slice(), [InputError::Terrain(TerrainError::NotIncreasing { index: 2, .. })]));
    assert_eq!(found[0].pointer(), "/terrain/profile/2");
}

#[test]
fn unknown_fields_and_names_are_refused() {
    let refused = |value: Value| serde_json::from_value::<RunoutInputs>(value).unwrap_err().to_string();
    assert!(refused(with(json!({"mesh": 0.1}))).contains("unknown field `mesh`"));
    assert!(refused(json!({"scenario": "group-6"})).contains("group-5"));
    assert!(refused(with(json!({"snow": {"M": 1, "beta": 0, "xi": 1}}))).contains("p0_kpa"));
    let defaults = RunoutInputs::of_scenario(ScenarioName::Group2, Some(SnowInputs::new(0.5, 0.3, 1.0, 12.0)));
    assert_eq!(inputs(group_two()), defaults);
    assert_eq!(inputs(with(json!({"quality": "quick"}))).quality, Some(Quality::Quick));
}
