//! `/v1/processes`: what can be executed, and executing it (OGC API - Processes Part 1, sections 7.8 to 7.11).

use std::collections::BTreeMap;

use axum::{
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    auth::Caller,
    extract::{Body, Conditions, Path, Wait, parse_json, respond_async},
    jobs::{StatusInfo, news_of},
    landing::Link,
    problem::ApiResult,
    respond,
};
use crate::{
    domain::{
        job::{Job, Labels, Priority, Transmission, Wanted},
        problem::{Code, Problem},
        schema,
    },
    jobs::{Submission, Submitted, processes::Process},
    store::jobs::{Answer, Reservation},
};

/// Which process.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct ProcessPath {
    /// Id of the process.
    #[serde(rename = "processID")]
    #[param(rename = "processID", example = "train-model")]
    process_id: String,
}

/// A process in a list.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ProcessSummary {
    /// Id of the process.
    id: &'static str,
    /// In a few words.
    title: &'static str,
    /// In a few sentences.
    description: &'static str,
    /// The version of the process, which is that of firn.
    version: &'static str,
    /// How it can be executed.
    job_control_options: [&'static str; 2],
    /// How its outputs can be had.
    output_transmission: [&'static str; 2],
    /// Where to go from here.
    links: Vec<Link>,
}

/// The processes.
#[derive(Serialize, ToSchema)]
pub struct ProcessList {
    /// All of them.
    processes: Vec<ProcessSummary>,
    /// Where to go from here.
    links: Vec<Link>,
}

/// A process with its inputs and outputs.
#[derive(Serialize, ToSchema)]
pub struct ProcessDescription {
    /// What the list says of it.
    #[serde(flatten)]
    summary: ProcessSummary,
    /// Each input with its JSON Schema: the one that inputs are checked against.
    #[schema(value_type = Object)]
    inputs: Value,
    /// Each output with its JSON Schema.
    #[schema(value_type = Object)]
    outputs: Value,
    /// An execute request.
    #[schema(value_type = Object)]
    example: Value,
}

/// An execute request.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Execute {
    /// The inputs by name, as the process description says.
    #[serde(default)]
    #[schema(value_type = Object, required = false)]
    inputs: Option<serde_json::Map<String, Value>>,
    /// Wanted outputs by name; left out or empty: all.
    #[serde(default)]
    outputs: Option<BTreeMap<String, OutputRequest>>,
    /// Names and values to find the job again: at most 20, names of 1 to 64 characters, values of at most 256.
    #[serde(default)]
    #[schema(value_type = Option<std::collections::BTreeMap<String, String>>)]
    labels: Option<Labels>,
    /// How urgent it is, 0 (last) to 9 (first).
    #[serde(default)]
    #[schema(value_type = Option<u8>, minimum = 0, maximum = 9, default = 5)]
    priority: Option<Priority>,
    /// The form of the results; left out: `document`.
    #[serde(default)]
    response: Option<ResponseForm>,
}

/// The form of the results.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum ResponseForm {
    /// One JSON document with all outputs.
    Document,
    /// One output as it is; where the process has several, `outputs` names it.
    Raw,
}

/// How an output is wanted.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct OutputRequest {
    /// In the document (large outputs are by reference all the same), or as its address.
    #[serde(default)]
    transmission_mode: Option<TransmissionMode>,
}

/// Where an output stands.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum TransmissionMode {
    /// In the document.
    Value,
    /// At its own address.
    Reference,
}

/// Which outputs are wanted, by the names that the process has.
fn wanted(process: Process, request: &Execute) -> Result<Wanted, Problem> {
    let outputs = process.description().outputs;
    let known: Vec<&String> = outputs.as_object().into_iter().flat_map(|outputs| outputs.keys()).collect();
    let mut wanted = Wanted { raw: matches!(request.response, Some(ResponseForm::Raw)), ..Wanted::default() };
    for (name, output) in request.outputs.iter().flatten() {
        if !known.contains(&name) {
            let pointer = format!("/outputs/{}", schema::escape(name));
            return Err(Problem::field(
                Code::InvalidBody,
                pointer,
                "invalid_value",
                format!("must be one of {known:?}"),
            ));
        }
        let mode = match output.transmission_mode {
            Some(TransmissionMode::Reference) => Transmission::Reference,
            Some(TransmissionMode::Value) | None => Transmission::Value,
        };
        wanted.outputs.insert(name.clone(), mode);
    }
    if wanted.raw && wanted.outputs.is_empty() && known.len() == 1 {
        wanted.outputs.insert(known[0].clone(), Transmission::Value);
    }
    if wanted.raw && wanted.outputs.len() != 1 {
        let rule = format!("of raw results outputs must name exactly one of {known:?}");
        return Err(Problem::field(Code::InvalidBody, "/outputs", "invalid_value", rule));
    }
    Ok(wanted)
}

fn find(id: &str) -> Result<Process, Problem> {
    Process::from_id(id).ok_or_else(|| {
        let known: Vec<&str> = Process::ALL.iter().map(|process| process.id()).collect();
        Problem::new(Code::NoSuchProcess, format!("there is no process {id}; there are: {}", known.join(", ")))
    })
}

fn summary(process: Process) -> ProcessSummary {
    let description = process.description();
    let at = format!("/v1/processes/{}", description.id);
    ProcessSummary {
        id: description.id,
        title: description.title,
        description: description.description,
        version: env!("CARGO_PKG_VERSION"),
        job_control_options: ["async-execute", "dismiss"],
        output_transmission: ["value", "reference"],
        links: vec![
            Link::json(at.clone(), "self", "the process description"),
            Link::json(format!("{at}/execution"), "http://www.opengis.net/def/rel/ogc/1.0/execute", "execute it"),
        ],
    }
}

/// Lists the processes.
#[utoipa::path(get, path = "/v1/processes", operation_id = "list_processes", tag = "processes",
    responses((status = 200, description = "The processes.", body = ProcessList)))]
pub async fn list_processes(conditions: Conditions) -> ApiResult<Response> {
    let processes = Process::ALL.into_iter().map(summary).collect();
    let links = vec![Link::json("/v1/processes", "self", "this document")];
    respond::resource(&conditions, &ProcessList { processes, links })
}

/// One process with the JSON Schema of its inputs, the one that they are checked against.
#[utoipa::path(get, path = "/v1/processes/{processID}", operation_id = "get_process", tag = "processes", params(ProcessPath),
    responses((status = 200, description = "The process.", body = ProcessDescription)))]
pub async fn get_process(Path(path): Path<ProcessPath>, conditions: Conditions) -> ApiResult<Response> {
    let process = find(&path.process_id)?;
    let description = process.description();
    let document = ProcessDescription {
        inputs: description.input_descriptions(),
        outputs: description.outputs,
        example: description.example,
        summary: summary(process),
    };
    respond::resource(&conditions, &document)
}

/// Executes a process as a job. The inputs are checked in full first: where they are at fault, there is no job.
///
/// * `Idempotency-Key`: a request that is sent twice with the same key makes one job and has the same answer; with
///   another body it is 422, while the first is being accepted 409. A key is remembered for 24 hours.
/// * The same inputs on the same data and version were computed before: the answer is that job, `reused` is true, unless
///   `Cache-Control: no-cache` is sent. `echo` is always computed anew.
/// * `Prefer: wait=N`: the answer comes when the job has ended, or after N seconds (at most 30).
#[utoipa::path(post, path = "/v1/processes/{processID}/execution", operation_id = "execute_process", tag = "processes",
    params(ProcessPath, ("Idempotency-Key" = Option<String>, Header, pattern = "^[!-~]{1,255}$",
        description = "1 to 255 visible ASCII characters")),
    request_body(content = Execute, example = json!({"inputs": {"station": "lochaber", "label": "observed", "lead": 0}})),
    responses((status = 201, description = "The job; `Location` is its status document.", body = StatusInfo,
               headers(("Location" = String, description = "The status document of the job."),
                       ("Preference-Applied" = String, description = "What of `Prefer` was heard.")))))]
pub async fn execute_process(
    State(state): State<AppState>,
    Path(path): Path<ProcessPath>,
    caller: Caller,
    wait: Wait,
    headers: HeaderMap,
    Body(bytes): Body,
) -> ApiResult<Response> {
    let wait = wait.within(state.config.request_timeout);
    let process = find(&path.process_id)?;
    let request: Execute = parse_json(&headers, &bytes)?;
    let wanted = wanted(process, &request)?;
    let labels = request.labels.unwrap_or_default();
    check_labels(&labels)?;
    let submission = Submission {
        process,
        inputs: request.inputs.map_or_else(|| json!({}), Value::Object),
        labels,
        wanted,
        priority: request.priority.unwrap_or_default(),
        reservation: reservation(&headers, caller.name.as_deref(), process, &bytes)?,
        submitted_by: caller.name,
        anew: wants_anew(&headers),
    };
    let (location, body) = match state.desk.submit(submission, answer).await? {
        Submitted::New(answer) | Submitted::Reused(answer) | Submitted::Repeated(answer) => {
            (answer.location, answer.body)
        }
    };
    let mut response = (StatusCode::CREATED, axum::Json(&body)).into_response();
    if !wait.0.is_zero()
        && let Some(id) = body["jobID"].as_str().and_then(|id| id.parse().ok())
        && let Some(job) = wait_for_end(&state, id, wait).await?
    {
        let reused = body["reused"].as_bool().unwrap_or(false);
        let info = if reused { StatusInfo::reused(job) } else { StatusInfo::from(job) };
        response = (StatusCode::CREATED, axum::Json(info)).into_response();
        wait.applied(&mut response);
    } else if respond_async(&headers) {
        response.headers_mut().insert("preference-applied", HeaderValue::from_static("respond-async"));
    }
    if let Ok(location) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

fn answer(job: &Job, reused: bool) -> Answer {
    let info = if reused { StatusInfo::reused(job.clone()) } else { StatusInfo::from(job.clone()) };
    Answer { location: format!("/v1/jobs/{}", job.id), body: json!(info) }
}

/// Waits until a job has ended or the time is over; none where it was removed meanwhile.
async fn wait_for_end(state: &AppState, id: Uuid, wait: Wait) -> ApiResult<Option<Job>> {
    let mut changes = state.desk.changes();
    let deadline = tokio::time::Instant::now() + wait.0;
    let closed = state.desk.closed();
    loop {
        let job = state.store.job(id).await?;
        let over = closed.is_cancelled() || tokio::time::Instant::now() >= deadline;
        if over || job.as_ref().is_none_or(|job| job.status.ended()) {
            return Ok(job);
        }
        tokio::select! {
            () = news_of(id, &mut changes) => {}
            () = closed.cancelled() => {}
            () = tokio::time::sleep_until(deadline) => {}
        }
    }
}

fn wants_anew(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::CACHE_CONTROL).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|value| value.trim().eq_ignore_ascii_case("no-cache"))
}

fn check_labels(labels: &Labels) -> Result<(), Problem> {
    let good = |name: &str, value: &str| (1..=64).contains(&name.chars().count()) && value.chars().count() <= 256;
    let rule = "must be at most 20 labels, names of 1 to 64 characters without : and , and values of at most 256";
    let bad =
        labels.iter().find(|(name, value)| !good(name, value) || name.contains([':', ',']) || value.contains(','));
    match bad {
        Some((name, _)) => {
            let pointer = format!("/labels/{}", schema::escape(name));
            Err(Problem::field(Code::InvalidBody, pointer, "invalid_value", rule))
        }
        None if labels.len() > 20 => Err(Problem::field(Code::InvalidBody, "/labels", "invalid_value", rule)),
        None => Ok(()),
    }
}

fn reservation(
    headers: &HeaderMap,
    caller: Option<&str>,
    process: Process,
    body: &[u8],
) -> Result<Option<Reservation>, Problem> {
    let Some(key) = headers.get("idempotency-key") else { return Ok(None) };
    let key =
        key.to_str().ok().filter(|key| (1..=255).contains(&key.len()) && key.bytes().all(|b| b.is_ascii_graphic()));
    let key = key.ok_or_else(|| {
        Problem::new(Code::InvalidHeader, "Idempotency-Key must be 1 to 255 visible ASCII characters without spaces")
    })?;
    let mut hasher = Sha256::new();
    hasher.update(process.id());
    hasher.update([0]);
    hasher.update(body);
    let request_hash = hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Some(Reservation { caller: caller.unwrap_or_default().to_owned(), key: key.to_owned(), request_hash }))
}
