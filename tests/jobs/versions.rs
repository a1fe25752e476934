//! Workers of another version than the server.

use std::time::Duration;

use firn::domain::job::Status;
use serde_json::json;

use crate::{processes::PATIENCE, rig::Rig};

#[tokio::test]
async fn a_worker_that_is_turned_away_takes_no_more_and_the_job_waits_for_another() {
    let mut rig = Rig::local(Duration::from_secs(30)).await;
    let id = rig.submit(json!({"message": "a"}), 5).await;
    let fitting = rig.link.clone();
    rig.newer_desk();
    let old = rig.worker("old", 1);
    tokio::time::timeout(PATIENCE, old.unfit()).await.expect("it is turned away");
    old.stop(Duration::from_secs(5)).await;
    assert_eq!(rig.job(id).await.status, Status::Accepted);
    rig.link = fitting;
    let _new = rig.worker("new", 1);
    let job = rig.ended(id).await;
    assert_eq!((job.status, job.attempt, job.worker.as_deref()), (Status::Successful, 1, Some("new")));
}
