//! The few numbers that a run is told by.

use serde::{Deserialize, Serialize};

use super::{Observer, PROFILE_FRAMES, Pieces, Scene, Series};
use crate::runout::GRAVITY_M_S2;
use crate::runout::regime::{Criteria, FlowShape, Indicators, Regime, classify};

/// Share of the mean mass of a bin below which it is no deposit but scattered snow.
const SCATTERED: f64 = 0.1;

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// The flow came to rest.
    AtRest,
    /// The time that was asked for had passed.
    EndTime,
    /// Snow left the terrain: what is reported was seen until then.
    LeftDomain,
}

/// A run in a few numbers. Speeds are those of the frames, 24 a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Summary {
    /// Largest over time of the speed that 99 % of the mass do not exceed, m/s.
    pub v_max: f64,
    /// `v_max` over sqrt(g H0), dimensionless; `H0` is the drop height of the scene.
    pub v_max_scaled: f64,
    /// Largest velocity of the front along the bed, m/s; see [`Series`].
    pub front_v_max: f64,
    /// Front at the end: 99 % quantile of the mass along x, m.
    pub front_m: f64,
    /// Largest speed of the centre of mass, m/s.
    pub com_v_max: f64,
    /// Centre of mass at the end, m along x.
    pub com_end_m: f64,
    /// Largest speed of any particle, m/s; chaotic where snow breaks up.
    pub particle_v_max: f64,
    /// How far the avalanche went for the height that it fell.
    pub reach_angle_deg: ReachAngles,
    /// What lies there at the end.
    pub deposit: Deposit,
    /// What the flow had broken into half a second or less after the middle of the slope.
    pub pieces_mid: Pieces,
    /// What lies there at the end, or lay half a second or less before.
    pub pieces_end: Pieces,
    /// Flow regime.
    pub regime: Regime,
    /// What the parameters alone say of the flow.
    pub indicators: Indicators,
    /// Largest energy at any time that no term accounts for, as a share of the potential energy released in all.
    pub energy_closure: f64,
    /// Why the run ended.
    pub ending: Ending,
    /// Physical time at the end, s since release.
    pub duration_s: f64,
    /// Time steps.
    pub steps: u64,
    /// Particles.
    pub particles: u64,
    /// Particle-steps a second of computing time; `null` where nobody held a clock.
    pub particle_steps_per_s: Option<f64>,
}

/// Reach (run-out) angles: of the line between two points over the horizontal, degrees. The front is the point of the bed at
/// the front at the end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ReachAngles {
    /// From the upper end of the slab on the bed to the front.
    pub crown: f64,
    /// From the centroid of the slab to the front.
    pub front: f64,
    /// From the centre of mass at release to the centre of mass at the end.
    pub com: f64,
}

/// The deposit: all bins of 0.5 m with at least a tenth of their mean mass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Deposit {
    /// Length along the bed from the 1 % to the 99 % quantile of mass, m.
    pub length_m: f64,
    /// Largest depth normal to the bed, m.
    pub max_depth_m: f64,
    /// Mass over volume, kg/m3, voids included.
    pub mean_density: f64,
}

impl Observer {
    /// The summary of what was seen; `None` before the first frame.
    #[must_use]
    pub fn summary(&self, ending: Ending, steps: u64, particles: u64) -> Option<Summary> {
        let (scene, series) = (&self.scene, &self.seen.series);
        let last = self.frames().checked_sub(1)?;
        let v_max = largest(&series.v99_m_s);
        let pieces = &self.seen.pieces;
        let pieces_at = |frame: usize| pieces.get(frame.div_ceil(PROFILE_FRAMES)).or(pieces.last()).copied();
        Some(Summary {
            v_max,
            v_max_scaled: v_max / (GRAVITY_M_S2 * scene.drop_height_m).sqrt(),
            front_v_max: largest(&series.front_velocity_m_s),
            front_m: series.front_m[last],
            com_v_max: largest(&series.com_speed_m_s()),
            com_end_m: series.com_x_m[last],
            particle_v_max: largest(&series.particle_v_max_m_s),
            reach_angle_deg: reach_angles(scene, series, last),
            deposit: self.deposit(series.shape[last]),
            pieces_mid: pieces_at(self.mid_frame()).unwrap_or_default(),
            pieces_end: pieces.last().copied().unwrap_or_default(),
            regime: classify(self.criteria(last)),
            indicators: scene.indicators,
            energy_closure: self.energy_closure(last),
            ending,
            duration_s: series.time_s[last],
            steps,
            particles,
            particle_steps_per_s: None,
        })
    }

    /// The frame at mid slope, or the one of the largest speed of a flow that never came that far.
    fn mid_frame(&self) -> usize {
        let series = &self.seen.series;
        let passed = series.com_x_m.iter().position(|&x| x >= self.scene.mid_slope_m);
        passed.unwrap_or_else(|| place_of_largest(&series.com_speed_m_s()))
    }

    /// The flow at mid slope and at its end.
    fn criteria(&self, last: usize) -> Criteria {
        let (series, mid) = (&self.seen.series, self.mid_frame());
        Criteria { mid_time_s: series.time_s[mid], mid: series.shape[mid], end: series.shape[last] }
    }

    fn energy_closure(&self, last: usize) -> f64 {
        let energies = &self.seen.series.energies;
        let unexplained = energies.iter().map(|now| (now.total() - energies[0].total()).abs());
        unexplained.fold(0.0, f64::max) / self.released(&energies[last])
    }

    fn deposit(&self, shape: FlowShape) -> Deposit {
        let latest = &self.seen.latest;
        let occupied = latest.mass_kg_m2.iter().filter(|&&mass| mass > 0.0);
        let (mass, bins) = occupied.fold((0.0, 0.0), |(mass, bins), one| (mass + one, bins + 1.0));
        let is_deposit = |bin: &(&f64, &f64)| *bin.0 > 0.0 && *bin.0 * bins >= SCATTERED * mass;
        let kept: Vec<(&f64, &f64)> = latest.mass_kg_m2.iter().zip(&latest.depth_m).filter(is_deposit).collect();
        let volume: f64 = kept.iter().map(|(_, depth)| **depth).sum();
        Deposit {
            length_m: shape.stretch * self.scene.slab.length_m,
            max_depth_m: kept.iter().map(|(_, depth)| **depth).fold(0.0, f64::max),
            mean_density: if volume > 0.0 { kept.iter().map(|(mass, _)| **mass).sum::<f64>() / volume } else { 0.0 },
        }
    }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn place_of_largest(values: &[f64]) -> usize {
    let by_value = |a: &(usize, &f64), b: &(usize, &f64)| a.1.total_cmp(b.1);
    values.iter().enumerate().max_by(by_value).map_or(0, |(place, _)| place)
}

fn reach_angles(scene: &Scene, series: &Series, last: usize) -> ReachAngles {
    let Scene { terrain, slab, .. } = scene;
    let angle = |from: [f64; 2], to: [f64; 2]| (from[1] - to[1]).atan2(to[0] - from[0]).to_degrees();
    let centre_of_mass = |frame: usize| [series.com_x_m[frame], series.com_z_m[frame]];
    let front = [series.front_m[last], terrain.height_m(series.front_m[last])];
    ReachAngles {
        crown: angle(slab.crown_m(terrain), front),
        front: angle(slab.centre_m(terrain), front),
        com: angle(centre_of_mass(0), centre_of_mass(last)),
    }
}
