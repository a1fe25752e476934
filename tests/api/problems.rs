//! Whatever is refused is refused in one form, with nothing half-done.

use firn::domain::problem::Code;
use insta::assert_json_snapshot;
use reqwest::Method;
use serde_json::{Value, json};

use crate::support::TestApp;

#[tokio::test]
async fn a_problem_says_what_and_where() {
    let app = TestApp::start().await;
    let problem = app.get("/v1/stations/lochaber").await.problem("unknown-station");
    assert_json_snapshot!(problem, {".traceId" => "[id]"}, @r#"
    {
      "type": "/problems/unknown-station",
      "title": "No such station",
      "status": 404,
      "detail": "there is no station lochaber; create it with PUT /v1/stations/lochaber",
      "code": "unknown-station",
      "traceId": "[id]"
    }
    "#);
}

#[tokio::test]
async fn the_callers_own_request_id_comes_back() {
    let app = TestApp::start().await;
    let answer = app.get("/v1/stations/lochaber").header("x-request-id", "my-own-7").await;
    assert_eq!(answer.problem("unknown-station")["traceId"], "my-own-7");
    assert_eq!(app.get("/livez").header("x-request-id", "my-own-8").await.header("x-request-id"), "my-own-8");
    // one that would fill the log is replaced
    let long = "x".repeat(200);
    let answer = app.get("/v1/stations/lochaber").header("x-request-id", &long).await;
    assert_ne!(answer.problem("unknown-station")["traceId"], long);
}

#[tokio::test]
async fn every_kind_of_problem_explains_itself() {
    let app = TestApp::start().await;
    let kinds = app.read("/problems").await;
    assert_eq!(kinds.as_array().unwrap().len(), Code::ALL.len());
    for kind in kinds.as_array().unwrap() {
        let explained = app.read(&format!("/problems/{}", kind["code"].as_str().unwrap())).await;
        assert_eq!(&explained, kind);
        assert!(kind["help"].as_str().unwrap().len() > 20, "{kind}");
    }
    let one = app.read("/problems/payload-too-large").await;
    assert_json_snapshot!(one, @r#"
    {
      "code": "payload-too-large",
      "type": "/problems/payload-too-large",
      "status": 413,
      "title": "The body is too large",
      "help": "The body exceeds the limit in the detail. Send it in several parts."
    }
    "#);
    app.get("/problems/nonsense").await.problem("not-found");
}

#[tokio::test]
async fn an_address_that_is_not_there_and_a_method_that_is_not_taken_are_told_apart() {
    let app = TestApp::start().await;
    for path in ["/nothing", "/v1/nothing", "/v2", "/v1/stations/a/b/c", "/v1/stations/"] {
        app.get(path).await.problem("not-found");
    }
    let patch = app.call(Method::PATCH, "/v1/stations/lochaber").await;
    patch.problem("method-not-allowed");
    assert_eq!(allowed(patch.header("allow")), ["GET", "HEAD", "PUT"]);
    let delete = app.delete("/v1/stations/lochaber/observations").await;
    delete.problem("method-not-allowed");
    assert_eq!(allowed(delete.header("allow")), ["GET", "HEAD", "POST"]);
    let post = app.post("/livez").json(&json!({})).await;
    post.problem("method-not-allowed");
    assert_eq!(allowed(post.header("allow")), ["GET", "HEAD"]);
}

fn allowed(header: &str) -> Vec<&str> {
    let mut methods: Vec<&str> = header.split(',').map(str::trim).collect();
    methods.sort_unstable();
    methods
}

#[tokio::test]
async fn a_format_that_is_not_served_is_refused() {
    let app = TestApp::start().await;
    app.station("lochaber").await;
    let list = |accept: &str| app.get("/v1/stations/lochaber/observations").header("accept", accept);
    let problem = list("image/png").await.problem("not-acceptable");
    assert!(problem["detail"].as_str().unwrap().contains("text/csv"), "{problem}");
    assert_eq!(list("text/html,*/*;q=0.8").await.header("content-type"), "application/json");
    assert_eq!(list("text/csv").await.header("content-type"), "text/csv; charset=utf-8");
}

#[tokio::test]
async fn a_page_of_another_origin_cannot_write() {
    let app = TestApp::start().await;
    let body = json!({"name": "x"});
    let from = |name: &str, value: &str| app.put("/v1/stations/a", &body).header(name, value);
    from("sec-fetch-site", "cross-site").await.problem("cross-origin");
    from("origin", "http://elsewhere.example").await.problem("cross-origin");
    let own = format!("http://{}", app.address);
    from("origin", &own).await.json(201);
}

/// Calls that must all be refused, with what each is refused as.
fn bad_calls() -> Vec<(Method, &'static str, Value, &'static str)> {
    use Method as M;
    let none = || Value::Null;
    let execute = |inputs: Value| json!({"inputs": inputs});
    let training = "/v1/processes/train-model/execution";
    let nobody = "00000000-0000-7000-8000-000000000000";
    vec![
        (M::PUT, "/v1/stations/lochaber", json!([]), "invalid-body"),
        (M::PUT, "/v1/stations/lochaber", json!("Lochaber"), "invalid-body"),
        (M::PUT, "/v1/stations/lochaber", json!({"name": 7}), "invalid-body"),
        (M::PUT, "/v1/stations/lochaber", json!({"name": "x", "latitude": 91}), "invalid-body"),
        (M::PUT, "/v1/stations/lochaber?x=1", json!({"name": "x", "extra": 1}), "invalid-body"),
        (M::PUT, "/v1/stations/..%2f..", json!({"name": "x"}), "invalid-parameter"),
        (M::PUT, "/v1/stations/a%00b", json!({"name": "x"}), "invalid-parameter"),
        (M::PUT, "/v1/stations/%ff", json!({"name": "x"}), "invalid-parameter"),
        (M::GET, "/v1/stations?limit=0", none(), "invalid-parameter"),
        (M::GET, "/v1/stations?limit=1001", none(), "invalid-parameter"),
        (M::GET, "/v1/stations?limit=2&limit=3", none(), "invalid-parameter"),
        (M::GET, "/v1/stations/absent", none(), "unknown-station"),
        (M::PUT, "/v1/stations/lochaber/observations/2007-02-14", json!({"date": "2007-02-14"}), "invalid-body"),
        (M::PUT, "/v1/stations/lochaber/observations/2007-02-29", json!({}), "invalid-parameter"),
        (M::PUT, "/v1/stations/lochaber/observations/2007-02-14", json!({"wind_speed": -1}), "invalid-body"),
        (M::PUT, "/v1/stations/lochaber/observations/2007-02-14", json!({"wind_speed": [1]}), "invalid-body"),
        (M::PUT, "/v1/stations/absent/observations/2007-02-14", json!({}), "unknown-station"),
        (M::PUT, "/v1/stations/lochaber/avalanches/2007-02-14", json!({"activity": null}), "invalid-body"),
        (M::POST, "/v1/stations/lochaber/observations", json!([{"date": "2007-02-14"}, {}]), "invalid-body"),
        (M::POST, "/v1/stations/lochaber/observations", json!(7), "invalid-body"),
        (M::POST, "/v1/stations/absent/observations", json!([{"date": "2007-02-14"}]), "unknown-station"),
        (M::POST, training, none(), "invalid-body"),
        (M::POST, training, json!({"inputs": 7}), "invalid-body"),
        (M::POST, training, json!({"input": {}}), "invalid-body"),
        (M::POST, training, execute(json!({})), "invalid-inputs"),
        (M::POST, training, execute(json!({"station": "absent", "label": "observed", "lead": 0})), "invalid-inputs"),
        (M::POST, training, execute(json!({"station": "lochaber", "label": "observed", "lead": 0})), "training-window"),
        (M::POST, "/v1/processes/nothing/execution", json!({"inputs": {}}), "no-such-process"),
        (M::GET, "/v1/processes/nothing", none(), "no-such-process"),
        (M::GET, "/v1/jobs/nothing", none(), "invalid-parameter"),
        (M::GET, "/v1/jobs/00000000-0000-7000-8000-000000000000", none(), "no-such-job"),
        (M::GET, "/v1/jobs/00000000-0000-7000-8000-000000000000/results", none(), "no-such-job"),
        (M::DELETE, "/v1/jobs/00000000-0000-7000-8000-000000000000", none(), "no-such-job"),
        (M::GET, "/v1/jobs?status=done", none(), "invalid-parameter"),
        (M::GET, "/v1/jobs?datetime=yesterday", none(), "invalid-parameter"),
        (M::GET, "/v1/jobs?minDuration=-1", none(), "invalid-parameter"),
        (M::GET, "/v1/jobs?type=service", none(), "invalid-parameter"),
        (M::GET, "/v1/models/00000000-0000-7000-8000-000000000000", none(), "unknown-model"),
        (M::GET, "/v1/models/00000000-0000-7000-8000-000000000000/evaluation", none(), "unknown-model"),
        (M::GET, "/v1/models/00000000-0000-7000-8000-000000000000/features", none(), "unknown-model"),
        (M::GET, "/v1/models/00000000-0000-7000-8000-000000000000/transfers", none(), "unknown-model"),
        (M::GET, "/v1/models?station=a%20b", none(), "invalid-parameter"),
        (M::GET, "/v1/models?station=a&region=b", none(), "invalid-parameter"),
        (M::PUT, "/v1/regions/a", json!({"name": "x"}), "invalid-body"),
        (M::PUT, "/v1/regions/a", json!({"name": "x", "stations": []}), "invalid-body"),
        (M::PUT, "/v1/regions/a", json!({"name": "x", "stations": ["absent"]}), "invalid-body"),
        (M::PUT, "/v1/regions/a", json!({"name": "x", "stations": ["lochaber", "lochaber"]}), "invalid-body"),
        (M::GET, "/v1/regions/absent", none(), "unknown-region"),
        (M::GET, "/v1/regions/absent/active-model", none(), "unknown-region"),
        (M::GET, "/v1/regions/absent/forecasts/2007-02-14", none(), "unknown-region"),
        (M::PUT, "/v1/regions/absent/active-model", json!({"model_id": nobody}), "unknown-region"),
        (M::POST, "/v1/regions/absent/active-model/rollback", json!({}), "unknown-region"),
        (M::POST, "/v1/stations/lochaber/active-model/rollback", json!({}), "no-earlier-model"),
        (M::POST, "/v1/stations/lochaber/active-model/rollback", json!({"why": "x"}), "invalid-body"),
        (M::GET, "/v1/stations/absent/proposals", none(), "unknown-station"),
        (M::GET, "/v1/regions/absent/proposals", none(), "unknown-region"),
        (M::POST, "/v1/stations/lochaber/proposals/x/accept", json!({}), "invalid-parameter"),
        (M::PUT, "/v1/stations/lochaber", json!({"name": "x", "retrain": {"yearly": "02-29"}}), "invalid-body"),
        (M::PUT, "/v1/stations/lochaber", json!({"name": "x", "retrain": "07-01"}), "invalid-body"),
        (M::GET, "/v1/audit?limit=0", none(), "invalid-parameter"),
        (M::GET, "/v1/audit?cursor=x", none(), "invalid-parameter"),
        (M::GET, "/v1/feature-sets/all", none(), "unknown-feature-set"),
        (M::GET, "/v1/stations/lochaber/active-model", none(), "no-active-model"),
        (M::GET, "/v1/stations/lochaber/active-model?lead=2", none(), "invalid-parameter"),
        (M::GET, "/v1/stations/absent/active-model", none(), "unknown-station"),
        (M::PUT, "/v1/stations/lochaber/active-model", json!({"model_id": nobody}), "model-mismatch"),
        (M::PUT, "/v1/stations/lochaber/active-model", json!({"model_id": "x"}), "invalid-body"),
        (M::GET, "/v1/stations/lochaber/forecasts", none(), "no-active-model"),
        (M::GET, "/v1/stations/lochaber/forecasts/latest", none(), "no-active-model"),
        (M::GET, "/v1/stations/lochaber/forecasts/2007-02-14", none(), "no-active-model"),
        (M::GET, "/v1/stations/lochaber/forecasts/2007-02-14/similar-days", none(), "no-active-model"),
        (M::GET, "/v1/stations/lochaber/forecasts/2007-02-14?lead=7", none(), "invalid-parameter"),
        (M::GET, "/v1/stations/absent/forecasts/2007-02-14", none(), "unknown-station"),
    ]
}

#[tokio::test]
async fn no_refused_call_leaves_a_trace() {
    let app = TestApp::start().await;
    app.station("lochaber").await;
    app.put("/v1/stations/lochaber/observations/2007-02-13", &json!({"cloud_cover": 1})).await.json(201);
    let before = app.rows().await;
    assert!(before["observation"] == 1 && before["station"] == 1, "{before:?}");
    for (method, path, body, code) in bad_calls() {
        let call = app.call(method.clone(), path);
        let writes = method == Method::PUT || method == Method::POST;
        let answer = if writes { call.json(&body).await } else { call.await };
        let name = format!("{method} {path} {body}: {}", String::from_utf8_lossy(&answer.body));
        assert_eq!(answer.status, Code::from_slug(code).unwrap().status(), "{name}");
        answer.problem(code);
        assert_eq!(app.rows().await, before, "{name}");
    }
}

/// A request whose body does not come.
const HALF: &str = "PUT /v1/stations/a HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\
                    content-type: application/json\r\ncontent-length: 12\r\n\r\n";

#[tokio::test]
async fn a_request_that_takes_too_long_is_given_up() {
    let app = TestApp::with(|config| config.request_timeout = std::time::Duration::from_secs(1)).await;
    let answer = app.raw(HALF).await;
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    assert!(answer.contains("application/problem+json") && answer.contains("request-timeout"), "{answer}");
    assert_eq!(app.rows().await["station"], 0);
}

#[tokio::test]
async fn more_requests_than_can_be_worked_on_are_refused_for_now() {
    let app = TestApp::with(|config| config.max_requests = 1).await;
    let since = std::time::Instant::now();
    let (slow, refused) = loop {
        let slow = app.begin(HALF).await;
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
        // another address: all share one count
        let answer = app.get("/v1/stations").await;
        if answer.status != 200 {
            break (slow, answer);
        }
        assert!(since.elapsed() < std::time::Duration::from_secs(10), "the slow request was never taken up");
    };
    refused.problem("overloaded");
    assert_eq!(refused.header("retry-after"), "10");
    // a busy process lives, and whoever restarts it for not saying so makes it worse
    assert_eq!(app.get("/livez").await.status, 200);
    drop(slow);
}
