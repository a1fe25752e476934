//! `/v1/jobs/{jobID}/frames`: the frames of a run-out simulation, one by one.

use axum::{extract::State, http::HeaderMap, response::Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Path, etag},
    job_results::results,
    jobs::{JobPath, find},
    problem::ApiResult,
    respond,
};
use crate::{
    domain::problem::{Code, Problem},
    formats::film::{self, Entry},
    jobs::processes::runout::FRAMES,
    science::runout::frames::{self, Frame},
    store::jobs::OutputRecord,
};

/// Which frame of which job.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct FramePath {
    /// Id of the job.
    #[serde(rename = "jobID")]
    #[param(rename = "jobID")]
    job_id: Uuid,
    /// Number of the frame, from 0.
    #[param(example = 0)]
    frame: u32,
}

/// A frame in the list.
#[derive(Serialize, ToSchema)]
pub struct FrameEntry {
    /// Its number, from 0.
    frame: usize,
    /// Time since release, s.
    time_s: f64,
    /// Its size when packed.
    bytes: u64,
    /// Where it is.
    href: String,
}

/// The frames of a job.
#[derive(Serialize, ToSchema)]
pub struct FrameList {
    /// In the order of time.
    frames: Vec<FrameEntry>,
}

/// The frames of a job with their table.
struct Film<'a> {
    state: &'a AppState,
    output: OutputRecord,
    entries: Vec<Entry>,
}

impl<'a> Film<'a> {
    async fn of(state: &'a AppState, job_id: Uuid) -> ApiResult<Self> {
        let job = find(state, job_id).await?;
        // says why where there are none yet, or never will be
        results(state, &job).await?;
        let output = state.store.job_outputs(job.id).await?.into_iter().find(|output| output.name == FRAMES);
        let output = output.ok_or_else(|| {
            Problem::new(
                Code::UnknownOutput,
                format!("job {} is of the process {}, which has no frames", job.id, job.process_id),
            )
        })?;
        let header = read(state, &output, 0..film::HEADER_BYTES).await?;
        let table = film::table_bytes(&header).map_err(Problem::internal)?;
        let table = read(state, &output, table).await?;
        let entries = film::read_table(&table).map_err(Problem::internal)?;
        Ok(Self { state, output, entries })
    }

    async fn frame(&self, number: u32) -> ApiResult<Vec<u8>> {
        let entry = self.entries.get(number as usize).ok_or_else(|| {
            Problem::new(
                Code::UnknownOutput,
                format!("there are {} frames, counted from 0; not {number}", self.entries.len()),
            )
        })?;
        read(self.state, &self.output, entry.bytes.clone()).await
    }
}

async fn read(state: &AppState, output: &OutputRecord, range: std::ops::Range<u64>) -> ApiResult<Vec<u8>> {
    Ok(state.desk.artifacts().get(&output.sha256, range).await.map_err(Problem::internal)?)
}

/// Lists the frames of a successful run-out simulation with their times.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/frames", operation_id = "list_job_frames", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The frames.", body = FrameList)))]
pub async fn list_frames(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let film = Film::of(&state, path.job_id).await?;
    let entry = |(frame, entry): (usize, &Entry)| FrameEntry {
        frame,
        time_s: entry.time_s,
        bytes: entry.bytes.end - entry.bytes.start,
        href: format!("/v1/jobs/{}/frames/{frame}", path.job_id),
    };
    respond::resource(&conditions, &FrameList { frames: film.entries.iter().enumerate().map(entry).collect() })
}

/// One frame: every particle with its place, speed and state, in the order of release. As JSON, or packed
/// (`Accept: application/octet-stream`) in the layout that `docs/runout.md` describes.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/frames/{frame}", operation_id = "get_job_frame", tag = "jobs", params(FramePath),
    responses((status = 200, description = "The frame.", content((Frame = "application/json"), (String = "application/octet-stream")))))]
pub async fn get_frame(
    State(state): State<AppState>,
    Path(path): Path<FramePath>,
    conditions: Conditions,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let packed = respond::prefers(&headers, "application/octet-stream")
        .ok_or_else(|| Problem::new(Code::NotAcceptable, "served as application/json and application/octet-stream"))?;
    let bytes = Film::of(&state, path.job_id).await?.frame(path.frame).await?;
    if packed {
        let (tag, media_type) = (etag(&bytes), "application/octet-stream");
        return Ok(respond::tagged_bytes(&conditions, axum::http::StatusCode::OK, tag, media_type, bytes));
    }
    respond::resource(&conditions, &frames::decode(&bytes).map_err(Problem::internal)?)
}
