//! `/v1/audit`: who changed what, when and why.

use axum::{extract::State, response::Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};

use super::{
    AppState,
    extract::{Conditions, Query},
    problem::ApiResult,
    respond,
    stations::Limit,
};
use crate::store::audit::{AuditEntry, AuditFilter};

/// Which entries.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct AuditQuery {
    /// Only what was done in this way, such as `model_activated`.
    #[serde(default)]
    #[param(max_length = 100)]
    action: Option<String>,
    /// Only what was done to this address, such as `/v1/stations/lochaber/active-model`, or key, `key:ID`.
    #[serde(default)]
    #[param(max_length = 200)]
    target: Option<String>,
    /// Largest number of entries in the answer, 1 to 1000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1000, default = 100)]
    limit: Option<Limit<100, 1000>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    #[param(value_type = Option<u64>, minimum = 0, maximum = 9_007_199_254_740_991_u64)]
    cursor: Option<u64>,
}

/// Something that was changed.
#[derive(Serialize, ToSchema)]
pub struct AuditResource {
    /// Its number, rising.
    id: i64,
    /// When.
    at: Timestamp,
    /// The name of the key; null where no key was needed, and for the service itself.
    who: Option<String>,
    /// What was done: `station_created`, `station_changed`, `region_created`, `region_changed`, `model_activated`,
    /// `model_rolled_back`, `proposal_made`, `proposal_accepted`, `proposal_declined`, `key_created`, `key_revoked`.
    action: String,
    /// To what: its address, or `key:` and the id of a key.
    target: String,
    /// Why, in the words of whoever did it.
    reason: Option<String>,
    /// What was there before; null where nothing was.
    before: Option<Value>,
    /// What is there after; null where nothing is.
    after: Option<Value>,
    /// The id of the request, as in its `x-request-id` and in the log.
    trace_id: Option<String>,
}

/// A page of the audit.
#[derive(Serialize, ToSchema)]
pub struct AuditList {
    /// Newest first.
    entries: Vec<AuditResource>,
    /// The `cursor` of the next page; null on the last.
    next: Option<i64>,
}

impl From<AuditEntry> for AuditResource {
    fn from(entry: AuditEntry) -> Self {
        Self {
            id: entry.sequence,
            at: entry.at,
            who: entry.who,
            action: entry.action,
            target: entry.target,
            reason: entry.reason,
            before: entry.before,
            after: entry.after,
            trace_id: entry.trace_id,
        }
    }
}

/// Who changed what, when and why: settings of stations and regions, active models, proposals, keys. It grows only; each entry is
/// written together with its change. For the role operator.
#[utoipa::path(get, path = "/v1/audit", operation_id = "list_audit", tag = "service", params(AuditQuery),
    responses((status = 200, description = "A page of the audit.", body = AuditList)))]
pub async fn list_audit(
    State(state): State<AppState>,
    Query(query): Query<AuditQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let limit = Limit::or_default(query.limit);
    let before = query.cursor.map(|cursor| i64::try_from(cursor).unwrap_or(i64::MAX));
    let filter = AuditFilter { action: query.action, target: query.target, before };
    let mut entries = state.store.audit(&filter, limit + 1).await?;
    let more = entries.len() > limit as usize;
    entries.truncate(limit as usize);
    let next = entries.last().filter(|_| more).map(|entry| entry.sequence);
    let list = AuditList { entries: entries.into_iter().map(Into::into).collect(), next };
    let mut response = respond::resource(&conditions, &list)?;
    if let Some(cursor) = next {
        let mut query = form_urlencoded::Serializer::new(String::new());
        query.append_pair("limit", &limit.to_string()).append_pair("cursor", &cursor.to_string());
        for (name, value) in [("action", &filter.action), ("target", &filter.target)] {
            if let Some(value) = value {
                query.append_pair(name, value);
            }
        }
        respond::link_next(&mut response, &format!("/v1/audit?{}", query.finish()));
    }
    Ok(response)
}
