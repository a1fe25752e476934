//! The server begins, refuses to begin, and ends.

use firn::server::Server;
use serde_json::json;

use crate::support::{TestApp, app, binary};

#[tokio::test]
async fn a_running_server_lives_and_is_ready() {
    let app = TestApp::start().await;
    for path in ["/livez", "/readyz"] {
        assert_eq!(app.read(path).await, json!({"status": "ok", "version": env!("CARGO_PKG_VERSION")}));
    }
}

#[tokio::test]
async fn two_servers_do_not_share_their_data() {
    let app = TestApp::start().await;
    let config = app::config(app.data_dir());
    let refused =
        app::beside_the_servers(async { Server::bind(config).await.err().map(|error| error.to_string()) }).await;
    let said = refused.expect("the second server must not start");
    assert!(said.contains("is in use by another firn process"), "{said}");

    let process = binary::run_on(app.data_dir(), &["serve", "--listen", "127.0.0.1:0"]);
    assert!(!process.status.success());
    let said = String::from_utf8(process.stderr).unwrap();
    assert!(said.contains("is in use by another firn process"), "{said}");
    // the first does not mind
    app.station("a").await;
}

#[tokio::test]
async fn data_outlive_the_server() {
    let mut app = TestApp::start().await;
    app.station("a").await;
    let body = app.read("/v1/stations/a").await;
    app.begin_to_stop();
    app.stopped().await;
    let config = app::config(app.data_dir());
    let again =
        app::beside_the_servers(async { Server::bind(config).await.map(|server| server.state().store.clone()) });
    let store = again.await.expect("the lock is free again");
    let station = app::beside_the_servers(async move { store.station(&"a".parse().unwrap()).await.unwrap() }).await;
    assert_eq!(body["created"], station.expect("the station").created.to_string());
}

#[tokio::test]
async fn a_stopping_server_is_not_ready_and_takes_no_jobs() {
    let app = TestApp::start().await;
    app.state.stopping.cancel();
    let answer = app.get("/readyz").await;
    answer.problem("shutting-down");
    assert_eq!(answer.header("retry-after"), "10");
    assert_eq!(app.get("/livez").await.status, 200);
}

#[test]
fn a_folder_or_file_that_is_not_ours_is_refused() {
    let data = app::data_dir();
    let file = data.path().join("firn.db");
    std::fs::write(&file, "not a database, but longer than a header of one hundred bytes would be".repeat(4)).unwrap();
    let refused = binary::run_on(data.path(), &["serve", "--listen", "127.0.0.1:0"]);
    assert!(!refused.status.success());
    assert!(String::from_utf8(refused.stderr).unwrap().starts_with("firn: "));

    let in_a_file = binary::run_on(&file, &["serve", "--listen", "127.0.0.1:0"]);
    assert!(!in_a_file.status.success());
    let said = String::from_utf8(in_a_file.stderr).unwrap();
    assert!(said.contains("firn.db"), "{said}");
}

#[test]
fn a_setting_that_is_not_known_is_refused_by_name() {
    let data = app::data_dir();
    let file = data.path().join("firn.toml");
    std::fs::write(&file, "listne = '127.0.0.1:0'").unwrap();
    let refused = binary::run_on(data.path(), &["serve", "--config", file.to_str().unwrap()]);
    assert!(!refused.status.success());
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(said.contains("listne") && said.contains("data_dir"), "{said}");
}

#[test]
fn the_contract_can_be_printed_without_a_server() {
    let printed = binary::run(&["openapi"]);
    assert!(printed.status.success());
    let document: serde_json::Value = serde_json::from_slice(&printed.stdout).unwrap();
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"), "{}", document["openapi"]);
    let text = document.to_string();
    assert!(!text.contains("\"$ref\":\"http"), "a reference to the outside");
}

#[tokio::test]
async fn a_fresh_machine_has_something_to_look_at() {
    let data = app::data_dir();
    let server = binary::Serving::start(data.path(), &["--demo"]);
    // the address is told before the demo is made
    let path = "/v1/jobs?processID=train-model";
    while server.read(path).await["jobs"] == json!([]) {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    let station = server.read("/v1/stations/synthetic").await;
    assert_eq!(station["synthetic"], true);
    assert!(station["name"].as_str().unwrap().contains("not a real place"), "{station}");
    let days = server.read("/v1/stations/synthetic/observations?limit=10000").await;
    let days = days["observations"].as_array().unwrap();
    assert!(days.len() > 1000 && days.iter().all(|day| day["synthetic"] == true));
    drop(server);

    // a second start neither makes the days again nor minds that the training was interrupted
    let again = binary::Serving::start(data.path(), &["--demo"]);
    while again.read(path).await["jobs"].as_array().unwrap().len() < 2 {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert_eq!(again.read("/v1/stations/synthetic").await, station);
}

/// A request whose body is still to come.
const HALF: &str = "PUT /v1/stations/a HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\
                    content-type: application/json\r\ncontent-length: 12\r\n\r\n";
const REST: &str = "{\"name\":\"a\"}";

#[tokio::test]
async fn what_is_being_asked_is_answered_before_the_end() {
    let mut app = TestApp::start().await;
    let asking = app.begin(HALF).await;
    // an answer on another connection shows that the first has been taken up
    app.read("/livez").await;
    app.begin_to_stop();
    let answer = app::finish(asking, REST).await;
    assert!(answer.starts_with("HTTP/1.1 201 "), "{answer}");
    app.stopped().await;
}

#[tokio::test]
async fn a_client_that_says_nothing_does_not_hold_the_server() {
    let mut app = TestApp::with(|config| config.shutdown_timeout = std::time::Duration::from_secs(1)).await;
    let silent = app.begin(HALF).await;
    app.read("/livez").await;
    app.begin_to_stop();
    let since = std::time::Instant::now();
    app.stopped().await;
    // the deadline, and what a busy machine adds; without a deadline it would be the time-out of the request
    assert!(since.elapsed() < app.state.config.request_timeout / 3, "{:?}", since.elapsed());
    drop(silent);
}
