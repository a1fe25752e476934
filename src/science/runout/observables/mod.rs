//! What is measured on a flow: series at 24 frames a second, profiles, and the summary of a run.

mod on_bed;
mod pieces;
mod profiles;
mod series;
mod summary;

use serde::{Deserialize, Serialize};

pub use pieces::Pieces;
pub use profiles::{BIN_M, DepthProfile, VelocityProfile};
pub use series::{FRONT, Series, TAIL};
pub use summary::{Deposit, Ending, ReachAngles, Summary};

use super::GRAVITY_M_S2;
use super::regime::Indicators;
use super::release::Slab;
use super::snapshot::{Energies, Snapshot};
use super::terrain::Terrain;
use on_bed::{OnBed, mean};
use profiles::{Bins, velocity_profile};

/// Frames a second (Li et al. 2020, Table 1).
pub const FRAMES_PER_S: f64 = 24.0;
/// Frames from one stored profile to the next: every half second.
pub const PROFILE_FRAMES: usize = 12;

/// Kinetic energy at rest, as a share of what was released.
const REST_ENERGY: f64 = 1e-4;
/// Speed of the centre of mass at rest, m/s.
const REST_SPEED_M_S: f64 = 0.05;
/// How long a flow must be at rest, frames: a second.
const REST_FRAMES: usize = 24;

/// What an observer must know of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The bed.
    pub terrain: Terrain,
    /// The slab that was released.
    pub slab: Slab,
    /// Mass of the slab, kg a metre of width.
    pub mass_kg_m: f64,
    /// Cell size of the mesh, m.
    pub mesh_m: f64,
    /// Height by which `v_max` is scaled: `H0` of Li et al. (2020), m.
    pub drop_height_m: f64,
    /// Where along the track the middle of the slope is, m.
    pub mid_slope_m: f64,
    /// What the parameters alone say of the flow.
    pub indicators: Indicators,
}

/// Everything observed so far; serialised it is the observer's part of a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Observations {
    /// One entry a frame.
    pub series: Series,
    /// Along the track: every half second.
    pub depth_profiles: Vec<DepthProfile>,
    /// At the centre of mass, as often.
    pub velocity_profiles: Vec<VelocityProfile>,
    /// What the flow has broken into, as often.
    pub pieces: Vec<Pieces>,
    /// Along the track, in the last frame: the deposit of a run that has ended.
    pub latest: DepthProfile,
}

/// Takes in frame after frame of a run.
#[derive(Clone, Debug)]
pub struct Observer {
    scene: Scene,
    seen: Observations,
}

impl Observer {
    /// An observer that has seen nothing yet, or all of `seen` in an earlier attempt of the same run.
    #[must_use]
    pub const fn new(scene: Scene, seen: Observations) -> Self {
        Self { scene, seen }
    }

    /// Takes in a frame.
    pub fn observe(&mut self, snapshot: &Snapshot, energies: &Energies) {
        let terrain = &self.scene.terrain;
        let on_bed = OnBed::new(snapshot, terrain);
        let bins = Bins::new(&on_bed);
        let frame = self.frames();
        self.seen.series.push(snapshot, energies, &on_bed, &bins, self.scene.slab.length_m);
        let particle_mass = self.scene.mass_kg_m / snapshot.x_m.len() as f64;
        self.seen.latest = bins.depth_profile(snapshot.time_s, &on_bed, terrain, particle_mass);
        if frame.is_multiple_of(PROFILE_FRAMES) {
            self.seen.depth_profiles.push(self.seen.latest.clone());
            self.seen.pieces.push(Pieces::new(snapshot, &self.scene, &bins));
            let centre = mean(on_bed.s.iter().copied());
            self.seen.velocity_profiles.push(velocity_profile(snapshot.time_s, &on_bed, terrain, centre));
        }
    }

    /// What was seen so far.
    #[must_use]
    pub const fn seen(&self) -> &Observations {
        &self.seen
    }

    /// All that was seen.
    #[must_use]
    pub fn into_seen(self) -> Observations {
        self.seen
    }

    /// Frames seen so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.seen.series.time_s.len()
    }

    /// Whether the flow has come to rest: for a second, its kinetic energy was below 1e-4 of the potential energy that it has
    /// released, and its centre of mass slower than 0.05 m/s.
    ///
    /// What was released counts as at least the fall of the slab by its own thickness, so that snow that never moves is at
    /// rest as well.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let series = &self.seen.series;
        let speeds = series.com_speed_m_s();
        let quiet = |&frame: &usize| {
            let energies = &series.energies[frame];
            let moving = energies.kinetic + energies.affine;
            moving < REST_ENERGY * self.released(energies) && speeds[frame] < REST_SPEED_M_S
        };
        let quiet_frames = (0..self.frames()).rev().take_while(quiet).count();
        quiet_frames > REST_FRAMES
    }

    /// Potential energy that was released until a frame, J a metre of width, at least that of a fall by the slab's thickness.
    fn released(&self, until: &Energies) -> f64 {
        let Scene { mass_kg_m, slab, .. } = &self.scene;
        let before = self.seen.series.energies.first().map_or(0.0, |first| first.potential);
        (before - until.potential).max(mass_kg_m * GRAVITY_M_S2 * slab.thickness_m)
    }
}

#[cfg(test)]
mod tests;
