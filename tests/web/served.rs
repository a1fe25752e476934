//! What is served: types, tags, security headers, and that all parts of a page are there.

use std::path::Path;

use firn::store::{Store, keys::Role};
use reqwest::{Client, Response, StatusCode, header};

use crate::service::Service;

const PAGES: [&str; 3] = ["/", "/stations/synthetic", "/docs"];

/// Every file of the pages with the media type that it must have.
fn assets() -> Vec<(String, &'static str)> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/web/assets");
    let files =
        walkdir::WalkDir::new(folder).into_iter().map(Result::unwrap).filter(|entry| entry.file_type().is_file());
    let own = files.filter_map(|entry| {
        let name = entry.path().strip_prefix(folder).unwrap().to_str().unwrap().to_owned();
        Some((media_type(entry.path())?, name))
    });
    let reader = ["swagger-ui/swagger-ui.css", "swagger-ui/swagger-ui-bundle.js"];
    let reader = reader.into_iter().map(|name| (media_type(Path::new(name)).unwrap(), name.to_owned()));
    own.chain(reader).map(|(media_type, name)| (format!("/assets/{name}"), media_type)).collect()
}

fn media_type(path: &Path) -> Option<&'static str> {
    match path.extension()?.to_str()? {
        "css" => Some("text/css; charset=utf-8"),
        "js" => Some("text/javascript; charset=utf-8"),
        "svg" => Some("image/svg+xml"),
        "html" => None,
        other => panic!("a file of an unknown kind: {other}"),
    }
}

fn value<'a>(response: &'a Response, name: &header::HeaderName) -> &'a str {
    response.headers().get(name).map_or("", |value| value.to_str().unwrap())
}

#[tokio::test]
async fn pages_and_assets_have_their_type_and_the_security_headers() {
    let service = Service::start(false).await;
    let pages = PAGES.map(|path| (path.to_owned(), "text/html; charset=utf-8"));
    let all: Vec<_> = pages.into_iter().chain(assets()).collect();
    assert!(all.len() > 15, "the folder of the assets was not found");
    for (path, media_type) in all {
        let response = reqwest::get(service.url(&path)).await.unwrap();
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        assert_eq!(value(&response, &header::CONTENT_TYPE), media_type, "{path}");
        assert_eq!(value(&response, &header::X_CONTENT_TYPE_OPTIONS), "nosniff", "{path}");
        assert_eq!(value(&response, &header::REFERRER_POLICY), "same-origin", "{path}");
        let policy = value(&response, &header::CONTENT_SECURITY_POLICY);
        assert!(policy.starts_with("default-src 'self';"), "{path}: {policy}");
        assert!(policy.contains("frame-ancestors 'none'"), "{path}: {policy}");
        assert!(path == "/docs" || !policy.contains("unsafe"), "{path}: {policy}");
        assert!(!policy.contains("unsafe-eval") && !policy.contains("script-src"), "{path}: {policy}");
    }
}

#[tokio::test]
async fn whoever_has_an_asset_is_told_so() {
    let service = Service::start(false).await;
    for path in ["/", "/assets/base.css", "/assets/swagger-ui/swagger-ui-bundle.js"] {
        let first = reqwest::get(service.url(path)).await.unwrap();
        let tag = value(&first, &header::ETAG).to_owned();
        assert!(tag.starts_with('"') || tag.starts_with("W/\""), "{path}: {tag}");
        let ask = |tag: String| Client::new().get(service.url(path)).header(header::IF_NONE_MATCH, tag).send();
        let again = ask(tag.clone()).await.unwrap();
        assert_eq!(again.status(), StatusCode::NOT_MODIFIED, "{path}");
        assert_eq!(value(&again, &header::ETAG).trim_start_matches("W/"), tag.trim_start_matches("W/"), "{path}");
        assert!(again.bytes().await.unwrap().is_empty(), "{path}");
        assert_eq!(ask("\"another\"".to_owned()).await.unwrap().status(), StatusCode::OK, "{path}");
    }
}

#[tokio::test]
async fn what_is_not_there_is_a_problem() {
    let service = Service::start(false).await;
    let strangers = [
        "/nothing",
        "/assets/nothing.js",
        "/assets/index.html",
        "/assets/../Cargo.toml",
        "/assets/swagger-ui/index.html",
        "/stations/No%20Station",
        "/stations",
    ];
    for path in strangers {
        let response = reqwest::get(service.url(path)).await.unwrap();
        assert!(response.status().is_client_error(), "{path} is {}", response.status());
        assert_eq!(value(&response, &header::CONTENT_TYPE), "application/problem+json", "{path}");
    }
    let missing = reqwest::get(service.url("/nothing")).await.unwrap();
    assert_eq!(missing.status(), StatusCode::NOT_FOUND);
    let written = Client::new().post(service.url("/")).send().await.unwrap();
    assert_eq!(written.status(), StatusCode::METHOD_NOT_ALLOWED);
    let head = Client::new().head(service.url("/")).send().await.unwrap();
    assert_eq!(head.status(), StatusCode::OK);
}

/// Quoted addresses of this service in a text: `"/assets/dom.js"`, `'./dom.js'`.
fn addresses(text: &str) -> Vec<String> {
    text.split(['"', '\''])
        .filter(|part| part.starts_with("/assets/") || (part.starts_with("./") && part.ends_with(".js")))
        .map(|part| part.strip_prefix("./").map_or_else(|| part.to_owned(), |name| format!("/assets/{name}")))
        .collect()
}

#[tokio::test]
async fn every_part_that_a_page_or_a_module_names_is_served() {
    let service = Service::start(false).await;
    let mut to_read: Vec<String> = PAGES.map(str::to_owned).into();
    let mut seen = std::collections::BTreeSet::new();
    while let Some(path) = to_read.pop() {
        if !seen.insert(path.clone()) {
            continue;
        }
        let response = reqwest::get(service.url(&path)).await.unwrap();
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        if !path.contains("swagger-ui") {
            to_read.extend(addresses(&response.text().await.unwrap()));
        }
    }
    let unused: Vec<_> = assets().into_iter().map(|(path, _)| path).filter(|path| !seen.contains(path)).collect();
    assert!(unused.is_empty(), "no page needs {unused:?}");
}

#[tokio::test]
async fn pages_need_no_key_where_data_do() {
    let data = tempfile::tempdir().unwrap();
    let store = Store::open(data.path()).await.unwrap();
    let key = store.create_key("pages", Role::Reader, None, firn::clock::now()).await.unwrap().to_string();
    store.close().await;
    let service = Service::serve(data, "0.0.0.0:0", false).await;
    for path in PAGES.into_iter().chain(["/assets/base.css", "/openapi.json"]) {
        assert_eq!(reqwest::get(service.url(path)).await.unwrap().status(), StatusCode::OK, "{path}");
    }
    assert_eq!(reqwest::get(service.url("/v1/stations")).await.unwrap().status(), StatusCode::UNAUTHORIZED);
    let known = Client::new().get(service.url("/v1/stations")).bearer_auth(key).send().await.unwrap();
    assert_eq!(known.status(), StatusCode::OK);
}
