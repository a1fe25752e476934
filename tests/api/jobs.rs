//! Jobs are watched, listed and given up.

use firn::{
    domain::{
        ids::new_id,
        job::{Exception, Job, Labels, Priority, Report, Spent, Status, Wanted},
    },
    store::jobs::{Claim, Outcome},
};
use insta::assert_json_snapshot;
use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};
use uuid::Uuid;

use crate::support::{
    TestApp,
    app::beside_the_servers,
    data,
    trained::{id, submit, trained, until},
};

/// One training at a time on one thread, of a station that takes many times as long as a test waits.
async fn busy() -> TestApp {
    let app = TestApp::with(|config| (config.job_slots, config.compute_threads) = (1, 1)).await;
    app.station("long").await.station("short").await;
    app.import_csv("long", &data::csv(&data::winters(7, 14))).await.json(200);
    app.import_csv("short", &data::csv(&data::winters(7, 3))).await.json(200);
    app
}

fn inputs(station: &str) -> Value {
    json!({"station": station, "label": "observed", "lead": 0})
}

fn is(status: &'static str) -> impl Fn(&Value) -> bool {
    move |job| job["status"] == status
}

#[tokio::test]
async fn a_job_is_accepted_with_its_address() {
    let app = busy().await;
    let request = json!({"inputs": inputs("long"), "outputs": {}, "response": "document"});
    let call = app.post("/v1/processes/train-model/execution").json(&request).header("prefer", "respond-async");
    let answer = call.await;
    assert_eq!(answer.header("preference-applied"), "respond-async");
    let job = answer.json(201);
    assert_eq!(answer.header("location"), format!("/v1/jobs/{}", id(&job)));
    assert_json_snapshot!(job, {
        ".jobID" => "[id]", ".id" => "[id]", ".created" => "[instant]", ".updated" => "[instant]", ".links[].href" => "[path]"
    }, @r#"
    {
      "jobID": "[id]",
      "id": "[id]",
      "type": "process",
      "processID": "train-model",
      "status": "accepted",
      "progress": 0,
      "phase": null,
      "rate": null,
      "rateUnit": null,
      "etaSeconds": null,
      "attempt": 0,
      "priority": 5,
      "labels": {},
      "parent": null,
      "reused": false,
      "message": null,
      "exception": null,
      "created": "[instant]",
      "started": null,
      "finished": null,
      "updated": "[instant]",
      "links": [
        {
          "href": "[path]",
          "rel": "self",
          "type": "application/json",
          "title": "this document"
        },
        {
          "href": "[path]",
          "rel": "monitor",
          "type": "application/json",
          "title": "the status of the job"
        },
        {
          "href": "[path]",
          "rel": "http://www.opengis.net/def/rel/ogc/1.0/log",
          "type": "application/json",
          "title": "the log"
        }
      ]
    }
    "#);
    let watched = app.get(answer.header("location")).await;
    assert_eq!(watched.header("retry-after"), "1");
    assert_eq!(watched.json(200)["jobID"], job["jobID"]);
}

#[tokio::test]
async fn a_running_job_has_no_results_yet_and_stops_when_it_is_given_up() {
    let app = busy().await;
    let long = submit(&app, &inputs("long")).await;
    let waiting = submit(&app, &inputs("short")).await;
    let running = until(&app, id(&long), |job| job["progress"].as_u64() > Some(0)).await;
    assert_eq!(running["status"], "running");
    assert!(running["phase"].is_string() && running["started"].is_string(), "{running}");
    let at = format!("/v1/jobs/{}", id(&long));
    let early = app.get(&format!("{at}/results")).await.problem("result-not-ready");
    assert_eq!(early["type"], "http://www.opengis.net/def/exceptions/ogcapi-processes-1/1.0/result-not-ready");

    let dismissed = app.delete(&at).await.json(200);
    assert_eq!((&dismissed["status"], &dismissed["message"]), (&json!("dismissed"), &json!("dismissed on request")));
    // its thread is free for the next long before the long one could have ended: the computation has stopped
    let next = until(&app, id(&waiting), |job| job["status"] != "accepted").await;
    let ended: Timestamp = dismissed["finished"].as_str().unwrap().parse().unwrap();
    let started: Timestamp = next["started"].as_str().unwrap().parse().unwrap();
    assert!(started.duration_since(ended) < SignedDuration::from_secs(1), "{ended} {started}");
    app.get(&format!("{at}/results")).await.problem("job-dismissed");

    // the record stays as it is until it is removed
    until(&app, id(&waiting), is("successful")).await;
    assert_eq!(app.read(&at).await, dismissed);
    assert_eq!(app.delete(&at).await.json(200), dismissed);
    app.get(&at).await.problem("no-such-job");
    app.delete(&at).await.problem("no-such-job");
    assert_eq!(app.read("/v1/models").await["models"].as_array().unwrap().len(), 1, "the short one only");
}

#[tokio::test]
async fn a_waiting_job_that_is_given_up_never_starts() {
    let app = busy().await;
    let first = submit(&app, &inputs("long")).await;
    let second = submit(&app, &inputs("short")).await;
    let third = submit(&app, &inputs("short")).await;
    until(&app, id(&first), is("running")).await;
    app.delete(&format!("/v1/jobs/{}", id(&second))).await.json(200);
    app.delete(&format!("/v1/jobs/{}", id(&first))).await.json(200);
    until(&app, id(&third), is("successful")).await;
    let second = app.read(&format!("/v1/jobs/{}", id(&second))).await;
    assert_eq!((&second["status"], &second["started"]), (&json!("dismissed"), &Value::Null));
}

#[tokio::test]
async fn jobs_over_the_queue_are_refused_for_now() {
    let app = TestApp::with(|config| {
        (config.job_slots, config.compute_threads, config.max_queue) = (1, 1, 1);
    })
    .await;
    app.station("long").await.import_csv("long", &data::csv(&data::winters(7, 14))).await.json(200);
    let first = submit(&app, &inputs("long")).await;
    until(&app, id(&first), is("running")).await;
    submit(&app, &inputs("long")).await;
    let full = app.post("/v1/processes/train-model/execution").json(&json!({"inputs": inputs("long")})).await;
    full.problem("overloaded");
    assert_eq!(full.header("retry-after"), "10");
    assert_eq!(app.rows().await["job"], 2);
}

#[tokio::test]
async fn removing_a_job_keeps_its_model() {
    let app = TestApp::start().await;
    app.station("short").await.import_csv("short", &data::csv(&data::winters(7, 3))).await.json(200);
    let mut inputs = inputs("short");
    inputs["kernel"] = json!("linear");
    let job = crate::support::trained::train(&app, &inputs).await;
    app.delete(&format!("/v1/jobs/{}", id(&job))).await.json(200);
    app.get(&format!("/v1/jobs/{}/results", id(&job))).await.problem("no-such-job");
    let model = &app.read("/v1/models").await["models"][0];
    assert_eq!(model["job"], job["jobID"]);
    assert_eq!(app.get(model["links"][1]["href"].as_str().unwrap()).await.status, 200);
}

#[tokio::test]
async fn an_ended_job_is_dressed_for_its_reader() {
    let trained = trained().await;
    assert_json_snapshot!(trained.job, {
        ".jobID" => "[id]", ".id" => "[id]", ".created" => "[instant]", ".started" => "[instant]",
        ".finished" => "[instant]", ".updated" => "[instant]", ".links[].href" => "[path]"
    }, @r#"
    {
      "jobID": "[id]",
      "id": "[id]",
      "type": "process",
      "processID": "train-model",
      "status": "successful",
      "progress": 100,
      "phase": null,
      "rate": null,
      "rateUnit": null,
      "etaSeconds": null,
      "attempt": 1,
      "priority": 5,
      "labels": {},
      "parent": null,
      "reused": false,
      "message": null,
      "exception": null,
      "created": "[instant]",
      "started": "[instant]",
      "finished": "[instant]",
      "updated": "[instant]",
      "links": [
        {
          "href": "[path]",
          "rel": "self",
          "type": "application/json",
          "title": "this document"
        },
        {
          "href": "[path]",
          "rel": "monitor",
          "type": "application/json",
          "title": "the status of the job"
        },
        {
          "href": "[path]",
          "rel": "http://www.opengis.net/def/rel/ogc/1.0/results",
          "type": "application/json",
          "title": "the results"
        },
        {
          "href": "[path]",
          "rel": "http://www.opengis.net/def/rel/ogc/1.0/log",
          "type": "application/json",
          "title": "the log"
        }
      ]
    }
    "#);
    let at = format!("/v1/jobs/{}", id(&trained.job));
    let answer = trained.app.get(&at).await;
    assert!(answer.headers.get("retry-after").is_none(), "nothing to wait for");
    assert_eq!(trained.app.get(&at).header("if-none-match", answer.header("etag")).await.status, 304);
    let stamp = |name: &str| trained.job[name].as_str().unwrap().parse::<Timestamp>().unwrap();
    assert!(stamp("created") <= stamp("started") && stamp("started") < stamp("finished"));
}

/// Five jobs of known times, as a busy week would leave them; oldest first.
async fn a_week(app: &TestApp) -> Vec<Uuid> {
    let store = app.state.store.clone();
    beside_the_servers(async move {
        let mut ids = Vec::new();
        let monday: Timestamp = "2026-11-16T06:00:00Z".parse().unwrap();
        let outcomes = [
            Some(Outcome::Successful { results: json!({}), outputs: vec![] }),
            Some(Outcome::Failed(Exception { code: "job-failed".into(), detail: "it broke".into() })),
            None,
            Some(Outcome::Successful { results: json!({}), outputs: vec![] }),
        ];
        for (day, outcome) in (0..).zip(outcomes) {
            let created = monday + SignedDuration::from_hours(24 * day);
            let job = job(if day == 3 { "echo" } else { "train-model" }, created);
            store.insert_job(&job, None).await.unwrap();
            let taken =
                store.claim_job(job.id, "somebody", created, SignedDuration::from_secs(60), true).await.unwrap();
            assert!(matches!(taken, Claim::Taken { .. }), "{taken:?}");
            let end = created + SignedDuration::from_secs(10 * (day + 1));
            match outcome {
                Some(outcome) => drop(store.finish_job(job.id, 1, outcome, None, Spent::default(), end).await.unwrap()),
                None => drop(store.dismiss_job(job.id, end).await.unwrap()),
            }
            ids.push(job.id);
        }
        let waiting = job("train-model", monday + SignedDuration::from_hours(24 * 4));
        store.insert_job(&waiting, None).await.unwrap();
        ids.push(waiting.id);
        ids
    })
    .await
}

fn job(process: &str, created: Timestamp) -> Job {
    Job {
        id: new_id(),
        process_id: process.into(),
        status: Status::Accepted,
        report: Report::default(),
        message: None,
        exception: None,
        inputs: json!({}),
        input_hash: String::new(),
        version: "0".into(),
        submitted_by: None,
        labels: Labels::new(),
        wanted: Wanted::default(),
        priority: Priority::default(),
        parent: None,
        position: None,
        attempt: 0,
        worker: None,
        spent: Spent::default(),
        created,
        started: None,
        finished: None,
        updated: created,
    }
}

#[tokio::test]
async fn the_list_of_jobs_is_filtered() {
    let app = TestApp::start().await;
    let week = a_week(&app).await;
    let cases: [(&str, &[usize]); 16] = [
        ("", &[4, 3, 2, 1, 0]),
        ("status=successful", &[3, 0]),
        ("status=failed,dismissed", &[2, 1]),
        ("status=accepted", &[4]),
        ("status=running", &[]),
        ("processID=echo", &[3]),
        ("processID=nothing", &[]),
        ("type=process&status=failed", &[1]),
        ("datetime=2026-11-17T06:00:00Z", &[1]),
        ("datetime=2026-11-17T06:00:00Z/2026-11-18T06:00:00Z", &[2, 1]),
        ("datetime=2026-11-17T07:00:00%2B01:00/..", &[4, 3, 2, 1]),
        ("datetime=../2026-11-16T06:00:00Z", &[0]),
        ("minDuration=20", &[3, 2, 1]),
        ("maxDuration=20", &[1, 0]),
        ("minDuration=20&maxDuration=30", &[2, 1]),
        ("status=successful&processID=train-model&maxDuration=15", &[0]),
    ];
    for (query, expected) in cases {
        let list = app.read(&format!("/v1/jobs?{query}")).await;
        let found: Vec<&str> = list["jobs"].as_array().unwrap().iter().map(id).collect();
        let expected: Vec<String> = expected.iter().map(|at| week[*at].to_string()).collect();
        assert_eq!(found, expected, "{query}");
    }
}

#[tokio::test]
async fn the_next_page_of_a_filtered_list_is_filtered_too() {
    let app = TestApp::start().await;
    let week = a_week(&app).await;
    let query = "processID=train-model&status=failed,successful,dismissed&datetime=2026-11-16T06:00:00Z/..&minDuration=1&limit=1";
    let mut path = Some(format!("/v1/jobs?{query}"));
    let mut found = Vec::new();
    while let Some(at) = path {
        let answer = app.get(&at).await;
        let page = answer.json(200);
        found.extend(page["jobs"].as_array().unwrap().iter().map(|job| id(job).to_owned()));
        path = page["links"].as_array().unwrap().iter().find(|link| link["rel"] == "next").map(|link| {
            let href = link["href"].as_str().unwrap().to_owned();
            assert_eq!(answer.header("link"), format!("<{href}>; rel=\"next\""));
            href
        });
    }
    let expected: Vec<String> = [2, 1, 0].map(|at: usize| week[at].to_string()).into();
    assert_eq!(found, expected);
}

#[tokio::test]
async fn a_failed_job_says_why_instead_of_results() {
    let app = TestApp::start().await;
    let week = a_week(&app).await;
    let failed = app.read(&format!("/v1/jobs/{}", week[1])).await;
    assert_eq!(failed["exception"], json!({"code": "job-failed", "detail": "it broke"}));
    let problem = app.get(&format!("/v1/jobs/{}/results", week[1])).await.problem("job-failed");
    assert_eq!(problem["detail"], "it broke");
}
