//! Parents and children as a caller sees them.

use serde_json::{Value, json};

use crate::{
    lost_workers::{echo, ended},
    support::{
        TestApp,
        trained::{id, until},
    },
};

async fn children(app: &TestApp, parent: &str) -> Vec<Value> {
    app.read(&format!("/v1/jobs?parent={parent}")).await["jobs"].as_array().unwrap().clone()
}

#[tokio::test]
async fn a_parent_gives_what_its_parts_gave_in_their_order() {
    let app = TestApp::start().await;
    let request =
        json!({"inputs": {"message": "a", "parts": 5, "delay_s": 0.05}, "labels": {"sweep": "one"}, "priority": 7});
    let parent = app.post("/v1/processes/echo/execution").json(&request).await.json(201);
    let parent = ended(&app, id(&parent)).await;
    assert_eq!(parent["status"], "successful", "{parent}");
    let results = app.read(&format!("/v1/jobs/{}/results", id(&parent))).await;
    assert_eq!(results, json!({"message": "a", "parts": vec![json!({"message": "a"}); 5]}));

    let children = children(&app, id(&parent)).await;
    assert_eq!(children.len(), 5);
    for child in &children {
        assert_eq!(child["parent"], parent["jobID"]);
        assert_eq!((&child["labels"], &child["priority"]), (&json!({"sweep": "one"}), &json!(7)));
        let up = child["links"].as_array().unwrap().iter().find(|link| link["rel"] == "up").unwrap();
        assert_eq!(up["href"], format!("/v1/jobs/{}", id(&parent)));
    }
    // with the parent go its children
    app.delete(&format!("/v1/jobs/{}", id(&parent))).await.json(200);
    app.get(&format!("/v1/jobs/{}", id(&children[0]))).await.problem("no-such-job");
}

#[tokio::test]
async fn a_part_that_fails_fails_its_parent() {
    let app = TestApp::start().await;
    let parent = echo(&app, json!({"message": "a", "parts": 2, "fail": true})).await;
    let failed = ended(&app, &parent).await;
    assert_eq!(failed["status"], "failed");
    assert_eq!(failed["exception"]["detail"], "part 0 has no result: it was asked to fail");
    app.get(&format!("/v1/jobs/{parent}/results")).await.problem("job-failed");
}

#[tokio::test]
async fn a_part_that_is_dismissed_fails_its_parent() {
    let app = TestApp::start().await;
    let parent = echo(&app, json!({"message": "a", "parts": 2, "delay_s": 600})).await;
    until(&app, &parent, |job| job["phase"] == "waiting for its children").await;
    for child in children(&app, &parent).await {
        app.delete(&format!("/v1/jobs/{}", id(&child))).await.json(200);
    }
    let failed = ended(&app, &parent).await;
    assert_eq!(failed["exception"]["detail"], "part 0 has no result: it was dismissed");
}

#[tokio::test]
async fn the_dismissal_of_a_parent_dismisses_its_children() {
    let app = TestApp::start().await;
    let parent = echo(&app, json!({"message": "a", "parts": 4, "delay_s": 600})).await;
    until(&app, &parent, |job| job["phase"] == "waiting for its children").await;
    for child in children(&app, &parent).await.iter().take(1) {
        until(&app, id(child), |job| !job["status"].is_null()).await;
    }
    let dismissed = app.delete(&format!("/v1/jobs/{parent}")).await.json(200);
    assert_eq!(dismissed["status"], "dismissed");
    let children = children(&app, &parent).await;
    assert_eq!(children.len(), 4);
    assert!(children.iter().all(|child| child["status"] == "dismissed"), "{children:?}");
    // the slots are free again
    let next = echo(&app, json!({"message": "next"})).await;
    assert_eq!(ended(&app, &next).await["status"], "successful");
    assert_eq!(app.read(&format!("/v1/jobs/{parent}")).await["status"], "dismissed");
}

#[tokio::test]
async fn a_part_is_not_removed_before_its_parent() {
    let app = TestApp::with(|config| config.job_slots = 1).await;
    // one slot: the second part has not begun when the first has ended
    let parent = echo(&app, json!({"message": "a", "parts": 2, "delay_s": 1})).await;
    until(&app, &parent, |job| job["progress"].as_u64() > Some(0)).await;
    let parts = children(&app, &parent).await;
    let done = parts.iter().find(|part| part["status"] == "successful").expect("one has ended");
    let at = format!("/v1/jobs/{}", id(done));
    let refused = app.delete(&at).await.problem("part-of-another-job");
    assert!(refused["detail"].as_str().unwrap().contains(&parent), "{refused}");
    let results = app.read(&format!("/v1/jobs/{}/results", id(&ended(&app, &parent).await))).await;
    assert_eq!(results["parts"], json!([{"message": "a"}, {"message": "a"}]));
    // nor later: the results of the parent may name its outputs
    app.delete(&at).await.problem("part-of-another-job");
    app.delete(&format!("/v1/jobs/{parent}")).await.json(200);
    app.get(&at).await.problem("no-such-job");
}
