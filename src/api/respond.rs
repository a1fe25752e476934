//! How answers look: JSON with an entity tag, 304 where the caller has it already, links to the next page.

use axum::{
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;

use super::{
    extract::{Conditions, etag},
    problem::ApiResult,
};
use crate::domain::problem::Problem;

/// A resource as JSON with an entity tag made from its bytes; 304 where the caller has these bytes.
pub fn resource<T: Serialize>(conditions: &Conditions, value: &T) -> ApiResult<Response> {
    let body = serde_json::to_vec(value).map_err(Problem::internal)?;
    let tag = etag(&body);
    Ok(tagged_bytes(conditions, StatusCode::OK, tag, "application/json", body))
}

/// The entity tag that [`resource`] gives `value`.
///
/// # Errors
/// A [`Problem`] where it cannot be written as JSON.
pub fn tag_of<T: Serialize>(value: &T) -> ApiResult<HeaderValue> {
    Ok(etag(&serde_json::to_vec(value).map_err(Problem::internal)?))
}

/// The same with the entity tag that writes are checked against.
pub fn tagged<T: Serialize>(conditions: &Conditions, status: StatusCode, tag: &str, value: &T) -> ApiResult<Response> {
    let body = serde_json::to_vec(value).map_err(Problem::internal)?;
    let tag = HeaderValue::from_str(tag).map_err(Problem::internal)?;
    Ok(tagged_bytes(conditions, status, tag, "application/json", body))
}

/// Bytes of any media type with their entity tag.
pub fn tagged_bytes(
    conditions: &Conditions,
    status: StatusCode,
    tag: HeaderValue,
    media_type: &'static str,
    body: Vec<u8>,
) -> Response {
    let seen = status == StatusCode::OK && tag.to_str().is_ok_and(|tag| conditions.is_fresh(tag));
    if seen {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response();
    }
    let headers = [(header::CONTENT_TYPE, HeaderValue::from_static(media_type)), (header::ETAG, tag)];
    (status, headers, body).into_response()
}

/// Adds `Link: <url>; rel="next"`.
pub fn link_next(response: &mut Response, url: &str) {
    if let Ok(value) = HeaderValue::from_str(&format!("<{url}>; rel=\"next\"")) {
        response.headers_mut().insert(header::LINK, value);
    }
}

/// Whether the caller prefers `media_type` to JSON by its `Accept`; none where it accepts neither.
pub fn prefers(headers: &axum::http::HeaderMap, media_type: &str) -> Option<bool> {
    let Some(accept) = headers.get(header::ACCEPT) else { return Some(false) };
    let accept = accept.to_str().ok()?.to_ascii_lowercase();
    let quality = |wanted: &[&str]| -> f32 {
        accept
            .split(',')
            .filter_map(|range| {
                let mut parts = range.split(';').map(str::trim);
                let name = parts.next()?;
                let q = parts.find_map(|part| part.strip_prefix("q=")?.parse().ok()).unwrap_or(1.0);
                wanted.contains(&name).then_some(q)
            })
            .fold(0.0, f32::max)
    };
    let json = quality(&["application/json", "application/*"]);
    let family = media_type.split('/').next().map(|family| format!("{family}/*")).unwrap_or_default();
    // a range that covers both prefers neither
    let other = if family == "application/*" { quality(&[media_type]) } else { quality(&[media_type, &family]) };
    let any = quality(&["*/*"]);
    if other > json.max(any) {
        Some(true)
    } else if json > 0.0 || any > 0.0 {
        Some(false)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_preferred_is_served() {
        let wants = |accept: &str| {
            let mut headers = axum::http::HeaderMap::new();
            headers.insert(header::ACCEPT, HeaderValue::from_str(accept).unwrap());
            prefers(&headers, "text/csv")
        };
        assert_eq!(wants("text/csv"), Some(true));
        assert_eq!(wants("application/json"), Some(false));
        assert_eq!(wants("*/*"), Some(false));
        assert_eq!(wants("text/html,*/*;q=0.8"), Some(false));
        assert_eq!(wants("text/csv;q=0.5, application/json"), Some(false));
        assert_eq!(wants("image/png"), None);
        assert_eq!(prefers(&axum::http::HeaderMap::new(), "text/csv"), Some(false));
        let bytes = |accept: &'static str| {
            let headers = [(header::ACCEPT, HeaderValue::from_static(accept))].into_iter().collect();
            prefers(&headers, "application/octet-stream")
        };
        assert_eq!(bytes("application/octet-stream"), Some(true));
        assert_eq!(bytes("application/*"), Some(false));
    }
}
