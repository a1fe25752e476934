//! `/v1/jobs`: how jobs are, what they gave, and giving them up (OGC API - Processes Part 1, sections 7.12, 7.13, 11, 13).

use std::fmt;

use axum::{
    Json,
    extract::State,
    http::HeaderValue,
    response::{IntoResponse, Response},
};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Path, Query, Wait},
    landing::Link,
    problem::ApiResult,
    respond,
    stations::Limit,
};
use crate::{
    clock,
    domain::{
        job::{Exception, Job, Labels, Priority, Status},
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
    pub job_id: Uuid,
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
    /// Only jobs with this label, as `name:value`; several with commas.
    #[serde(default)]
    #[param(example = "campaign:2007", pattern = "^[^:,]{1,64}:[^,]{0,256}(,[^:,]{1,64}:[^,]{0,256})*$")]
    label: Option<String>,
    /// Only the children of this job.
    #[serde(default)]
    parent: Option<Uuid>,
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
    /// How much of the newest attempt is done, 0 to 100; never falls within an attempt.
    #[schema(minimum = 0, maximum = 100)]
    progress: u8,
    /// What is being done.
    phase: Option<String>,
    /// How fast: so many `rateUnit` a second.
    rate: Option<f64>,
    /// What `rate` counts.
    rate_unit: Option<String>,
    /// Expected time to the end, s.
    eta_seconds: Option<f64>,
    /// Counts how often a worker took the job, from 1; 0: none has.
    attempt: u32,
    /// How urgent it is, 0 (last) to 9 (first).
    #[schema(value_type = u8, minimum = 0, maximum = 9)]
    priority: Priority,
    /// Names and values to find it again.
    #[schema(value_type = std::collections::BTreeMap<String, String>)]
    labels: Labels,
    /// The job whose result this one is a part of.
    parent: Option<Uuid>,
    /// True where the answer is a job that computed the same before.
    reused: bool,
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
        let mut links = vec![
            Link::json(at.clone(), "self", "this document"),
            Link::json(at.clone(), "monitor", "the status of the job"),
        ];
        if job.status == Status::Successful {
            links.push(Link::json(
                format!("{at}/results"),
                "http://www.opengis.net/def/rel/ogc/1.0/results",
                "the results",
            ));
        }
        links.push(Link::json(format!("{at}/log"), "http://www.opengis.net/def/rel/ogc/1.0/log", "the log"));
        if let Some(parent) = job.parent {
            links.push(Link::json(format!("/v1/jobs/{parent}"), "up", "the job that it is a part of"));
        }
        let ended = job.status.ended();
        Self {
            job_id: job.id,
            id: job.id,
            r#type: "process",
            process_id: job.process_id,
            status: job.status,
            progress: job.report.percent,
            phase: Some(job.report.phase).filter(|phase| !phase.is_empty()),
            rate: job.report.rate,
            rate_unit: job.report.rate_unit,
            eta_seconds: job.report.eta_seconds.filter(|_| !ended),
            attempt: job.attempt,
            priority: job.priority,
            labels: job.labels,
            parent: job.parent,
            reused: false,
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

impl StatusInfo {
    /// The same, as the answer to a request that asked for what was computed before.
    pub fn reused(job: Job) -> Self {
        Self { reused: true, ..Self::from(job) }
    }
}

/// The job of that id.
pub async fn find(state: &AppState, id: Uuid) -> ApiResult<Job> {
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

fn labels(list: Option<&str>) -> Result<Vec<(String, String)>, Problem> {
    let pair = |text: &str| {
        let pair = text
            .split_once(':')
            .filter(|(name, value)| (1..=64).contains(&name.chars().count()) && value.chars().count() <= 256);
        pair.map(|(name, value)| (name.to_owned(), value.to_owned())).ok_or_else(|| {
            let detail =
                "must be name:value, names of 1 to 64 and values of at most 256 characters, with commas between";
            Problem::field(Code::InvalidParameter, "/label", "wrong_pattern", detail)
        })
    };
    list.map_or_else(|| Ok(Vec::new()), |list| list.split(',').map(pair).collect())
}

/// The address of the page after `cursor`, with the filters of this one.
fn page_after(query: &JobsQuery, limit: u32, cursor: Uuid) -> String {
    let filters = [
        ("status", query.status.clone()),
        ("processID", query.process_id.clone()),
        ("datetime", query.datetime.map(|interval| interval.to_string())),
        ("minDuration", query.min_duration.map(|seconds| seconds.to_string())),
        ("maxDuration", query.max_duration.map(|seconds| seconds.to_string())),
        ("label", query.label.clone()),
        ("parent", query.parent.map(|id| id.to_string())),
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
        labels: labels(query.label.as_deref())?,
        parent: query.parent,
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

/// How a job is. With `Prefer: wait=N` the answer comes when the job has changed (since the `ETag` in `If-None-Match`,
/// where there is one; else when it has ended), or after N seconds.
#[utoipa::path(get, path = "/v1/jobs/{jobID}", operation_id = "get_job", tag = "jobs", params(JobPath),
    responses((status = 200, description = "Its status document.", body = StatusInfo)))]
pub async fn get_job(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
    wait: Wait,
) -> ApiResult<Response> {
    let wait = wait.within(state.config.request_timeout);
    let mut changes = state.desk.changes();
    let deadline = tokio::time::Instant::now() + wait.0;
    let closed = state.desk.closed();
    loop {
        let job = find(&state, path.job_id).await?;
        let ended = job.status.ended();
        let mut response = respond::resource(&conditions, &StatusInfo::from(job))?;
        let unchanged = response.status() == axum::http::StatusCode::NOT_MODIFIED;
        let enough = if conditions.asks_for_news() { !unchanged } else { ended };
        if enough || ended || closed.is_cancelled() || tokio::time::Instant::now() >= deadline {
            if !ended {
                response.headers_mut().insert("retry-after", HeaderValue::from_static("1"));
            }
            wait.applied(&mut response);
            return Ok(response);
        }
        tokio::select! {
            () = news_of(path.job_id, &mut changes) => {}
            () = closed.cancelled() => {}
            () = tokio::time::sleep_until(deadline) => {}
        }
    }
}

/// Waits until a job may have changed.
pub async fn news_of(id: Uuid, changes: &mut broadcast::Receiver<Uuid>) {
    loop {
        match changes.recv().await {
            Ok(changed) if changed != id => {}
            // a listener that missed some must look for itself
            Ok(_) | Err(broadcast::error::RecvError::Lagged(_)) => return,
            Err(broadcast::error::RecvError::Closed) => std::future::pending().await,
        }
    }
}

/// Gives a job up: one that has not ended is dismissed and its computation stops; one that has ended is removed, with its
/// children. An ended child is not removed before its parent: 409.
#[utoipa::path(delete, path = "/v1/jobs/{jobID}", operation_id = "dismiss_job", tag = "jobs", params(JobPath),
    responses((status = 200, description = "Its last status document.", body = StatusInfo)))]
pub async fn dismiss_job(
    State(state): State<AppState>,
    Path(path): Path<JobPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let job = find(&state, path.job_id).await?;
    let tag = respond::tag_of(&StatusInfo::from(job.clone()))?;
    if !conditions.permit_write(tag.to_str().ok()) {
        return Err(StoreError::Precondition.into());
    }
    match state.desk.dismiss(job.id).await {
        Ok(()) => Ok(Json(StatusInfo::from(find(&state, path.job_id).await?)).into_response()),
        Err(StoreError::Transition(_)) => match state.desk.remove(job.id).await {
            Ok(()) => Ok(Json(StatusInfo::from(job)).into_response()),
            Err(StoreError::Missing) => Err(gone(job.id).into()),
            Err(StoreError::Child(parent)) => {
                let detail = format!("job {} is part of job {parent} and is removed with it", job.id);
                Err(Problem::new(Code::PartOfAnotherJob, detail).into())
            }
            Err(error) => Err(error.into()),
        },
        Err(StoreError::Missing) => Err(gone(job.id).into()),
        Err(error) => Err(error.into()),
    }
}

fn gone(id: Uuid) -> Problem {
    Problem::new(Code::NoSuchJob, format!("job {id} was removed meanwhile"))
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
