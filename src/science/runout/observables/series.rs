//! Numbers that describe a whole flow, over time.

use serde::{Deserialize, Serialize};

use super::on_bed::{OnBed, mean, quantile};
use super::profiles::Bins;
use crate::runout::regime::FlowShape;
use crate::runout::snapshot::{Energies, Snapshot};

/// Share of the mass behind the front.
pub const FRONT: f64 = 0.99;
/// Share of the mass behind the tail.
pub const TAIL: f64 = 0.01;
/// Share of the mean mass of a bin below which it is a gap.
const GAP: f64 = 0.1;
/// Frames on either side that the velocity of the front is fitted to.
const FIT_FRAMES: usize = 3;
/// Slower than this, in m/s, a flow has no velocity profile.
const STILL_M_S: f64 = 1e-3;

/// Numbers of a flow over time; every vector has one entry a frame, 24 a second.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Series {
    /// Time since release, s.
    pub time_s: Vec<f64>,
    /// Front: 99 % quantile of the mass along x, m. Single grains ahead are chaotic.
    pub front_m: Vec<f64>,
    /// The same along the bed, m of arc length since the bed's left end.
    pub front_along_bed_m: Vec<f64>,
    /// Velocity of the front along the bed, m/s: the slope of the straight line that is fitted by least squares to its
    /// positions from three frames before to three frames after, an eighth of a second each way.
    pub front_velocity_m_s: Vec<f64>,
    /// Tail: 1 % quantile of the mass along x, m.
    pub tail_m: Vec<f64>,
    /// Centre of mass along x, m.
    pub com_x_m: Vec<f64>,
    /// Height of the centre of mass, m.
    pub com_z_m: Vec<f64>,
    /// Velocity of the centre of mass along x, m/s.
    pub com_vx_m_s: Vec<f64>,
    /// Velocity of the centre of mass along z, m/s.
    pub com_vz_m_s: Vec<f64>,
    /// 99 % quantile of the mass by speed, m/s.
    pub v99_m_s: Vec<f64>,
    /// Speed of the fastest particle, m/s.
    pub particle_v_max_m_s: Vec<f64>,
    /// Mean bulk density of the particles, kg/m3, each with its mass.
    pub density_kg_m3: Vec<f64>,
    /// Shape of the flow.
    pub shape: Vec<FlowShape>,
    /// Energies, J a metre of width.
    pub energies: Vec<Energies>,
}

impl Series {
    /// Adds a frame. `release_length_m` is the length of the slab along the bed.
    pub(super) fn push(
        &mut self,
        snapshot: &Snapshot,
        energies: &Energies,
        on_bed: &OnBed,
        bins: &Bins,
        release_length_m: f64,
    ) {
        let wide = |values: &[f32]| -> Vec<f64> { values.iter().copied().map(f64::from).collect() };
        let velocities = snapshot.vx_m_s.iter().zip(&snapshot.vz_m_s);
        let speeds: Vec<f64> = velocities.map(|(&vx, &vz)| f64::from(vx).hypot(f64::from(vz))).collect();
        let mean_of = |values: &[f32]| mean(values.iter().copied().map(f64::from));
        self.time_s.push(snapshot.time_s);
        self.front_m.push(quantile(wide(&snapshot.x_m), FRONT));
        self.tail_m.push(quantile(wide(&snapshot.x_m), TAIL));
        self.com_x_m.push(mean_of(&snapshot.x_m));
        self.com_z_m.push(mean_of(&snapshot.z_m));
        self.com_vx_m_s.push(mean_of(&snapshot.vx_m_s));
        self.com_vz_m_s.push(mean_of(&snapshot.vz_m_s));
        self.particle_v_max_m_s.push(speeds.iter().copied().fold(0.0, f64::max));
        self.v99_m_s.push(quantile(speeds, FRONT));
        self.density_kg_m3.push(mean_of(&snapshot.density_kg_m3));
        let (tail, front) = (quantile(on_bed.s.clone(), TAIL), quantile(on_bed.s.clone(), FRONT));
        self.front_along_bed_m.push(front);
        self.fit_front_velocity();
        self.shape.push(shape(snapshot, on_bed, bins, (tail, front), release_length_m));
        self.energies.push(*energies);
    }

    /// Speed of the centre of mass, m/s, one entry a frame.
    #[must_use]
    pub fn com_speed_m_s(&self) -> Vec<f64> {
        self.com_vx_m_s.iter().zip(&self.com_vz_m_s).map(|(vx, vz)| vx.hypot(*vz)).collect()
    }

    /// Velocities of the front that the newest frame changes.
    fn fit_front_velocity(&mut self) {
        let frames = self.time_s.len();
        self.front_velocity_m_s.truncate(frames.saturating_sub(FIT_FRAMES + 1));
        for frame in self.front_velocity_m_s.len()..frames {
            let near = frame.saturating_sub(FIT_FRAMES)..(frame + FIT_FRAMES + 1).min(frames);
            self.front_velocity_m_s.push(slope(&self.time_s[near.clone()], &self.front_along_bed_m[near]));
        }
    }
}

/// Slope of the straight line through some points, by least squares; 0 for less than two.
fn slope(x: &[f64], y: &[f64]) -> f64 {
    let (middle_x, middle_y) = (mean(x.iter().copied()), mean(y.iter().copied()));
    let products = x.iter().zip(y).map(|(x, y)| (x - middle_x) * (y - middle_y));
    let squares: f64 = x.iter().map(|x| (x - middle_x).powi(2)).sum();
    if squares > 0.0 { products.sum::<f64>() / squares } else { 0.0 }
}

fn shape(
    snapshot: &Snapshot,
    on_bed: &OnBed,
    bins: &Bins,
    (tail, front): (f64, f64),
    release_length_m: f64,
) -> FlowShape {
    let layers = bins.layers(on_bed);
    let bed: f64 = layers.iter().map(|layer| layer.count * layer.bed).sum();
    let surface: f64 = layers.iter().map(|layer| layer.count * layer.surface).sum();
    let particles = snapshot.x_m.len() as f64;
    let still = surface.abs() <= STILL_M_S * particles;
    let counts = bins.counts_between(tail, front);
    let mean_count = mean(counts.iter().copied());
    let variance = mean(counts.iter().map(|count| (count - mean_count).powi(2)));
    FlowShape {
        slip: if still { 1.0 } else { bed / surface },
        stretch: (front - tail) / release_length_m,
        gap: mean(counts.iter().map(|&count| f64::from(count < GAP * mean_count))),
        cv: if mean_count > 0.0 { variance.sqrt() / mean_count } else { 0.0 },
        broken: mean(snapshot.plastic_strain.iter().map(|&strain| f64::from(strain > 0.0))),
    }
}
