//! From inputs to all that a run needs, and what of them is refused.

use thiserror::Error;

use super::material::{ParameterError, ShearNorm, Snow};
use super::observables::Scene;
use super::regime::Indicators;
use super::release::{ReleaseError, Slab};
use super::scenario::{MESH_M, Quality, RunoutInputs, SnowInputs};
use super::terrain::{Terrain, TerrainError};
use super::{LIMITED_ABOVE, LIMITED_BEYOND, RunoutError, Setup};

/// Cells over the thickness of a slab, at least: fewer do not resolve it.
pub const LEAST_CELLS: f64 = 4.0;
/// The shortest and the longest physical time of a run, s.
pub const END_TIMES_S: (f64, f64) = (0.1, 600.0);
/// The largest seed: the largest whole number that every JSON reader keeps.
pub const LARGEST_SEED: u64 = (1 << 53) - 1;

/// What of the inputs of a run is not accepted.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InputError {
    /// A number out of its range.
    #[error("must be {accepted}, got {value}")]
    OutOfRange {
        /// Where it stands: a JSON pointer into the inputs.
        pointer: &'static str,
        /// What would be accepted.
        accepted: String,
        /// What was given, in the unit of the field.
        value: f64,
    },
    /// A field that is needed with the others.
    #[error("is missing: {needed}")]
    Missing {
        /// Where it should stand.
        pointer: &'static str,
        /// What is accepted.
        needed: &'static str,
    },
    /// A field that the others leave no room for.
    #[error("cannot be given beside `{beside}`: leave one of them out")]
    Beside {
        /// Where it stands.
        pointer: &'static str,
        /// The other field.
        beside: &'static str,
    },
    /// A bed that is none.
    #[error(transparent)]
    Terrain(#[from] TerrainError),
    /// A slab that does not lie on the bed.
    #[error(transparent)]
    Release(#[from] ReleaseError),
    /// A time step over the limit of Courant, Friedrichs & Lewy.
    #[error(
        "a time step of {time_step_s} s: at most {limit_s} s is accepted for this mesh and this snow (a pressure wave then \
             crosses a cell)"
    )]
    TimeStep {
        /// The time step given, s.
        time_step_s: f64,
        /// The longest accepted, s.
        limit_s: f64,
    },
    /// A mesh that is too fine for the memory.
    #[error(
        "a mesh of {mesh_m} m would make {particles} particles and take {bytes} bytes: at most {limit_bytes} bytes are accepted"
    )]
    TooLarge {
        /// Cell size, m.
        mesh_m: f64,
        /// Particles of the run.
        particles: u64,
        /// Bytes that it would take.
        bytes: u64,
        /// Bytes that it may take.
        limit_bytes: u64,
    },
}

impl InputError {
    /// Where in the inputs the fault stands: a JSON pointer (RFC 6901).
    #[must_use]
    pub fn pointer(&self) -> String {
        match self {
            Self::OutOfRange { pointer, .. } | Self::Missing { pointer, .. } | Self::Beside { pointer, .. } => {
                (*pointer).to_owned()
            }
            Self::Terrain(error) => match error {
                TerrainError::Coordinate { index }
                | TerrainError::NotIncreasing { index, .. }
                | TerrainError::TooSteep { index } => format!("/terrain/profile/{index}"),
                TerrainError::Smoothing { .. } => "/terrain/smoothing_m".to_owned(),
                TerrainError::Points { .. } | TerrainError::IdealSlope { .. } => "/terrain/profile".to_owned(),
            },
            Self::Release(_) => "/release".to_owned(),
            Self::TimeStep { .. } => "/time_step_s".to_owned(),
            Self::TooLarge { .. } => "/mesh_m".to_owned(),
        }
    }
}

/// A run that can be started.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The inputs with everything filled in that they left out, apart from the snow of a scenario that has its own: the same
    /// plan comes of them.
    pub inputs: RunoutInputs,
    /// What the dynamics are made of.
    pub setup: Setup,
    /// Physical time at which the run ends if the flow is not at rest before, s.
    pub end_time_s: f64,
    /// Height by which speeds are scaled, m: `H0` of Table 1; on other terrain that of the slab's centre over the lowest point.
    pub drop_height_m: f64,
    /// Where the middle of the slope is, m along x: on other terrain, where the bed below the slab has lost half of the drop.
    pub mid_slope_m: f64,
    /// What the parameters alone say of the flow.
    pub indicators: Indicators,
}

impl Plan {
    /// The plan of some inputs, for a run that may take `memory_limit_bytes`. It costs milliseconds.
    ///
    /// # Errors
    /// Everything that is not accepted, at least one.
    pub fn new(inputs: &RunoutInputs, memory_limit_bytes: u64) -> Result<Self, Vec<InputError>> {
        let mut faults = range_faults(inputs);
        let snow = match snow_of(inputs) {
            Ok(snow) => Some(snow),
            Err(fault) => {
                faults.push(fault);
                None
            }
        };
        let ground = ground_of(inputs).map_err(|fault| faults.push(fault)).ok();
        match (snow, ground) {
            (Some(snow), Some(ground)) if faults.is_empty() => {
                Self::on(inputs, snow, ground, memory_limit_bytes).map_err(|fault| vec![fault])
            }
            _ => Err(faults),
        }
    }

    /// About how many particles the run has.
    #[must_use]
    pub fn particles(&self) -> u64 {
        self.setup.particles()
    }

    /// About how many bytes of memory the run takes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.setup.bytes()
    }

    /// What an observer of the run must know, given its mass in kg a metre of width.
    #[must_use]
    pub fn scene(&self, mass_kg_m: f64) -> Scene {
        Scene {
            terrain: self.setup.terrain.clone(),
            slab: self.setup.release,
            mass_kg_m,
            mesh_m: self.setup.mesh_m,
            drop_height_m: self.drop_height_m,
            mid_slope_m: self.mid_slope_m,
            indicators: self.indicators,
        }
    }

    fn on(inputs: &RunoutInputs, snow: Snow, ground: Ground, memory_limit_bytes: u64) -> Result<Self, InputError> {
        let Ground { terrain, slab, drop_height_m, mid_slope_m } = ground;
        let mesh_m = mesh(inputs, slab.thickness_m)?;
        let mut setup = Setup {
            terrain,
            release: slab,
            snow,
            bed_friction: inputs.bed.mu,
            contact: inputs.bed.contact,
            flow_rule: inputs.flow_rule,
            shear_norm: ShearNorm::default(),
            mesh_m,
            time_step_s: 0.0,
            limited_above: LIMITED_ABOVE,
            limited_beyond: LIMITED_BEYOND,
            flip: inputs.transfer.flip,
            precision: inputs.precision,
            memory_limit_bytes,
        };
        setup.time_step_s = inputs.time_step_s.unwrap_or_else(|| usual_time_step_s(&setup));
        setup.validate().map_err(|error| input_error(error, mesh_m))?;
        let filled = RunoutInputs {
            quality: None,
            mesh_m: Some(mesh_m),
            time_step_s: Some(setup.time_step_s),
            ..inputs.clone()
        };
        let indicators = Indicators::new(&snow, slab.thickness_m, inputs.bed.mu);
        Ok(Self { inputs: filled, setup, end_time_s: inputs.end_time_s, drop_height_m, mid_slope_m, indicators })
    }
}

/// The time step of Table 1, to two digits, or the limit, down to two digits, where that is shorter.
fn usual_time_step_s(setup: &Setup) -> f64 {
    let usual = to_two_digits(Setup::usual_time_step_s(&setup.snow, setup.mesh_m), f64::round);
    usual.min(to_two_digits(setup.time_step_limit_s(), f64::floor))
}

fn to_two_digits(value: f64, round: fn(f64) -> f64) -> f64 {
    // powers of ten from their decimal text, so that 2.3e-4 is that number and not one beside it
    let digits = 1 - value.log10().floor() as i32;
    let steps = round(value * 10_f64.powi(digits));
    format!("{steps}e{}", -digits).parse().unwrap_or(value)
}

/// A bed with a slab on it.
struct Ground {
    terrain: Terrain,
    slab: Slab,
    drop_height_m: f64,
    mid_slope_m: f64,
}

fn ground_of(inputs: &RunoutInputs) -> Result<Ground, InputError> {
    match (inputs.scenario, &inputs.terrain, &inputs.release) {
        (Some(scenario), None, None) => {
            let slope = scenario.slope();
            let terrain = slope.terrain()?;
            let slab = slope.slab(&terrain);
            Ok(Ground { terrain, slab, drop_height_m: slope.drop_height_m(), mid_slope_m: slope.mid_slope_m() })
        }
        (Some(_), Some(_), _) => Err(InputError::Beside { pointer: "/terrain", beside: "scenario" }),
        (Some(_), None, Some(_)) => Err(InputError::Beside { pointer: "/release", beside: "scenario" }),
        (None, Some(terrain), Some(release)) => {
            let terrain = Terrain::from_profile(&terrain.profile, terrain.smoothing_m)?;
            let slab = Slab { x_m: release.x_m, length_m: release.length_m, thickness_m: release.thickness_m };
            // an estimate of the spacing: the mesh is not known yet
            slab.check(&terrain, 1e-9)?;
            Ok(on_profile(terrain, slab))
        }
        (None, Some(_), None) => Err(InputError::Missing {
            pointer: "/release",
            needed: "a terrain needs a slab with x_m, length_m and thickness_m",
        }),
        (None, None, Some(_)) => {
            Err(InputError::Missing { pointer: "/terrain", needed: "a release needs a terrain with a profile" })
        }
        (None, None, None) => Err(InputError::Missing {
            pointer: "/scenario",
            needed: "either a scenario, or a terrain and a release, is needed",
        }),
    }
}

fn on_profile(terrain: Terrain, slab: Slab) -> Ground {
    const LOOKS: u32 = 10_000;
    let drop_height_m = slab.centre_m(&terrain)[1] - terrain.lowest_m();
    let (from_s, to_s) = (terrain.arc_length_m(slab.x_m), terrain.length_m());
    let half = terrain.height_m(slab.x_m) - 0.5 * drop_height_m;
    let places =
        (0..=LOOKS).map(|look| terrain.at_arc_length(from_s + (to_s - from_s) * f64::from(look) / f64::from(LOOKS)));
    let below = places.into_iter().find(|place| place.z_m <= half);
    let mid_slope_m = below.map_or(terrain.extent_m().1, |place| place.x_m);
    Ground { terrain, slab, drop_height_m, mid_slope_m }
}

fn snow_of(inputs: &RunoutInputs) -> Result<Snow, InputError> {
    let own = inputs.scenario.and_then(|scenario| scenario.snow());
    let snow: SnowInputs = match (own, inputs.snow) {
        (Some(_), Some(_)) => return Err(InputError::Beside { pointer: "/snow", beside: "scenario" }),
        (Some(snow), None) | (None, Some(snow)) => snow,
        (None, None) => {
            return Err(InputError::Missing {
                pointer: "/snow",
                needed: "snow with M, beta, xi and p0_kpa is needed here",
            });
        }
    };
    let material = snow.material();
    material.validate().map_err(|error| parameter_error(&error))?;
    Ok(material)
}

fn mesh(inputs: &RunoutInputs, thickness_m: f64) -> Result<f64, InputError> {
    let coarsest = thickness_m / LEAST_CELLS;
    let mesh_m = match (inputs.mesh_m, inputs.quality.unwrap_or_default()) {
        (Some(mesh_m), _) => mesh_m,
        (None, Quality::Default) => MESH_M.min(coarsest),
        (None, Quality::Scaled) => thickness_m / 40.0,
        (None, Quality::Quick) => thickness_m / 20.0,
    };
    if mesh_m <= coarsest {
        return Ok(mesh_m);
    }
    let accepted = format!("at most {coarsest} m: a slab needs {LEAST_CELLS} cells over its thickness");
    Err(InputError::OutOfRange { pointer: "/mesh_m", accepted, value: mesh_m })
}

/// The faults of single numbers that no other module looks at.
fn range_faults(inputs: &RunoutInputs) -> Vec<InputError> {
    let mut faults = Vec::new();
    let mut check = |pointer: &'static str, value: f64, within: bool, accepted: &str| {
        if !(within && value.is_finite()) {
            faults.push(InputError::OutOfRange { pointer, accepted: accepted.to_owned(), value });
        }
    };
    let (shortest, longest) = END_TIMES_S;
    let end = inputs.end_time_s;
    check("/end_time_s", end, (shortest..=longest).contains(&end), &format!("from {shortest} to {longest} s"));
    check("/bed/mu", inputs.bed.mu, (0.0..=10.0).contains(&inputs.bed.mu), "from 0 to 10");
    let flip = inputs.transfer.flip;
    check("/transfer/flip", flip, (0.0..=1.0).contains(&flip), "from 0 to 1");
    check("/seed", inputs.seed as f64, inputs.seed <= LARGEST_SEED, "from 0 to 9007199254740991 (2^53 - 1)");
    if let Some(mesh) = inputs.mesh_m {
        check("/mesh_m", mesh, (1e-3..=10.0).contains(&mesh), "from 0.001 to 10 m");
    }
    if let Some(step) = inputs.time_step_s {
        check("/time_step_s", step, step > 0.0, "above 0 s");
    }
    if inputs.quality.is_some() && inputs.mesh_m.is_some() {
        faults.push(InputError::Beside { pointer: "/quality", beside: "mesh_m" });
    }
    faults
}

/// A parameter of the dynamics as the field of the inputs that it comes from.
fn parameter_error(error: &ParameterError) -> InputError {
    let (pointer, unit, accepted) = match error.name {
        "friction" => ("/snow/M", 1.0, error.accepted),
        "cohesion" => ("/snow/beta", 1.0, error.accepted),
        "hardening" => ("/snow/xi", 1.0, error.accepted),
        "strength_pa" => ("/snow/p0_kpa", 1e3, error.accepted),
        "density_kg_m3" => ("/snow/density_kg_m3", 1.0, error.accepted),
        "youngs_modulus_pa" => ("/snow/youngs_modulus_mpa", 1e6, "from 0.001 to 100000 MPa"),
        "poisson_ratio" => ("/snow/poisson_ratio", 1.0, error.accepted),
        "bed_friction" => ("/bed/mu", 1.0, error.accepted),
        "flip" => ("/transfer/flip", 1.0, error.accepted),
        "time_step_s" => ("/time_step_s", 1.0, error.accepted),
        _ => ("/mesh_m", 1.0, error.accepted),
    };
    InputError::OutOfRange { pointer, accepted: accepted.to_owned(), value: error.value / unit }
}

fn input_error(error: RunoutError, mesh_m: f64) -> InputError {
    match error {
        RunoutError::Parameter(error) => parameter_error(&error),
        RunoutError::Release(error) => InputError::Release(error),
        RunoutError::TimeStep { time_step_s, limit_s } => InputError::TimeStep { time_step_s, limit_s },
        RunoutError::TooLarge { particles, bytes, limit_bytes } => {
            InputError::TooLarge { mesh_m, particles, bytes, limit_bytes }
        }
        // a setup that was never run can neither break nor be resumed
        RunoutError::Diverged { .. } | RunoutError::Checkpoint(_) => {
            InputError::Missing { pointer: "", needed: "a run that can be started" }
        }
    }
}
