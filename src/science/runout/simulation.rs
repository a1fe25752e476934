//! A run as its caller sees it: made of a [`Setup`], advanced from one time to the next, looked at in between.

use serde::{Deserialize, Serialize};

use super::{
    checkpoint,
    engine::{Engine, Frame, Halt, Released},
    error::RunoutError,
    grid::BedColumn,
    lanes::Real,
    material::{FlowRule, Material, ParameterError, ShearNorm, Snow, check},
    observe,
    particles::{BLOCK, Block, Flip},
    release::{Placement, Slab},
    snapshot::{Energies, Snapshot},
    terrain::Terrain,
    transfer::Motion,
};
use crate::progress::Progress;

/// Acceleration of gravity, m/s2.
pub const GRAVITY_M_S2: f64 = 9.81;

/// The usual value of [`Setup::limited_above`]: so far dilated, snow has come apart.
pub const LIMITED_ABOVE: f64 = 0.2;

/// The usual value of [`Setup::limited_beyond`]: what flows on a bed with friction as a whole stays below it.
pub const LIMITED_BEYOND: f64 = 0.75;

/// Cells above the bed at which a node still counts as lying on it.
const ON_BED: f64 = 1e-6;

/// Particle-steps between two looks at whether the run is still wanted: some 0.1 s on the slowest machines.
const BETWEEN_LOOKS: u64 = 500_000;

/// How the snow meets the bed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Contact {
    /// Coulomb friction while snow is pressed against the bed; it may lift off.
    #[default]
    Separable,
    /// Snow at the bed sticks to it.
    Sticky,
}

/// Numbers in which a run is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// Single precision: about twice as fast.
    #[default]
    F32,
    /// Double precision.
    F64,
}

/// All that decides a run: nothing in it is random, and it has the same bits at any number of threads.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The bed.
    pub terrain: Terrain,
    /// The snow that is released, from rest.
    pub release: Slab,
    /// Its material.
    pub snow: Snow,
    /// Coulomb coefficient of friction at the bed, dimensionless.
    pub bed_friction: f64,
    /// How the snow meets the bed.
    pub contact: Contact,
    /// How stresses come back to the yield surface.
    pub flow_rule: FlowRule,
    /// The norm in which shear stress is measured.
    pub shear_norm: ShearNorm,
    /// Cell size, m; a cell is released with four particles.
    pub mesh_m: f64,
    /// Time step, s: at most [`Setup::time_step_limit_s`].
    pub time_step_s: f64,
    /// Volumetric plastic strain above which the affine motion of a particle is limited where it comes near to the speed of a
    /// frictionless fall from the highest snow at release, usually [`LIMITED_ABOVE`]; what is faster than that fall is limited
    /// whatever its strain. Infinity gives plain APIC, in which lone grains may come to twice that speed.
    pub limited_above: f64,
    /// The share of the speed of that fall above which this holds, usually [`LIMITED_BEYOND`].
    pub limited_beyond: f64,
    /// The share of FLIP in the transfer, from 0 to 1; 0 is plain APIC, see [`super::scenario::TransferInputs`].
    pub flip: f64,
    /// Numbers in which the run is computed.
    pub precision: Precision,
    /// Bytes that the run may take.
    pub memory_limit_bytes: u64,
}

impl Setup {
    /// The time step of Li et al. (2020), Table 1: `0.5 dx / sqrt(E / rho)`, s.
    #[must_use]
    pub fn usual_time_step_s(snow: &Snow, mesh_m: f64) -> f64 {
        0.5 * mesh_m / (snow.youngs_modulus_pa / snow.density_kg_m3).sqrt()
    }

    /// The largest time step that is accepted, s: that in which a pressure wave crosses a cell.
    #[must_use]
    pub fn time_step_limit_s(&self) -> f64 {
        self.mesh_m / self.snow.wave_speed_m_s()
    }

    /// How many particles the run has, about.
    #[must_use]
    pub fn particles(&self) -> u64 {
        let spacing = 0.5 * self.mesh_m;
        let [along, across] = [self.release.length_m, self.release.thickness_m].map(|size| (size / spacing).round());
        // saturates at what no memory holds
        (along * across) as u64
    }

    /// Bytes that the run takes, about: its particles twice, because they are sorted, and a grid of as many nodes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let (per_block, flip) = match self.precision {
            Precision::F32 => {
                (2 * size_of::<Block<f32>>() + size_of::<Motion<f32>>() + (7 * 4 + 8) * BLOCK, size_of::<Flip<f32>>())
            }
            Precision::F64 => {
                (2 * size_of::<Block<f64>>() + size_of::<Motion<f64>>() + (7 * 8 + 8) * BLOCK, size_of::<Flip<f64>>())
            }
        };
        let per_block = per_block + if self.flip > 0.0 { 2 * flip } else { 0 };
        self.particles().div_ceil(BLOCK as u64).saturating_mul(per_block as u64)
    }

    /// Checks all that can be checked before the run.
    ///
    /// # Errors
    /// A parameter outside of the model, a time step over its limit, a mesh over the memory limit, a slab off the terrain.
    pub fn validate(&self) -> Result<(), RunoutError> {
        self.snow.validate()?;
        if self.flow_rule == FlowRule::AssociativeImplicit {
            let cohesion = self.snow.cohesion;
            check("cohesion", cohesion, cohesion <= 1.0, "from 0 to 1 with implicit hardening")?;
        }
        check("bed_friction", self.bed_friction, (0.0..=10.0).contains(&self.bed_friction), "from 0 to 10")?;
        check("mesh_m", self.mesh_m, (1e-3..=10.0).contains(&self.mesh_m), "from 0.001 to 10")?;
        if self.limited_above.is_nan() || self.limited_above < 0.0 {
            let accepted = "at least 0, or infinity";
            return Err(ParameterError { name: "limited_above", value: self.limited_above, accepted }.into());
        }
        let beyond = self.limited_beyond;
        check("limited_beyond", beyond, (0.0..=10.0).contains(&beyond), "from 0 to 10")?;
        check("flip", self.flip, (0.0..=1.0).contains(&self.flip), "from 0 to 1")?;
        let (time_step_s, limit_s) = (self.time_step_s, self.time_step_limit_s());
        check("time_step_s", time_step_s, time_step_s > 0.0, "above 0")?;
        if time_step_s > limit_s {
            return Err(RunoutError::TimeStep { time_step_s, limit_s });
        }
        let (particles, bytes) = (self.particles(), self.bytes());
        if bytes > self.memory_limit_bytes || particles > u64::from(u32::MAX / 64) {
            return Err(RunoutError::TooLarge { particles, bytes, limit_bytes: self.memory_limit_bytes });
        }
        Ok(self.release.check(&self.terrain, 0.5 * self.mesh_m)?)
    }

    /// Particles of the release, at rest.
    pub(super) fn placement(&self) -> Result<Placement, RunoutError> {
        Ok(self.release.place(&self.terrain, 0.5 * self.mesh_m)?)
    }

    /// What the dynamics are told, for particles that stand for `particle_area_m2` each.
    pub(super) fn frame<T: Real>(&self, particle_area_m2: f64) -> Frame<T> {
        let (mesh_m, time_step_s) = (self.mesh_m, self.time_step_s);
        let (from, to) = self.terrain.extent_m();
        let columns = ((to - from) / mesh_m).floor() as usize + 1;
        let bed_at = |column: usize| {
            let x = from + column as f64 * mesh_m;
            let z = self.terrain.height_m(x);
            let [nx, nz] = self.terrain.normal(x, z);
            // a node on the bed is in it, also where its height was rounded: else a plane bed has holes
            BedColumn { row: (z / mesh_m + ON_BED).floor() as i32, nx: T::of(nx), nz: T::of(nz) }
        };
        let scale = 4.0 * time_step_s * time_step_s / (self.snow.density_kg_m3 * mesh_m * mesh_m);
        Frame {
            mesh_m,
            time_step_s,
            origin_m: from,
            bed: (0..columns).map(bed_at).collect(),
            lowest_m: self.terrain.lowest_m(),
            material: Material::new(&self.snow, self.flow_rule, self.shear_norm, scale),
            plastic_strain_at_release: self.snow.plastic_strain_at_release(),
            density_kg_m3: self.snow.density_kg_m3,
            particle_area_m2,
            gravity_m_s2: GRAVITY_M_S2,
            friction: self.bed_friction,
            sticky: self.contact == Contact::Sticky,
            limited_above: self.limited_above,
            limited_beyond: self.limited_beyond,
            flip: self.flip,
            top_m: self.release.top_m(&self.terrain),
        }
    }
}

/// How far an advance came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Advance {
    /// To the time that was asked for.
    Reached,
    /// To the edge of the terrain: the flow would leave it, and the run ends.
    LeftDomain,
    /// Until nobody wanted the run any more; it may go on.
    Cancelled,
}

/// A run, in either precision.
#[derive(Clone, Debug)]
pub struct Simulation(Inner);

#[derive(Clone, Debug)]
enum Inner {
    F32(Box<Engine<f32>>),
    F64(Box<Engine<f64>>),
}

/// The same expression of an engine in either precision.
macro_rules! either {
    ($simulation:expr, $engine:ident => $value:expr) => {
        match $simulation {
            Inner::F32($engine) => $value,
            Inner::F64($engine) => $value,
        }
    };
}

impl Simulation {
    /// The release at time 0.
    ///
    /// # Errors
    /// What [`Setup::validate`] says.
    pub fn new(setup: &Setup) -> Result<Self, RunoutError> {
        setup.validate()?;
        Ok(Self(match setup.precision {
            Precision::F32 => Inner::F32(Box::new(start(setup)?)),
            Precision::F64 => Inner::F64(Box::new(start(setup)?)),
        }))
    }

    /// Advances to the first step at or after `time_s` (s since release), unless the flow leaves the terrain before.
    ///
    /// Asks at least every 500,000 particle-steps, at one step's end, whether the run is still wanted. The steps, and so the
    /// bits, do not depend on the times that are asked for.
    ///
    /// # Errors
    /// [`RunoutError::Diverged`] with the state where something is not finite any more.
    pub fn step_until(&mut self, time_s: f64, progress: &dyn Progress) -> Result<Advance, RunoutError> {
        either!(&mut self.0, engine => advance(engine, time_s, progress))
    }

    /// All particles now, in the order of release.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        either!(&self.0, engine => observe::snapshot(engine))
    }

    /// Energies now and dissipated since release, J a metre of width.
    ///
    /// The loss of the transfer is measured every 16 steps and taken for the steps between.
    #[must_use]
    pub fn energies(&self) -> Energies {
        either!(&self.0, engine => observe::energies(engine))
    }

    /// Steps since release.
    #[must_use]
    pub fn steps(&self) -> u64 {
        either!(&self.0, engine => engine.steps)
    }

    /// Number of particles.
    #[must_use]
    pub fn particles(&self) -> usize {
        either!(&self.0, engine => engine.particles())
    }

    /// Time since release, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        either!(&self.0, engine => engine.steps as f64 * engine.frame.time_step_s)
    }

    /// Mass of the snow, kg a metre of width.
    #[must_use]
    pub fn mass_kg(&self) -> f64 {
        either!(&self.0, engine => {
            engine.particles() as f64 * engine.frame.density_kg_m3 * engine.frame.particle_area_m2
        })
    }

    /// The whole state, from which [`Simulation::resume`] goes on with the same bits.
    #[must_use]
    pub fn checkpoint(&self, setup: &Setup) -> Vec<u8> {
        either!(&self.0, engine => checkpoint::save(engine, setup))
    }

    /// A run as it was when `state` was saved; `setup` must be that of the run.
    ///
    /// # Errors
    /// What [`Setup::validate`] says, and [`RunoutError::Checkpoint`] where the state is damaged or another run's.
    pub fn resume(setup: &Setup, state: &[u8]) -> Result<Self, RunoutError> {
        setup.validate()?;
        Ok(Self(match setup.precision {
            Precision::F32 => Inner::F32(Box::new(checkpoint::load(setup, state)?)),
            Precision::F64 => Inner::F64(Box::new(checkpoint::load(setup, state)?)),
        }))
    }
}

/// The release of a setup.
fn start<T: Real>(setup: &Setup) -> Result<Engine<T>, RunoutError> {
    let placement = setup.placement()?;
    let released: Vec<Released> = std::iter::zip(&placement.x_m, &placement.z_m)
        .map(|(&x, &z)| Released { position_m: [x, z], velocity_m_s: [0.0; 2], gradient_1_s: [0.0; 4] })
        .collect();
    let (particles, bytes) = (released.len() as u64, setup.bytes());
    // a slab that passed the check lies inside of the domain and is at rest
    Engine::new(setup.frame(placement.particle_area_m2), &released).map_err(|_| RunoutError::TooLarge {
        particles,
        bytes,
        limit_bytes: setup.memory_limit_bytes,
    })
}

/// See [`Simulation::step_until`].
fn advance<T: Real>(engine: &mut Engine<T>, time_s: f64, progress: &dyn Progress) -> Result<Advance, RunoutError> {
    // a time that is a multiple of the step must not cost one more by rounding; casts saturate
    let target = (time_s / engine.frame.time_step_s - 1e-6).ceil().max(0.0) as u64;
    let at_once = (BETWEEN_LOOKS / engine.particles().max(1) as u64).max(1);
    while engine.steps < target {
        if progress.cancelled() {
            return Ok(Advance::Cancelled);
        }
        let end = target.min(engine.steps + at_once);
        while engine.steps < end {
            let keep = engine.steps + 1 == end;
            match engine.step(keep) {
                Ok(()) => {}
                Err(Halt::LeftDomain) => return Ok(Advance::LeftDomain),
                Err(Halt::Diverged | Halt::TooLarge) => {
                    let dump = Box::new(observe::dump(engine));
                    return Err(RunoutError::Diverged { step: engine.steps, dump });
                }
            }
        }
    }
    Ok(Advance::Reached)
}
