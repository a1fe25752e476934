//! What happened to a job and what it was made of: events as a stream, log, inputs, provenance.

use std::{convert::Infallible, sync::Arc, time::Duration};

use axum::{
    extract::State,
    http::HeaderMap,
    response::{
        IntoResponse, Response,
        sse::{Event, KeepAlive, Sse},
    },
};
use jiff::Timestamp;
use serde::Serialize;
use serde_json::{Value, json};
use tokio_stream::wrappers::ReceiverStream;
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Path},
    jobs::{JobPath, find, news_of},
    problem::ApiResult,
    respond,
};
use crate::{
    domain::problem::{Code, Problem},
    store::{StoreError, jobs::EventRecord},
};

/// How often a silent stream says that it lives.
const HEARTBEAT: Duration = Duration::from_secs(15);

/// The log of a job.
#[derive(Serialize, ToSchema)]
pub struct JobLog {
    /// Oldest first; at most 1000 lines are kept.
    lines: Vec<JobLogLine>,
}

/// A line of the log of a job.
#[derive(Serialize, ToSchema)]
pub struct JobLogLine {
    /// Which attempt wrote it.
    attempt: u32,
    /// When.
    at: Timestamp,
    /// `info`, `warn` or `error`.
    level: String,
    /// What.
    message: String,
}

/// An event of a stream, in the fields of `text/event-stream`.
#[derive(Serialize, ToSchema)]
pub struct StreamEvent {
    /// What `Last-Event-ID` resumes after.
    id: String,
    /// `status` or `progress`.
    event: String,
    /// JSON: the status and the attempt, or how far the attempt is.
    data: String,
}

/// What is needed to run a job again, bit for bit.
#[derive(Serialize, ToSchema)]
pub struct Provenance {
    /// The process.
    #[serde(rename = "processID")]
    process_id: String,
    /// The version of firn that computed it.
    version: String,
    /// SHA-256 of the inputs with every default filled in and of the content that they name.
    input_hash: String,
    /// The seed of everything random; null where nothing is.
    #[schema(value_type = Option<u64>)]
    seed: Value,
    /// The inputs with every default and the seed filled in.
    #[schema(value_type = Object)]
    inputs: Value,
    /// How often a worker took the job.
    attempts: u32,
    /// The worker that took it last.
    worker: Option<String>,
    /// Who submitted it; null where no key was needed.
    submitted_by: Option<String>,
    /// Time in the queue before the first attempt, s.
    queued_seconds: Option<f64>,
    /// Computing time over all attempts, s; of one that ended without a word, up to its last sign of life.
    computed_seconds: f64,
    /// How many states were stored to go on from, without those of an attempt that ended without a word.
    states: u32,
    /// For how much of the computing it stood still to save them, s.
    saving_seconds: f64,
    /// How long it took to store them, beside the computing, s.
    storing_seconds: f64,
}

/// The events of a job as a stream (`text/event-stream`): `status` and `progress`, each with an id that `Last-Event-ID`
/// resumes after. The stream ends when the job has ended, and at a shutdown.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/events", operation_id = "stream_job_events", tag = "jobs",
    params(JobPath, ("Last-Event-ID" = Option<String>, Header, description = "Resume after the event of this id")),
    responses((status = 200, description = "The events.", content_type = "text/event-stream", body = StreamEvent)))]
pub async fn stream_events(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    // a stream has no entity tag; what is no list of tags is refused here as anywhere
    _: Conditions,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    let last = headers.get("last-event-id").and_then(|id| id.to_str().ok()?.parse().ok()).unwrap_or(0);
    let turn = Arc::clone(&state.streams).try_acquire_owned().map_err(|_| {
        let detail = format!("{} streams of events are open already; poll the job instead", state.config.max_requests);
        Problem::new(Code::Overloaded, detail)
    })?;
    let (send, receive) = tokio::sync::mpsc::channel(16);
    tokio::spawn(async move {
        let _turn = turn;
        if let Err(error) = follow(&state, job.id, last, &send).await {
            tracing::warn!(job = %job.id, %error, "a stream of events was cut");
        }
    });
    let keep_alive = KeepAlive::new().interval(HEARTBEAT).text("alive");
    Ok(Sse::new(ReceiverStream::new(receive)).keep_alive(keep_alive).into_response())
}

type Sender = tokio::sync::mpsc::Sender<Result<Event, Infallible>>;

/// Sends the events of a job as they come, until it has ended, the reader has gone, or the service stops.
async fn follow(state: &AppState, id: Uuid, mut last: i64, send: &Sender) -> Result<(), StoreError> {
    let mut changes = state.desk.changes();
    let closed = state.desk.closed();
    loop {
        // looked at before the events, so that the last of them is not missed
        let ended = state.store.job(id).await?.is_none_or(|job| job.status.ended());
        for event in state.store.job_events(id, last).await? {
            last = event.sequence;
            if send.send(Ok(event_of(&event))).await.is_err() {
                return Ok(());
            }
        }
        if ended || closed.is_cancelled() {
            return Ok(());
        }
        tokio::select! {
            () = news_of(id, &mut changes) => {}
            () = closed.cancelled() => {}
            () = send.closed() => return Ok(()),
        }
    }
}

fn event_of(event: &EventRecord) -> Event {
    Event::default().id(event.sequence.to_string()).event(&event.kind).data(event.body.to_string())
}

/// The log of a job.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/log", operation_id = "get_job_log", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The log.", body = JobLog)))]
pub async fn get_log(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    let lines = state.store.job_log(job.id).await?;
    let line = |line: crate::store::jobs::LogRecord| JobLogLine {
        attempt: line.attempt,
        at: line.at,
        level: line.level,
        message: line.message,
    };
    respond::resource(&conditions, &JobLog { lines: lines.into_iter().map(line).collect() })
}

/// The inputs of a job, with every default and the seed filled in.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/inputs", operation_id = "get_job_inputs", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The inputs.", body = Object)))]
pub async fn get_inputs(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    respond::resource(&conditions, &json!({"inputs": job.inputs}))
}

/// What is needed to run a job again, bit for bit, and what it took.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/prov", operation_id = "get_job_provenance", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The provenance.", body = Provenance)))]
pub async fn get_provenance(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    let seconds = |ms: u64| Duration::from_millis(ms).as_secs_f64();
    let provenance = Provenance {
        process_id: job.process_id,
        version: job.version,
        input_hash: job.input_hash,
        seed: job.inputs.get("seed").cloned().unwrap_or(Value::Null),
        inputs: job.inputs,
        attempts: job.attempt,
        worker: job.worker,
        submitted_by: job.submitted_by,
        queued_seconds: job.started.map(|started| started.duration_since(job.created).as_secs_f64()),
        computed_seconds: seconds(job.spent.compute_ms),
        states: job.spent.states,
        saving_seconds: seconds(job.spent.saving_ms),
        storing_seconds: seconds(job.spent.storing_ms),
    };
    respond::resource(&conditions, &provenance)
}
