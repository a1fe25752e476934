//! Observations of snow that is laid by hand, whose numbers are known.

use super::*;
use crate::runout::GRAVITY_M_S2;
use crate::runout::regime::{Indicators, RegimeClass};

/// A flat bed from -100 to 400 m behind a slope that nothing lies on; arc length 0 lies at its top.
fn flat() -> Terrain {
    Terrain::from_profile(&[[-100.0, 0.0], [400.0, 0.0]], 10.0).unwrap()
}

fn scene(terrain: Terrain) -> Scene {
    let slab = Slab { x_m: 0.0, length_m: 10.0, thickness_m: 1.0 };
    let indicators = Indicators { friction_ratio: None, cohesion: 1.0, ductility: 0.1 };
    Scene { indicators, terrain, slab, mass_kg_m: 2500.0, mesh_m: 0.1, drop_height_m: 50.0, mid_slope_m: 10.9 }
}

/// 100 by 20 particles that fill 10 m by 1 m from (`x`, 0) on and move along x with `velocity(height)`.
fn block(time_s: f64, x: f64, velocity: impl Fn(f64) -> f64) -> Snapshot {
    let mut block = Snapshot { time_s, ..Snapshot::default() };
    for row in 0..20 {
        for column in 0..100 {
            let height = 0.05 * (f64::from(row) + 0.5);
            block.x_m.push((x + 0.1 * (f64::from(column) + 0.5)) as f32);
            block.z_m.push(height as f32);
            block.vx_m_s.push(velocity(height) as f32);
            block.vz_m_s.push(0.0);
            block.density_kg_m3.push(250.0);
            block.plastic_strain.push(-0.01);
        }
    }
    block
}

fn observed(frames: impl IntoIterator<Item = (Snapshot, Energies)>) -> Observer {
    let mut observer = Observer::new(scene(flat()), Observations::default());
    for (snapshot, energies) in frames {
        observer.observe(&snapshot, &energies);
    }
    observer
}

fn close(left: f64, right: f64, tolerance: f64) {
    assert!((left - right).abs() <= tolerance, "{left} is not {right}");
}

#[test]
fn a_block_is_where_it_is_and_as_it_is() {
    let observer = observed([(block(0.0, 0.0, |_| 3.0), Energies::default())]);
    let series = &observer.seen().series;
    // 99 of 100 columns are not beyond the 99th, at 9.85 m, and the 1 % quantile is the first
    close(series.front_m[0], 9.85, 1e-6);
    close(series.tail_m[0], 0.05, 1e-6);
    close(series.front_along_bed_m[0], 109.85, 1e-6);
    close(series.com_x_m[0], 5.0, 1e-6);
    close(series.com_z_m[0], 0.5, 1e-6);
    close(series.com_speed_m_s()[0], 3.0, 1e-12);
    close(series.v99_m_s[0], 3.0, 1e-12);
    close(series.density_kg_m3[0], 250.0, 1e-12);
    let shape = series.shape[0];
    assert_eq!((shape.slip, shape.gap, shape.cv, shape.broken), (1.0, 0.0, 0.0, 0.0));
    close(shape.stretch, 0.98, 1e-6);
    let profile = &observer.seen().latest;
    assert_eq!(profile.x_m.len(), 20);
    for bin in 0..20 {
        close(profile.x_m[bin], 0.5 * bin as f64 + 0.25, 1e-9);
        close(profile.depth_m[bin], 1.0, 1e-6);
        close(profile.mass_kg_m2[bin], 250.0, 1e-9);
        close(profile.density_kg_m3[bin].unwrap(), 250.0, 1e-3);
    }
}

#[test]
fn layers_of_a_shear_flow_have_their_velocities() {
    let observer = observed([(block(0.0, 0.0, |height| 10.0 * height), Energies::default())]);
    // means over the lowest and the highest fifth of the height, where it grows from 0 to 10 m/s
    close(observer.seen().series.shape[0].slip, 1.0 / 9.0, 1e-6);
    let profile = &observer.seen().latest;
    close(profile.bed_velocity_m_s[3].unwrap(), 1.0, 1e-5);
    close(profile.surface_velocity_m_s[3].unwrap(), 9.0, 1e-5);
    close(profile.velocity_m_s[3].unwrap(), 5.0, 1e-5);
    let vertical = &observer.seen().velocity_profiles[0];
    close(vertical.x_m, 5.0, 1e-5);
    for (layer, velocity) in vertical.velocity_m_s.iter().enumerate() {
        let middle = (layer as f64 + 0.5) * vertical.layer_m;
        if let Some(velocity) = velocity {
            close(*velocity, 10.0 * middle, 0.26);
        }
    }
    assert!(vertical.velocity_m_s.iter().flatten().count() >= 19);
}

#[test]
fn gaps_unevenness_and_broken_snow_are_counted() {
    let mut flow = block(0.0, 0.0, |_| 1.0);
    // two blocks of 5 m with 5 m between them: 30 bins, 10 of them empty
    for (place, x) in flow.x_m.iter_mut().enumerate() {
        *x += if place % 100 >= 50 { 5.0 } else { 0.0 };
    }
    flow.plastic_strain[..500].fill(0.3);
    let observer = observed([(flow, Energies::default())]);
    let shape = observer.seen().series.shape[0];
    close(shape.gap, 1.0 / 3.0, 1e-12);
    // two thirds of the bins hold 3/2 of the mean, the others nothing
    close(shape.cv, 0.5_f64.sqrt(), 1e-12);
    close(shape.broken, 0.25, 1e-12);
    close(shape.stretch, 1.48, 1e-6);
    let deposit = observer.summary(Ending::AtRest, 1, 2000).unwrap().deposit;
    close(deposit.length_m, 14.8, 1e-5);
    close(deposit.max_depth_m, 1.0, 1e-6);
    close(deposit.mean_density, 250.0, 1e-3);
    assert_eq!(observer.seen().latest.velocity_m_s[15], None);
    assert_eq!(observer.seen().latest.depth_m[15], 0.0);
}

#[test]
fn granules_are_counted_and_measured() {
    let whole = observed([(block(0.0, 0.0, |_| 1.0), Energies::default())]);
    let pieces = whole.seen().pieces[0];
    assert_eq!((pieces.granules, pieces.granule_share, pieces.surges, pieces.surge_spacing_m), (1, 1.0, 1, None));
    // 10 m by 1 m of snow in one piece
    close(pieces.granule_size_m.unwrap(), 10_f64.sqrt(), 1e-9);

    // 2 m, 3 m and 5 m long, 1 m apart; of the last one the upper half is dust
    let mut flow = block(0.0, 0.0, |_| 1.0);
    for (place, (x, strain)) in flow.x_m.iter_mut().zip(&mut flow.plastic_strain).enumerate() {
        let (row, column) = (place / 100, place % 100);
        *x += f32::from(u8::from(column >= 20) + u8::from(column >= 50));
        if column >= 50 && row >= 10 {
            *strain = 0.1;
        }
    }
    let broken = observed([(flow, Energies::default())]);
    let pieces = broken.seen().pieces[0];
    assert_eq!((pieces.granules, pieces.surges), (3, 3));
    close(pieces.granule_share, 0.75, 1e-12);
    // 2, 2.5 and 3 m2
    close(pieces.granule_size_m.unwrap(), 2.5_f64.sqrt(), 1e-9);
    close(pieces.largest_granule_m.unwrap(), 3_f64.sqrt(), 1e-9);
    // the first bins of the three, at 0, 3 and 7 m
    close(pieces.surge_spacing_m.unwrap(), 3.5, 1e-9);
}

/// A block that flies along at 12 m/s for a second, then stands at once.
fn flight() -> Vec<(Snapshot, Energies)> {
    let frames = (0..72_u32).map(|frame| {
        let time = f64::from(frame) / FRAMES_PER_S;
        let speed = if time <= 1.0 { 12.0 } else { 0.0 };
        let kinetic = 0.5 * 2500.0 * speed * speed;
        let potential = 2500.0 * GRAVITY_M_S2 * (30.0 - 10.0 * time.min(1.0));
        let bed = 2500.0 * GRAVITY_M_S2 * 30.0 - potential - kinetic;
        let energies = Energies { kinetic, potential, bed, ..Energies::default() };
        (block(time, 12.0 * time.min(1.0), |_| speed), energies)
    });
    frames.collect()
}

#[test]
fn a_run_is_summarised() {
    let observer = observed(flight());
    let summary = observer.summary(Ending::AtRest, 1000, 2000).unwrap();
    close(summary.v_max, 12.0, 1e-12);
    close(summary.v_max_scaled, 12.0 / (GRAVITY_M_S2 * 50.0).sqrt(), 1e-12);
    close(summary.front_v_max, 12.0, 1e-4);
    let velocities = &observer.seen().series.front_velocity_m_s;
    assert_eq!(velocities.len(), 72);
    // as long as all seven frames of the fit are of the flight or of the stand
    assert!(velocities[..22].iter().all(|velocity| (velocity - 12.0).abs() < 1e-4));
    assert!(velocities[27..].iter().all(|velocity| velocity.abs() < 1e-4));
    close(summary.com_v_max, 12.0, 1e-12);
    close(summary.front_m, 21.85, 1e-5);
    close(summary.com_end_m, 17.0, 1e-5);
    close(summary.duration_s, 71.0 / 24.0, 1e-12);
    close(summary.energy_closure, 0.0, 1e-12);
    // the slab of the scene lies from -5 to 5 m, half a metre high in the middle
    close(summary.reach_angle_deg.crown, 0.0, 1e-9);
    close(summary.reach_angle_deg.front, (0.5_f64 / 21.85).atan().to_degrees(), 1e-5);
    close(summary.reach_angle_deg.com, 0.0, 1e-5);
    assert_eq!(summary.regime.class, RegimeClass::WarmPlug);
    // after half a second the centre is at 11 m
    assert_eq!(summary.regime.criteria.mid_time_s, 0.5);
    assert_eq!((summary.steps, summary.particles, summary.particle_steps_per_s), (1000, 2000, None));
    assert_eq!(observed([]).summary(Ending::AtRest, 0, 0), None);
}

#[test]
fn energy_that_no_term_accounts_for_is_the_closure() {
    let frames = flight().into_iter().map(|(snapshot, mut energies)| {
        // an eighth of a second with 2 % of the released energy too little, afterwards made good
        let is_short = (1.5..1.625).contains(&snapshot.time_s);
        energies.bed -= if is_short { 0.02 * 2500.0 * GRAVITY_M_S2 * 10.0 } else { 0.0 };
        (snapshot, energies)
    });
    close(observed(frames).summary(Ending::AtRest, 1, 1).unwrap().energy_closure, 0.02, 1e-9);
}

#[test]
fn rest_takes_a_second_of_standing() {
    let mut observer = observed([]);
    let mut rested = None;
    for (snapshot, energies) in flight() {
        observer.observe(&snapshot, &energies);
        if observer.is_at_rest() && rested.is_none() {
            rested = Some(snapshot.time_s);
        }
    }
    // the first frame at rest is the one after 1 s
    close(rested.unwrap(), 1.0 + 1.0 / 24.0 + 1.0, 1e-9);
}

#[test]
fn a_slow_or_a_hot_flow_is_not_at_rest() {
    let released = 2500.0 * GRAVITY_M_S2 * 10.0;
    let run = |speed: f64, kinetic: f64| {
        let frames = (0..72_u32).map(|frame| {
            let time = f64::from(frame) / FRAMES_PER_S;
            let fallen = if frame == 0 { 0.0 } else { released };
            let energies = Energies { kinetic, potential: 2.0 * released - fallen, ..Energies::default() };
            (block(time, 0.0, |_| speed), energies)
        });
        observed(frames).is_at_rest()
    };
    assert!(run(0.049, 0.99e-4 * released));
    assert!(!run(0.051, 0.99e-4 * released), "the centre of mass moves");
    assert!(!run(0.0, 1.01e-4 * released), "grains move about");
}

#[test]
fn an_observer_that_is_taken_up_again_sees_the_same() {
    let whole = observed(flight());
    let mut first = observed(flight().into_iter().take(30));
    let bytes = postcard::to_stdvec(first.seen()).unwrap();
    first = Observer::new(scene(flat()), postcard::from_bytes(&bytes).unwrap());
    for (snapshot, energies) in flight().into_iter().skip(30) {
        first.observe(&snapshot, &energies);
    }
    assert_eq!(first.seen(), whole.seen());
}

#[test]
fn velocities_follow_the_bed_and_not_the_axes() {
    let terrain = Terrain::slope_arc_flat(40.0, 10.0, -200.0, 100.0).unwrap();
    let slab = Slab::centred(&terrain, [-65.0, 52.793], 12.0, 2.0);
    let placed = slab.place(&terrain, 0.1).unwrap();
    let (sine, cosine) = 40_f64.to_radians().sin_cos();
    let count = placed.x_m.len();
    let snapshot = Snapshot {
        time_s: 0.0,
        x_m: placed.x_m.iter().map(|&x| x as f32).collect(),
        z_m: placed.z_m.iter().map(|&z| z as f32).collect(),
        vx_m_s: vec![(10.0 * cosine) as f32; count],
        vz_m_s: vec![(-10.0 * sine) as f32; count],
        density_kg_m3: vec![250.0; count],
        plastic_strain: vec![-0.01; count],
    };
    let mut observer = Observer::new(Scene { terrain, slab, ..scene(flat()) }, Observations::default());
    observer.observe(&snapshot, &Energies::default());
    let inner = observer.seen().latest.velocity_m_s.iter().flatten();
    for velocity in inner {
        close(*velocity, 10.0, 1e-5);
    }
    let depth = observer.seen().latest.depth_m[12];
    close(depth, 2.0, 1e-4);
}
