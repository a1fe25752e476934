//! What can be seen of the dynamics, in SI units: particles, energies, and the state where a run broke.

use super::{
    engine::Engine,
    error::{Dump, ParticleState},
    lanes::Real,
    particles::{BLOCK, Block, Flip},
    snapshot::{Energies, Snapshot},
    transfer::{Motion, weights},
};

/// Particles in a [`Dump`] besides the one that broke the run.
const NEIGHBOURS: usize = 64;

/// Every block with the motion of its particles, that which brought them where they are or else that of the grid there, and
/// their own velocities where FLIP is blended in.
fn in_motion<T: Real>(engine: &Engine<T>) -> impl Iterator<Item = (&Block<T>, Motion<T>, Option<&Flip<T>>)> {
    engine.chunks.iter().flat_map(move |chunk| {
        chunk.blocks.iter().enumerate().map(move |(index, block)| {
            let kept = chunk.motion.get(index).copied();
            (block, kept.unwrap_or_else(|| motion_of_grid(engine, block)), chunk.flip.get(index))
        })
    })
}

/// Velocities and gradients of the grid at the particles of a block.
fn motion_of_grid<T: Real>(engine: &Engine<T>, block: &Block<T>) -> Motion<T> {
    let mut motion = Motion::default();
    for k in 0..block.len {
        let (gx, gz) = (block.place.gx[k], block.place.gz[k]);
        let (wx, wz) = (weights(gx), weights(gz));
        for (i, &wx) in wx.iter().enumerate() {
            for (j, &wz) in wz.iter().enumerate() {
                let (di, dj) = (i as i32 - 1, j as i32 - 1);
                let column = (block.place.column[k] + di) as usize;
                let Some(offset) = engine.layout.offset.get(column) else { continue };
                let node = (offset + block.place.row[k] + dj) as usize;
                let Some(&[vx, vz, ..]) = engine.velocity.get(node) else { continue };
                let (w, dx, dz) = (wx * wz, T::of(f64::from(di)) - gx, T::of(f64::from(dj)) - gz);
                motion.vx[k] += w * vx;
                motion.vz[k] += w * vz;
                motion.lxx[k] += T::of(4.0) * w * dx * vx;
                motion.lxz[k] += T::of(4.0) * w * dz * vx;
                motion.lzx[k] += T::of(4.0) * w * dx * vz;
                motion.lzz[k] += T::of(4.0) * w * dz * vz;
            }
        }
    }
    motion
}

/// Elastic volumetric strain, `ln det(b) / 2`, and half the difference of the principal strains.
fn elastic_strains<T: Real>(block: &Block<T>, k: usize) -> (f64, f64) {
    let (xx, zz, xz) = (block.bxx[k].f64(), block.bzz[k].f64(), block.bxz[k].f64());
    let (mean, radius) = (0.5 * (xx + zz), (0.5 * (xx - zz)).hypot(xz));
    let (first, second) = ((mean + radius).ln_1p(), (mean - radius).ln_1p());
    (0.5 * (first + second), 0.25 * (first - second))
}

/// Position of a particle, m.
fn position<T: Real>(engine: &Engine<T>, block: &Block<T>, k: usize) -> [f64; 2] {
    let place = &block.place;
    let x = f64::from(place.column[k]) + place.gx[k].f64();
    let z = f64::from(place.row[k]) + place.gz[k].f64();
    [engine.frame.origin_m + x * engine.frame.mesh_m, z * engine.frame.mesh_m]
}

/// All particles, in the order of release.
pub(super) fn snapshot<T: Real>(engine: &Engine<T>) -> Snapshot {
    let frame = &engine.frame;
    let none = vec![0.0_f32; engine.particles()];
    let mut out = Snapshot {
        time_s: engine.steps as f64 * frame.time_step_s,
        x_m: none.clone(),
        z_m: none.clone(),
        vx_m_s: none.clone(),
        vz_m_s: none.clone(),
        density_kg_m3: none.clone(),
        plastic_strain: none,
    };
    let speed = frame.mesh_m / frame.time_step_s;
    for (block, motion, flip) in in_motion(engine) {
        let (vx, vz) = flip.map_or((&motion.vx, &motion.vz), |flip| (&flip.vx, &flip.vz));
        for k in 0..block.len {
            let id = block.id[k] as usize;
            let [x, z] = position(engine, block, k);
            (out.x_m[id], out.z_m[id]) = (x as f32, z as f32);
            out.vx_m_s[id] = (vx[k].f64() * speed) as f32;
            out.vz_m_s[id] = (vz[k].f64() * speed) as f32;
            let plastic = block.plastic_strain[k].f64();
            let dilation = elastic_strains(block, k).0 + plastic - frame.plastic_strain_at_release;
            out.density_kg_m3[id] = (frame.density_kg_m3 * (-dilation).exp()) as f32;
            out.plastic_strain[id] = plastic as f32;
        }
    }
    out
}

/// Energies, J a metre of width; kinetic energy is that which the grid carries, also where FLIP is blended in.
pub(super) fn energies<T: Real>(engine: &Engine<T>) -> Energies {
    let frame = &engine.frame;
    let mass = frame.density_kg_m3 * frame.particle_area_m2;
    let unit = mass * (frame.mesh_m / frame.time_step_s).powi(2);
    let [bed, transfer] = engine.ledger.lost(engine.steps).map(|lost| unit * lost);
    let mut out = Energies { bed, plastic: unit * engine.ledger.plastic, transfer, ..Energies::default() };
    for (block, motion, _) in in_motion(engine) {
        for k in 0..block.len {
            let square = |values: &[T]| values.iter().map(|value| value.f64() * value.f64()).sum::<f64>();
            out.kinetic += unit * 0.5 * square(&[motion.vx[k], motion.vz[k]]);
            // moments of a quadratic spline are dx^2 / 4
            out.affine += unit * 0.125 * square(&[motion.lxx[k], motion.lxz[k], motion.lzx[k], motion.lzz[k]]);
            out.potential += mass * frame.gravity_m_s2 * (position(engine, block, k)[1] - frame.lowest_m);
            let (volumetric, deviatoric) = elastic_strains(block, k);
            let density = 0.5 * frame.material.bulk.f64() * volumetric * volumetric
                + frame.material.shear_2.f64() * deviatoric * deviatoric;
            out.elastic += unit * 0.25 * density;
        }
    }
    out
}

/// The state around what broke the run: the first particle that is not finite, else the fastest.
pub(super) fn dump<T: Real>(engine: &Engine<T>) -> Dump {
    let all: Vec<(ParticleState, [i32; 2])> = engine
        .blocks()
        .flat_map(|block| {
            let motion = motion_of_grid(engine, block);
            (0..block.len).map(move |k| (state(engine, block, &motion, k), [block.place.column[k], block.place.row[k]]))
        })
        .collect();
    let speed = |state: &ParticleState| state.velocity_m_s[0].hypot(state.velocity_m_s[1]);
    // what a particle is itself comes before its velocity: that of a broken one spreads to its neighbours
    let is_whole = |state: &ParticleState| {
        let numbers = [state.x_m, state.z_m, state.plastic_strain, state.strength_pa];
        numbers.iter().chain(&state.elastic).all(|number| number.is_finite())
    };
    let broken = all.iter().find(|(state, _)| !is_whole(state));
    let broken = broken.or_else(|| all.iter().find(|(state, _)| !speed(state).is_finite()));
    let fastest = || all.iter().max_by(|a, b| speed(&a.0).total_cmp(&speed(&b.0)));
    let nothing = ParticleState {
        id: 0,
        x_m: f64::NAN,
        z_m: f64::NAN,
        velocity_m_s: [f64::NAN; 2],
        elastic: [f64::NAN; 3],
        plastic_strain: f64::NAN,
        strength_pa: f64::NAN,
    };
    let (offender, cell) = broken.or_else(fastest).copied().unwrap_or((nothing, [0; 2]));
    let near = |other: &[i32; 2]| (0..2).all(|axis| other[axis].abs_diff(cell[axis]) <= 1);
    let others = all.iter().filter(|(state, at)| near(at) && state.id != offender.id);
    Dump { offender, neighbours: others.map(|(state, _)| *state).take(NEIGHBOURS).collect() }
}

fn state<T: Real>(engine: &Engine<T>, block: &Block<T>, motion: &Motion<T>, k: usize) -> ParticleState {
    let frame = &engine.frame;
    let [x_m, z_m] = position(engine, block, k);
    let speed = frame.mesh_m / frame.time_step_s;
    let stress = frame.density_kg_m3 * speed * speed / 4.0;
    ParticleState {
        id: block.id[k] as usize,
        x_m,
        z_m,
        velocity_m_s: [motion.vx[k], motion.vz[k]].map(|v| v.f64() * speed),
        elastic: [block.bxx[k], block.bzz[k], block.bxz[k]].map(Real::f64),
        plastic_strain: block.plastic_strain[k].f64(),
        strength_pa: block.strength[k].f64() * stress,
    }
}

const _: () = assert!(NEIGHBOURS <= BLOCK, "a dump stays small");
