//! RFC 9457: how a [`Problem`] goes over the wire, and what every other layer's failure becomes.

use axum::{
    Json,
    body::Body,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;
use utoipa::ToSchema;

use crate::{
    domain::problem::{Code, FieldError, Problem},
    store::StoreError,
};

/// Shorthand of every handler.
pub type ApiResult<T> = Result<T, ApiError>;

/// A [`Problem`] on its way out.
#[derive(Debug)]
pub struct ApiError(pub Problem);

/// The problem document of RFC 9457 that every 4xx and 5xx answer is.
#[derive(Serialize, ToSchema)]
#[schema(as = Problem)]
pub struct ProblemDocument {
    /// URI of the kind of problem; a relative one is served by this service and explains itself.
    #[schema(example = "/problems/invalid-body")]
    pub r#type: String,
    /// The kind in a few words, the same for every occurrence.
    #[schema(example = "The body has unacceptable values")]
    pub title: String,
    /// The status of the answer.
    #[schema(minimum = 400, maximum = 599, example = 422)]
    pub status: u16,
    /// This occurrence, for a human.
    pub detail: String,
    /// Short stable name of the kind.
    #[schema(example = "invalid-body")]
    pub code: String,
    /// The fields at fault, where there are any.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    pub errors: Vec<FieldError>,
    /// The id of the request, which every log line of it carries.
    #[serde(rename = "traceId", skip_serializing_if = "Option::is_none")]
    pub trace_id: Option<String>,
    /// Further members, such as the `report` of an import.
    #[serde(flatten)]
    #[schema(ignore)]
    pub extensions: serde_json::Map<String, serde_json::Value>,
}

tokio::task_local! {
    /// The id of the request that is being answered.
    pub static REQUEST_ID: String;
}

impl From<Problem> for ApiError {
    fn from(problem: Problem) -> Self {
        Self(problem)
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        Self(match error {
            StoreError::Observed(date) => Problem::new(
                Code::AlreadyObserved,
                format!("the weather of {date} was observed, and no forecast replaces it; nothing was stored"),
            ),
            StoreError::Precondition => Problem::new(
                Code::PreconditionFailed,
                "the resource is not in the state that If-Match or If-None-Match asks for",
            ),
            other => Problem::internal(other),
        })
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let problem = self.0;
        let code = problem.code;
        if let Some(cause) = &problem.cause {
            tracing::error!(cause, "request failed");
        }
        let document = ProblemDocument {
            r#type: code.type_uri(),
            title: code.title().to_owned(),
            status: code.status(),
            detail: problem.detail,
            code: code.slug().to_owned(),
            errors: problem.errors,
            trace_id: REQUEST_ID.try_with(Clone::clone).ok(),
            extensions: *problem.extensions,
        };
        let status = StatusCode::from_u16(code.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let mut response = (status, Json(document)).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        match code {
            Code::Unauthorized => {
                headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"firn\""));
            }
            Code::Overloaded | Code::ShuttingDown | Code::NotReady => {
                headers.insert(header::RETRY_AFTER, HeaderValue::from_static("10"));
            }
            _ => {}
        }
        response
    }
}

/// What a panic becomes: the log has its message, the caller a problem.
pub fn from_panic(panic: Box<dyn std::any::Any + Send>) -> Response<Body> {
    let message = panic
        .downcast_ref::<String>()
        .cloned()
        .or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()))
        .unwrap_or_else(|| "panic without a message".to_owned());
    ApiError(Problem::internal(message)).into_response()
}
