//! The events of a job as a stream that can be resumed.

use std::{future::IntoFuture, time::Duration};

use serde_json::{Value, json};

use crate::{
    lost_workers::{echo, ended},
    support::{TestApp, trained::until},
};

/// One event as the stream wrote it.
#[derive(Clone, Debug, PartialEq)]
struct Event {
    id: i64,
    kind: String,
    data: Value,
}

/// The events of a stream that has ended.
fn events(text: &str) -> Vec<Event> {
    let field = |block: &str, name: &str| {
        block.lines().find_map(|line| Some(line.strip_prefix(name)?.strip_prefix(':')?.trim().to_owned()))
    };
    let read = |block: &str| {
        let data = serde_json::from_str(&field(block, "data")?).expect("data in JSON");
        Some(Event { id: field(block, "id")?.parse().ok()?, kind: field(block, "event")?, data })
    };
    text.split("\n\n").filter_map(read).collect()
}

#[tokio::test]
async fn a_stream_tells_a_job_from_its_beginning_to_its_end() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "delay_s": 2})).await;
    let at = format!("/v1/jobs/{job}/events");
    // it is read while the job runs, and ends by itself
    let answer = app.get(&at).await;
    assert_eq!(answer.header("content-type"), "text/event-stream");
    let live = events(&answer.text());
    let status: Vec<&Value> =
        live.iter().filter(|event| event.kind == "status").map(|event| &event.data["status"]).collect();
    assert_eq!(status, ["accepted", "running", "successful"]);
    assert!(live.iter().map(|event| event.id).is_sorted_by(|a, b| a < b), "{live:?}");
    let percents: Vec<u64> = live
        .iter()
        .filter(|event| event.kind == "progress")
        .map(|event| event.data["percent"].as_u64().unwrap())
        .collect();
    assert!(percents.len() >= 2 && percents.is_sorted(), "{live:?}");

    // who lost the connection after the second event goes on with the third
    let resumed = app.get(&at).header("last-event-id", &live[1].id.to_string()).await;
    let resumed = events(&resumed.text());
    assert!(resumed.iter().all(|event| event.id > live[1].id));
    assert_eq!(resumed.last(), live.last());
    let nothing = app.get(&at).header("last-event-id", &live.last().unwrap().id.to_string()).await;
    assert_eq!((nothing.status, events(&nothing.text())), (200, vec![]));
    app.get("/v1/jobs/00000000-0000-7000-8000-000000000000/events").await.problem("no-such-job");
}

#[tokio::test]
async fn a_stream_ends_with_the_dismissal_of_its_job() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "delay_s": 600})).await;
    until(&app, &job, |job| job["status"] == "running").await;
    let stream = tokio::spawn(app.get(&format!("/v1/jobs/{job}/events")).into_future());
    tokio::time::sleep(Duration::from_millis(100)).await;
    app.delete(&format!("/v1/jobs/{job}")).await.json(200);
    let told = events(&stream.await.unwrap().text());
    assert_eq!(told.last().unwrap().data["status"], "dismissed");
}

#[tokio::test]
async fn the_stream_of_a_parent_tells_how_many_children_are_open() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "parts": 3, "delay_s": 0.6})).await;
    let told = events(&app.get(&format!("/v1/jobs/{job}/events")).await.text());
    let open: Vec<&Value> =
        told.iter().filter(|event| event.kind == "progress").map(|event| &event.data["open_children"]).collect();
    assert_eq!(open[open.len() - 3..], [2, 1, 0], "{told:?}");
    assert_eq!(ended(&app, &job).await["progress"], 100);
}

#[tokio::test]
async fn only_so_many_streams_are_open_at_once() {
    let app = TestApp::with(|config| config.max_requests = 2).await;
    let job = echo(&app, json!({"message": "a", "delay_s": 60})).await;
    let at = format!("http://{}/v1/jobs/{job}/events", app.address);
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    // the answer is there once its head is: the bodies stay unread and open
    let open = || async { client.get(&at).send().await.unwrap() };
    let (one, two) = (open().await, open().await);
    assert!(one.status() == 200 && two.status() == 200);
    let refused = app.get(&format!("/v1/jobs/{job}/events")).await;
    assert_eq!(refused.header("retry-after"), "10");
    refused.problem("overloaded");
    drop(one);
    until(&app, &job, |status| status["status"] == "running").await;
    let since = std::time::Instant::now();
    while open().await.status() != 200 {
        assert!(since.elapsed() < crate::processes::PATIENCE, "a stream that was closed still counts");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}
