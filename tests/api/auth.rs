//! Who may do what, on an address that others can reach and on one that they cannot.

use std::collections::BTreeSet;

use firn::store::{Store, keys::Role};
use jiff::{SignedDuration, Timestamp};
use reqwest::Method;
use serde_json::{Value, json};

use crate::support::{TestApp, app, app::beside_the_servers, binary};

/// Makes a key in a store that is open.
async fn key_in(store: Store, role: Role, expires: Option<Timestamp>) -> String {
    beside_the_servers(async move { store.create_key(role.name(), role, expires, firn::clock::now()).await.unwrap() })
        .await
}

/// A server on every address, with the key of its administrator.
async fn in_the_open() -> (TestApp, String) {
    let data = app::data_dir();
    let path = data.path().to_owned();
    let key = beside_the_servers(async move {
        let store = Store::open(&path).await.unwrap();
        let key = store.create_key("anna", Role::Admin, None, firn::clock::now()).await.unwrap();
        store.close().await;
        key
    })
    .await;
    let app = TestApp::on(data, |config| config.listen = "0.0.0.0:0".parse().unwrap()).await;
    (app, key)
}

#[tokio::test]
async fn loopback_needs_no_key_but_refuses_a_wrong_one() {
    let app = TestApp::start().await;
    app.station("a").await;
    app.get("/v1/stations/a").key("firn_0_0").await.problem("unauthorized");
}

#[tokio::test]
async fn a_key_opens_the_door_and_nothing_else_does() {
    let (app, key) = in_the_open().await;
    assert_eq!(app.get("/v1/stations").key(&key).await.status, 200);
    let refused = app.get("/v1/stations").await;
    refused.problem("unauthorized");
    assert_eq!(refused.header("www-authenticate"), "Bearer realm=\"firn\"");

    let id = key.split('_').nth(1).unwrap();
    let half = key[..key.len() - 1].to_owned();
    let other_secret = format!("firn_{id}_{}", "0".repeat(64));
    let hash = "x".repeat(64);
    for wrong in
        ["", "nonsense", "firn", "firn_", &format!("firn_{id}"), &format!("firn_{id}_"), &half, &other_secret, &hash]
    {
        app.get("/v1/stations").key(wrong).await.problem("unauthorized");
    }
    for header in [format!("Basic {key}"), key.clone(), "Bearer".into(), format!("Bearer {key} {key}")] {
        app.get("/v1/stations").header("authorization", &header).await.problem("unauthorized");
    }
    // the name of the scheme is not case-sensitive (RFC 9110, section 11.1)
    assert_eq!(app.get("/v1/stations").header("authorization", &format!("bearer {key}")).await.status, 200);
    // a key in the address would stand in every log
    app.get(&format!("/v1/stations?key={key}")).await.problem("unauthorized");
}

#[tokio::test]
async fn a_revoked_or_expired_key_is_no_key() {
    let (app, _) = in_the_open().await;
    let store = app.state.store.clone();
    let now = firn::clock::now();
    let expired = key_in(store.clone(), Role::Operator, Some(now - SignedDuration::from_secs(1))).await;
    app.get("/v1/stations").key(&expired).await.problem("unauthorized");
    let later = key_in(store.clone(), Role::Admin, Some(now + SignedDuration::from_hours(1))).await;
    assert_eq!(app.get("/v1/stations").key(&later).await.status, 200);
    let id = later.split('_').nth(1).unwrap().to_owned();
    assert!(beside_the_servers(async move { store.revoke_key(&id, firn::clock::now()).await.unwrap() }).await);
    app.get("/v1/stations").key(&later).await.problem("unauthorized");
}

#[tokio::test]
async fn each_role_may_do_what_it_is_for() {
    let (app, admin) = in_the_open().await;
    let store = app.state.store.clone();
    let [reader, forecaster, operator] = [
        key_in(store.clone(), Role::Reader, None).await,
        key_in(store.clone(), Role::Forecaster, None).await,
        key_in(store.clone(), Role::Operator, None).await,
    ];
    let before = app.rows().await;
    let body = json!({"name": "a"});
    let refused = app.put("/v1/stations/a", &body).key(&reader).await.problem("forbidden");
    assert_eq!(refused["detail"], "this call needs the role forecaster, the key has reader");
    app.post("/v1/stations/a/observations").json(&json!([])).key(&reader).await.problem("forbidden");
    app.post("/v1/processes/train-model/execution").json(&json!({})).key(&reader).await.problem("forbidden");
    app.delete("/v1/jobs/00000000-0000-7000-8000-000000000000").key(&reader).await.problem("forbidden");
    assert_eq!(app.rows().await, before);
    assert_eq!(app.get("/v1/stations").key(&reader).await.status, 200);

    app.put("/v1/stations/a", &body).key(&forecaster).await.json(201);
    let activate = json!({"model_id": "00000000-0000-7000-8000-000000000000"});
    app.put("/v1/stations/a/active-model", &activate).key(&forecaster).await.problem("forbidden");
    for may in [&operator, &admin] {
        app.put("/v1/stations/a/active-model", &activate).key(may).await.problem("model-mismatch");
    }
}

/// Every path and method of the contract, its variable parts filled in.
fn operations(document: &Value) -> Vec<(Method, String)> {
    let mut found = Vec::new();
    for (path, item) in document["paths"].as_object().expect("paths") {
        let path = path
            .replace("{station}", "a")
            .replace("{region}", "a")
            .replace("{proposal}", "00000000-0000-7000-8000-000000000000")
            .replace("{date}", "2007-02-14")
            .replace("{processID}", "train-model")
            .replace("{jobID}", "00000000-0000-7000-8000-000000000000")
            .replace("{model}", "00000000-0000-7000-8000-000000000000")
            .replace("{feature_set}", "expert")
            .replace("{output}", "model_id")
            .replace("{frame}", "0")
            .replace("{dataset}", "00000000-0000-7000-8000-000000000000")
            .replace("{code}", "not-found");
        assert!(!path.contains('{'), "{path}: give the test a value for its variable part");
        for method in item.as_object().unwrap().keys().filter(|key| !matches!(key.as_str(), "parameters" | "summary")) {
            found.push((method.to_uppercase().parse().unwrap(), path.clone()));
        }
    }
    found
}

#[tokio::test]
async fn without_a_key_no_operation_of_the_contract_is_open() {
    let (app, key) = in_the_open().await;
    let document = app.read("/openapi.json").await;
    let operations = operations(&document);
    assert!(operations.len() > 25, "{operations:?}");
    let mut open = BTreeSet::new();
    for (method, path) in operations {
        let answer = app.call(method.clone(), &path).json(&json!({})).await;
        if path == "/v1" || path.starts_with("/v1/") {
            answer.problem("unauthorized");
            let named = app.call(method, &path).json(&json!({})).key(&key).await;
            assert_ne!(named.status, 401, "{path}");
        } else {
            open.insert(path);
            assert_eq!(answer.status, 200);
        }
    }
    // what a monitor, a browser or a client library needs before it has a key, and nothing that is data
    let expected = ["/livez", "/metrics", "/openapi.json", "/problems", "/problems/not-found", "/readyz"];
    assert_eq!(open.into_iter().collect::<Vec<_>>(), expected);
    // what is not there is no more open than what is
    app.get("/v1/nothing").await.problem("unauthorized");
    app.call(Method::PATCH, "/v1/stations/a").await.problem("unauthorized");
    assert_ne!(app.get("/V1/stations").await.status, 200);
    assert_ne!(app.get("//v1/stations").await.status, 200);
    assert_ne!(app.get("/%761/stations").await.status, 200);
}

#[tokio::test]
async fn an_open_address_needs_a_key_or_the_operators_word() {
    let data = app::data_dir();
    let refused = binary::run_on(data.path(), &["serve", "--listen", "0.0.0.0:0"]);
    assert!(!refused.status.success());
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(said.contains("firn key create") && said.contains("--allow-anonymous"), "{said}");
    assert_eq!(said.lines().filter(|line| line.starts_with("firn: ")).count(), 1, "{said}");

    let anybody = TestApp::with(|config| {
        config.listen = "0.0.0.0:0".parse().unwrap();
        config.allow_anonymous = true;
    })
    .await;
    anybody.station("a").await;
}

#[tokio::test]
async fn a_key_is_shown_once_and_kept_as_a_hash() {
    let data = app::data_dir();
    let made = binary::run_on(data.path(), &["key", "create", "--name", "anna", "--role", "operator"]);
    assert!(made.status.success(), "{made:?}");
    let said = String::from_utf8(made.stdout).unwrap();
    let key = said.lines().next().unwrap().to_owned();
    let secret = key.rsplit('_').next().unwrap().to_owned();
    assert!(key.starts_with("firn_") && secret.len() == 64, "{said}");

    let listed = binary::run_on(data.path(), &["key", "list"]);
    let list = String::from_utf8(listed.stdout).unwrap();
    assert!(list.contains("anna") && list.contains("operator") && !list.contains(&secret), "{list}");
    for file in std::fs::read_dir(data.path()).unwrap() {
        let bytes = std::fs::read(file.unwrap().path()).unwrap();
        assert!(!bytes.windows(64).any(|window| window == secret.as_bytes()), "the secret is on disk");
    }
    let again = binary::run_on(data.path(), &["key", "create", "--name", "compose", "--if-none"]);
    assert_eq!(String::from_utf8(again.stdout).unwrap(), "there is a valid key already\n");

    // made by one process, honoured by another, and no more once withdrawn by a third
    let server = TestApp::on(data, |config| config.listen = "0.0.0.0:0".parse().unwrap()).await;
    assert_eq!(server.get("/v1/stations").key(&key).await.status, 200);
    let id = key.split('_').nth(1).unwrap();
    assert!(binary::run_on(server.data_dir(), &["key", "revoke", id]).status.success());
    server.get("/v1/stations").key(&key).await.problem("unauthorized");
    let twice = binary::run_on(server.data_dir(), &["key", "revoke", id]);
    assert!(!twice.status.success());
    assert!(String::from_utf8(twice.stderr).unwrap().contains("firn key list"));
}
