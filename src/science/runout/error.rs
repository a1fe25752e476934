//! Why a run-out simulation cannot be made or cannot go on.

use thiserror::Error;

use super::{material::ParameterError, release::ReleaseError};

/// A particle at the moment at which a run broke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParticleState {
    /// Its place in the order of release.
    pub id: usize,
    /// Position along the track, m.
    pub x_m: f64,
    /// Height, m.
    pub z_m: f64,
    /// Velocity along x and z, m/s: that of the grid at the particle.
    pub velocity_m_s: [f64; 2],
    /// Elastic left Cauchy-Green tensor less the identity: xx, zz, xz.
    pub elastic: [f64; 3],
    /// Volumetric plastic strain.
    pub plastic_strain: f64,
    /// Compressive strength, Pa.
    pub strength_pa: f64,
}

/// The state around the particle that broke a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Dump {
    /// The particle whose state is not finite, or else the fastest.
    pub offender: ParticleState,
    /// Particles of its cell and the cells beside it, at most 64.
    pub neighbours: Vec<ParticleState>,
}

/// Why there is no simulation, or none any more.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RunoutError {
    /// A parameter outside of the model.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// A slab that cannot be released.
    #[error(transparent)]
    Release(#[from] ReleaseError),
    /// A time step over the limit of Courant, Friedrichs & Lewy for pressure waves.
    #[error("a time step of {time_step_s:e} s: the limit for this mesh and this snow is {limit_s:e} s")]
    TimeStep {
        /// The time step given, s.
        time_step_s: f64,
        /// The largest that is accepted, s.
        limit_s: f64,
    },
    /// A mesh that is too fine for the memory.
    #[error("{particles} particles would take {bytes} bytes, more than the limit of {limit_bytes}")]
    TooLarge {
        /// Particles of the run.
        particles: u64,
        /// Bytes that they and the grid would take.
        bytes: u64,
        /// The limit given.
        limit_bytes: u64,
    },
    /// Something became infinite or not a number, or moved by more than a cell in one step.
    #[error("the run broke at step {step}: particle {} at x = {} m", dump.offender.id, dump.offender.x_m)]
    Diverged {
        /// Steps that were done.
        step: u64,
        /// The state there.
        dump: Box<Dump>,
    },
    /// A saved state that is damaged, or that is another run's.
    #[error("the saved state cannot be resumed: {0}")]
    Checkpoint(&'static str),
}
