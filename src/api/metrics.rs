//! `/metrics`: figures of the service in the text format of Prometheus, for whoever watches it.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    extract::{MatchedPath, Request, State},
    http::header,
    middleware::Next,
    response::{IntoResponse, Response},
};
use jiff::Timestamp;
use metrics::{counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram, with_local_recorder};
use metrics_exporter_prometheus::{BuildError, Matcher, PrometheusBuilder, PrometheusHandle, PrometheusRecorder};
use tokio_util::sync::CancellationToken;

use super::{AppState, problem::ApiResult};
use crate::{
    clock,
    jobs::{
        desk::{Tally, Write},
        processes::Process,
    },
    store::jobs::Queue,
};

/// The text format, version 0.0.4: every collector reads it.
const TEXT: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Upper bounds of the times of requests, s: from a status poll to the longest that a request may wait.
const BUCKETS: [f64; 14] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0];

/// Recorded times are sorted into their buckets at least this often: until then each is kept by itself.
const UPKEEP: Duration = Duration::from_secs(5);

const REQUESTS: &str = "firn_http_request_duration_seconds";
const QUEUE: &str = "firn_jobs_waiting";
const OLDEST: &str = "firn_jobs_oldest_waiting_seconds";
const RUNNING: &str = "firn_jobs_running";
const ATTEMPTS: &str = "firn_job_attempts_total";
const FENCED: &str = "firn_job_fenced_writes_total";
const LEASES_LOST: &str = "firn_job_leases_lost_total";
const DISMISSALS: &str = "firn_job_dismissals_total";
const BUILD: &str = "firn_build_info";

/// The figures of one server; clones share them.
#[derive(Clone)]
pub struct Metrics(Arc<Inner>);

struct Inner {
    recorder: PrometheusRecorder,
    text: PrometheusHandle,
}

impl Metrics {
    /// Figures that begin at 0.
    ///
    /// # Errors
    /// [`BuildError`] where there are no buckets.
    pub fn new() -> Result<Self, BuildError> {
        let buckets = Matcher::Full(REQUESTS.into());
        let recorder = PrometheusBuilder::new().set_buckets_for_metric(buckets, &BUCKETS)?.build_recorder();
        let metrics = Self(Arc::new(Inner { text: recorder.handle(), recorder }));
        with_local_recorder(&metrics.0.recorder, || {
            describe_histogram!(REQUESTS, "Time to the headers of an answer, by the route that took the request.");
            describe_gauge!(QUEUE, "Jobs that wait for a worker.");
            describe_gauge!(OLDEST, "Time since the job was accepted that waits longest; 0 where none waits.");
            describe_gauge!(RUNNING, "Jobs that a worker has or that wait for their children.");
            describe_counter!(ATTEMPTS, "How often a job was taken by a worker.");
            describe_counter!(FENCED, "Writes of attempts that counted no more, refused: from any worker.");
            describe_counter!(LEASES_LOST, "Attempts that ended without a word.");
            describe_counter!(DISMISSALS, "Jobs that were dismissed, children of dismissed parents included.");
            describe_gauge!(BUILD, "Always 1; the labels say what runs.");
            gauge!(BUILD, "version" => env!("CARGO_PKG_VERSION")).set(1.0);
        });
        Ok(metrics)
    }

    /// Sorts what was recorded into its buckets until `stop`.
    pub async fn upkeep(self, stop: CancellationToken) {
        while stop.run_until_cancelled(tokio::time::sleep(UPKEEP)).await.is_some() {
            self.0.text.run_upkeep();
        }
    }

    fn text(&self, tally: &Tally, queues: &[Queue], now: Timestamp) -> String {
        with_local_recorder(&self.0.recorder, || {
            for process in Process::ALL {
                let queue = queues.iter().find(|queue| queue.process_id == process.id());
                let age = queue.and_then(|queue| queue.oldest).map(|oldest| now.duration_since(oldest).as_secs_f64());
                gauge!(QUEUE, "process" => process.id()).set(queue.map_or(0.0, |queue| f64::from(queue.waiting)));
                gauge!(RUNNING, "process" => process.id()).set(queue.map_or(0.0, |queue| f64::from(queue.running)));
                gauge!(OLDEST, "process" => process.id()).set(age.unwrap_or(0.0).max(0.0));
                counter!(ATTEMPTS, "process" => process.id()).absolute(tally.attempts(process));
            }
            for write in Write::ALL {
                counter!(FENCED, "write" => write.name()).absolute(tally.fenced_writes(write));
            }
            counter!(LEASES_LOST).absolute(tally.leases_lost());
            counter!(DISMISSALS).absolute(tally.dismissals());
        });
        self.0.text.render()
    }

    fn answered(&self, method: &'static str, route: String, status: u16, time: Duration) {
        let status = status.to_string();
        with_local_recorder(&self.0.recorder, || {
            histogram!(REQUESTS, "method" => method, "route" => route, "status" => status).record(time);
        });
    }
}

/// Times every request by the route that takes it: what matches none is one route, whatever its address is.
pub async fn time_requests(State(state): State<AppState>, request: Request, next: Next) -> Response {
    let method = match request.method().as_str() {
        "GET" => "GET",
        "HEAD" => "HEAD",
        "POST" => "POST",
        "PUT" => "PUT",
        "DELETE" => "DELETE",
        _ => "other",
    };
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str).to_owned();
    let since = Instant::now();
    let response = next.run(request).await;
    state.metrics.answered(method, route, response.status().as_u16(), since.elapsed());
    response
}

/// Figures of the service in the text format of Prometheus: requests by route, the queue by process, attempts, refused
/// writes, lost leases, dismissals, version. Counts begin at 0 with every start. It needs no key and is answered however
/// busy the service is.
#[utoipa::path(get, path = "/metrics", operation_id = "get_metrics", tag = "service",
    responses((status = 200, description = "The figures.", content_type = "text/plain", body = String)))]
pub async fn metrics(State(state): State<AppState>) -> ApiResult<Response> {
    let queues = state.store.job_queues().await?;
    let text = state.metrics.text(state.desk.tally(), &queues, clock::now());
    Ok(([(header::CONTENT_TYPE, TEXT)], text).into_response())
}
