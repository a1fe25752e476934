//! What a caller can ask of a job, and what is the answer at the wrong time.

use serde_json::{Value, json};

use crate::{
    lost_workers::{echo, ended},
    support::{
        TestApp,
        trained::{id, until},
    },
};

const EXECUTION: &str = "/v1/processes/echo/execution";

#[tokio::test]
async fn a_job_tells_what_it_was_made_of() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "delay_s": 0.3})).await;
    ended(&app, &job).await;
    let inputs = app.read(&format!("/v1/jobs/{job}/inputs")).await;
    let filled_in = json!({"message": "a", "delay_s": 0.3, "parts": 0, "attachment_bytes": 0, "fail": false});
    assert_eq!(inputs, json!({"inputs": filled_in}));
    let prov = app.read(&format!("/v1/jobs/{job}/prov")).await;
    assert_eq!((&prov["processID"], &prov["inputs"]), (&json!("echo"), &filled_in));
    assert_eq!((&prov["attempts"], &prov["worker"], &prov["seed"]), (&json!(1), &json!("local"), &Value::Null));
    assert_eq!(prov["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(prov["input_hash"].as_str().map(str::len), Some(64));
    assert!(prov["computed_seconds"].as_f64() >= Some(0.3), "{prov}");
    assert!(prov["queued_seconds"].as_f64() >= Some(0.0), "{prov}");
    let log = app.read(&format!("/v1/jobs/{job}/log")).await;
    assert_eq!(log["lines"][0]["message"], "taken by local, from its beginning");

    let failed = echo(&app, json!({"message": "a", "fail": true})).await;
    ended(&app, &failed).await;
    let log = app.read(&format!("/v1/jobs/{failed}/log")).await;
    assert_eq!(
        (&log["lines"][1]["level"], &log["lines"][1]["message"]),
        (&json!("error"), &json!("it was asked to fail"))
    );
}

#[tokio::test]
async fn results_are_what_was_asked_for() {
    let app = TestApp::start().await;
    let inputs = json!({"message": "a", "attachment_bytes": 5});
    let results = async |wish: Value| {
        let mut request = json!({"inputs": inputs});
        request.as_object_mut().unwrap().extend(wish.as_object().unwrap().clone());
        let job = id(&app.post(EXECUTION).json(&request).await.json(201)).to_owned();
        ended(&app, &job).await;
        (app.get(&format!("/v1/jobs/{job}/results")).await, job)
    };
    let (all, _) = results(json!({"outputs": {}})).await;
    assert_eq!(all.json(200).as_object().unwrap().len(), 2);
    let (some, _) = results(json!({"outputs": {"message": {"transmissionMode": "value"}}})).await;
    assert_eq!(some.json(200), json!({"message": "a"}));
    let (address, job) = results(json!({"outputs": {"message": {"transmissionMode": "reference"}}})).await;
    let at = format!("/v1/jobs/{job}/results/message");
    assert_eq!(address.json(200), json!({"message": {"href": at, "type": "application/json"}}));
    assert_eq!(app.read(&at).await, "a");
    let (raw, _) = results(json!({"response": "raw", "outputs": {"message": {}}})).await;
    assert_eq!(raw.json(200), "a");
    let (bytes, _) = results(json!({"response": "raw", "outputs": {"attachment": {}}})).await;
    assert_eq!((bytes.header("content-type"), &bytes.body[..]), ("application/octet-stream", &[0, 1, 2, 3, 4][..]));
}

#[tokio::test]
async fn jobs_are_found_by_their_labels() {
    let app = TestApp::start().await;
    let label = async |labels: Value| {
        let job = app.post(EXECUTION).json(&json!({"inputs": {"message": "a"}, "labels": labels})).await.json(201);
        id(&job).to_owned()
    };
    let both = label(json!({"campaign": "2007", "place": "Pente d'Ar"})).await;
    let one = label(json!({"campaign": "2007"})).await;
    let other = label(json!({"campaign": "2008"})).await;
    let find = async |query: &str| -> Vec<String> {
        let list = app.read(&format!("/v1/jobs?label={query}")).await;
        list["jobs"].as_array().unwrap().iter().map(|job| id(job).to_owned()).collect()
    };
    assert_eq!(find("campaign:2007").await, [one, both.clone()]);
    assert_eq!(find("campaign:2007,place:Pente%20d%27Ar").await, [both]);
    assert_eq!(find("campaign:2008").await, [other]);
    assert_eq!(find("campaign:2009").await, Vec::<String>::new());
    assert_eq!(app.get("/v1/jobs?label=campaign").await.pointers("invalid-parameter"), ["/label"]);

    for labels in [json!({"a:b": "x"}), json!({"": "x"}), json!({"a": "x,y"}), json!({"a": "x".repeat(257)})] {
        let body = json!({"inputs": {"message": "a"}, "labels": labels});
        app.post(EXECUTION).json(&body).await.problem("invalid-body");
    }
    let many: serde_json::Map<String, Value> = (0..21).map(|at| (at.to_string(), json!("x"))).collect();
    app.post(EXECUTION).json(&json!({"inputs": {"message": "a"}, "labels": many})).await.problem("invalid-body");
}

#[tokio::test]
async fn a_priority_is_from_0_to_9() {
    let app = TestApp::start().await;
    for priority in [0, 9] {
        let job = app.post(EXECUTION).json(&json!({"inputs": {"message": "a"}, "priority": priority})).await.json(201);
        assert_eq!(job["priority"], priority);
    }
    assert_eq!(app.post(EXECUTION).json(&json!({"inputs": {"message": "a"}})).await.json(201)["priority"], 5);
    for priority in [json!(10), json!(-1), json!(1.5), json!("5")] {
        let body = json!({"inputs": {"message": "a"}, "priority": priority});
        assert_eq!(app.post(EXECUTION).json(&body).await.pointers("invalid-body"), ["/priority"], "{body}");
    }
}

#[tokio::test]
async fn what_cannot_be_executed_makes_no_job() {
    let app = TestApp::start().await;
    app.post("/v1/processes/nothing/execution").json(&json!({})).await.problem("no-such-process");
    let refused = app.post(EXECUTION).json(&json!({"inputs": {"message": "a", "delay_s": 601, "parts": 1001}})).await;
    assert_eq!(refused.pointers("invalid-inputs"), ["/inputs/delay_s", "/inputs/parts"]);
    assert_eq!(app.read("/v1/jobs").await["jobs"], json!([]));
}

#[tokio::test]
async fn results_that_are_not_there_yet_are_404_of_the_standards_type() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "delay_s": 600})).await;
    for path in ["results", "results/message"] {
        let problem = app.get(&format!("/v1/jobs/{job}/{path}")).await.problem("result-not-ready");
        assert_eq!(problem["type"], "http://www.opengis.net/def/exceptions/ogcapi-processes-1/1.0/result-not-ready");
    }
    app.delete(&format!("/v1/jobs/{job}")).await.json(200);
    app.get(&format!("/v1/jobs/{job}/results")).await.problem("job-dismissed");
}

#[tokio::test]
async fn the_first_delete_dismisses_and_the_second_removes() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "delay_s": 600})).await;
    until(&app, &job, |job| job["status"] == "running").await;
    let at = format!("/v1/jobs/{job}");
    assert_eq!(app.delete(&at).await.json(200)["status"], "dismissed");
    assert_eq!(app.read(&at).await["status"], "dismissed");
    assert_eq!(app.delete(&at).await.json(200)["status"], "dismissed");
    app.delete(&at).await.problem("no-such-job");
    app.get(&at).await.problem("no-such-job");

    let done = echo(&app, json!({"message": "a"})).await;
    ended(&app, &done).await;
    assert_eq!(app.delete(&format!("/v1/jobs/{done}")).await.json(200)["status"], "successful");
    app.delete(&format!("/v1/jobs/{done}")).await.problem("no-such-job");
}

#[tokio::test]
async fn who_waits_is_answered_at_the_end_of_the_job() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "delay_s": 1})).await;
    let answer = app.get(&format!("/v1/jobs/{job}")).header("prefer", "wait=20").await;
    assert_eq!(answer.header("preference-applied"), "wait=20");
    assert_eq!(answer.json(200)["status"], "successful");

    let request = json!({"inputs": {"message": "a", "delay_s": 0.5}});
    let answer = app.post(EXECUTION).header("prefer", "wait=20").json(&request).await;
    assert_eq!(answer.header("preference-applied"), "wait=20");
    let job = answer.json(201);
    assert_eq!(job["status"], "successful");
    assert_eq!(answer.header("location"), format!("/v1/jobs/{}", id(&job)));
}

#[tokio::test]
async fn who_has_a_version_waits_for_the_next() {
    let app = TestApp::with(|config| config.job_slots = 1).await;
    let running = echo(&app, json!({"message": "a", "delay_s": 30})).await;
    let waiting = echo(&app, json!({"message": "b"})).await;
    until(&app, &running, |job| job["status"] == "running").await;
    let at = format!("/v1/jobs/{running}");
    let first = app.get(&at).await;
    let next = app.get(&at).header("prefer", "wait=20").header("if-none-match", first.header("etag")).await;
    let (before, after) = (first.json(200), next.json(200));
    assert_eq!(after["status"], "running", "it did not wait for the end");
    assert_ne!(before, after);

    // nothing happens to a job that waits
    let at = format!("/v1/jobs/{waiting}");
    let tag = app.get(&at).await.header("etag").to_owned();
    let same = app.get(&at).header("prefer", "wait=1").header("if-none-match", &tag).await;
    assert_eq!((same.status, same.header("retry-after")), (304, "1"));
    app.delete(&format!("/v1/jobs/{running}")).await.json(200);
}

#[tokio::test]
async fn nobody_waits_longer_than_a_request_may_take() {
    let app = TestApp::with(|config| config.request_timeout = std::time::Duration::from_secs(2)).await;
    let job = echo(&app, json!({"message": "a", "delay_s": 600})).await;
    let answer = app.get(&format!("/v1/jobs/{job}")).header("prefer", "wait=30").await;
    assert_eq!(answer.header("preference-applied"), "wait=1");
    assert_eq!(answer.json(200)["status"], "running");
    app.delete(&format!("/v1/jobs/{job}")).await.json(200);
}
