//! The state of a run as bytes.
//!
//! Particles are saved in their sorted order with the layout of the grid, so that all sums go on in the same order.

use serde::{Deserialize, Serialize};

use super::{
    engine::{ChunkParticles, Engine, Ledger, blocks_of},
    error::RunoutError,
    grid::Layout,
    lanes::Real,
    particles::{BLOCK, Flip, Particle},
    simulation::Setup,
    transfer::Motion,
};

/// Raised with every change to what is saved or to what it means.
const VERSION: u32 = 3;

#[derive(Serialize, Deserialize)]
struct Saved<T> {
    version: u32,
    /// Digest of the setup.
    setup: u64,
    particle_area_m2: f64,
    steps: u64,
    drift: f64,
    fastest: f64,
    ledger: Ledger,
    layout: Layout,
    /// Velocities of the nodes.
    velocity: Vec<[T; 2]>,
    particles: Vec<Particle<T>>,
    /// Velocities and gradients of all particles, or of none.
    motion: Vec<[T; 6]>,
    /// Velocities and remainders of all particles where FLIP is blended in.
    flip: Vec<[T; 4]>,
}

/// FNV-1a of everything that a setup says: enough to tell another run's state by accident, not by intent.
fn digest(setup: &Setup) -> u64 {
    let text = format!("{setup:?}");
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// The whole state.
pub(super) fn save<T: Real>(engine: &Engine<T>, setup: &Setup) -> Vec<u8> {
    let particles = engine.blocks().flat_map(|block| (0..block.len).map(|k| block.get(k))).collect();
    let of_block = |motion: &Motion<T>, k: usize| {
        [motion.vx[k], motion.vz[k], motion.lxx[k], motion.lxz[k], motion.lzx[k], motion.lzz[k]]
    };
    let motion = engine.chunks.iter().flat_map(|chunk| {
        chunk.blocks.iter().zip(&chunk.motion).flat_map(|(block, motion)| (0..block.len).map(|k| of_block(motion, k)))
    });
    let flip = engine.chunks.iter().flat_map(|chunk| {
        chunk.blocks.iter().zip(&chunk.flip).flat_map(|(block, flip)| (0..block.len).map(|k| flip.get(k)))
    });
    let saved = Saved {
        version: VERSION,
        setup: digest(setup),
        particle_area_m2: engine.frame.particle_area_m2,
        steps: engine.steps,
        drift: engine.drift,
        fastest: engine.fastest,
        ledger: engine.ledger,
        layout: engine.layout.clone(),
        velocity: engine.velocity.iter().map(|&[vx, vz, ..]| [vx, vz]).collect(),
        particles,
        motion: motion.collect(),
        flip: flip.collect(),
    };
    // a vector takes everything; what is empty cannot be resumed
    postcard::to_stdvec(&saved).unwrap_or_default()
}

/// The engine that [`save`] saw.
pub(super) fn load<T: Real>(setup: &Setup, state: &[u8]) -> Result<Engine<T>, RunoutError> {
    let saved: Saved<T> = postcard::from_bytes(state).map_err(|_| RunoutError::Checkpoint("it is damaged"))?;
    if saved.version != VERSION {
        return Err(RunoutError::Checkpoint("it was saved by another version"));
    }
    if saved.setup != digest(setup) {
        return Err(RunoutError::Checkpoint("it is another run's"));
    }
    let mut engine = Engine::assemble(setup.frame(saved.particle_area_m2));
    let count = saved.particles.len();
    let mut seen = vec![false; count];
    for particle in &saved.particles {
        match seen.get_mut(particle.id as usize) {
            Some(seen) if !*seen => *seen = true,
            _ => return Err(RunoutError::Checkpoint("its particles are not those of a run")),
        }
    }
    let fits = saved.layout.fits(&saved.particles, engine.frame.bed.len());
    let moving = saved.motion.is_empty() || saved.motion.len() == count;
    let blended = saved.flip.len() == if engine.frame.flip > 0.0 { count } else { 0 };
    if count == 0 || !fits || !moving || !blended || saved.velocity.len() != saved.layout.nodes() {
        return Err(RunoutError::Checkpoint("its parts do not fit each other"));
    }
    for span in &saved.layout.chunks {
        let range = span.particles[0] as usize..span.particles[1] as usize;
        let blocks = blocks_of(&saved.particles[range.clone()]);
        let motion = saved.motion.get(range.clone()).unwrap_or_default().chunks(BLOCK).map(motion_of).collect();
        let flip = saved.flip.get(range).unwrap_or_default().chunks(BLOCK).map(flip_of).collect();
        engine.chunks.push(ChunkParticles { blocks, motion, flip });
    }
    engine.adopt(saved.layout);
    engine.velocity = saved.velocity.iter().map(|&[vx, vz]| [vx, vz, vx, vz]).collect();
    (engine.drift, engine.fastest, engine.steps) = (saved.drift, saved.fastest, saved.steps);
    engine.ledger = saved.ledger;
    Ok(engine)
}

fn motion_of<T: Real>(rows: &[[T; 6]]) -> Motion<T> {
    let mut motion = Motion::default();
    for (k, row) in rows.iter().enumerate() {
        [motion.vx[k], motion.vz[k], motion.lxx[k], motion.lxz[k], motion.lzx[k], motion.lzz[k]] = *row;
    }
    motion
}

fn flip_of<T: Real>(rows: &[[T; 4]]) -> Flip<T> {
    let mut flip = Flip::default();
    for (k, row) in rows.iter().enumerate() {
        flip.set(k, *row);
    }
    flip
}
