//! The contract and the meaning of its problems, served by the service itself.

use axum::{
    Json,
    http::{HeaderValue, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    extract::{Conditions, Path},
    openapi,
    problem::ApiResult,
    respond,
};
use crate::domain::problem::{Code, Problem};

/// One kind of problem.
#[derive(Serialize, ToSchema)]
pub struct ProblemKind {
    /// Its stable name: the `code` of a problem document.
    pub code: &'static str,
    /// Its URI: the `type` of a problem document.
    pub r#type: String,
    /// The status that goes with it.
    pub status: u16,
    /// In a few words.
    pub title: &'static str,
    /// What it means and what to do about it.
    pub help: &'static str,
}

impl From<Code> for ProblemKind {
    fn from(code: Code) -> Self {
        Self {
            code: code.slug(),
            r#type: code.type_uri(),
            status: code.status(),
            title: code.title(),
            help: code.help(),
        }
    }
}

/// Which kind of problem.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct ProblemPath {
    /// The `code` of a problem document.
    #[param(example = "invalid-body")]
    code: String,
}

/// This document: OpenAPI 3.1, without references to anything outside of it.
#[utoipa::path(get, path = "/openapi.json", operation_id = "get_openapi", tag = "service",
    responses((status = 200, description = "The contract.", body = Object)))]
pub async fn openapi_json() -> Response {
    let headers = [(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))];
    (headers, openapi::text()).into_response()
}

/// Every kind of problem that the service knows.
#[utoipa::path(get, path = "/problems", operation_id = "list_problems", tag = "service",
    responses((status = 200, description = "The kinds of problems.", body = Vec<ProblemKind>)))]
pub async fn list_problems() -> Json<Vec<ProblemKind>> {
    Json(Code::ALL.iter().copied().map(ProblemKind::from).collect())
}

/// What a kind of problem means and what to do about it.
#[utoipa::path(get, path = "/problems/{code}", operation_id = "get_problem", tag = "service", params(ProblemPath),
    responses((status = 200, description = "The kind of problem.", body = ProblemKind)))]
pub async fn get_problem(Path(path): Path<ProblemPath>, conditions: Conditions) -> ApiResult<Response> {
    let code = Code::from_slug(&path.code)
        .ok_or_else(|| Problem::new(Code::NotFound, "no such kind of problem; GET /problems lists them"))?;
    respond::resource(&conditions, &ProblemKind::from(code))
}
