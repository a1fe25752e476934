//! What can be simulated: the five groups of Li et al. (2020), Table 1, four typical flows, and any terrain. [`super::plan`]
//! says what of it is refused.

use serde::{Deserialize, Serialize};

use super::material::{FlowRule, Snow};
use super::release::Slab;
use super::terrain::{SMOOTHING_M, Terrain, TerrainError};
use super::{Contact, Precision};

/// Physical time after which a run ends, s, unless it is said.
pub const END_TIME_S: f64 = 60.0;
/// Cell size of Table 1, m.
pub const MESH_M: f64 = 0.05;
/// Friction coefficient of the bed of Table 1.
pub const BED_FRICTION: f64 = 0.5;

/// A scenario by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ScenarioName {
    /// Group I of Table 1: slope of 30 degrees.
    #[serde(rename = "group-1")]
    Group1,
    /// Group II: 40 degrees.
    #[serde(rename = "group-2")]
    Group2,
    /// Group III: 50 degrees.
    #[serde(rename = "group-3")]
    Group3,
    /// Group IV: Group II, 2.5 times as large.
    #[serde(rename = "group-4")]
    Group4,
    /// Group V: Group II, 4 times as large.
    #[serde(rename = "group-5")]
    Group5,
    /// Group II with snow that shears: M 0.5, beta 0, xi 1, p0 3 kPa.
    ColdDense,
    /// Group II with snow that breaks into granules: M 1.5, beta 0.3, xi 1, p0 30 kPa.
    WarmShear,
    /// Group II with snow that glides and breaks late: M 1.5, beta 0.5, xi 1, p0 42 kPa.
    SlidingSlab,
    /// Group II with snow that glides as one body: M 0.5, beta 1, xi 0.1, p0 12 kPa.
    WarmPlug,
}

/// The ideal slope of Li et al. (2020), Figure 1 and Table 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdealSlope {
    /// Thickness of the slab normal to the slope, `h0`, m.
    pub thickness_m: f64,
    /// Length of the slab along the slope, `l0`, m.
    pub length_m: f64,
    /// Slope angle `theta`, degrees.
    pub angle_deg: f64,
    /// Radius `r` of the arc, m.
    pub radius_m: f64,
    /// Horizontal distance `L0` of the slab's centre from the end of the arc, m.
    pub distance_m: f64,
}

impl ScenarioName {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 9] = [
        Self::Group1,
        Self::Group2,
        Self::Group3,
        Self::Group4,
        Self::Group5,
        Self::ColdDense,
        Self::WarmShear,
        Self::SlidingSlab,
        Self::WarmPlug,
    ];

    /// Its slope and slab: Table 1.
    #[must_use]
    pub const fn slope(self) -> IdealSlope {
        let [thickness_m, length_m, angle_deg, radius_m, distance_m] = match self {
            Self::Group1 => [2.0, 12.0, 30.0, 10.0, 65.0],
            Self::Group3 => [2.0, 12.0, 50.0, 10.0, 65.0],
            Self::Group4 => [5.0, 30.0, 40.0, 25.0, 162.5],
            Self::Group5 => [8.0, 48.0, 40.0, 40.0, 260.0],
            _ => [2.0, 12.0, 40.0, 10.0, 65.0],
        };
        IdealSlope { thickness_m, length_m, angle_deg, radius_m, distance_m }
    }

    /// The snow of a typical flow (Li et al. 2021); none for a group, whose snow is free.
    #[must_use]
    pub const fn snow(self) -> Option<SnowInputs> {
        let [m, beta, xi, p0_kpa] = match self {
            Self::ColdDense => [0.5, 0.0, 1.0, 3.0],
            Self::WarmShear => [1.5, 0.3, 1.0, 30.0],
            Self::SlidingSlab => [1.5, 0.5, 1.0, 42.0],
            Self::WarmPlug => [0.5, 1.0, 0.1, 12.0],
            _ => return None,
        };
        Some(SnowInputs::new(m, beta, xi, p0_kpa))
    }
}

impl IdealSlope {
    /// Height of the slab's centre over the flat, m: `H0 = L0 tan(theta) - (r - h0 / 2) / cos(theta) + r`.
    #[must_use]
    pub fn drop_height_m(&self) -> f64 {
        let (sine, cosine) = self.angle_deg.to_radians().sin_cos();
        self.distance_m * sine / cosine - (self.radius_m - 0.5 * self.thickness_m) / cosine + self.radius_m
    }

    /// Where the centre of the slab is half-way down the slope, m along x: the slope ends for it at the radius of the arc
    /// less half of its thickness.
    #[must_use]
    pub fn mid_slope_m(&self) -> f64 {
        let end = -(self.radius_m - 0.5 * self.thickness_m) * self.angle_deg.to_radians().sin();
        0.5 * (end - self.distance_m)
    }

    /// The bed: the slope begins a length of the slab above its centre, and the flat is four times as long as the horizontal
    /// and the vertical way down to it.
    ///
    /// # Errors
    /// Numbers that make no such bed.
    pub fn terrain(&self) -> Result<Terrain, TerrainError> {
        let end = 4.0 * (self.distance_m + self.drop_height_m());
        Terrain::slope_arc_flat(self.angle_deg, self.radius_m, -self.distance_m - self.length_m, end)
    }

    /// The slab, with its centre at (`-L0`, `H0`).
    #[must_use]
    pub fn slab(&self, terrain: &Terrain) -> Slab {
        Slab::centred(terrain, [-self.distance_m, self.drop_height_m()], self.length_m, self.thickness_m)
    }
}

/// The snow of a release; what is left out is that of Li et al. (2020), Table 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct SnowInputs {
    /// Slope of the critical state line: internal friction, dimensionless; above 0 and at most 10. Table 1: 0.1 to 1.5.
    #[serde(rename = "M")]
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0, maximum = 10, example = 0.5))]
    pub m: f64,
    /// Tensile over compressive strength: cohesion, dimensionless; from 0 to 10. Table 1: 0 to 1.
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 10, example = 0.0))]
    pub beta: f64,
    /// Hardening factor, dimensionless; from 0.001 to 1000. Table 1: 0.1 to 10.
    #[cfg_attr(feature = "schema", schema(minimum = 0.001, maximum = 1000, example = 1.0))]
    pub xi: f64,
    /// Compressive strength at release (initial consolidation pressure), kPa; above 0 and at most Young's modulus. Table 1: 3
    /// to 30.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0, example = 3.0))]
    pub p0_kpa: f64,
    /// Density, kg/m3.
    #[serde(default = "density")]
    #[cfg_attr(feature = "schema", schema(minimum = 1, maximum = 1000, default = 250.0))]
    pub density_kg_m3: f64,
    /// Young's modulus, MPa.
    #[serde(default = "youngs_modulus")]
    #[cfg_attr(feature = "schema", schema(minimum = 0.001, maximum = 100_000, default = 3.0))]
    pub youngs_modulus_mpa: f64,
    /// Poisson's ratio, dimensionless; at least 0 and below 0.5.
    #[serde(default = "poisson_ratio")]
    #[cfg_attr(feature = "schema", schema(minimum = 0, exclusive_maximum = 0.5, default = 0.3))]
    pub poisson_ratio: f64,
}

const fn density() -> f64 {
    250.0
}

const fn youngs_modulus() -> f64 {
    3.0
}

const fn poisson_ratio() -> f64 {
    0.3
}

impl SnowInputs {
    /// Snow with the density and the elasticity of Table 1: slope of the critical state line, cohesion, hardening factor and
    /// strength in kPa.
    #[must_use]
    pub const fn new(m: f64, beta: f64, xi: f64, p0_kpa: f64) -> Self {
        let (density_kg_m3, youngs_modulus_mpa, poisson_ratio) = (density(), youngs_modulus(), poisson_ratio());
        Self { m, beta, xi, p0_kpa, density_kg_m3, youngs_modulus_mpa, poisson_ratio }
    }

    /// In SI units.
    #[must_use]
    pub fn material(&self) -> Snow {
        Snow {
            friction: self.m,
            cohesion: self.beta,
            hardening: self.xi,
            strength_pa: 1e3 * self.p0_kpa,
            density_kg_m3: self.density_kg_m3,
            youngs_modulus_pa: 1e6 * self.youngs_modulus_mpa,
            poisson_ratio: self.poisson_ratio,
        }
    }
}

/// How snow meets the bed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct BedInputs {
    /// Coulomb coefficient of friction, dimensionless; from 0 to 10.
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 10, default = 0.5))]
    pub mu: f64,
    /// Whether snow may lift off: `separable`, or `sticky`.
    #[cfg_attr(feature = "schema", schema(value_type = String, pattern = "^(separable|sticky)$", default = "separable"))]
    pub contact: Contact,
}

impl Default for BedInputs {
    fn default() -> Self {
        Self { mu: BED_FRICTION, contact: Contact::default() }
    }
}

/// How particles and grid exchange their motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct TransferInputs {
    /// Share of FLIP, dimensionless, from 0 to 1. With 0, affine particle in cell (APIC), particles have the velocity of the
    /// grid; with FLIP they keep this share of what the grid could not take of their own, which dissipates less and is noisy.
    /// They move with the grid and give its velocity gradient in either case.
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 1, default = 0.0))]
    pub flip: f64,
}

/// A bed of the caller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct TerrainInputs {
    /// Points `[x, z]` in m: x runs down the track and grows from point to point, z points up. From 2 to 100,000 points,
    /// within 20 km of 0, nowhere steeper than 80 degrees.
    #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 100_000, example = json!([[-60.0, 45.0], [0.0, 0.0], [200.0, 0.0]])))]
    pub profile: Vec<[f64; 2]>,
    /// How far from a corner of the profile its rounding begins, m.
    #[serde(default = "smoothing")]
    #[cfg_attr(feature = "schema", schema(minimum = 0.1, maximum = 20_000, default = 10.0))]
    pub smoothing_m: f64,
}

const fn smoothing() -> f64 {
    SMOOTHING_M
}

/// A slab on a bed of the caller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct ReleaseInputs {
    /// Where the bed below its middle lies, m along x.
    pub x_m: f64,
    /// Length along the bed, m.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0, example = 12.0))]
    pub length_m: f64,
    /// Thickness normal to the bed, m.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0, example = 2.0))]
    pub thickness_m: f64,
}

/// How fine the mesh is, where its size is not said.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// 0.05 m, that of Table 1, or a quarter of the slab's thickness if that is less.
    #[default]
    Default,
    /// A fortieth of the slab's thickness.
    Scaled,
    /// A twentieth of the slab's thickness.
    Quick,
}

/// What to simulate: either a `scenario`, or a `terrain` and a `release`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct RunoutInputs {
    /// A slope and a slab by name: `group-1` to `group-5` with any snow, or one of the four typical flows with its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(inline))]
    pub scenario: Option<ScenarioName>,
    /// The bed, in place of a scenario.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(inline))]
    pub terrain: Option<TerrainInputs>,
    /// The slab, in place of a scenario.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(inline))]
    pub release: Option<ReleaseInputs>,
    /// The snow; left out where the scenario is a typical flow.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(inline))]
    pub snow: Option<SnowInputs>,
    /// The bed's friction.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(inline))]
    pub bed: BedInputs,
    /// Plastic flow rule: `associative` with the hardening of a step's start, `associative_implicit` with that of its end (for
    /// beta up to 1, and several times as slow), or `nacc`.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(value_type = String, pattern = "^(associative|associative_implicit|nacc)$", default = "associative"))]
    pub flow_rule: FlowRule,
    /// How particles and grid exchange their motion.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(inline))]
    pub transfer: TransferInputs,
    /// Numbers to compute in: `f32`, or `f64`.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(value_type = String, pattern = "^(f32|f64)$", default = "f32"))]
    pub precision: Precision,
    /// How fine the mesh is, in place of `mesh_m`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(inline))]
    pub quality: Option<Quality>,
    /// Cell size, m; at most a quarter of the slab's thickness. A cell is released with four particles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(minimum = 0.001, maximum = 10))]
    pub mesh_m: Option<f64>,
    /// Time step, s, at most that in which a pressure wave crosses a cell; left out: half a cell over sqrt(E / rho), to two
    /// digits, as in Table 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub time_step_s: Option<f64>,
    /// Physical time at which the run ends if the flow is not at rest before, s.
    #[serde(default = "end_time")]
    #[cfg_attr(feature = "schema", schema(minimum = 0.1, maximum = 600, default = 60.0))]
    pub end_time_s: f64,
    /// Seed of what is random. A single run draws nothing: the seed is kept, so that all that belongs to a run is written
    /// down in one way.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 9_007_199_254_740_991_u64, default = 0))]
    pub seed: u64,
}

const fn end_time() -> f64 {
    END_TIME_S
}

impl RunoutInputs {
    /// A scenario with all that is left out by default.
    #[must_use]
    pub fn of_scenario(scenario: ScenarioName, snow: Option<SnowInputs>) -> Self {
        Self { scenario: Some(scenario), snow, ..Self::empty() }
    }

    /// A slab on a bed of the caller, with all that is left out by default.
    #[must_use]
    pub fn of_terrain(terrain: TerrainInputs, release: ReleaseInputs, snow: SnowInputs) -> Self {
        Self { terrain: Some(terrain), release: Some(release), snow: Some(snow), ..Self::empty() }
    }

    fn empty() -> Self {
        Self {
            scenario: None,
            terrain: None,
            release: None,
            snow: None,
            bed: BedInputs::default(),
            flow_rule: FlowRule::default(),
            transfer: TransferInputs::default(),
            precision: Precision::default(),
            quality: None,
            mesh_m: None,
            time_step_s: None,
            end_time_s: END_TIME_S,
            seed: 0,
        }
    }
}
