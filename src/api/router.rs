//! Every address of the service in one list, and the layers that each request passes.

use std::time::Duration;

use axum::{
    BoxError, Router,
    error_handling::HandleErrorLayer,
    extract::{DefaultBodyLimit, Request, State},
    http::{Extensions, HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Version},
    middleware::{self, Next},
    response::{IntoResponse, Response},
};
use tower::{ServiceBuilder, limit::GlobalConcurrencyLimitLayer};
use tower_http::{
    catch_panic::CatchPanicLayer,
    compression::{CompressionLayer, Predicate as _, predicate::DefaultPredicate},
    csrf::CsrfLayer,
    request_id::{MakeRequestId, PropagateRequestIdLayer, RequestId, SetRequestIdLayer},
    trace::TraceLayer,
};
use utoipa::OpenApi;
use utoipa_axum::{router::OpenApiRouter, routes};

use super::{
    AppState, active_models, audit, auth, avalanches, bulletins, dataset_hits, datasets, docs,
    extract::BodyLimit,
    feature_sets, forecasts, health, imports, issued, job_frames, job_history,
    job_results::{self, REPR_DIGEST},
    jobs, landing, metrics, models, observations, openapi, overview,
    problem::{ApiError, REQUEST_ID, from_panic},
    processes, proposals, region_forecasts, regions, scenarios, selections, stations, transfers, verification, what_if,
};
use crate::domain::{
    ids::new_id,
    problem::{Code, Problem},
};

const REQUEST_ID_HEADER: HeaderName = HeaderName::from_static("x-request-id");

/// A request id from outside is kept only up to this length: it goes into every log line.
const LONGEST_REQUEST_ID: usize = 128;

/// Answered however busy the service is: whoever watches it must not end a process that works hard.
fn vital_signs() -> OpenApiRouter<AppState> {
    OpenApiRouter::with_openapi(openapi::Document::openapi())
        .routes(routes!(health::livez))
        .routes(routes!(health::readyz))
        .routes(routes!(metrics::metrics))
}

fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        // the service itself
        .routes(routes!(docs::openapi_json))
        .routes(routes!(docs::list_problems))
        .routes(routes!(docs::get_problem))
        .routes(routes!(audit::list_audit))
        // OGC API - Processes
        .routes(routes!(landing::landing_page))
        .routes(routes!(landing::conformance))
        .routes(routes!(processes::list_processes))
        .routes(routes!(processes::get_process))
        .routes(routes!(processes::execute_process))
        .routes(routes!(scenarios::list_scenarios))
        .routes(routes!(jobs::list_jobs))
        .routes(routes!(jobs::get_job, jobs::dismiss_job))
        .routes(routes!(job_results::get_results))
        .routes(routes!(job_results::get_output))
        .routes(routes!(job_frames::list_frames))
        .routes(routes!(job_frames::get_frame))
        .routes(routes!(job_history::stream_events))
        .routes(routes!(job_history::get_log))
        .routes(routes!(job_history::get_inputs))
        .routes(routes!(job_history::get_provenance))
        // stations and their days
        .routes(routes!(stations::list_stations))
        .routes(routes!(stations::get_station, stations::put_station))
        .routes(routes!(observations::list_observations, imports::import_observations))
        .routes(routes!(observations::get_observation, observations::put_observation))
        .routes(routes!(observations::list_revisions))
        .routes(routes!(avalanches::get_avalanches, avalanches::put_avalanches))
        .routes(routes!(avalanches::list_revisions))
        // acoustic emission
        .routes(routes!(datasets::list_datasets, datasets::create_dataset))
        .routes(routes!(datasets::get_dataset, datasets::put_dataset, datasets::delete_dataset))
        .routes(routes!(dataset_hits::list_hits))
        .routes(routes!(dataset_hits::get_picture))
        // models and forecasts
        .routes(routes!(feature_sets::list_feature_sets))
        .routes(routes!(feature_sets::get_feature_set))
        .routes(routes!(models::list_models))
        .routes(routes!(models::get_model))
        .routes(routes!(models::get_evaluation))
        .routes(routes!(models::get_features))
        .routes(routes!(selections::get_selection))
        .routes(routes!(overview::list_station_forecasts))
        .routes(routes!(transfers::list_transfers))
        .routes(routes!(active_models::get_active_model, active_models::put_active_model))
        .routes(routes!(active_models::roll_back_model))
        .routes(routes!(proposals::list_proposals))
        .routes(routes!(proposals::accept_proposal))
        .routes(routes!(proposals::decline_proposal))
        .routes(routes!(regions::list_regions))
        .routes(routes!(regions::get_region, regions::put_region))
        .routes(routes!(active_models::get_region_model, active_models::put_region_model))
        .routes(routes!(active_models::roll_back_region_model))
        .routes(routes!(proposals::list_region_proposals))
        .routes(routes!(proposals::accept_region_proposal))
        .routes(routes!(proposals::decline_region_proposal))
        .routes(routes!(region_forecasts::get_region_forecast))
        .routes(routes!(forecasts::list_forecasts))
        .routes(routes!(forecasts::get_latest_forecast))
        .routes(routes!(forecasts::get_forecast, issued::issue_forecast))
        .routes(routes!(forecasts::list_similar_days))
        .routes(routes!(forecasts::explain_forecast))
        .routes(routes!(what_if::ask_what_if))
        .routes(routes!(issued::get_issued_forecast))
        .routes(routes!(issued::put_forecaster_call))
        .routes(routes!(verification::verify_forecasts))
        .routes(routes!(bulletins::list_bulletins))
        .routes(routes!(bulletins::get_bulletin))
}

/// The contract of all addresses, before [`openapi`] completes it.
#[must_use]
pub fn document() -> utoipa::openapi::OpenApi {
    vital_signs().merge(routes()).into_openapi()
}

/// The whole service.
pub fn router(state: AppState) -> Router {
    let (router, _) = routes().split_for_parts();
    let router = router.merge(crate::web::router());
    let (vital_signs, _) = vital_signs().split_for_parts();
    let limits = ServiceBuilder::new()
        .layer(HandleErrorLayer::new(limit_reached))
        .load_shed()
        // one count for all addresses: a plain limit would count each of them by itself
        .layer(GlobalConcurrencyLimitLayer::new(state.config.max_requests));
    router
        .fallback(not_found)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(middleware::from_fn_with_state(state.clone(), auth::authenticate))
        .layer(CsrfLayer::new().with_rejection_response(cross_origin))
        .layer(DefaultBodyLimit::max(state.config.max_body_bytes))
        .layer(axum::Extension(BodyLimit(state.config.max_body_bytes)))
        .layer(middleware::from_fn_with_state(state.clone(), in_time))
        .layer(limits)
        .merge(vital_signs.method_not_allowed_fallback(method_not_allowed))
        .layer(CatchPanicLayer::custom(from_panic))
        .layer(CompressionLayer::new().compress_when(DefaultPredicate::new().and(has_no_digest)))
        .layer(middleware::from_fn(with_request_id))
        .layer(middleware::from_fn_with_state(state.clone(), metrics::time_requests))
        .layer(TraceLayer::new_for_http().make_span_with(request_span).on_response(log_response))
        .layer(PropagateRequestIdLayer::new(REQUEST_ID_HEADER))
        .layer(SetRequestIdLayer::new(REQUEST_ID_HEADER, NewRequestId))
        .layer(middleware::from_fn(drop_long_request_id))
        .with_state(state)
}

/// A digest is of the bytes as they are sent, and parts of them must fit together: they stay as they are stored.
fn has_no_digest(_: StatusCode, _: Version, headers: &HeaderMap, _: &Extensions) -> bool {
    !headers.contains_key(REPR_DIGEST)
}

#[derive(Clone, Copy)]
struct NewRequestId;

impl MakeRequestId for NewRequestId {
    fn make_request_id<B>(&mut self, _: &axum::http::Request<B>) -> Option<RequestId> {
        HeaderValue::from_str(&new_id().to_string()).ok().map(RequestId::new)
    }
}

async fn drop_long_request_id(mut request: Request, next: Next) -> Response {
    if request.headers().get(REQUEST_ID_HEADER).is_some_and(|id| id.len() > LONGEST_REQUEST_ID) {
        request.headers_mut().remove(REQUEST_ID_HEADER);
    }
    next.run(request).await
}

fn request_id(request: &Request) -> String {
    let id = request.headers().get(REQUEST_ID_HEADER);
    id.and_then(|id| id.to_str().ok()).unwrap_or_default().to_owned()
}

/// Makes the request id known to every problem document of the request.
async fn with_request_id(request: Request, next: Next) -> Response {
    let id = request_id(&request);
    REQUEST_ID.scope(id, next.run(request)).await
}

fn request_span(request: &Request) -> tracing::Span {
    let id = request_id(request);
    tracing::info_span!("request", id, method = %request.method(), path = request.uri().path())
}

fn log_response(response: &Response, latency: Duration, _: &tracing::Span) {
    let latency_ms = latency.as_secs_f64() * 1e3;
    tracing::info!(status = response.status().as_u16(), latency_ms, "answered");
}

/// Gives up what is not answered in time; an upload has longer, as it is as long as its file.
async fn in_time(State(state): State<AppState>, request: Request, next: Next) -> Response {
    let uploads = request.method() == Method::POST && request.uri().path() == "/v1/datasets";
    let config = &state.config;
    let time = if uploads { config.upload_timeout } else { config.request_timeout };
    match tokio::time::timeout(time.max(Duration::from_secs(1)), next.run(request)).await {
        Ok(response) => response,
        Err(_) => {
            let detail = "the request was not answered in time; send large data in parts";
            ApiError(Problem::new(Code::RequestTimeout, detail)).into_response()
        }
    }
}

async fn limit_reached(error: BoxError) -> Response {
    let problem = if error.is::<tower::load_shed::error::Overloaded>() {
        Problem::new(Code::Overloaded, "too many requests are being worked on")
    } else {
        Problem::internal(error)
    };
    ApiError(problem).into_response()
}

fn cross_origin(_: tower_http::csrf::ProtectionError) -> Response {
    ApiError(Problem::new(Code::CrossOrigin, "the request comes from a page of another origin")).into_response()
}

async fn not_found(request: Request) -> ApiError {
    ApiError(Problem::new(Code::NotFound, format!("there is nothing at {}", request.uri().path())))
}

async fn method_not_allowed(request: Request) -> ApiError {
    let detail =
        format!("{} does not take {}; the Allow header lists what it takes", request.uri().path(), request.method());
    ApiError(Problem::new(Code::MethodNotAllowed, detail))
}
