//! A request that is sent twice with one key is done once.

use reqwest::Method;
use serde_json::{Value, json};
use tokio::{io::AsyncWriteExt, net::TcpStream};

use crate::support::{
    Answer, TestApp,
    app::{beside_the_servers, data_dir},
    binary::Serving,
};

const EXECUTION: &str = "/v1/processes/echo/execution";

async fn post(app: &TestApp, key: &str, body: &Value) -> Answer {
    app.post(EXECUTION).header("idempotency-key", key).json(body).await
}

async fn jobs(app: &TestApp) -> usize {
    app.read("/v1/jobs?limit=1000").await["jobs"].as_array().unwrap().len()
}

#[tokio::test(flavor = "multi_thread")]
async fn fifty_requests_at_once_with_one_key_are_one_job() {
    let app = TestApp::start().await;
    let body = json!({"inputs": {"message": "once", "delay_s": 0.5}});
    let calls = (0..50).map(|_| {
        let call = app.post(EXECUTION).header("idempotency-key", "fifty").json(&body);
        async move { call.await }
    });
    let mut made = Vec::new();
    for answer in calls.map(tokio::spawn).collect::<Vec<_>>() {
        let answer = answer.await.unwrap();
        if answer.status == 201 {
            made.push((answer.header("location").to_owned(), answer.json(201)));
        } else {
            answer.problem("request-at-work");
        }
    }
    assert!(!made.is_empty());
    assert!(made.iter().all(|answer| *answer == made[0]), "{made:?}");
    assert_eq!(jobs(&app).await, 1);

    // later, once the job has ended, the answer is still the first
    let id = made[0].1["jobID"].as_str().unwrap();
    crate::lost_workers::ended(&app, id).await;
    let again = post(&app, "fifty", &body).await;
    assert_eq!((again.header("location"), again.json(201)), (made[0].0.as_str(), made[0].1.clone()));
    assert_eq!(jobs(&app).await, 1);
    // another body is another request
    post(&app, "fifty", &json!({"inputs": {"message": "other"}})).await.problem("idempotency-key-reused");
    assert_eq!(jobs(&app).await, 1);
}

#[tokio::test]
async fn a_refusal_does_not_burn_the_key() {
    let app = TestApp::start().await;
    post(&app, "k", &json!({"inputs": {"message": "a", "delay_s": -1}})).await.problem("invalid-inputs");
    post(&app, "k", &json!({"inputs": {}})).await.problem("invalid-inputs");
    let made = post(&app, "k", &json!({"inputs": {"message": "a"}})).await.json(201);
    assert_eq!(post(&app, "k", &json!({"inputs": {"message": "a"}})).await.json(201), made);
    for bad in ["", "a b", &"k".repeat(256)] {
        post(&app, bad, &json!({"inputs": {"message": "a"}})).await.problem("invalid-header");
    }
}

#[tokio::test]
async fn a_key_outlives_its_server() {
    let data = data_dir();
    let body = json!({"inputs": {"message": "a"}});
    let ask = async |server: &Serving| {
        let call = server.call(Method::POST, EXECUTION).header("idempotency-key", "restart").json(&body);
        let answer = call.await;
        (answer.header("location").to_owned(), answer.json(201))
    };
    let mut server = Serving::start(data.path(), &[]);
    let first = ask(&server).await;
    server.kill();
    let server = Serving::start(data.path(), &[]);
    assert_eq!(ask(&server).await, first);
}

#[tokio::test]
async fn a_caller_that_hangs_up_leaves_a_usable_key() {
    let app = TestApp::start().await;
    let body = r#"{"inputs":{"message":"a"}}"#;
    for number in 0..40_u64 {
        let request = format!(
            "POST {EXECUTION} HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\nidempotency-key: {number}\r\n\
             content-length: {}\r\n\r\n{body}",
            body.len()
        );
        let address = app.address;
        beside_the_servers(async move {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(request.as_bytes()).await.unwrap();
            // sooner or later in the course of its work
            tokio::time::sleep(std::time::Duration::from_micros(number * 200)).await;
        })
        .await;
    }
    for number in 0..40 {
        let again = async || {
            let call = app.post(EXECUTION).header("idempotency-key", &number.to_string());
            call.body("application/json", body).await
        };
        let mut answer = again().await;
        for _ in 0..100 {
            if answer.status == 201 {
                break;
            }
            answer.problem("request-at-work");
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
            answer = again().await;
        }
        answer.json(201);
    }
    assert_eq!(jobs(&app).await, 40);
}
