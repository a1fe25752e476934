//! Flows on a bed: energies, another code, and what a caller can rely on.

use std::sync::atomic::{AtomicU32, Ordering};

use super::{
    Advance, LIMITED_ABOVE, Precision, RunoutError, Setup, Simulation,
    engine::Engine,
    material::Snow,
    observe,
    release::Slab,
    scenario::ScenarioName,
    terrain::Terrain,
    test_scenes::{bits, engine, front, group_2, mean, setup, speeds},
};
use crate::progress::{Progress, Unobserved};

/// What a run shows until it ends.
struct Audit {
    /// Largest rise of the energy sum, and its change at the end, over the released energy.
    rise: f64,
    closure: f64,
    /// The largest speed of any grain, m/s.
    fastest: f64,
    /// Centre of mass and front at the start and after 5 s, m.
    start: [f64; 2],
    at_5: [f64; 2],
}

fn places(simulation: &Simulation) -> [f64; 2] {
    let snapshot = simulation.snapshot();
    [mean(&snapshot.x_m), front(&snapshot)]
}

fn audited(setup: &Setup, time_s: f64) -> Audit {
    let mut simulation = Simulation::new(setup).unwrap();
    let first = simulation.energies();
    let start = places(&simulation);
    let mut seen = Audit { rise: 0.0, closure: 0.0, fastest: 0.0, start, at_5: start };
    let (mut lowest, mut last) = (first.total(), first);
    // as often as the observables do: grains are fast for a moment only
    for look in 1..=(24.0 * time_s).round() as u32 {
        assert_eq!(simulation.step_until(f64::from(look) / 24.0, &Unobserved).unwrap(), Advance::Reached);
        last = simulation.energies();
        assert!(last.bed >= 0.0 && last.plastic >= 0.0 && last.transfer >= 0.0);
        lowest = lowest.min(last.total());
        seen.rise = seen.rise.max(last.total() - lowest);
        seen.fastest = speeds(&simulation.snapshot()).fold(seen.fastest, f64::max);
        if look == 5 * 24 {
            seen.at_5 = places(&simulation);
        }
    }
    let released = first.potential - last.potential;
    Audit { rise: seen.rise / released, closure: (last.total() - first.total()) / released, ..seen }
}

/// In all four regimes the energies close, no lone grain outruns free fall, and the limiter that sees to it leaves the flow
/// as plain APIC has it: after 5 s centre and front are where they are without it, to 1 % of the way since release.
#[test]
fn no_grain_outruns_free_fall_and_the_flow_is_that_of_plain_apic() {
    // from the block's top to the flat
    let angle = 40_f64.to_radians();
    let top = 65.0 * angle.tan() - 9.0 / angle.cos() + 10.0 + angle.cos() + 6.0 * angle.sin();
    let free = (2.0 * 9.81 * top).sqrt();
    assert!((free - 33.5).abs() < 0.1, "{free}");
    for flow in [ScenarioName::ColdDense, ScenarioName::WarmShear, ScenarioName::SlidingSlab, ScenarioName::WarmPlug] {
        let setup = group_2(flow, 0.1);
        let seen = audited(&setup, 12.0);
        assert!(seen.closure.abs() < 0.02, "{flow:?}: {} of the released energy is unexplained", seen.closure);
        assert!(seen.rise < 1e-3, "{flow:?}: the energy sum rises by {} of the released energy", seen.rise);
        assert!(seen.fastest < 1.15 * free, "{flow:?}: {} m/s", seen.fastest);
        let mut plain = Simulation::new(&Setup { limited_above: f64::INFINITY, ..setup }).unwrap();
        plain.step_until(5.0, &Unobserved).unwrap();
        for ((plain, limited), start) in places(&plain).iter().zip(seen.at_5).zip(seen.start) {
            let change = (limited - plain) / (plain - start);
            assert!(change.abs() < 0.01, "{flow:?}: {limited} for {plain} m, {change} of the way");
        }
    }
}

/// Speeds of a slab that has hardly any strength of its own, on a slope whose friction is `mu`: for each half second until it
/// reaches the flat, the 99 % quantile beyond `g t sin(theta)`, and the largest over that of a free fall from the top, m/s.
fn loose(mu: f64, limited_above: f64) -> (Vec<f64>, f64) {
    let snow = Snow { friction: 0.1, cohesion: 0.0, ..group_2(ScenarioName::ColdDense, 0.1).snow };
    let setup = Setup { snow, bed_friction: mu, limited_above, ..group_2(ScenarioName::ColdDense, 0.1) };
    let mut simulation = Simulation::new(&setup).unwrap();
    let top = simulation.snapshot().z_m.into_iter().fold(0.0_f32, f32::max);
    let slide = 9.81 * 40_f64.to_radians().sin();
    let (mut beyond, mut fastest) = (Vec::new(), 0.0_f64);
    for look in 1..=7 {
        let time_s = 0.5 * f64::from(look);
        simulation.step_until(time_s, &Unobserved).unwrap();
        let snapshot = simulation.snapshot();
        let mut sorted: Vec<f64> = speeds(&snapshot).collect();
        let over = |(speed, z): (&f64, &f32)| speed / (2.0 * 9.81 * f64::from(top - z).max(1.0)).sqrt();
        fastest = sorted.iter().zip(&snapshot.z_m).map(over).fold(fastest, f64::max);
        sorted.sort_by(f64::total_cmp);
        beyond.push(sorted[(0.99 * sorted.len() as f64) as usize] - slide * time_s);
    }
    (beyond, fastest)
}

/// A slab without strength on a frictionless slope is a dam that breaks: in the frame that slides with it nothing comes to more
/// than `2 sqrt(g h cos(theta))` (Ritter 1892; Mangeney, Heinrich & Roche 2000, Pure Appl. Geophys. 157, 1081), which stays
/// below a free fall from the top. Plain APIC has that, and the limiter leaves it alone. With friction at the bed plain APIC
/// makes the upper snow faster than without, more so from second to second, which no friction does: that is what the limiter is
/// for.
#[test]
fn friction_at_the_bed_makes_no_snow_faster() {
    let wave = 2.0 * (9.81 * 2.0 * 40_f64.to_radians().cos()).sqrt();
    let (plain, _) = loose(0.0, f64::INFINITY);
    let (limited, fastest) = loose(0.0, LIMITED_ABOVE);
    assert!(plain.iter().all(|beyond| *beyond < wave), "{plain:?} for {wave}");
    for (limited, plain) in limited.iter().zip(&plain) {
        assert!((limited - plain).abs() < 0.02 * wave, "{limited} for {plain}");
    }
    assert!(fastest < 1.05, "{fastest}");
    let most = plain.iter().copied().fold(0.0, f64::max);
    let (rough, fastest) = loose(0.5, LIMITED_ABOVE);
    assert!(rough.iter().all(|beyond| *beyond < most), "{rough:?} for {most}");
    assert!(fastest < 1.15, "{fastest}");
    // else this shows nothing
    let (rough, _) = loose(0.5, f64::INFINITY);
    assert!(rough.iter().any(|beyond| *beyond > most), "{rough:?}");
}

/// Group II with gravity of 10 m/s2, stepped at 24 frames a second; `(v99 max, speed of all max, front, centre)`.
fn other_code(flow: ScenarioName, time_s: f64, limited_above: f64) -> [f64; 4] {
    let setup = Setup { limited_above, ..group_2(flow, 0.1) };
    let mut engine: Engine<f32> = engine(&setup, 10.0);
    let (mut v99, mut speed) = (0.0_f64, 0.0_f64);
    let frames = (time_s / setup.time_step_s / 90.0) as usize;
    for _ in 0..frames {
        for step in 1..=90 {
            engine.step(step == 90).unwrap();
        }
        let mut sorted: Vec<f64> = speeds(&observe::snapshot(&engine)).collect();
        sorted.sort_by(f64::total_cmp);
        v99 = v99.max(sorted[(0.99 * sorted.len() as f64) as usize]);
        speed = speed.max(sorted.iter().sum::<f64>() / sorted.len() as f64);
    }
    let s = observe::snapshot(&engine);
    [v99, speed, front(&s), mean(&s.x_m)]
}

#[test]
fn another_code_computes_the_same_flows() {
    // an independent open MPM code in f64. Its speeds are 1 % above those that 9.81 m/s2 gives while its run-out is the same:
    // run-out does not depend on gravity and speed goes with its root, so it is compared at 10 m/s2
    let close = |ours: f64, theirs: f64, share: f64, what: &str| {
        assert!((ours - theirs).abs() <= share * theirs.abs(), "{what}: {ours} for {theirs}");
    };
    let [v99, speed, front, centre] = other_code(ScenarioName::WarmPlug, 14.0, LIMITED_ABOVE);
    close(v99, 21.82, 0.005, "largest v99");
    close(speed, 19.45, 0.005, "largest speed of all");
    close(front, 21.94, 0.005, "front");
    // 15.99 m: 0.51 %
    close(centre, 15.91, 0.006, "centre");
    for limited_above in [f64::INFINITY, LIMITED_ABOVE] {
        let [_, speed, front, centre] = other_code(ScenarioName::ColdDense, 10.0, limited_above);
        close(speed, 16.14, 0.02, "largest speed of all");
        close(centre, 27.2, 0.02, "centre after 10 s");
        close(front, 95.3, 0.15, "front after 10 s");
    }
}

/// With FLIP blended in, the energies of a flow close as they do without, and it flows about as far.
#[test]
fn a_blend_with_flip_flows_and_keeps_its_energies() {
    let plain = audited(&group_2(ScenarioName::ColdDense, 0.2), 6.0);
    let blended = audited(&Setup { flip: 0.95, ..group_2(ScenarioName::ColdDense, 0.2) }, 6.0);
    assert!(blended.closure.abs() < 0.02, "{} of the released energy is unexplained", blended.closure);
    let way = plain.at_5[0] - plain.start[0];
    let change = (blended.at_5[0] - plain.at_5[0]) / way;
    println!("closure {}, rise {}, centre {change}", blended.closure, blended.rise);
    assert!(change != 0.0 && change.abs() < 0.1, "{change} of the way");
}

/// Cancels after so many looks.
struct Impatient(AtomicU32);

impl Progress for Impatient {
    fn report(&self, _fraction: f64, _phase: &str) {}

    fn cancelled(&self) -> bool {
        self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_err()
    }
}

#[test]
fn bits_depend_on_nothing_but_the_setup() {
    for (precision, flip) in [(Precision::F32, 0.0), (Precision::F64, 0.0), (Precision::F32, 0.95)] {
        // fine enough for several chunks
        let setup = Setup { precision, flip, ..group_2(ScenarioName::ColdDense, 0.05) };
        let whole = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut simulation = Simulation::new(&setup).unwrap();
                simulation.step_until(0.4, &Unobserved).unwrap();
                bits(&simulation)
            })
        };
        let one = whole(1);
        assert_eq!(one, whole(3), "threads");
        // in parts, cancelled, saved and resumed
        let mut simulation = Simulation::new(&setup).unwrap();
        simulation.step_until(0.05, &Unobserved).unwrap();
        let cancelled = simulation.step_until(0.4, &Impatient(AtomicU32::new(5))).unwrap();
        assert_eq!(cancelled, Advance::Cancelled);
        assert!(simulation.time_s() < 0.4);
        let saved = simulation.checkpoint(&setup);
        let mut resumed = Simulation::resume(&setup, &saved).unwrap();
        assert_eq!(bits(&resumed), bits(&simulation), "saved");
        resumed.step_until(0.4, &Unobserved).unwrap();
        assert_eq!(bits(&resumed), one, "resumed");
    }
}

#[test]
fn damaged_and_foreign_states_are_refused() {
    let setup = group_2(ScenarioName::WarmPlug, 0.2);
    let mut simulation = Simulation::new(&setup).unwrap();
    simulation.step_until(0.1, &Unobserved).unwrap();
    let saved = simulation.checkpoint(&setup);
    let refused =
        |setup: &Setup, state: &[u8]| matches!(Simulation::resume(setup, state), Err(RunoutError::Checkpoint(_)));
    assert!(refused(&setup, &[]));
    assert!(refused(&setup, &saved[..saved.len() / 2]));
    assert!(refused(&Setup { bed_friction: 0.4, ..setup.clone() }, &saved));
    assert!(refused(&Setup { precision: Precision::F64, ..setup.clone() }, &saved));
    // whatever byte is wrong: refused, or a run that ends in its own way
    for at in (0..saved.len()).step_by(saved.len() / 300) {
        let mut damaged = saved.clone();
        damaged[at] ^= 0x55;
        if let Ok(mut simulation) = Simulation::resume(&setup, &damaged) {
            let _ = simulation.step_until(simulation.time_s() + 0.01, &Unobserved);
        }
    }
}

#[test]
fn what_cannot_be_run_is_refused_with_its_limit() {
    let good = group_2(ScenarioName::WarmPlug, 0.1);
    let fast = Setup { time_step_s: 1e-3, ..good.clone() };
    let limit = 0.1 / 127.1;
    match Simulation::new(&fast).map(|_| ()) {
        Err(RunoutError::TimeStep { limit_s, .. }) => assert!((limit_s / limit - 1.0).abs() < 1e-3),
        other => panic!("{other:?}"),
    }
    let fine = Setup { mesh_m: 0.002, time_step_s: 1e-6, ..good.clone() };
    match Simulation::new(&fine).map(|_| ()) {
        Err(RunoutError::TooLarge { particles, bytes, .. }) => {
            assert_eq!(particles, 24_000_000);
            assert!(bytes > 24_000_000 * 100);
        }
        other => panic!("{other:?}"),
    }
    let off = Setup { release: Slab { x_m: 468.0, ..good.release }, ..good.clone() };
    assert!(matches!(Simulation::new(&off), Err(RunoutError::Release(_))));
    for flip in [-0.1, 1.1, f64::NAN] {
        assert!(matches!(
            Simulation::new(&Setup { flip, ..good.clone() }),
            Err(RunoutError::Parameter(error)) if error.name == "flip"
        ));
    }
    for friction in [-0.1, f64::NAN] {
        assert!(matches!(
            Simulation::new(&Setup { bed_friction: friction, ..good.clone() }),
            Err(RunoutError::Parameter(error)) if error.name == "bed_friction"
        ));
    }
}

#[test]
fn a_flow_that_leaves_the_terrain_ends_there() {
    let terrain = Terrain::from_profile(&[[-20.0, 20.0], [0.0, 0.0]], 1.0).unwrap();
    let release = Slab { x_m: -8.0, length_m: 2.0, thickness_m: 0.5 };
    let mut simulation =
        Simulation::new(&setup(terrain, release, group_2(ScenarioName::ColdDense, 0.1).snow, 0.1)).unwrap();
    assert_eq!(simulation.step_until(20.0, &Unobserved).unwrap(), Advance::LeftDomain);
    let s = simulation.snapshot();
    assert!(s.time_s < 10.0 && front(&s) > -2.0 && speeds(&s).all(f64::is_finite));
}

#[test]
fn what_is_not_finite_ends_the_run_with_its_state() {
    let setup = group_2(ScenarioName::WarmPlug, 0.2);
    let mut engine: Engine<f32> = engine(&setup, 9.81);
    engine.step(true).unwrap();
    engine.chunks[0].blocks[1].bxx[3] = f32::NAN;
    let id = engine.chunks[0].blocks[1].id[3] as usize;
    assert!(engine.step(true).is_err());
    let dump = observe::dump(&engine);
    assert_eq!(dump.offender.id, id);
    assert!(!dump.neighbours.is_empty());
}

#[test]
fn particles_take_less_than_200_bytes() {
    let setup = group_2(ScenarioName::ColdDense, 0.05);
    assert_eq!(setup.particles(), 38_400);
    assert!(setup.bytes() < 38_400 * 200, "{}", setup.bytes());
    let blended = Setup { flip: 0.95, ..setup };
    assert!(blended.bytes() < 38_400 * 250, "{}", blended.bytes());
}
