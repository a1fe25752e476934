//! The material against golden vectors and closed forms.

use std::path::PathBuf;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    lanes::Real,
    material::{FlowRule, Material, ShearNorm, Snow},
    particles::{BLOCK, Block},
    transfer::{Motion, deformed},
};

/// `4 dt^2 / (rho dx^2)` of Table 1, 1/Pa: the material is tried in the units of the dynamics.
const SCALE: f64 = 4.0 * 2.3e-4 * 2.3e-4 / (250.0 * 0.05 * 0.05);

/// The four regimes: M, beta, xi, p0 (Pa).
const REGIMES: [[f64; 4]; 4] =
    [[0.5, 0.0, 1.0, 3e3], [1.5, 0.3, 1.0, 30e3], [1.5, 0.5, 1.0, 42e3], [0.5, 1.0, 0.1, 12e3]];

fn snow([m, beta, xi, p0]: [f64; 4]) -> Snow {
    Snow::li_2020(m, beta, xi, p0)
}

/// A block whose particles have these `b - I` (xx, zz, xz) and volumetric plastic strains, the last one again and again.
fn block_of<T: Real>(material: &Material<T>, states: &[([f64; 3], f64)]) -> Block<T> {
    let mut block = Block::empty(0, 0);
    block.len = states.len();
    for k in 0..BLOCK {
        let (b, strain) = states[k.min(states.len() - 1)];
        (block.bxx[k], block.bzz[k], block.bxz[k]) = (T::of(b[0]), T::of(b[1]), T::of(b[2]));
        block.plastic_strain[k] = T::of(strain);
        block.strength[k] = material.strength(T::of(strain));
    }
    block
}

/// p and q, Pa, of scaled stresses.
fn invariants<T: Real>(stress: &[[T; BLOCK]; 3], k: usize, norm: ShearNorm) -> (f64, f64) {
    let [xx, zz, xz] = [0, 1, 2].map(|i| stress[i][k].f64() / SCALE);
    let c = if norm == ShearNorm::Plane { 2.0_f64.sqrt() } else { 1.5_f64.sqrt() };
    (-0.5 * (xx + zz), c * 2.0_f64.sqrt() * (0.5 * (xx - zz)).hypot(xz))
}

struct Golden {
    rule: FlowRule,
    norm: ShearNorm,
    snow: Snow,
    b: [f64; 3],
    strain: f64,
    /// p, q, tau (xx, zz, xz), Pa; volumetric plastic strain; b - I.
    stress: [f64; 5],
    strain_after: f64,
    b_after: [f64; 3],
}

/// The golden vectors of all three rules: an independent implementation in up to 34 digits.
fn golden() -> Option<Vec<Golden>> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("FIRN_SHARED_DATA").map_or_else(beside, PathBuf::from);
    let Ok(text) = std::fs::read_to_string(folder.join("return_mapping.json")) else {
        println!("skipped: return_mapping.json is absent");
        return None;
    };
    let all: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    let read = |value: &serde_json::Value, name: &str| value[name].as_str().unwrap().parse::<f64>().unwrap();
    let golden = all.iter().map(|value| {
        let rule = match value["rule"].as_str().unwrap() {
            "assoc_explicit" => FlowRule::Associative,
            "assoc_implicit" => FlowRule::AssociativeImplicit,
            "nacc" => FlowRule::Nacc,
            other => panic!("{other}"),
        };
        let norm = match value["q_prefactor"].as_str().unwrap() {
            "sqrt(3/2)" => ShearNorm::VonMises,
            "sqrt(2)" => ShearNorm::Plane,
            other => panic!("{other}"),
        };
        let result = &value["result"];
        let b = |value: &serde_json::Value| [read(value, "b_xx") - 1.0, read(value, "b_yy") - 1.0, read(value, "b_xy")];
        Golden {
            rule,
            norm,
            snow: snow(["M", "beta", "xi", "p0_ini"].map(|name| read(value, name))),
            b: b(value),
            strain: read(value, "alpha"),
            stress: ["p", "q", "tau_xx", "tau_yy", "tau_xy"].map(|name| read(result, name)),
            strain_after: read(result, "alpha"),
            b_after: b(result),
        }
    });
    Some(golden.collect())
}

/// The largest error of the golden vectors, as a share of max(value, p0_ini) or of the strain that p0_ini gives.
fn golden_error<T: Real>(golden: &[Golden]) -> f64 {
    let mut worst = 0.0_f64;
    for case in golden {
        let material = Material::<T>::new(&case.snow, case.rule, case.norm, SCALE);
        let mut block = block_of(&material, &[(case.b, case.strain)]);
        let (stress, _) = deformed(&material, &mut block, &Motion::default());
        let (p, q) = invariants(&stress, 0, case.norm);
        let p0 = case.snow.strength_pa;
        let stress = [p, q, stress[0][0].f64() / SCALE, stress[1][0].f64() / SCALE, stress[2][0].f64() / SCALE];
        for (ours, theirs) in stress.iter().zip(case.stress) {
            worst = worst.max((ours - theirs).abs() / theirs.abs().max(p0));
        }
        let strain = p0 / case.snow.bulk_modulus_pa();
        let ours = [block.plastic_strain[0], block.bxx[0], block.bzz[0], block.bxz[0]].map(Real::f64);
        let theirs = [case.strain_after, case.b_after[0], case.b_after[1], case.b_after[2]];
        for (ours, theirs) in ours.iter().zip(theirs) {
            // b itself is given in 17 digits: 1 and less than 1e-16
            worst = worst.max(((ours - theirs).abs() - 2.3e-16).max(0.0) / theirs.abs().max(strain));
        }
    }
    worst
}

#[test]
fn the_return_gives_the_golden_vectors() {
    let Some(golden) = golden() else { return };
    assert_eq!(golden.len(), 120);
    let error = golden_error::<f64>(&golden);
    assert!(error < 1e-12, "f64: {error:e}");
    let error = golden_error::<f32>(&golden);
    assert!(error < 1e-4, "f32: {error:e}");
}

/// A random state and deformation: trial pressures and shears up to some ten p0.
fn random_state(rng: &mut ChaCha8Rng, snow: &Snow) -> ([f64; 3], f64) {
    let size = 10.0_f64.powf(rng.random_range(-1.0..1.3)) * snow.strength_pa / snow.bulk_modulus_pa();
    let b = [0, 1, 2].map(|_| (rng.random_range(-1.0..1.0) * size).max(-0.5));
    (b, snow.plastic_strain_at_release() * rng.random_range(-0.1..3.0))
}

/// Rounds of [`BLOCK`] random states each that make a million.
const MILLION: usize = 1_000_000 / BLOCK;

#[test]
fn a_million_returns_lie_on_the_surface_and_stay() {
    for rule in [FlowRule::Associative, FlowRule::AssociativeImplicit] {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for round in 0..MILLION {
            let regime = REGIMES[round % 4];
            let snow = snow(regime);
            let material = Material::<f64>::new(&snow, rule, ShearNorm::VonMises, SCALE);
            let states: Vec<_> = (0..BLOCK).map(|_| random_state(&mut rng, &snow)).collect();
            let mut block = block_of(&material, &states);
            let before = block.strength;
            let (stress, work) = deformed(&material, &mut block, &Motion::default());
            assert!(work >= 0.0, "{rule:?}: plastic work {work:e}");
            // the surface is that of the step's start, or of its end
            let strength = if rule == FlowRule::Associative { before } else { block.strength };
            let [m, beta, ..] = regime;
            for (k, p0) in strength.iter().map(|p0| p0 / SCALE).enumerate() {
                let (p, q) = invariants(&stress, k, ShearNorm::VonMises);
                let y = (1.0 + 2.0 * beta) * q * q + m * m * (p + beta * p0) * (p - p0);
                assert!(y <= 1e-10 * p0 * p0, "{rule:?}: y = {y:e} at p0 = {p0}, p = {p}, q = {q}");
            }
            // at the same p0 the returned state is a fixed point
            let mut again = block;
            again.strength = strength;
            let (stress_again, _) = deformed(&material, &mut again, &Motion::default());
            for (k, strength) in strength.iter().enumerate() {
                for i in 0..3 {
                    let difference = (stress_again[i][k] - stress[i][k]).abs();
                    assert!(difference <= 1e-9 * strength.max(1e-9 * SCALE), "{rule:?}: moved by {difference:e}");
                }
            }
        }
    }
}

#[test]
fn a_million_returns_turn_with_the_axes() {
    const RULES: [FlowRule; 3] = [FlowRule::Associative, FlowRule::AssociativeImplicit, FlowRule::Nacc];
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for round in 0..MILLION {
        let snow = snow(REGIMES[round % 4]);
        let material = Material::<f64>::new(&snow, RULES[round % 3], ShearNorm::VonMises, SCALE);
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let (s, c) = f64::sin_cos(angle);
        let turn = |[xx, zz, xz]: [f64; 3]| {
            let (cc, ss, cs) = (c * c, s * s, c * s);
            [cc * xx - 2.0 * cs * xz + ss * zz, ss * xx + 2.0 * cs * xz + cc * zz, cs * (xx - zz) + (cc - ss) * xz]
        };
        let states: Vec<_> = (0..BLOCK).map(|_| random_state(&mut rng, &snow)).collect();
        let turned: Vec<_> = states.iter().map(|&(b, strain)| (turn(b), strain)).collect();
        let (mut plain, mut rotated) = (block_of(&material, &states), block_of(&material, &turned));
        let (stress, _) = deformed(&material, &mut plain, &Motion::default());
        let (stress_turned, _) = deformed(&material, &mut rotated, &Motion::default());
        for k in 0..BLOCK {
            let expected = turn([stress[0][k], stress[1][k], stress[2][k]]);
            for i in 0..3 {
                let error = (stress_turned[i][k] - expected[i]).abs();
                assert!(error <= 1e-9 * snow.strength_pa * SCALE, "{:?}: {error:e} at {k}", material.rule);
            }
        }
    }
}

/// Deforms a fresh block by `step` of gradients again and again; returns p, q in Pa and the volumetric plastic strain.
fn driven(snow: &Snow, steps: usize, gradients: [f64; 4]) -> (f64, f64, f64) {
    let material = Material::<f64>::new(snow, FlowRule::Associative, ShearNorm::VonMises, SCALE);
    let mut block = block_of(&material, &[([0.0; 3], snow.plastic_strain_at_release())]);
    let [lxx, lxz, lzx, lzz] = gradients.map(|l| [l; BLOCK]);
    let motion = Motion { lxx, lxz, lzx, lzz, ..Motion::default() };
    let mut stress = [[0.0; BLOCK]; 3];
    for _ in 0..steps {
        let work;
        (stress, work) = deformed(&material, &mut block, &motion);
        assert!(work >= 0.0);
    }
    let (p, q) = invariants(&stress, 0, ShearNorm::VonMises);
    (p, q, block.plastic_strain[0])
}

#[test]
fn isotropic_compression_hardens_as_its_closed_form() {
    for regime in REGIMES {
        let snow = snow(regime);
        let (bulk, xi) = (snow.bulk_modulus_pa(), snow.hardening);
        let (steps, strain) = (200_000, 0.02);
        let stretch = (-0.5 * strain / steps as f64).exp_m1();
        let (p, q, _) = driven(&snow, steps, [stretch, 0.0, 0.0, stretch]);
        assert!(p > snow.strength_pa, "{regime:?} did not yield");
        let expected = -p / bulk - ((p / bulk).asinh() - (snow.strength_pa / bulk).asinh()) / xi;
        assert!((expected + strain).abs() < 1e-6, "{regime:?}: {expected} for {}", -strain);
        assert!(q < 1.0);
    }
}

#[test]
fn shear_at_constant_volume_reaches_the_critical_state() {
    for regime in REGIMES {
        let [m, beta, xi, _] = regime;
        let snow = snow(regime);
        let bulk = snow.bulk_modulus_pa();
        let step = 2e-5_f64;
        let (p, q, strain) = driven(&snow, 100_000, [step.exp_m1(), 0.0, 0.0, (-step).exp_m1()]);
        let p0 = bulk * (-xi * (snow.plastic_strain_at_release() + p / bulk)).sinh();
        assert!((strain - snow.plastic_strain_at_release() - p / bulk).abs() < 1e-9, "the volume is constant");
        let expected = [0.5 * (1.0 - beta) * p0, 0.5 * m * (1.0 + beta) * p0 / (1.0 + 2.0 * beta).sqrt()];
        for (ours, theirs) in [p, q].iter().zip(expected) {
            assert!((ours - theirs).abs() < 1e-4 * p0, "{regime:?}: p, q = {p}, {q} for {expected:?}");
        }
    }
}

#[test]
fn parameters_outside_of_the_model_are_refused_by_name() {
    let good = snow(REGIMES[1]);
    assert_eq!(good.validate(), Ok(()));
    let bad = [
        ("friction", Snow { friction: 0.0, ..good }),
        ("cohesion", Snow { cohesion: -0.1, ..good }),
        ("hardening", Snow { hardening: f64::NAN, ..good }),
        ("poisson_ratio", Snow { poisson_ratio: 0.5, ..good }),
        ("strength_pa", Snow { strength_pa: 0.0, ..good }),
        ("youngs_modulus_pa", Snow { youngs_modulus_pa: f64::INFINITY, ..good }),
    ];
    for (name, snow) in bad {
        assert_eq!(snow.validate().map_err(|error| error.name), Err(name));
    }
}
