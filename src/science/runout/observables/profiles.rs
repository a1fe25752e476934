//! Profiles of a flow: along the track in bins of the bed, and up from the bed at one place.

use serde::{Deserialize, Serialize};

use super::on_bed::{OnBed, mean, quantile};
use crate::runout::terrain::Terrain;

/// Width of a bin along the bed, m.
pub const BIN_M: f64 = 0.5;
/// Share of a bin's particles that are its bed layer, and its surface layer.
const LAYER: f64 = 0.2;
/// Layers of a vertical profile.
const LAYERS: usize = 20;
/// Half of the stretch of bed whose particles make a vertical profile, m.
const HALF_STATION_M: f64 = 1.0;

/// A flow along the track at one instant; every vector has one entry a bin of [`BIN_M`] along the bed, `null` where a bin is
/// empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DepthProfile {
    /// Time since release, s.
    pub time_s: f64,
    /// Middle of the bin along the track, m.
    pub x_m: Vec<f64>,
    /// Height of the bed there, m.
    pub bed_m: Vec<f64>,
    /// Mass, kg a metre of width and a metre of bed.
    pub mass_kg_m2: Vec<f64>,
    /// Flow depth normal to the bed, m: twice the mean distance of the mass from the bed, which is exact where density does
    /// not change with height and which single grains in the air hardly move. 0 where a bin is empty.
    pub depth_m: Vec<f64>,
    /// Mass over depth, kg/m3: what a probe would weigh, voids included.
    pub density_kg_m3: Vec<Option<f64>>,
    /// Mean velocity along the bed, m/s.
    pub velocity_m_s: Vec<Option<f64>>,
    /// Mean velocity along the bed of the lowest fifth of the mass, m/s.
    pub bed_velocity_m_s: Vec<Option<f64>>,
    /// Mean velocity along the bed of the highest fifth of the mass, m/s.
    pub surface_velocity_m_s: Vec<Option<f64>>,
}

/// Velocity over height at one place and one instant; `velocity_m_s` has one entry a layer, `null` where it is empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct VelocityProfile {
    /// Time since release, s.
    pub time_s: f64,
    /// The place along the track, m; the profile takes in the particles within 1 m of it along the bed.
    pub x_m: f64,
    /// Height of a layer, m: 20 equal ones reach to the height below which 99 % of the mass lie.
    pub layer_m: f64,
    /// Mean velocity along the bed, m/s, from the bed up.
    pub velocity_m_s: Vec<Option<f64>>,
}

/// The particles of each bin of the bed, and where the first bin begins.
pub(super) struct Bins {
    first: i64,
    particles: Vec<Vec<u32>>,
}

impl Bins {
    pub(super) fn new(on_bed: &OnBed) -> Self {
        let bin_of = |s: f64| (s / BIN_M).floor() as i64;
        let first = on_bed.s.iter().copied().map(bin_of).min().unwrap_or(0);
        let last = on_bed.s.iter().copied().map(bin_of).max().unwrap_or(-1);
        let mut particles = vec![Vec::new(); usize::try_from(last + 1 - first).unwrap_or(0)];
        for (particle, &s) in (0..).zip(&on_bed.s) {
            if let Ok(bin) = usize::try_from(bin_of(s) - first) {
                particles[bin].push(particle);
            }
        }
        Self { first, particles }
    }

    /// Counts of the bins that lie wholly or partly between two arc lengths.
    pub(super) fn counts_between(&self, from_s: f64, to_s: f64) -> Vec<f64> {
        let (from, to) = ((from_s / BIN_M).floor() as i64, (to_s / BIN_M).floor() as i64);
        let kept = (self.first..).zip(&self.particles).filter(|(bin, _)| (from..=to).contains(bin));
        kept.map(|(_, particles)| particles.len() as f64).collect()
    }

    /// Counts of all bins from the first to the last that has a particle.
    pub(super) fn masses(&self) -> impl Iterator<Item = f64> + Clone {
        self.particles.iter().map(|particles| particles.len() as f64)
    }

    /// Bed and surface velocity of every bin that has a particle, with its count of particles.
    pub(super) fn layers(&self, on_bed: &OnBed) -> Vec<Layers> {
        self.particles.iter().filter(|particles| !particles.is_empty()).map(|bin| Layers::new(bin, on_bed)).collect()
    }

    pub(super) fn depth_profile(&self, time_s: f64, on_bed: &OnBed, terrain: &Terrain, mass_kg_m: f64) -> DepthProfile {
        let mut profile = DepthProfile { time_s, ..DepthProfile::default() };
        for (bin, particles) in (self.first..).zip(&self.particles) {
            let place = terrain.at_arc_length((bin as f64 + 0.5) * BIN_M);
            let mass = particles.len() as f64 * mass_kg_m / BIN_M;
            let depth = 2.0 * mean(particles.iter().map(|&particle| on_bed.y[particle as usize])).max(0.0);
            let layers = (!particles.is_empty()).then(|| Layers::new(particles, on_bed));
            profile.x_m.push(place.x_m);
            profile.bed_m.push(place.z_m);
            profile.mass_kg_m2.push(mass);
            profile.depth_m.push(depth);
            profile.density_kg_m3.push((depth > 0.0).then(|| mass / depth));
            profile.velocity_m_s.push(layers.as_ref().map(|layers| layers.all));
            profile.bed_velocity_m_s.push(layers.as_ref().map(|layers| layers.bed));
            profile.surface_velocity_m_s.push(layers.map(|layers| layers.surface));
        }
        profile
    }
}

/// Velocities along the bed of one bin, m/s.
pub(super) struct Layers {
    pub(super) count: f64,
    all: f64,
    /// Of its lowest fifth.
    pub(super) bed: f64,
    /// Of its highest fifth.
    pub(super) surface: f64,
}

impl Layers {
    fn new(particles: &[u32], on_bed: &OnBed) -> Self {
        let mut order = particles.to_vec();
        let height = |particle: &u32| on_bed.y[*particle as usize];
        let by_height = |a: &u32, b: &u32| height(a).total_cmp(&height(b));
        let layer = ((LAYER * order.len() as f64).ceil() as usize).clamp(1, order.len());
        let mean_of = |part: &[u32]| mean(part.iter().map(|&particle| on_bed.u[particle as usize]));
        order.select_nth_unstable_by(layer - 1, by_height);
        let bed = mean_of(&order[..layer]);
        let top = order.len() - layer;
        order.select_nth_unstable_by(top, by_height);
        let surface = mean_of(&order[top..]);
        Self { count: particles.len() as f64, all: mean_of(particles), bed, surface }
    }
}

/// The vertical profile above the bed at arc length `s`; no layers where nothing is within reach.
pub(super) fn velocity_profile(time_s: f64, on_bed: &OnBed, terrain: &Terrain, s: f64) -> VelocityProfile {
    let near: Vec<(f64, f64)> = on_bed
        .s
        .iter()
        .zip(&on_bed.y)
        .zip(&on_bed.u)
        .filter(|((at, _), _)| (**at - s).abs() <= HALF_STATION_M)
        .map(|((_, &y), &u)| (y, u))
        .collect();
    let layer_m = quantile(near.iter().map(|&(y, _)| y).collect(), 0.99).max(0.0) / LAYERS as f64;
    let mut profile = VelocityProfile { time_s, x_m: terrain.at_arc_length(s).x_m, layer_m, velocity_m_s: Vec::new() };
    if layer_m > 0.0 {
        let mut layers = [(0.0, 0.0); LAYERS];
        for (y, u) in near {
            // what lies in the bed counts to the lowest layer; above the highest lies the last hundredth
            if let Some((sum, count)) = layers.get_mut((y / layer_m).max(0.0) as usize) {
                *sum += u;
                *count += 1.0;
            }
        }
        profile.velocity_m_s = layers.iter().map(|&(sum, count)| (count > 0.0).then(|| sum / count)).collect();
    }
    profile
}
