//! What a simulation shows of itself at one instant: the seam between the dynamics and everything that observes them.

use serde::{Deserialize, Serialize};

/// All particles at one instant, in the order of their release; every vector has one entry a particle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Time since release, s.
    pub time_s: f64,
    /// Position along the track, m.
    pub x_m: Vec<f32>,
    /// Height, m.
    pub z_m: Vec<f32>,
    /// Velocity along x, m/s.
    pub vx_m_s: Vec<f32>,
    /// Velocity along z, m/s.
    pub vz_m_s: Vec<f32>,
    /// Bulk density, kg/m3.
    pub density_kg_m3: Vec<f32>,
    /// Volumetric plastic strain, dimensionless, positive in dilation; above 0 the particle is broken and carries no stress.
    pub plastic_strain: Vec<f32>,
}

/// Energies since release, J a metre of width. The first four are states, the others what was dissipated so far (>= 0).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Energies {
    /// Kinetic energy of the velocities that particles have of the grid.
    pub kinetic: f64,
    /// Kinetic energy of the affine part of their motion.
    pub affine: f64,
    /// Potential energy above the lowest point of the terrain.
    pub potential: f64,
    /// Elastic energy.
    pub elastic: f64,
    /// Dissipated by friction and impact at the bed.
    pub bed: f64,
    /// Dissipated in plastic flow.
    pub plastic: f64,
    /// Dissipated by the transfer between particles and grid, the limiter of affine motion included.
    pub transfer: f64,
}

impl Energies {
    /// All of them, J a metre of width: constant where every term is accounted for.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.kinetic + self.affine + self.potential + self.elastic + self.bed + self.plastic + self.transfer
    }
}
