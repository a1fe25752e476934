//! Large outputs in S3. `tests/s3/run` starts something that speaks S3, makes the bucket and says where it is.

use firn::jobs::artifacts::Artifacts;
use futures_util::TryStreamExt as _;
use object_store::{ObjectMeta, ObjectStore as _, aws::AmazonS3Builder};
use serde_json::json;

use crate::{
    lost_workers::{echo, ended},
    support::TestApp,
};

const SIZE: usize = 3_000_000;

/// The bucket of the test; none, with a message, where there is nothing that speaks S3.
fn bucket() -> Option<String> {
    let bucket = std::env::var("FIRN_S3_TEST_BUCKET").ok();
    if bucket.is_none() {
        println!("skipped: tests/s3/run sets FIRN_S3_TEST_BUCKET");
    }
    bucket
}

/// What lies in the bucket.
async fn objects(bucket: &str) -> Vec<ObjectMeta> {
    let store = AmazonS3Builder::from_env().with_bucket_name(bucket).build().unwrap();
    let all: Vec<ObjectMeta> = store.list(None).try_collect().await.unwrap();
    all.into_iter().filter(|object| !object.location.as_ref().ends_with("/owner")).collect()
}

#[tokio::test]
async fn outputs_lie_in_the_bucket_as_long_as_a_job_names_them() {
    let Some(bucket) = bucket() else { return };
    let place = format!("s3://{bucket}/of/firn").parse().unwrap();
    let app = TestApp::with(|config| config.artifacts = place).await;
    let mut jobs = Vec::new();
    for message in ["a", "b"] {
        let job = echo(&app, json!({"message": message, "attachment_bytes": SIZE})).await;
        assert_eq!(ended(&app, &job).await["status"], "successful");
        jobs.push(job);
    }
    let results = app.read(&format!("/v1/jobs/{}/results", jobs[0])).await;
    let stored = objects(&bucket).await;
    assert_eq!(stored.len(), 1, "equal bytes are stored once");
    assert_eq!(stored[0].location.as_ref(), format!("of/firn/{}", results["attachment"]["sha256"].as_str().unwrap()));
    assert_eq!(stored[0].size, SIZE as u64);
    assert!(!app.data_dir().join("artifacts").exists(), "nothing lies beside the database");

    let at = format!("/v1/jobs/{}/results/attachment", jobs[0]);
    let whole = app.get(&at).await;
    assert!(whole.body.len() == SIZE && whole.body.iter().enumerate().all(|(at, byte)| *byte == (at % 251) as u8));
    let part = app.get(&at).header("range", "bytes=-7").await;
    assert_eq!((part.status, &part.body[..]), (206, &whole.body[SIZE - 7..]));

    app.delete(&format!("/v1/jobs/{}", jobs[0])).await.json(200);
    assert_eq!(objects(&bucket).await.len(), 1, "the other job names it");
    app.delete(&format!("/v1/jobs/{}", jobs[1])).await.json(200);
    assert_eq!(objects(&bucket).await.len(), 0);
}

#[tokio::test]
async fn a_bucket_that_is_not_there_is_told_at_the_start() {
    let Some(bucket) = bucket() else { return };
    let place = format!("s3://not-{bucket}/x").parse().unwrap();
    assert!(Artifacts::open(&place).await.is_err());
}
