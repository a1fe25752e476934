//! `/v1` and `/v1/conformance`: where a client of OGC API begins.

use axum::response::Response;
use serde::Serialize;
use utoipa::ToSchema;

use super::{extract::Conditions, problem::ApiResult, respond};

/// A link of OGC API.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Link {
    /// Where to.
    pub href: String,
    /// What the target is to this document.
    pub rel: &'static str,
    /// Media type of the target.
    pub r#type: &'static str,
    /// The target in a few words.
    pub title: &'static str,
}

impl Link {
    /// A link to a JSON document.
    pub fn json(href: impl Into<String>, rel: &'static str, title: &'static str) -> Self {
        Self::new(href, rel, "application/json", title)
    }

    /// A link to anything.
    pub fn new(href: impl Into<String>, rel: &'static str, media_type: &'static str, title: &'static str) -> Self {
        Self { href: href.into(), rel, r#type: media_type, title }
    }
}

/// What the service is and where its parts are.
#[derive(Serialize, ToSchema)]
pub struct LandingPage {
    /// Name of the service.
    title: &'static str,
    /// What it does.
    description: &'static str,
    /// The version of firn.
    version: &'static str,
    /// Its parts.
    links: Vec<Link>,
}

/// The standards that the service keeps to.
#[derive(Serialize, ToSchema)]
pub struct Conformance {
    /// URIs of conformance classes.
    #[serde(rename = "conformsTo")]
    conforms_to: Vec<&'static str>,
}

/// The conformance classes of OGC API - Processes Part 1, version 1.0, that are kept in full.
const CLASSES: [&str; 5] = [
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/core",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/json",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/ogc-process-description",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/job-list",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/dismiss",
];

/// What the service is and where its parts are.
#[utoipa::path(get, path = "/v1", operation_id = "get_landing_page", tag = "processes",
    responses((status = 200, description = "The landing page.", body = LandingPage)))]
pub async fn landing_page(conditions: Conditions) -> ApiResult<Response> {
    let page = LandingPage {
        title: "firn",
        description: "Avalanche forecasting and simulation service",
        version: env!("CARGO_PKG_VERSION"),
        links: vec![
            Link::json("/v1", "self", "this document"),
            Link {
                href: "/openapi.json".into(),
                rel: "service-desc",
                r#type: "application/vnd.oai.openapi+json;version=3.1",
                title: "the contract",
            },
            Link { href: "/".into(), rel: "service-doc", r#type: "text/html", title: "pages for people" },
            Link::json("/v1/conformance", "http://www.opengis.net/def/rel/ogc/1.0/conformance", "conformance classes"),
            Link::json("/v1/processes", "http://www.opengis.net/def/rel/ogc/1.0/processes", "processes"),
            Link::json("/v1/jobs", "http://www.opengis.net/def/rel/ogc/1.0/job-list", "jobs"),
            Link::json("/v1/stations", "stations", "stations with their observations and forecasts"),
            Link::json("/v1/models", "models", "trained models"),
            Link::json("/v1/feature-sets", "feature-sets", "feature sets"),
            Link::json("/problems", "problems", "kinds of problems"),
        ],
    };
    respond::resource(&conditions, &page)
}

/// The standards that the service keeps to.
#[utoipa::path(get, path = "/v1/conformance", operation_id = "get_conformance", tag = "processes",
    responses((status = 200, description = "The conformance classes.", body = Conformance)))]
pub async fn conformance(conditions: Conditions) -> ApiResult<Response> {
    respond::resource(&conditions, &Conformance { conforms_to: CLASSES.to_vec() })
}
