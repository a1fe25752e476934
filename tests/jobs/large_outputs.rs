//! Large outputs: by reference, with parts of them, entity tags and digests.

use base64::Engine as _;
use serde_json::json;
use sha2::{Digest, Sha256};

use crate::{
    lost_workers::{echo, ended},
    support::TestApp,
};

const SIZE: usize = 1_000_003;

/// What echo attaches: the number of each byte modulo 251.
fn expected() -> Vec<u8> {
    (0..SIZE).map(|at| (at % 251) as u8).collect()
}

#[tokio::test]
async fn an_attachment_can_be_had_in_parts() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "attachment_bytes": SIZE})).await;
    assert_eq!(ended(&app, &job).await["status"], "successful");
    let results = app.read(&format!("/v1/jobs/{job}/results")).await;
    let sha256: String = Sha256::digest(expected()).iter().map(|byte| format!("{byte:02x}")).collect();
    let at = format!("/v1/jobs/{job}/results/attachment");
    assert_eq!(
        results["attachment"],
        json!({"href": at, "type": "application/octet-stream", "length": SIZE, "sha256": sha256})
    );

    let whole = app.get(&at).await;
    assert_eq!(whole.status, 200);
    assert!(whole.body == expected());
    assert_eq!(whole.header("accept-ranges"), "bytes");
    let digest = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(expected()));
    assert_eq!(whole.header("repr-digest"), format!("sha-256=:{digest}:"));
    assert_eq!(whole.header("content-digest"), whole.header("repr-digest"));
    // compressed bytes would have another digest, and no part of them would fit to these
    let compressed = app.get(&at).header("accept-encoding", "gzip").await;
    assert_eq!(compressed.headers.get("content-encoding"), None);
    assert!(compressed.body == expected());
    let tag = whole.header("etag").to_owned();
    assert_eq!(app.get(&at).header("if-none-match", &tag).await.status, 304);

    let parts: [(&str, std::ops::Range<usize>); 4] = [
        ("bytes=0-9", 0..10),
        ("bytes=500000-500099", 500_000..500_100),
        ("bytes=-5", SIZE - 5..SIZE),
        ("bytes=999999-99999999", 999_999..SIZE),
    ];
    for (range, bytes) in parts {
        let part = app.get(&at).header("range", range).await;
        assert_eq!(part.status, 206, "{range}");
        assert_eq!(part.header("content-range"), format!("bytes {}-{}/{SIZE}", bytes.start, bytes.end - 1));
        assert_eq!(part.header("repr-digest"), format!("sha-256=:{digest}:"), "of the whole, not of the part");
        let of_part = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(&expected()[bytes.clone()]));
        assert_eq!(part.header("content-digest"), format!("sha-256=:{of_part}:"));
        assert!(part.body == expected()[bytes]);
    }
    // the version that the caller has the first part of, and another
    let same = app.get(&at).header("range", "bytes=0-9").header("if-range", &tag).await;
    assert_eq!((same.status, same.body.len()), (206, 10));
    let other = app.get(&at).header("range", "bytes=0-9").header("if-range", "\"other\"").await;
    assert_eq!((other.status, other.body.len()), (200, SIZE));
    // several at once may be answered with all
    assert_eq!(app.get(&at).header("range", "bytes=0-1,4-5").await.status, 200);

    let beyond = app.get(&at).header("range", &format!("bytes={SIZE}-")).await;
    assert_eq!(beyond.header("content-range"), format!("bytes */{SIZE}"));
    assert_eq!(beyond.problem("range-not-satisfiable")["length"], SIZE);
    app.get(&format!("/v1/jobs/{job}/results/nothing")).await.problem("unknown-output");
    assert_eq!(app.read(&format!("/v1/jobs/{job}/results/message")).await, "a");
}

#[tokio::test]
async fn equal_attachments_of_two_jobs_are_stored_once_and_kept_for_the_other() {
    let app = TestApp::start().await;
    let mut jobs = Vec::new();
    for message in ["a", "b"] {
        let job = echo(&app, json!({"message": message, "attachment_bytes": 1000})).await;
        ended(&app, &job).await;
        jobs.push(job);
    }
    assert_eq!(app.stored(), 1);
    app.delete(&format!("/v1/jobs/{}", jobs[0])).await.json(200);
    assert_eq!(app.get(&format!("/v1/jobs/{}/results/attachment", jobs[1])).await.body.len(), 1000);
    app.delete(&format!("/v1/jobs/{}", jobs[1])).await.json(200);
    assert_eq!(app.stored(), 0);
}

#[tokio::test]
async fn what_nobody_names_is_removed_and_what_somebody_names_stays() {
    let app = TestApp::start().await;
    let job = echo(&app, json!({"message": "a", "attachment_bytes": 1000})).await;
    ended(&app, &job).await;
    app.post("/v1/datasets?name=a&amplitude_unit=v").body("text/csv", "amplitude\n1\n2\n").await.json(201);
    // as a kill between storing and writing the row leaves it
    let desk = &app.state.desk;
    desk.artifacts().put_piece(b"nobody names me").await.unwrap();
    // the caretaker may have been first
    assert!(desk.sweep_artifacts().await.unwrap() <= 1);
    assert_eq!(app.stored(), 2);
    assert_eq!(app.get(&format!("/v1/jobs/{job}/results/attachment")).await.body.len(), 1000);
}

#[tokio::test]
async fn two_services_do_not_share_a_place_for_outputs() {
    let app = TestApp::start().await;
    let place = app.data_dir().join("artifacts");
    let data = crate::support::app::data_dir();
    let mut config = crate::support::app::config(data.path());
    config.artifacts = place.to_str().unwrap().parse().unwrap();
    let refused = firn::server::Server::bind(config).await.err().expect("it belongs to another").to_string();
    assert!(refused.contains("belongs to another firn"), "{refused}");
}

#[tokio::test]
async fn a_large_member_of_the_results_goes_by_reference() {
    let app = TestApp::start().await;
    let message = "x".repeat(10_000);
    let job = echo(&app, json!({"message": message, "parts": 30})).await;
    assert_eq!(ended(&app, &job).await["status"], "successful");
    let results = app.read(&format!("/v1/jobs/{job}/results")).await;
    assert_eq!(results["message"], message);
    assert_eq!(results["parts"]["type"], "application/json", "{}", results["parts"]);
    let parts = app.get(results["parts"]["href"].as_str().unwrap()).await.json(200);
    assert_eq!(parts, json!(vec![json!({"message": message}); 30]));
}
