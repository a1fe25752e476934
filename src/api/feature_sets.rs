//! `/v1/feature-sets`: what the machines look at, each feature with its unit and formula.

use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    extract::{Conditions, Path},
    problem::ApiResult,
    respond,
};
use crate::{
    domain::problem::{Code, Problem},
    science::forecast::{
        day::Variable,
        features::{Feature, FeatureSet, FeatureSetId},
    },
};

/// Which feature set.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct FeatureSetPath {
    /// Id of the feature set: `raw-30` or `expert`.
    #[param(example = "expert")]
    feature_set: String,
}

/// A feature: one number a day.
#[derive(Serialize, ToSchema)]
pub struct FeatureResource {
    /// Its stable name.
    #[schema(example = "new_snow_index_sum3")]
    name: String,
    /// Its unit; 1: a pure number.
    #[schema(example = "degC")]
    unit: &'static str,
    /// How it is computed; t is the base day, t-1 the calendar day before.
    formula: String,
    /// Days between the base day and the newest day that it reads.
    lag_days: u8,
    /// The variables that it reads; empty: only the calendar or the avalanche activity of earlier days.
    #[schema(value_type = Vec<String>)]
    inputs: Vec<&'static str>,
}

/// A feature set.
#[derive(Serialize, ToSchema)]
pub struct FeatureSetResource {
    /// Its id.
    #[schema(example = "expert")]
    id: String,
    /// Its version; models say which version they were trained with.
    version: u32,
    /// The features, in the order of the columns.
    features: Vec<FeatureResource>,
}

/// All feature sets.
#[derive(Serialize, ToSchema)]
pub struct FeatureSetList {
    /// All of them.
    feature_sets: Vec<FeatureSetResource>,
}

impl From<&Feature> for FeatureResource {
    fn from(feature: &Feature) -> Self {
        Self {
            name: feature.name.clone(),
            unit: feature.unit,
            formula: feature.formula.clone(),
            lag_days: feature.lag_days,
            inputs: feature.inputs.iter().map(|variable| variable.name()).collect(),
        }
    }
}

impl From<&FeatureSet> for FeatureSetResource {
    fn from(set: &FeatureSet) -> Self {
        let features = set.features.iter().map(FeatureResource::from).collect();
        Self { id: set.id.to_string(), version: set.version, features }
    }
}

/// The variables that the two sets are defined over: those of the seed's ten with the exported cumulative index. Other
/// variables of a station join in the same way; a model lists exactly its own.
pub const DEFINING: [Variable; 11] = [
    Variable::NewSnowIndex,
    Variable::RainAt900m,
    Variable::SnowDrift,
    Variable::AirTemperature,
    Variable::WindSpeed,
    Variable::WindDirection,
    Variable::CloudCover,
    Variable::FootPenetration,
    Variable::SnowTemperature,
    Variable::InsolationIndex,
    Variable::CumulativeSnowIndex,
];

/// Lists the feature sets with their features, as a station has them that reports the ten daily variables of the
/// Scottish service. Other variables join in the same way; `/v1/models/{model}/features` lists those of a model.
#[utoipa::path(get, path = "/v1/feature-sets", operation_id = "list_feature_sets", tag = "models",
    responses((status = 200, description = "The feature sets.", body = FeatureSetList)))]
pub async fn list_feature_sets(conditions: Conditions) -> ApiResult<Response> {
    let sets = FeatureSetId::ALL.map(|id| FeatureSetResource::from(&FeatureSet::new(id, &DEFINING)));
    respond::resource(&conditions, &FeatureSetList { feature_sets: sets.into() })
}

/// One feature set, as a station has it that reports the ten daily variables of the Scottish service.
#[utoipa::path(get, path = "/v1/feature-sets/{feature_set}", operation_id = "get_feature_set", tag = "models",
    params(FeatureSetPath), responses((status = 200, description = "The feature set.", body = FeatureSetResource)))]
pub async fn get_feature_set(Path(path): Path<FeatureSetPath>, conditions: Conditions) -> ApiResult<Response> {
    let id: FeatureSetId = path
        .feature_set
        .parse()
        .map_err(|_| Problem::new(Code::UnknownFeatureSet, "there are the feature sets raw-30 and expert"))?;
    respond::resource(&conditions, &FeatureSetResource::from(&FeatureSet::new(id, &DEFINING)))
}
