//! Particles in blocks of 64, one array a quantity (AoSoA), sorted by cell.
//!
//! Lengths are in cells and velocities in cells a step; a position is the nearest node and the offset from it, so that `f32`
//! resolves as well at the end of a track as at its start.

use super::lanes::Real;

/// Particles of a block.
pub(super) const BLOCK: usize = 64;
/// Particles that go through the plastic return together, and how many such groups a block has.
pub(super) const GROUP: usize = 16;
pub(super) const GROUPS: usize = BLOCK / GROUP;

/// Where the particles of a block are.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Place<T> {
    /// Offset from the nearest node, from -1/2 to 1/2.
    pub(super) gx: [T; BLOCK],
    pub(super) gz: [T; BLOCK],
    /// The nearest node.
    pub(super) column: [i32; BLOCK],
    pub(super) row: [i32; BLOCK],
}

/// 64 particles; those from `len` on are fillers that follow the first and scatter nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Block<T> {
    pub(super) place: Place<T>,
    /// Elastic left Cauchy-Green tensor, less the identity.
    pub(super) bxx: [T; BLOCK],
    pub(super) bzz: [T; BLOCK],
    pub(super) bxz: [T; BLOCK],
    /// Volumetric plastic strain and the compressive strength that it gives.
    pub(super) plastic_strain: [T; BLOCK],
    pub(super) strength: [T; BLOCK],
    /// Place in the order of release.
    pub(super) id: [u32; BLOCK],
    pub(super) len: usize,
}

/// What a FLIP blend keeps of the particles of a block from one step to the next, cells a step.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Flip<T> {
    /// Velocity.
    pub(super) vx: [T; BLOCK],
    pub(super) vz: [T; BLOCK],
    /// The share of it that the grid did not take and that the coming step gives back.
    pub(super) rx: [T; BLOCK],
    pub(super) rz: [T; BLOCK],
}

impl<T: Real> Default for Flip<T> {
    fn default() -> Self {
        let zero = [T::of(0.0); BLOCK];
        Self { vx: zero, vz: zero, rx: zero, rz: zero }
    }
}

impl<T: Real> Flip<T> {
    /// Velocity and remainder (x, z) of the particle at `k`.
    pub(super) fn get(&self, k: usize) -> [T; 4] {
        [self.vx[k], self.vz[k], self.rx[k], self.rz[k]]
    }

    /// Puts them at `k`.
    pub(super) fn set(&mut self, k: usize, values: [T; 4]) {
        [self.vx[k], self.vz[k], self.rx[k], self.rz[k]] = values;
    }
}

/// One particle, as it travels between blocks.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Particle<T> {
    pub(super) id: u32,
    pub(super) column: i32,
    pub(super) row: i32,
    pub(super) gx: T,
    pub(super) gz: T,
    pub(super) bxx: T,
    pub(super) bzz: T,
    pub(super) bxz: T,
    pub(super) plastic_strain: T,
    pub(super) strength: T,
}

impl<T: Real> Block<T> {
    /// A block of fillers at a node.
    pub(super) fn empty(column: i32, row: i32) -> Self {
        let zero = [T::of(0.0); BLOCK];
        Self {
            place: Place { gx: zero, gz: zero, column: [column; BLOCK], row: [row; BLOCK] },
            bxx: zero,
            bzz: zero,
            bxz: zero,
            // dilated and without strength: a filler carries no stress
            plastic_strain: [T::of(0.25); BLOCK],
            strength: zero,
            id: [u32::MAX; BLOCK],
            len: 0,
        }
    }

    /// The particle at `k < len`.
    #[inline(always)]
    pub(super) fn get(&self, k: usize) -> Particle<T> {
        Particle {
            id: self.id[k],
            column: self.place.column[k],
            row: self.place.row[k],
            gx: self.place.gx[k],
            gz: self.place.gz[k],
            bxx: self.bxx[k],
            bzz: self.bzz[k],
            bxz: self.bxz[k],
            plastic_strain: self.plastic_strain[k],
            strength: self.strength[k],
        }
    }

    /// Puts a particle at `k`.
    #[inline(always)]
    pub(super) fn set(&mut self, k: usize, particle: &Particle<T>) {
        self.id[k] = particle.id;
        self.place.column[k] = particle.column;
        self.place.row[k] = particle.row;
        self.place.gx[k] = particle.gx;
        self.place.gz[k] = particle.gz;
        self.bxx[k] = particle.bxx;
        self.bzz[k] = particle.bzz;
        self.bxz[k] = particle.bxz;
        self.plastic_strain[k] = particle.plastic_strain;
        self.strength[k] = particle.strength;
    }
}
