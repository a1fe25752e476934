//! `/v1/processes`: what can be executed, and executing it (OGC API - Processes Part 1, sections 7.8 to 7.11).

use axum::{
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::{IntoParams, ToSchema};

use super::{
    AppState,
    auth::Caller,
    extract::{Conditions, JsonBody, Path},
    jobs::StatusInfo,
    landing::Link,
    problem::ApiResult,
    respond,
};
use crate::{
    domain::problem::{Code, Problem},
    jobs::processes::Process,
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
    output_transmission: [&'static str; 1],
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
    /// Wanted outputs; all are served, whatever is named here.
    #[serde(default)]
    #[schema(value_type = Option<Object>)]
    #[expect(dead_code, reason = "a member that every client of the standard may send")]
    outputs: Option<serde_json::Map<String, Value>>,
    /// `document`: the only form of results that is served.
    #[serde(default)]
    #[expect(dead_code, reason = "a member that every client of the standard may send")]
    response: Option<ResponseForm>,
}

/// The form of the results.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum ResponseForm {
    /// One JSON document with all outputs.
    Document,
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
        output_transmission: ["value"],
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
#[utoipa::path(post, path = "/v1/processes/{processID}/execution", operation_id = "execute_process", tag = "processes",
    params(ProcessPath),
    request_body(content = Execute, example = json!({"inputs": {"station": "lochaber", "label": "observed", "lead": 0}})),
    responses((status = 201, description = "The job is accepted; `Location` is its status document.", body = StatusInfo,
               headers(("Location" = String, description = "The status document of the job."),
                       ("Preference-Applied" = String, description = "`respond-async` where it was asked for.")))))]
pub async fn execute_process(
    State(state): State<AppState>,
    Path(path): Path<ProcessPath>,
    caller: Caller,
    headers: HeaderMap,
    JsonBody(request): JsonBody<Execute>,
) -> ApiResult<Response> {
    let process = find(&path.process_id)?;
    let inputs = request.inputs.map_or_else(|| json!({}), Value::Object);
    let job = state.jobs.submit(process, &inputs, caller.name).await?;
    let location = format!("/v1/jobs/{}", job.id);
    let mut response = (StatusCode::CREATED, axum::Json(StatusInfo::from(job))).into_response();
    if let Ok(location) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    let prefers = headers.get_all("prefer").iter().filter_map(|value| value.to_str().ok());
    if prefers.flat_map(|value| value.split(',')).any(|value| value.trim().eq_ignore_ascii_case("respond-async")) {
        response.headers_mut().insert("preference-applied", HeaderValue::from_static("respond-async"));
    }
    Ok(response)
}
