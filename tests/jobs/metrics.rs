//! `/metrics`, read as a collector reads it.

use std::collections::BTreeMap;

use reqwest::Method;
use serde_json::json;

use crate::{
    lost_workers::{echo, ended},
    support::{TestApp, trained::until},
};

/// The samples of the text format by their name with labels, after checking each line against the format.
async fn figures(app: &TestApp) -> BTreeMap<String, f64> {
    let answer = app.get("/metrics").await;
    assert_eq!((answer.status, answer.header("content-type")), (200, "text/plain; version=0.0.4; charset=utf-8"));
    let text = answer.text();
    assert!(text.ends_with('\n'));
    let samples = text.lines().filter(|line| !line.is_empty() && !line.starts_with("# "));
    let read = |line: &str| {
        let (name, value) = line.rsplit_once(' ').expect("a name and a value");
        (name.to_owned(), value.parse().expect("a number"))
    };
    samples.map(read).collect()
}

#[tokio::test]
async fn the_queue_and_what_became_of_jobs_are_counted() {
    let app = TestApp::with(|config| config.job_slots = 1).await;
    let idle = figures(&app).await;
    for process in ["echo", "train-model"] {
        for name in ["firn_jobs_waiting", "firn_jobs_running", "firn_job_attempts_total"] {
            assert_eq!(idle[&format!("{name}{{process=\"{process}\"}}")], 0.0);
        }
    }
    assert_eq!(idle["firn_job_leases_lost_total"], 0.0);
    assert_eq!(idle[&format!("firn_build_info{{version=\"{}\"}}", env!("CARGO_PKG_VERSION"))], 1.0);

    let running = echo(&app, json!({"message": "a", "delay_s": 600})).await;
    until(&app, &running, |job| job["status"] == "running").await;
    let first = echo(&app, json!({"message": "b"})).await;
    let _second = echo(&app, json!({"message": "c"})).await;
    tokio::time::sleep(std::time::Duration::from_millis(1100)).await;
    let busy = figures(&app).await;
    let of = |name: &str| busy[&format!("{name}{{process=\"echo\"}}")];
    assert_eq!((of("firn_jobs_waiting"), of("firn_jobs_running"), of("firn_job_attempts_total")), (2.0, 1.0, 1.0));
    let oldest = of("firn_jobs_oldest_waiting_seconds");
    assert!((1.1..60.0).contains(&oldest), "{oldest}");

    app.delete(&format!("/v1/jobs/{running}")).await.json(200);
    ended(&app, &first).await;
    let after = figures(&app).await;
    assert_eq!(after["firn_job_dismissals_total"], 1.0);
    for write in ["beat", "log", "checkpoint", "piece", "release", "result"] {
        assert_eq!(after[&format!("firn_job_fenced_writes_total{{write=\"{write}\"}}")], 0.0);
    }
}

#[tokio::test]
async fn requests_are_timed_by_the_route_that_took_them() {
    let app = TestApp::start().await;
    for job in ["019ab3c4-0000-7000-8000-000000000000", "019ab3c4-0000-7000-8000-000000000001"] {
        app.get(&format!("/v1/jobs/{job}")).await.problem("no-such-job");
    }
    app.get("/v1/nowhere").await.problem("not-found");
    app.call(Method::PATCH, "/v1/jobs").await.problem("method-not-allowed");
    let figures = figures(&app).await;
    let of = |kind: &str, labels: &str| figures[&format!("firn_http_request_duration_seconds_{kind}{{{labels}}}")];
    let jobs = r#"method="GET",route="/v1/jobs/{jobID}",status="404""#;
    assert_eq!(of("count", jobs), 2.0);
    assert_eq!(of("bucket", &format!(r#"{jobs},le="+Inf""#)), 2.0);
    assert!(of("sum", jobs) > 0.0);
    assert_eq!(of("count", r#"method="GET",route="none",status="404""#), 1.0);
    assert_eq!(of("count", r#"method="other",route="/v1/jobs",status="405""#), 1.0);
}

#[tokio::test]
async fn no_key_is_needed_and_other_methods_are_refused() {
    let app = TestApp::with(|config| {
        config.listen = "0.0.0.0:0".parse().unwrap();
        config.allow_anonymous = true;
    });
    let app = app.await;
    figures(&app).await;
    app.post("/metrics").await.problem("method-not-allowed");
}
