//! `/v1/scenarios`: the slopes and slabs that a run-out simulation knows by name.

use axum::response::Response;
use serde::Serialize;
use utoipa::ToSchema;

use super::{extract::Conditions, problem::ApiResult, respond};
use crate::science::runout::scenario::{BED_FRICTION, MESH_M, ScenarioName, SnowInputs};

/// A slope with a slab on it.
#[derive(Serialize, ToSchema)]
pub struct ScenarioResource {
    /// What the input `scenario` of the process `runout` takes.
    #[schema(value_type = String, example = "group-2")]
    id: ScenarioName,
    /// Slope angle, degrees.
    angle_deg: f64,
    /// Radius of the arc between slope and flat, m.
    radius_m: f64,
    /// Thickness of the slab normal to the slope, m.
    thickness_m: f64,
    /// Length of the slab along the slope, m.
    length_m: f64,
    /// Horizontal distance of the slab's centre from the end of the arc, m.
    distance_m: f64,
    /// Height of the slab's centre over the flat, m.
    drop_height_m: f64,
    /// Cell size unless another is asked for, m.
    mesh_m: f64,
    /// Friction coefficient of the bed unless another is asked for.
    bed_mu: f64,
    /// The snow of a typical flow; null for a group, whose snow is an input.
    snow: Option<SnowInputs>,
}

/// All scenarios.
#[derive(Serialize, ToSchema)]
pub struct ScenarioList {
    /// The five groups of Li et al. (2020), Table 1, and four typical flows on the slope of the second.
    scenarios: Vec<ScenarioResource>,
}

impl From<ScenarioName> for ScenarioResource {
    fn from(id: ScenarioName) -> Self {
        let slope = id.slope();
        Self {
            id,
            angle_deg: slope.angle_deg,
            radius_m: slope.radius_m,
            thickness_m: slope.thickness_m,
            length_m: slope.length_m,
            distance_m: slope.distance_m,
            drop_height_m: slope.drop_height_m(),
            mesh_m: MESH_M,
            bed_mu: BED_FRICTION,
            snow: id.snow(),
        }
    }
}

/// Lists the scenarios of the process `runout` with their geometry.
#[utoipa::path(get, path = "/v1/scenarios", operation_id = "list_scenarios", tag = "processes",
    responses((status = 200, description = "The scenarios.", body = ScenarioList)))]
pub async fn list_scenarios(conditions: Conditions) -> ApiResult<Response> {
    respond::resource(&conditions, &ScenarioList { scenarios: ScenarioName::ALL.map(Into::into).into() })
}
