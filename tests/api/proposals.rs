//! A retraining proposes; a person decides.

use firn::jobs::retraining::start_due;
use jiff::Timestamp;
use serde_json::{Value, json};

use crate::support::{
    TestApp,
    app::beside_the_servers,
    data,
    trained::{id, train, until},
};

const EXECUTION: &str = "/v1/processes/retrain-model/execution";
const PROPOSALS: &str = "/v1/stations/a/proposals";

/// A station whose active model knows three of its four winters.
async fn one_winter_later() -> (TestApp, String) {
    let app = TestApp::start().await;
    app.station("a").await.import_csv("a", &data::csv(&data::winters(3, 3))).await.json(200);
    let inputs = json!({"station": "a", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30",
                        "to": "2014-06-30", "seed": 7});
    let job = train(&app, &inputs).await;
    let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
    let active = results["model_id"].as_str().unwrap().to_owned();
    app.import_csv("a", &data::csv(&data::winters(3, 4))).await.json(200);
    (app, active)
}

async fn ended(app: &TestApp, job: &str) -> Value {
    let ended = until(app, job, |job| !matches!(job["status"].as_str(), Some("accepted" | "running"))).await;
    assert_eq!(ended["status"], "successful", "{ended}");
    app.read(&format!("/v1/jobs/{job}/results")).await
}

async fn retrained(app: &TestApp, inputs: Value) -> Value {
    let job = app.post(EXECUTION).json(&json!({"inputs": inputs})).await.json(201);
    ended(app, id(&job)).await
}

async fn active(app: &TestApp) -> String {
    app.read("/v1/stations/a/active-model").await["model_id"].as_str().unwrap().to_owned()
}

#[tokio::test]
async fn a_retraining_proposes_and_replaces_nothing() {
    let (app, old) = one_winter_later().await;
    let results = retrained(&app, json!({"station": "a"})).await;
    assert_eq!((&results["activated"], results["model_id"] == json!(old)), (&json!(false), false));
    assert_eq!(active(&app).await, old, "nothing is replaced");
    // the recipe is that of the active model, on all days
    let new = results["model_id"].as_str().unwrap().to_owned();
    let model = app.read(&format!("/v1/models/{new}")).await;
    assert_eq!((&model["training"]["kernel"], &model["training"]["feature_set"]), (&json!("linear"), &json!("raw-30")));
    assert_eq!(model["training"]["seasons"], json!([2011, 2012, 2013, 2014]));
    assert_eq!(model["provenance"]["seed"], 7);
    assert_eq!(model["training"]["threshold_rule"]["kind"], "peirce");

    let list = app.read(PROPOSALS).await;
    let proposal = &list["proposals"][0];
    assert_eq!((&proposal["status"], &proposal["model_id"]), (&json!("open"), &json!(new)));
    assert_eq!(proposal["active_model_id"], json!(old));
    let comparison = &proposal["comparison"];
    assert_eq!(comparison["new_seasons"], json!([2014]));
    assert_eq!(comparison["seasons"].as_array().unwrap().len(), comparison["per_season"].as_array().unwrap().len());
    assert_eq!(comparison["candidate"], model["scores"], "the same seasons, held out alike");
    let auc = &comparison["difference"]["auc"];
    let (lower, upper) = (auc["lower"].as_f64().unwrap(), auc["upper"].as_f64().unwrap());
    assert!(lower <= upper && auc["estimate"].is_number());
    let recommendation = proposal["recommendation"].as_str().unwrap();
    assert!(recommendation.contains("seasons held out from both"), "{recommendation}");
    assert_eq!(&results["recommendation"], &proposal["recommendation"]);

    // accepted: the model is active, and the audit says who, when and why
    let at = format!("{PROPOSALS}/{}", proposal["id"].as_str().unwrap());
    let accepted = app.post(&format!("{at}/accept")).json(&json!({"reason": "one winter more"})).await.json(200);
    assert_eq!((&accepted["status"], &accepted["reason"]), (&json!("accepted"), &json!("one winter more")));
    assert!(accepted["decided"].is_string());
    assert_eq!(active(&app).await, new);
    for decision in ["accept", "decline"] {
        app.post(&format!("{at}/{decision}")).json(&json!({})).await.problem("proposal-closed");
    }
    let audit = app.read("/v1/audit?limit=3").await;
    let actions: Vec<&Value> = audit["entries"].as_array().unwrap().iter().map(|entry| &entry["action"]).collect();
    assert_eq!(json!(actions), json!(["proposal_accepted", "model_activated", "proposal_made"]));
    // and the way back is open
    app.post("/v1/stations/a/active-model/rollback").json(&json!({})).await.json(200);
    assert_eq!(active(&app).await, old);
}

#[tokio::test]
async fn a_declined_or_outdated_proposal_changes_nothing() {
    let (app, old) = one_winter_later().await;
    let first = retrained(&app, json!({"station": "a"})).await;
    let first_at = format!("{PROPOSALS}/{}", first["proposal_id"].as_str().unwrap());
    // the same days again are the same job; other days make a newer proposal
    let again = app.post(EXECUTION).json(&json!({"inputs": {"station": "a"}})).await.json(201);
    assert_eq!(again["reused"], true);
    app.put("/v1/stations/a/observations/2015-01-15", &json!({"air_temperature": -9})).await.json(200);
    let second = retrained(&app, json!({"station": "a"})).await;
    let second_at = format!("{PROPOSALS}/{}", second["proposal_id"].as_str().unwrap());
    let page = app.read(&format!("{PROPOSALS}?limit=1")).await;
    assert_eq!(page["proposals"][0]["id"], second["proposal_id"]);
    let rest = app.read(&format!("{PROPOSALS}?limit=1&cursor={}", page["next"].as_str().unwrap())).await;
    assert_eq!(rest["proposals"][0]["status"], "superseded");
    app.post(&format!("{first_at}/accept")).json(&json!({})).await.problem("proposal-closed");
    // somebody activates another model meanwhile: the comparison is with what is active no more
    app.put("/v1/stations/a/active-model", &json!({"model_id": first["model_id"]})).await.json(200);
    app.post(&format!("{second_at}/accept")).json(&json!({})).await.problem("proposal-outdated");
    app.put("/v1/stations/a/active-model", &json!({"model_id": old})).await.json(200);
    let declined = app.post(&format!("{second_at}/decline")).json(&json!({"reason": "a mild winter"})).await.json(200);
    assert_eq!((&declined["status"], &declined["reason"]), (&json!("declined"), &json!("a mild winter")));
    assert_eq!(active(&app).await, old);
    let nobody = "00000000-0000-7000-8000-000000000000";
    app.post(&format!("{PROPOSALS}/{nobody}/accept")).json(&json!({})).await.problem("unknown-proposal");
    app.station("b").await;
    let other = second_at.replace("/a/", "/b/");
    app.post(&format!("{other}/decline")).json(&json!({})).await.problem("unknown-proposal");
}

#[tokio::test]
async fn what_cannot_be_retrained_is_refused() {
    let app = TestApp::start().await;
    app.station("a").await;
    let refused =
        async |inputs: Value| app.post(EXECUTION).json(&json!({"inputs": inputs})).await.pointers("invalid-inputs");
    assert_eq!(refused(json!({"station": "a"})).await, ["/inputs/lead"], "no active model");
    assert_eq!(refused(json!({"station": "absent"})).await, ["/inputs/station"]);
    assert_eq!(refused(json!({"region": "absent"})).await, ["/inputs/region"]);
    assert_eq!(refused(json!({})).await, ["/inputs/station"]);
    assert_eq!(refused(json!({"station": "a", "lead": 2})).await, ["/inputs/lead"]);
    for bad in ["02-29", "7-1", "13-01"] {
        let body = json!({"name": "A", "retrain": {"yearly": bad}});
        let pointers = app.put("/v1/stations/a", &body).await.pointers("invalid-body");
        assert!(pointers[0].starts_with("/retrain"), "{pointers:?}");
    }
}

/// The day of the year comes, is missed, comes again; the service is asked many times and by many at once.
#[tokio::test]
async fn what_is_due_is_retrained_once_a_year() {
    let (app, old) = one_winter_later().await;
    let body = json!({"name": "a", "timezone": "Pacific/Auckland", "retrain": {"yearly": "07-01"}});
    let changed = app.put("/v1/stations/a", &body).await.json(200);
    assert_eq!(changed["retrain"], json!({"yearly": "07-01"}));
    let desk = app.state.desk.clone();
    let at = async |instant: String| {
        let (desk, now) = (desk.clone(), instant.parse::<Timestamp>().unwrap());
        beside_the_servers(async move { start_due(&desk, now).await.unwrap() }).await
    };
    let made = app.read(&format!("/v1/models/{old}")).await["created"].as_str().unwrap().parse::<Timestamp>().unwrap();
    let made = made.to_zoned(jiff::tz::TimeZone::UTC).date();
    // the next first of July, which begins twelve hours earlier at this station than in UTC
    let year = if (made.month(), made.day()) < (6, 30) { made.year() } else { made.year() + 1 };
    assert_eq!(at(format!("{}T00:00:00Z", made)).await, 0, "a model that is new is not due");
    assert_eq!(at(format!("{year}-06-30T11:59:00Z")).await, 0, "it is still June there");
    // five at once, and again the next minute: one
    let many = (0..5).map(|_| at(format!("{year}-06-30T12:00:00Z")));
    let mut started = 0;
    for result in futures(many).await {
        started += result;
    }
    assert_eq!(started, 1);
    assert_eq!(at(format!("{year}-07-01T12:00:00Z")).await, 0);
    let jobs = app.read("/v1/jobs?processID=retrain-model").await;
    assert_eq!(jobs["jobs"].as_array().unwrap().len(), 1);
    assert_eq!(jobs["jobs"][0]["labels"]["due"], format!("{year}-07-01"));
    ended(&app, id(&jobs["jobs"][0])).await;
    assert_eq!(active(&app).await, old, "it proposes, and replaces nothing");
    assert_eq!(app.read(PROPOSALS).await["proposals"].as_array().unwrap().len(), 1);
    // the year after next: the day in between was missed, and is not made up for twice
    assert_eq!(at(format!("{}-09-10T00:00:00Z", year + 2)).await, 1);
    assert_eq!(at(format!("{}-09-10T00:01:00Z", year + 2)).await, 0);
    // without the setting nothing is due
    app.put("/v1/stations/a", &json!({"name": "a"})).await.json(200);
    assert_eq!(at(format!("{}-09-10T00:00:00Z", year + 3)).await, 0);
}

async fn futures<T: Send + 'static>(calls: impl Iterator<Item = impl Future<Output = T>>) -> Vec<T> {
    let mut results = Vec::new();
    let mut pending: Vec<_> = calls.map(Box::pin).collect();
    std::future::poll_fn(|context| {
        pending.retain_mut(|call| match call.as_mut().poll(context) {
            std::task::Poll::Ready(result) => {
                results.push(result);
                false
            }
            std::task::Poll::Pending => true,
        });
        if pending.is_empty() { std::task::Poll::Ready(()) } else { std::task::Poll::Pending }
    })
    .await;
    results
}

#[tokio::test]
async fn a_region_is_retrained_like_a_station() {
    let app = TestApp::start().await;
    for (station, seed) in [("a", 3), ("b", 4)] {
        app.station(station).await.import_csv(station, &data::csv(&data::winters(seed, 3))).await.json(200);
    }
    let region = json!({"name": "R", "stations": ["a", "b"], "avalanche_day": {"quiet": "any_station"}});
    app.put("/v1/regions/r", &region).await.json(201);
    let inputs = json!({"region": "r", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30"});
    train(&app, &inputs).await;
    for (station, seed) in [("a", 3), ("b", 4)] {
        app.import_csv(station, &data::csv(&data::winters(seed, 4))).await.json(200);
    }
    let results = retrained(&app, json!({"region": "r"})).await;
    let list = app.read("/v1/regions/r/proposals").await;
    let proposal = &list["proposals"][0];
    assert_eq!((&proposal["region"], &proposal["station"]), (&json!("r"), &Value::Null));
    assert_eq!(proposal["comparison"]["new_seasons"], json!([2014]));
    let at = format!("/v1/regions/r/proposals/{}", proposal["id"].as_str().unwrap());
    app.post(&format!("{at}/accept")).json(&json!({})).await.json(200);
    assert_eq!(app.read("/v1/regions/r/active-model").await["model_id"], results["model_id"]);
}
