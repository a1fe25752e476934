//! `/v1/stations/{station}/proposals` and those of a region: what retrainings propose, and what becomes of it.

use axum::{extract::State, response::Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    active_models::check_reason,
    auth::Caller,
    extract::{Conditions, JsonBody, Path, Query},
    landing::Link,
    problem::ApiResult,
    regions::RegionPath,
    respond,
    stations::{Limit, StationPath},
};
use crate::{
    domain::{
        ids::{Place, RegionId, StationId},
        problem::{Code, Problem},
    },
    science::forecast::evaluation::Comparison,
    store::{
        StoreError,
        proposals::{Decided, Proposal},
    },
};

/// Which proposal of which station.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct StationProposalPath {
    /// Name of the station.
    #[param(inline)]
    station: StationId,
    /// Id of the proposal.
    proposal: Uuid,
}

/// Which proposal of which region.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct RegionProposalPath {
    /// Name of the region.
    #[param(inline)]
    region: RegionId,
    /// Id of the proposal.
    proposal: Uuid,
}

/// Which proposals.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ProposalsQuery {
    /// Largest number of proposals in the answer, 1 to 100.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 100, default = 20)]
    limit: Option<Limit<20, 100>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    cursor: Option<Uuid>,
}

/// A new model beside the active one, for somebody to decide.
#[derive(Serialize, ToSchema)]
pub struct ProposalResource {
    /// Id of the proposal.
    id: Uuid,
    /// The station; null for a region.
    station: Option<StationId>,
    /// The region; null for a station.
    region: Option<RegionId>,
    /// Days between the last observation and the day that is forecast.
    lead: u8,
    /// `open`, `accepted`, `declined`, or `superseded` by a newer one before anybody decided.
    status: &'static str,
    /// The model that is proposed.
    model_id: Uuid,
    /// The model that was active when it was made, and that it was compared with.
    active_model_id: Uuid,
    /// The job that made it.
    job: Uuid,
    /// What the comparison says, in words.
    recommendation: String,
    /// Both models on the same seasons, each held out from both; null where that could not be done.
    comparison: Option<Comparison>,
    /// When it was made.
    created: Timestamp,
    /// When it was decided.
    decided: Option<Timestamp>,
    /// The name of the key that decided; null where no key was needed.
    decided_by: Option<String>,
    /// Why, in the words of whoever decided.
    reason: Option<String>,
    /// Where to go from here.
    links: Vec<Link>,
}

/// A page of proposals.
#[derive(Serialize, ToSchema)]
pub struct ProposalList {
    /// Newest first.
    proposals: Vec<ProposalResource>,
    /// The `cursor` of the next page; null on the last.
    next: Option<Uuid>,
}

/// Why a proposal is accepted or declined.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DecisionBody {
    /// Why, at most 2000 characters; it stands in the audit.
    #[serde(default)]
    #[schema(max_length = 2000)]
    reason: Option<String>,
}

impl From<Proposal> for ProposalResource {
    fn from(proposal: Proposal) -> Self {
        Self {
            links: vec![
                Link::json(format!("/v1/models/{}", proposal.model), "model", "the model that is proposed"),
                Link::json(format!("/v1/models/{}/evaluation", proposal.model), "evaluation", "its evaluation"),
                Link::json(format!("/v1/models/{}", proposal.active), "predecessor", "what it was compared with"),
            ],
            id: proposal.id,
            station: proposal.place.station().cloned(),
            region: proposal.place.region().cloned(),
            lead: proposal.lead,
            status: proposal.status.name(),
            model_id: proposal.model,
            active_model_id: proposal.active,
            job: proposal.job,
            recommendation: proposal.recommendation,
            comparison: proposal.comparison,
            created: proposal.created,
            decided: proposal.decided,
            decided_by: proposal.decided_by,
            reason: proposal.reason,
        }
    }
}

async fn exists(state: &AppState, place: &Place) -> ApiResult<()> {
    match place {
        Place::Station(id) => state.station(id).await.map(drop),
        Place::Region(id) => state.region(id).await.map(drop),
    }
}

async fn list(state: &AppState, place: &Place, query: ProposalsQuery, conditions: &Conditions) -> ApiResult<Response> {
    exists(state, place).await?;
    let limit = Limit::or_default(query.limit);
    let mut proposals = state.store.proposals(place, query.cursor, limit + 1).await?;
    let more = proposals.len() > limit as usize;
    proposals.truncate(limit as usize);
    let next = proposals.last().filter(|_| more).map(|last| last.id);
    let list = ProposalList { proposals: proposals.into_iter().map(Into::into).collect(), next };
    let mut response = respond::resource(conditions, &list)?;
    if let Some(cursor) = next {
        respond::link_next(&mut response, &format!("{}/proposals?limit={limit}&cursor={cursor}", place.path()));
    }
    Ok(response)
}

async fn decide(
    state: &AppState,
    place: &Place,
    id: Uuid,
    accept: bool,
    caller: &Caller,
    body: &DecisionBody,
) -> ApiResult<Response> {
    exists(state, place).await?;
    check_reason(body.reason.as_deref())?;
    let decided = state.store.decide_proposal(place, id, accept, body.reason.as_deref(), &caller.actor()).await;
    match decided {
        Ok(Decided::Done(proposal)) => respond::resource(&Conditions::default(), &ProposalResource::from(*proposal)),
        Ok(Decided::Closed(status)) => {
            let detail = format!("the proposal is {}; only an open one can be decided", status.name());
            Err(Problem::new(Code::ProposalClosed, detail).into())
        }
        Ok(Decided::OtherModelActive) => {
            let detail = format!("{place} has another active model than the one that the proposal was compared with");
            Err(Problem::new(Code::ProposalOutdated, detail).into())
        }
        Err(StoreError::Missing) => {
            let detail = format!("{place} has no proposal {id}; GET {}/proposals lists them", place.path());
            Err(Problem::new(Code::UnknownProposal, detail).into())
        }
        Err(error) => Err(error.into()),
    }
}

/// What retrainings of a station propose, newest first. A retraining is the process `retrain-model`, on request or each year
/// by the setting `retrain` of the station.
#[utoipa::path(get, path = "/v1/stations/{station}/proposals", operation_id = "list_proposals", tag = "models",
    params(StationPath, ProposalsQuery), responses((status = 200, description = "A page of proposals.", body = ProposalList)))]
pub async fn list_proposals(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<ProposalsQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    list(&state, &Place::Station(path.station), query, &conditions).await
}

/// Accepts a proposal: its model becomes the active one. The active model must still be the one that it was compared with.
#[utoipa::path(post, path = "/v1/stations/{station}/proposals/{proposal}/accept", operation_id = "accept_proposal",
    tag = "models", params(StationProposalPath),
    request_body(content = DecisionBody, example = json!({"reason": "one winter more"})),
    responses((status = 200, description = "The proposal now.", body = ProposalResource)))]
pub async fn accept_proposal(
    State(state): State<AppState>,
    Path(path): Path<StationProposalPath>,
    caller: Caller,
    JsonBody(body): JsonBody<DecisionBody>,
) -> ApiResult<Response> {
    decide(&state, &Place::Station(path.station), path.proposal, true, &caller, &body).await
}

/// Declines a proposal: the active model stays, and so does the proposed one in the registry.
#[utoipa::path(post, path = "/v1/stations/{station}/proposals/{proposal}/decline", operation_id = "decline_proposal",
    tag = "models", params(StationProposalPath),
    request_body(content = DecisionBody, example = json!({"reason": "too few avalanche days last winter"})),
    responses((status = 200, description = "The proposal now.", body = ProposalResource)))]
pub async fn decline_proposal(
    State(state): State<AppState>,
    Path(path): Path<StationProposalPath>,
    caller: Caller,
    JsonBody(body): JsonBody<DecisionBody>,
) -> ApiResult<Response> {
    decide(&state, &Place::Station(path.station), path.proposal, false, &caller, &body).await
}

/// What retrainings of a region propose, newest first.
#[utoipa::path(get, path = "/v1/regions/{region}/proposals", operation_id = "list_region_proposals", tag = "regions",
    params(RegionPath, ProposalsQuery), responses((status = 200, description = "A page of proposals.", body = ProposalList)))]
pub async fn list_region_proposals(
    State(state): State<AppState>,
    Path(path): Path<RegionPath>,
    Query(query): Query<ProposalsQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    list(&state, &Place::Region(path.region), query, &conditions).await
}

/// Accepts a proposal: its model becomes the active one of the region.
#[utoipa::path(post, path = "/v1/regions/{region}/proposals/{proposal}/accept", operation_id = "accept_region_proposal",
    tag = "regions", params(RegionProposalPath),
    request_body(content = DecisionBody, example = json!({"reason": "one winter more"})),
    responses((status = 200, description = "The proposal now.", body = ProposalResource)))]
pub async fn accept_region_proposal(
    State(state): State<AppState>,
    Path(path): Path<RegionProposalPath>,
    caller: Caller,
    JsonBody(body): JsonBody<DecisionBody>,
) -> ApiResult<Response> {
    decide(&state, &Place::Region(path.region), path.proposal, true, &caller, &body).await
}

/// Declines a proposal: the active model of the region stays.
#[utoipa::path(post, path = "/v1/regions/{region}/proposals/{proposal}/decline", operation_id = "decline_region_proposal",
    tag = "regions", params(RegionProposalPath),
    request_body(content = DecisionBody, example = json!({"reason": "too few avalanche days last winter"})),
    responses((status = 200, description = "The proposal now.", body = ProposalResource)))]
pub async fn decline_region_proposal(
    State(state): State<AppState>,
    Path(path): Path<RegionProposalPath>,
    caller: Caller,
    JsonBody(body): JsonBody<DecisionBody>,
) -> ApiResult<Response> {
    decide(&state, &Place::Region(path.region), path.proposal, false, &caller, &body).await
}
