//! `/v1/jobs/{jobID}/results`: what a job gave, small outputs in the document and large ones by reference.

use std::ops::RangeInclusive;

use axum::{
    extract::State,
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use http_range_header::{StartPosition, SyntacticallyCorrectRange};
use serde::Deserialize;
use serde_json::Value;
use sha2::{Digest, Sha256};
use utoipa::IntoParams;
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Path},
    jobs::{JobPath, find},
    problem::{ApiError, ApiResult},
    respond,
};
use crate::{
    domain::{
        job::{Exception, Job, Status, Transmission},
        problem::{Code, Problem},
    },
    store::jobs::OutputRecord,
};

/// The digest of a whole output (RFC 9530), also where a part of it is sent.
pub const REPR_DIGEST: HeaderName = HeaderName::from_static("repr-digest");

/// Which output of which job.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct OutputPath {
    /// Id of the job.
    #[serde(rename = "jobID")]
    #[param(rename = "jobID")]
    job_id: Uuid,
    /// Name of the output.
    #[param(example = "model_id")]
    output: String,
}

/// The results document of a successful job; of any other, why there is none.
pub async fn results(state: &AppState, job: &Job) -> ApiResult<Value> {
    match job.status {
        Status::Successful => {
            let results = state.store.job_results(job.id).await?;
            Ok(results.ok_or_else(|| Problem::internal(format!("job {} is successful without results", job.id)))?)
        }
        Status::Accepted | Status::Running => {
            let detail = format!("job {} is {}", job.id, job.status.name());
            Err(Problem::new(Code::ResultNotReady, detail).into())
        }
        Status::Dismissed => Err(Problem::new(Code::JobDismissed, format!("job {} was dismissed", job.id)).into()),
        Status::Failed => {
            let unknown = || Exception { code: String::new(), detail: "no reason is known".into() };
            let exception = job.exception.clone().unwrap_or_else(unknown);
            let code = Code::from_slug(&exception.code).unwrap_or(Code::JobFailed);
            Err(Problem::new(code, exception.detail).into())
        }
    }
}

/// What a job gave: the outputs that it was asked for in one document, or the one that was wanted as it is (`response`:
/// `raw`). Before its end that is 404 of the type `result-not-ready`; of a failed job it is why it failed.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/results", operation_id = "get_job_results", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The outputs.", content((Value = "application/json"), (String = "application/octet-stream"),
        (String = "image/svg+xml"), (String = "image/png")))))]
pub async fn get_results(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    let results = results(&state, &job).await?;
    match job.wanted.outputs.keys().next().filter(|_| job.wanted.raw) {
        Some(output) => one(&state, &conditions, &HeaderMap::new(), &job, output, &results).await,
        None => respond::resource(&conditions, &document(&job, results)),
    }
}

/// The results without what was not asked for, and with the address in place of what was wanted by reference.
fn document(job: &Job, mut results: Value) -> Value {
    let wanted = &job.wanted.outputs;
    if let Some(outputs) = results.as_object_mut().filter(|_| !wanted.is_empty()) {
        outputs.retain(|name, _| wanted.contains_key(name));
        for (name, value) in outputs {
            let stands_elsewhere = value.get("href").is_some();
            if wanted.get(name) == Some(&Transmission::Reference) && !stands_elsewhere {
                let href = format!("/v1/jobs/{}/results/{name}", job.id);
                *value = serde_json::json!({"href": href, "type": "application/json"});
            }
        }
    }
    results
}

/// One output of a job: JSON where it stands in the results document, else its bytes, of which `Range` takes a part.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/results/{output}", operation_id = "get_job_output", tag = "jobs",
    params(OutputPath, ("Range" = Option<String>, Header, description = "`bytes=first-last`, of an output by reference")),
    responses((status = 200, description = "The output.", content((Value = "application/json"), (String = "application/octet-stream"),
        (String = "image/svg+xml"), (String = "image/png"))),
              (status = 206, description = "A part of the output.", content_type = "application/octet-stream", body = String)))]
pub async fn get_output(
    State(state): State<AppState>,
    Path(path): Path<OutputPath>,
    conditions: Conditions,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    let results = results(&state, &job).await?;
    one(&state, &conditions, &headers, &job, &path.output, &results).await
}

async fn one(
    state: &AppState,
    conditions: &Conditions,
    headers: &HeaderMap,
    job: &Job,
    name: &str,
    results: &Value,
) -> ApiResult<Response> {
    let stored = state.store.job_outputs(job.id).await?.into_iter().find(|output| output.name == name);
    if let Some(output) = stored {
        return bytes(state, conditions, headers, &output).await;
    }
    let value = results.get(name).ok_or_else(|| {
        let known: Vec<&String> = results.as_object().into_iter().flat_map(|object| object.keys()).collect();
        Problem::new(Code::UnknownOutput, format!("job {} has no output {name:?}; it has {known:?}", job.id))
    })?;
    respond::resource(conditions, value)
}

async fn bytes(
    state: &AppState,
    conditions: &Conditions,
    headers: &HeaderMap,
    output: &OutputRecord,
) -> ApiResult<Response> {
    let tag = format!("\"{}\"", output.sha256);
    if conditions.is_fresh(&tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    let wanted = match wanted_range(headers, &tag, output.size) {
        Ok(wanted) => wanted,
        Err(problem) => {
            let mut refusal = ApiError(problem).into_response();
            let length = HeaderValue::from_str(&format!("bytes */{}", output.size)).map_err(Problem::internal)?;
            refusal.headers_mut().insert(header::CONTENT_RANGE, length);
            return Ok(refusal);
        }
    };
    let range = wanted.clone().map_or(0..output.size, |range| *range.start()..range.end() + 1);
    let body = state.desk.artifacts().get(&output.sha256, range).await.map_err(Problem::internal)?;
    // megabytes: not on a thread that answers others
    let (body, content_digest) = tokio::task::spawn_blocking(move || {
        let digest = digest(&Sha256::digest(&body));
        (body, digest)
    })
    .await
    .map_err(Problem::internal)?;
    let mut response = body.into_response();
    let answer = response.headers_mut();
    let value = |text: &str| HeaderValue::from_str(text).map_err(Problem::internal);
    answer.insert(header::CONTENT_TYPE, value(&output.media_type)?);
    answer.insert(header::ETAG, value(&tag)?);
    answer.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    answer.insert(REPR_DIGEST, value(&digest(&bytes_of_hex(&output.sha256)))?);
    answer.insert("content-digest", value(&content_digest)?);
    answer.insert(header::CONTENT_DISPOSITION, HeaderValue::from_static("attachment"));
    if let Some(range) = wanted {
        let place = format!("bytes {}-{}/{}", range.start(), range.end(), output.size);
        answer.insert(header::CONTENT_RANGE, value(&place)?);
        *response.status_mut() = StatusCode::PARTIAL_CONTENT;
    }
    Ok(response)
}

/// The one range that is asked for; none where all is: without `Range`, with several (which may be ignored, RFC 9110
/// section 14.2) or where `If-Range` names another version.
fn wanted_range(headers: &HeaderMap, tag: &str, size: u64) -> Result<Option<RangeInclusive<u64>>, Problem> {
    let Some(text) = headers.get(header::RANGE).and_then(|range| range.to_str().ok()) else { return Ok(None) };
    let other_version = headers.get(header::IF_RANGE).is_some_and(|version| version.as_bytes() != tag.as_bytes());
    let Ok(parsed) = http_range_header::parse_range_header(text) else { return Ok(None) };
    if other_version || parsed.ranges.len() != 1 {
        return Ok(None);
    }
    if let [SyntacticallyCorrectRange { start: StartPosition::FromLast(many), .. }] = parsed.ranges.as_slice()
        && *many > size
        && size > 0
    {
        // more than there is: the whole (RFC 9110 section 14.1.2)
        return Ok(Some(0..=size - 1));
    }
    match parsed.validate(size) {
        Ok(ranges) => Ok(ranges.into_iter().next()),
        Err(_) => {
            let detail = format!("the output has {size} bytes; Range must be bytes=first-last within them");
            Err(Problem::new(Code::RangeNotSatisfiable, detail).with("length", size.into()))
        }
    }
}

/// A SHA-256 as `Repr-Digest` and `Content-Digest` (RFC 9530) have it.
fn digest(sha256: &[u8]) -> String {
    use base64::Engine as _;
    format!("sha-256=:{}:", base64::engine::general_purpose::STANDARD.encode(sha256))
}

fn bytes_of_hex(hex: &str) -> Vec<u8> {
    (0..hex.len() / 2).filter_map(|at| u8::from_str_radix(hex.get(2 * at..2 * at + 2)?, 16).ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(text: &str) -> Result<Option<RangeInclusive<u64>>, u16> {
        let mut headers = HeaderMap::new();
        headers.insert(header::RANGE, HeaderValue::from_str(text).unwrap());
        wanted_range(&headers, "\"a\"", 100).map_err(|problem| problem.code.status())
    }

    #[test]
    fn ranges_are_those_of_rfc_9110() {
        assert_eq!(range("bytes=0-9"), Ok(Some(0..=9)));
        assert_eq!(range("bytes=90-"), Ok(Some(90..=99)));
        assert_eq!(range("bytes=-10"), Ok(Some(90..=99)));
        assert_eq!(range("bytes=-500"), Ok(Some(0..=99)));
        assert_eq!(range("bytes=90-500"), Ok(Some(90..=99)));
        assert_eq!(range("bytes=100-"), Err(416));
        assert_eq!(range("bytes=0-1,5-6"), Ok(None));
        assert_eq!(range("lines=1-2"), Ok(None));
    }

    #[test]
    fn a_digest_is_written_in_base64() {
        assert_eq!(digest(&bytes_of_hex("000102ff")), "sha-256=:AAEC/w==:");
    }
}
