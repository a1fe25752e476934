//! Particles in the coordinates of the bed: along it, above it, and how fast along it.

use crate::runout::snapshot::Snapshot;
use crate::runout::terrain::Terrain;

/// Where the particles of a snapshot are with respect to the bed; every vector has one entry a particle.
pub(super) struct OnBed {
    /// Arc length of the bed point below, m.
    pub(super) s: Vec<f64>,
    /// Distance from the bed along its normal, m.
    pub(super) y: Vec<f64>,
    /// Velocity along the bed, down the track, m/s.
    pub(super) u: Vec<f64>,
}

impl OnBed {
    pub(super) fn new(snapshot: &Snapshot, terrain: &Terrain) -> Self {
        let particles = snapshot.x_m.len();
        let [mut s, mut y, mut u] = [(); 3].map(|()| Vec::with_capacity(particles));
        let velocities = snapshot.vx_m_s.iter().zip(&snapshot.vz_m_s);
        for ((&x, &z), (&vx, &vz)) in snapshot.x_m.iter().zip(&snapshot.z_m).zip(velocities) {
            let foot = terrain.project(f64::from(x), f64::from(z));
            let [along_x, along_z] = foot.tangent();
            s.push(foot.s_m);
            y.push(foot.distance_m);
            u.push(f64::from(vx) * along_x + f64::from(vz) * along_z);
        }
        Self { s, y, u }
    }
}

/// The smallest value that at least `share` of all values do not exceed; 0 of none.
///
/// As all particles have the same mass this is a quantile of mass: 0.99 of positions is the front.
pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let rank = ((share * values.len() as f64).ceil() as usize).clamp(1, values.len()) - 1;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

/// The mean of some values; 0 of none.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}
