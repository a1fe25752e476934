//! `/v1/jobs`: how jobs are, what they gave, and giving them up (OGC API - Processes Part 1, sections 7.12, 7.13, 11, 13).

use std::fmt;

use axum::{
    Json,
    extract::State,
    response::{IntoResponse, Response},
};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Path, Query},
    landing::Link,
    problem::ApiResult,
    respond,
    stations::Limit,
};
use crate::{
    clock,
    domain::{
        job::{Exception, Job, Status},
        problem::{Code, Problem},
    },
    store::{StoreError, jobs::JobFilter},
};

/// Which job.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct JobPath {
    /// Id of the job.
    #[serde(rename = "jobID")]
    #[param(rename = "jobID")]
    job_id: Uuid,
}

/// Which jobs.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct JobsQuery {
    /// Only jobs in these states, with commas: accepted, running, successful, failed, dismissed.
    #[serde(default)]
    #[param(
        example = "accepted,running",
        pattern = "^(accepted|running|successful|failed|dismissed)(,(accepted|running|successful|failed|dismissed))*$"
    )]
    status: Option<String>,
    /// Only jobs of this process.
    #[serde(default, rename = "processID")]
    #[param(rename = "processID", example = "train-model")]
    process_id: Option<String>,
    /// `process`: the only type of job there is.
    #[serde(default, rename = "type")]
    #[param(rename = "type", inline)]
    #[expect(dead_code, reason = "its only value changes nothing")]
    kind: Option<JobType>,
    /// Only jobs made at this instant or in this interval: `instant`, `from/to`, `from/..` or `../to` (RFC 3339).
    #[serde(default)]
    #[param(value_type = Option<String>, example = "2026-11-01T00:00:00Z/..", pattern = "^([0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(\\.[0-9]{1,9})?(Z|[+-][0-9]{2}:[0-9]{2})|[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(\\.[0-9]{1,9})?(Z|[+-][0-9]{2}:[0-9]{2})/([0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(\\.[0-9]{1,9})?(Z|[+-][0-9]{2}:[0-9]{2})|\\.\\.)?|(\\.\\.)?/[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(\\.[0-9]{1,9})?(Z|[+-][0-9]{2}:[0-9]{2}))$")]
    datetime: Option<Interval>,
    /// Only jobs that have run for at least this long, s.
    #[serde(default, rename = "minDuration")]
    #[param(rename = "minDuration", value_type = Option<u64>, minimum = 0, maximum = 4_294_967_295_u64)]
    min_duration: Option<u32>,
    /// Only jobs that have run for at most this long, s.
    #[serde(default, rename = "maxDuration")]
    #[param(rename = "maxDuration", value_type = Option<u64>, minimum = 0, maximum = 4_294_967_295_u64)]
    max_duration: Option<u32>,
    /// Largest number of jobs in the answer, 1 to 1000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1000, default = 100)]
    limit: Option<Limit<100, 1000>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    cursor: Option<Uuid>,
}

/// The type of a job.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum JobType {
    /// An execution of a process.
    Process,
}

/// An interval of time, open at neither, one or both ends.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "String")]
struct Interval {
    from: Option<Timestamp>,
    to: Option<Timestamp>,
}

impl TryFrom<String> for Interval {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        const RULE: &str = "must be an RFC 3339 instant or two of them with / between, .. for an open end";
        let instant = |text: &str| text.parse::<Timestamp>().map_err(|_| RULE);
        let end = |text: &str| if matches!(text, ".." | "") { Ok(None) } else { instant(text).map(Some) };
        match text.split_once('/') {
            Some((from, to)) => Ok(Self { from: end(from)?, to: end(to)? }),
            None => instant(&text).map(|at| Self { from: Some(at), to: Some(at) }),
        }
    }
}

/// The status document of a job.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct StatusInfo {
    /// Id of the job.
    #[serde(rename = "jobID")]
    job_id: Uuid,
    /// The same, as version 2 of the standard names it.
    id: Uuid,
    /// `process`
    r#type: &'static str,
    /// What it executes.
    #[serde(rename = "processID")]
    process_id: String,
    /// Where it is in its life.
    status: Status,
    /// How much is done, 0 to 100; never falls.
    #[schema(minimum = 0, maximum = 100)]
    progress: u8,
    /// What is being done.
    phase: Option<String>,
    /// A sentence on its state.
    message: Option<String>,
    /// Why it failed.
    exception: Option<Exception>,
    /// When it was accepted.
    created: Timestamp,
    /// When it was started.
    started: Option<Timestamp>,
    /// When it ended.
    finished: Option<Timestamp>,
    /// When it last changed.
    updated: Timestamp,
    /// Where to go from here.
    links: Vec<Link>,
}

/// A page of jobs.
#[derive(Serialize, ToSchema)]
pub struct JobList {
    /// Newest first.
    jobs: Vec<StatusInfo>,
    /// Where to go from here.
    links: Vec<Link>,
    /// The `cursor` of the next page; null on the last.
    next: Option<Uuid>,
}

impl From<Job> for StatusInfo {
    fn from(job: Job) -> Self {
        let at = format!("/v1/jobs/{}", job.id);
        let mut links = vec![Link::json(at.clone(), "self", "this document")];
        if job.status == Status::Successful {
            links.push(Link::json(
                format!("{at}/results"),
                "http://www.opengis.net/def/rel/ogc/1.0/results",
                "the results",
            ));
        }
        Self {
            job_id: job.id,
            id: job.id,
            r#type: "process",
            process_id: job.process_id,
            status: job.status,
            progress: job.progress,
            phase: job.phase,
            message: job.message,
            exception: job.exception,
            created: job.created,
            started: job.started,
            finished: job.finished,
            updated: job.updated,
            links,
        }
    }
}

async fn find(state: &AppState, id: Uuid) -> ApiResult<Job> {
    let job = state.store.job(id).await?;
    job.ok_or_else(|| Problem::new(Code::NoSuchJob, format!("there is no job {id}")).into())
}

fn states(list: Option<&str>) -> Result<Vec<Status>, Problem> {
    let parse = |name: &str| {
        Status::from_name(name).ok_or_else(|| {
            let detail = "must be accepted, running, successful, failed or dismissed, with commas between";
            Problem::field(Code::InvalidParameter, "/status", "not_in_list", detail)
        })
    };
    list.map_or_else(|| Ok(Vec::new()), |list| list.split(',').map(parse).collect())
}

/// The address of the page after `cursor`, with the filters of this one.
fn page_after(query: &JobsQuery, limit: u32, cursor: Uuid) -> String {
    let filters = [
        ("status", query.status.clone()),
        ("processID", query.process_id.clone()),
        ("datetime", query.datetime.map(|interval| interval.to_string())),
        ("minDuration", query.min_duration.map(|seconds| seconds.to_string())),
        ("maxDuration", query.max_duration.map(|seconds| seconds.to_string())),
        ("limit", Some(limit.to_string())),
        ("cursor", Some(cursor.to_string())),
    ];
    let given = filters.into_iter().filter_map(|(name, value)| Some((name, value?)));
    format!("/v1/jobs?{}", form_urlencoded::Serializer::new(String::new()).extend_pairs(given).finish())
}

/// Lists jobs, newest first.
#[utoipa::path(get, path = "/v1/jobs", operation_id = "list_jobs", tag = "jobs", params(JobsQuery),
    responses((status = 200, description = "A page of jobs.", body = JobList)))]
pub async fn list_jobs(
    State(state): State<AppState>,
    Query(query): Query<JobsQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let limit = Limit::or_default(query.limit);
    let filter = JobFilter {
        status: states(query.status.as_deref())?,
        process_id: query.process_id.clone().into_iter().collect(),
        created_from: query.datetime.and_then(|interval| interval.from),
        created_to: query.datetime.and_then(|interval| interval.to),
        min_duration_s: query.min_duration.map(f64::from),
        max_duration_s: query.max_duration.map(f64::from),
        before: query.cursor,
    };
    let mut jobs = state.store.jobs(&filter, clock::now(), limit + 1).await?;
    let more = jobs.len() > limit as usize;
    jobs.truncate(limit as usize);
    let next = jobs.last().filter(|_| more).map(|job| job.id);
    let mut links = vec![Link::json("/v1/jobs", "self", "this list from its beginning")];
    let next_page = next.map(|cursor| page_after(&query, limit, cursor));
    if let Some(page) = &next_page {
        links.push(Link::json(page.clone(), "next", "the next page"));
    }
    let list = JobList { jobs: jobs.into_iter().map(Into::into).collect(), links, next };
    let mut response = respond::resource(&conditions, &list)?;
    if let Some(page) = &next_page {
        respond::link_next(&mut response, page);
    }
    Ok(response)
}

/// How a job is.
#[utoipa::path(get, path = "/v1/jobs/{jobID}", operation_id = "get_job", tag = "jobs", params(JobPath),
    responses((status = 200, description = "Its status document.", body = StatusInfo)))]
pub async fn get_job(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    let ended = job.status.ended();
    let mut response = respond::resource(&conditions, &StatusInfo::from(job))?;
    if !ended {
        response.headers_mut().insert("retry-after", axum::http::HeaderValue::from_static("1"));
    }
    Ok(response)
}

/// What a job gave. Before its end that is 404 of the type `result-not-ready`; of a failed job it is why it failed.
#[utoipa::path(get, path = "/v1/jobs/{jobID}/results", operation_id = "get_job_results", tag = "jobs", params(JobPath),
    responses((status = 200, description = "All outputs in one document.", body = Object)))]
pub async fn get_results(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    match job.status {
        Status::Successful => {
            let results: Value = state
                .store
                .job_results(job.id)
                .await?
                .ok_or_else(|| Problem::internal(format!("job {} is successful without results", job.id)))?;
            respond::resource(&conditions, &results)
        }
        Status::Accepted | Status::Running => {
            Err(Problem::new(Code::ResultNotReady, format!("job {} is {}", job.id, job.status.name())).into())
        }
        Status::Dismissed => Err(Problem::new(Code::JobDismissed, format!("job {} was dismissed", job.id)).into()),
        Status::Failed => {
            let exception =
                job.exception.unwrap_or(Exception { code: String::new(), detail: "no reason is known".into() });
            let code = Code::from_slug(&exception.code).unwrap_or(Code::JobFailed);
            Err(Problem::new(code, exception.detail).into())
        }
    }
}

/// Gives a job up: one that has not ended is dismissed and its computation stops; one that has ended is removed.
#[utoipa::path(delete, path = "/v1/jobs/{jobID}", operation_id = "dismiss_job", tag = "jobs", params(JobPath),
    responses((status = 200, description = "Its last status document.", body = StatusInfo)))]
pub async fn dismiss_job(State(state): State<AppState>, Path(path): Path<JobPath>) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    match state.jobs.dismiss(job.id).await {
        Ok(()) => {
            let job = find(&state, path.job_id).await?;
            Ok(Json(StatusInfo::from(job)).into_response())
        }
        Err(StoreError::Transition(_)) => match state.store.remove_job(job.id).await {
            Ok(()) => Ok(Json(StatusInfo::from(job)).into_response()),
            Err(StoreError::Missing) => {
                Err(Problem::new(Code::NoSuchJob, format!("job {} was removed meanwhile", job.id)).into())
            }
            Err(error) => Err(error.into()),
        },
        Err(StoreError::Missing) => Err(Problem::new(Code::NoSuchJob, format!("there is no job {}", job.id)).into()),
        Err(error) => Err(error.into()),
    }
}

impl fmt::Display for Interval {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let end = |at: Option<Timestamp>| at.map_or_else(|| "..".to_owned(), |at| at.to_string());
        write!(f, "{}/{}", end(self.from), end(self.to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_open_where_they_say_so() {
        let read = |text: &str| Interval::try_from(text.to_owned());
        let at = "2026-11-01T00:00:00Z".parse().unwrap();
        assert_eq!(read("2026-11-01T00:00:00Z"), Ok(Interval { from: Some(at), to: Some(at) }));
        assert_eq!(read("2026-11-01T00:00:00Z/.."), Ok(Interval { from: Some(at), to: None }));
        assert_eq!(read("../2026-11-01T00:00:00Z"), Ok(Interval { from: None, to: Some(at) }));
        assert!(read("yesterday").is_err());
    }
}
