//! The pages in a real browser, on the synthetic station from its first second to its forecast.
//!
//! Skipped where no Chromium is installed; `FIRN_CHROMIUM` names one that is not on the path.

use std::{
    fs,
    path::PathBuf,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use serde_json::Value;

use crate::service::Service;

/// What a browser made of a page.
struct Seen {
    /// The document after its scripts ran.
    dom: String,
    /// What it wrote to its console: a message or an uncaught error of a script, a refusal of the content security policy.
    console: Vec<String>,
}

impl Seen {
    fn count(&self, mark: &str) -> usize {
        self.dom.matches(mark).count()
    }

    fn has(&self, text: &str) -> bool {
        self.dom.contains(text)
    }
}

fn chromium() -> Option<PathBuf> {
    let named = std::env::var_os("FIRN_CHROMIUM").map(PathBuf::from);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    let known = ["chromium", "chromium-browser", "google-chrome"];
    let found =
        known.iter().find_map(|name| folders.iter().map(|folder| folder.join(name)).find(|file| file.is_file()));
    let found = named.or(found);
    if found.is_none() {
        println!("skipped: no chromium is installed");
    }
    found
}

/// Opens `url` in a new browser with a new profile and lets its clock run for `budget` of its own time.
async fn open(browser: PathBuf, url: String, budget: Duration) -> Seen {
    tokio::task::spawn_blocking(move || {
        let folder = tempfile::tempdir().unwrap();
        let (dom, log) = (folder.path().join("dom"), folder.path().join("log"));
        let mut child = Command::new(browser)
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"])
            .args([
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--disable-dev-shm-usage",
            ])
            .args(["--enable-logging=stderr", "--window-size=1280,900", "--dump-dom"])
            .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
            .arg(format!("--virtual-time-budget={}", budget.as_millis()))
            .arg(&url)
            .stdin(Stdio::null())
            .stdout(fs::File::create(&dom).unwrap())
            .stderr(fs::File::create(&log).unwrap())
            .spawn()
            .unwrap();
        let begun = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if begun.elapsed() > Duration::from_secs(180) {
                child.kill().unwrap();
                child.wait().unwrap();
                panic!("the browser does not come to an end with {url}");
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        let log = String::from_utf8_lossy(&fs::read(&log).unwrap()).into_owned();
        let console = log.lines().filter(|line| line.contains("CONSOLE")).map(str::to_owned).collect();
        Seen { dom: String::from_utf8_lossy(&fs::read(&dom).unwrap()).into_owned(), console }
    })
    .await
    .unwrap()
}

const WHILE: Duration = Duration::from_secs(8);

/// A share as the pages write it: a narrow space before the sign.
fn percent(share: &Value) -> String {
    format!("{:.0}\u{202f}%", share.as_f64().unwrap() * 100.0)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_demo_shows_its_training_and_then_its_forecast() {
    let Some(browser) = chromium() else { return };
    let service = Service::start(true).await;

    let early = open(browser.clone(), service.url("/"), Duration::from_secs(2)).await;
    assert!(early.has("SYNTHETIC"), "{}", early.dom);
    assert!(early.has("<progress") || early.has("class=\"probability\""), "{}", early.dom);
    assert!(early.console.is_empty(), "{:?}", early.console);

    while service.json("/v1/stations/synthetic/active-model").await.is_none() {
        let jobs = service.json("/v1/jobs?status=failed").await.unwrap();
        assert!(jobs["jobs"].as_array().unwrap().is_empty(), "{jobs}");
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
    let latest = service.json("/v1/stations/synthetic/forecasts/latest").await.unwrap();

    let home = open(browser.clone(), service.url("/"), WHILE).await;
    assert!(home.console.is_empty(), "{:?}", home.console);
    assert_eq!(home.count("class=\"badge synthetic\""), 2, "of the station and of its forecast: {}", home.dom);
    assert!(home.has(&percent(&latest["probability"])), "{}", home.dom);
    assert!(home.has(&format!("datetime=\"{}\"", latest["date"].as_str().unwrap())), "{}", home.dom);
    assert!(home.has(&format!("class=\"badge {}\"", latest["category"].as_str().unwrap())), "{}", home.dom);

    let station = open(browser.clone(), service.url("/stations/synthetic"), WHILE).await;
    assert!(station.console.is_empty(), "{:?}", station.console);
    assert_station(&service, &latest, &station).await;

    let reader = open(browser.clone(), service.url("/docs"), WHILE).await;
    assert!(reader.console.is_empty(), "{:?}", reader.console);
    assert!(reader.count("class=\"opblock ") >= 20, "the reader lists {} calls", reader.count("class=\"opblock "));
    assert!(reader.has("id=\"operations-forecasts-get_latest_forecast\""), "{}", reader.dom);

    let stranger = open(browser, service.url("/stations/nowhere"), WHILE).await;
    assert!(stranger.has("No such station") && stranger.has("there is no station nowhere"), "{}", stranger.dom);
}

/// Without this the silence of the consoles above would prove nothing.
#[tokio::test(flavor = "multi_thread")]
async fn a_console_is_heard() {
    let Some(browser) = chromium() else { return };
    let error = open(browser.clone(), "data:text/html,<script>console.error('loud')</script>".to_owned(), WHILE).await;
    assert!(error.console.iter().any(|line| line.contains("loud")), "{:?}", error.console);
    let policy =
        "data:text/html,<meta http-equiv=Content-Security-Policy content=\"script-src 'self'\"><script>1</script>";
    let refused = open(browser.clone(), policy.to_owned(), WHILE).await;
    assert!(refused.console.iter().any(|line| line.contains("Content Security Policy")), "{:?}", refused.console);
    let thrown = open(browser, "data:text/html,<script>throw new Error('thrown')</script>".to_owned(), WHILE).await;
    assert!(thrown.console.iter().any(|line| line.contains("thrown")), "{:?}", thrown.console);
}

async fn assert_station(service: &Service, latest: &Value, seen: &Seen) {
    assert!(seen.has("class=\"badge synthetic\""), "{}", seen.dom);
    assert!(seen.has(&percent(&latest["probability"])) && seen.has(&percent(&latest["threshold"])), "{}", seen.dom);

    // the marks of the chart, each with one more in the legend
    let listed = service.json("/v1/stations/synthetic/forecasts").await.unwrap();
    let forecasts = listed["forecasts"].as_array().unwrap();
    let season = &seen.dom[seen.dom.find("id=\"season\"").unwrap()..seen.dom.find("id=\"similar\"").unwrap()];
    for category in ["avalanche_day", "no_avalanche_day"] {
        let days = forecasts.iter().filter(|day| day["category"] == category).count();
        assert_eq!(season.matches(&format!("class=\"bar {category}\"")).count(), days + 1, "bars of {category}");
        assert!(days > 0, "the season shows no {category}");
    }
    let first = forecasts[0]["date"].as_str().unwrap();
    let days = service.json(&format!("/v1/stations/synthetic/observations?from={}-07-01", &first[..4])).await.unwrap();
    let observed =
        days["observations"].as_array().unwrap().iter().filter(|day| day["avalanche_activity"] == "observed");
    assert_eq!(season.matches("class=\"mark-observed\"").count(), observed.count() + 1, "marks of observed avalanches");
    assert!(
        season.contains("<title id=\"season-chart-title\">") && season.contains("<desc id=\"season-chart-about\">")
    );

    let model = latest["model_id"].as_str().unwrap();
    let evaluation = service.json(&format!("/v1/models/{model}/evaluation")).await.unwrap();
    for (name, scores) in evaluation["scores"].as_object().unwrap() {
        let auc = format!("{:.3}", scores["auc"].as_f64().unwrap());
        assert!(seen.has(&format!(">{auc}<")), "the AUC of {name}, {auc}, is not on the page");
    }
    let difference = &evaluation["bootstrap"]["svm_minus_knn30_auc"];
    let contains_0 = difference["lower"].as_f64().unwrap() <= 0.0 && difference["upper"].as_f64().unwrap() >= 0.0;
    assert_eq!(seen.has("No real difference."), contains_0, "{difference}");
    assert!(seen.has("is no fair test of it"), "the day was in the training and the page does not say so");
    assert_eq!(
        seen.count("class=\"point\"") - 1,
        10 + count_of_filled_bins(&evaluation),
        "points of reliability and seasons"
    );
}

/// Bins of the reliability diagram that hold a day: each is a point.
fn count_of_filled_bins(evaluation: &Value) -> usize {
    evaluation["reliability"].as_array().unwrap().iter().filter(|bin| bin["count"].as_u64().unwrap() > 0).count()
}
