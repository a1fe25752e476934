//! The pages that people read: plain HTML, CSS and ES modules inside the binary, which call the public API below `/v1`.
//!
//! A page holds no data and so needs no key; what it shows comes from calls that do. No page asks another host for
//! anything, and the content security policy makes sure of that.

mod assets;

use axum::{
    Router,
    extract::Path as PagePath,
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
    routing::get,
};

use crate::{
    api::{
        AppState,
        extract::{Conditions, Path},
        problem::ApiResult,
        stations::StationPath,
    },
    domain::problem::{Code, Problem},
};
use assets::Asset;

/// Everything a page needs comes from this service, and nothing may be written into it.
const POLICY: &str =
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// The API reader draws its icons from `data:` addresses and sets a few inline styles; scripts stay as strict.
const READER_POLICY: &str = "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; \
                             object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// The addresses of the pages and of what they are made of.
pub fn router() -> Router<AppState> {
    Router::new()
        .route("/", get(home))
        .route("/stations/{station}", get(station))
        .route("/docs", get(reader))
        .route("/assets/{*name}", get(asset))
}

async fn home(conditions: Conditions) -> ApiResult<Response> {
    page("index.html", POLICY, &conditions)
}

/// The same page for every station: whether there is such a station is for the API to say, to whoever may ask it.
async fn station(Path(_): Path<StationPath>, conditions: Conditions) -> ApiResult<Response> {
    page("station.html", POLICY, &conditions)
}

async fn reader(conditions: Conditions) -> ApiResult<Response> {
    page("docs.html", READER_POLICY, &conditions)
}

async fn asset(PagePath(name): PagePath<String>, conditions: Conditions) -> ApiResult<Response> {
    // a page is served at its own address only, so that each has one address and one policy
    let found = assets::find(&name).filter(|asset| asset.media_type != assets::HTML);
    let asset = found.ok_or_else(|| Problem::new(Code::NotFound, format!("there is nothing at /assets/{name}")))?;
    Ok(serve(&asset, POLICY, &conditions))
}

fn page(name: &str, policy: &'static str, conditions: &Conditions) -> ApiResult<Response> {
    let asset = assets::find(name).ok_or_else(|| Problem::internal(format!("the page {name} is not in the binary")))?;
    Ok(serve(&asset, policy, conditions))
}

fn serve(asset: &Asset, policy: &'static str, conditions: &Conditions) -> Response {
    let fixed = |name: HeaderName, value: &'static str| (name, HeaderValue::from_static(value));
    let mut headers = HeaderMap::from_iter([
        fixed(header::CONTENT_TYPE, asset.media_type),
        fixed(header::CONTENT_SECURITY_POLICY, policy),
        fixed(header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        fixed(header::REFERRER_POLICY, "same-origin"),
        // kept, but asked for again each time: a page and its modules are always of one version
        fixed(header::CACHE_CONTROL, "no-cache"),
    ]);
    headers.insert(header::ETAG, asset.tag.clone());
    if asset.tag.to_str().is_ok_and(|tag| conditions.is_fresh(tag)) {
        headers.remove(header::CONTENT_TYPE);
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    (headers, asset.bytes).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_reader_may_have_inline_styles_and_nothing_may_have_inline_scripts() {
        assert!(!POLICY.contains("unsafe"));
        assert!(READER_POLICY.contains("style-src 'self' 'unsafe-inline'"));
        assert!(!READER_POLICY.contains("script-src"), "scripts fall back to default-src 'self'");
    }
}
