//! How long the service takes for what a forecaster waits for: an import, a training, a forecast, a season of days. One
//! server in this process on a port of its own, asked over HTTP as well as from inside. See `README.md` beside this file.
#![expect(clippy::print_stdout, reason = "a bench reports on the terminal")]

use std::{
    error::Error,
    future::Future,
    hint::black_box,
    path::PathBuf,
    time::{Duration, Instant},
};

use firn::{
    config::{Config, Settings},
    domain::{
        avalanche::AvalancheRecord,
        ids::{Place, StationId},
        observation::Observation,
    },
    formats::observations_csv,
    science::forecast::{
        day::{DayRecord, season_of},
        synthetic::synthetic_station,
    },
    server::Server,
    store::Store,
};
use jiff::{
    Timestamp,
    civil::{Date, date},
};
use reqwest::{Client, RequestBuilder};
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Calls of each kind that are timed, after a tenth as many that are not.
const CALLS: usize = 300;

#[tokio::main]
async fn main() -> Outcome<()> {
    println!("{}", machine());
    let archive = Archive::find()?;
    println!("{}", archive.name);
    let folder = tempfile::tempdir()?;
    let service = Service::start(Settings { data_dir: Some(folder.path().into()), ..Settings::default() }).await?;
    println!("{} compute threads\n", service.threads);

    let parts: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    let wanted = |part: &str| parts.is_empty() || parts.iter().any(|name| name == part);
    if wanted("archive") {
        import(&service, &archive).await?;
        train(&service).await?;
        let store = service.store.clone();
        forecast(&service, &store).await?;
        what_if(&service).await?;
        season(&service, &store).await?;
    }
    if wanted("fleet") {
        fleet(&service).await?;
    }
    service.stop.cancel();
    Ok(())
}

/// Days to send in.
struct Archive {
    name: String,
    query: &'static str,
    body: Vec<u8>,
}

impl Archive {
    /// The Lochaber archive of the shared data, or as many generated winters where that is absent.
    fn find() -> Outcome<Self> {
        let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
        let folder = std::env::var_os("FIRN_SHARED_DATA").map_or_else(beside, PathBuf::from);
        if let Ok(body) = std::fs::read(folder.join("sais_lochaber_1993-2007.csv")) {
            let name = "Lochaber 1993/94 to 2006/07, the export of its service".to_owned();
            return Ok(Self { name, query: "?format=sais", body });
        }
        let days = synthetic_station(1, 1993, 14);
        let dated = |day: &DayRecord| {
            let record = AvalancheRecord::of(day.activity);
            Observation::from_values(&day.values, Some(&record)).map(|observation| observation.on(day.date))
        };
        let rows = days.iter().map(dated).collect::<Result<Vec<_>, _>>()?;
        let name = "14 SYNTHETIC winters: the archive is absent (FIRN_SHARED_DATA)".to_owned();
        Ok(Self { name, query: "", body: observations_csv::write(rows).into_bytes() })
    }
}

/// The server in this process.
struct Service {
    base: String,
    client: Client,
    store: Store,
    threads: usize,
    stop: CancellationToken,
}

impl Service {
    async fn start(settings: Settings) -> Outcome<Self> {
        let mut config: Config = settings.over(Settings::default());
        config.listen = "127.0.0.1:0".parse()?;
        let threads = config.compute_threads;
        let server = Server::bind(config).await?;
        let base = format!("http://{}", server.address()?);
        let store = server.state().store.clone();
        let stop = CancellationToken::new();
        tokio::spawn(server.run(stop.clone()));
        let client = Client::builder().no_proxy().build()?;
        Ok(Self { base, client, store, threads, stop })
    }

    fn get(&self, path: &str) -> RequestBuilder {
        self.client.get(format!("{}{path}", self.base))
    }

    fn post(&self, path: &str) -> RequestBuilder {
        self.client.post(format!("{}{path}", self.base))
    }

    async fn station(&self, id: &str) -> Outcome<()> {
        let body = json!({"name": id, "timezone": "Europe/London"});
        answer(self.client.put(format!("{}/v1/stations/{id}", self.base)).json(&body)).await?;
        Ok(())
    }
}

/// Sends a request and reads its whole answer, which must be a good one.
async fn answer(request: RequestBuilder) -> Outcome<Vec<u8>> {
    let response = request.send().await?;
    let status = response.status();
    let body = response.bytes().await?.to_vec();
    if status.is_success() { Ok(body) } else { Err(format!("{status}: {}", String::from_utf8_lossy(&body)).into()) }
}

async fn json_of(request: RequestBuilder) -> Outcome<Value> {
    Ok(serde_json::from_slice(&answer(request).await?)?)
}

/// Times `call` with the numbers 0, 1, 2, ... after a tenth as many that are not timed; ms, in rising order.
async fn timed<F: Future<Output = Outcome<()>>>(calls: usize, call: impl Fn(usize) -> F) -> Outcome<Vec<f64>> {
    for number in 0..calls / 10 {
        call(number).await?;
    }
    let mut times = Vec::with_capacity(calls);
    for number in 0..calls {
        let since = Instant::now();
        call(number).await?;
        times.push(since.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    Ok(times)
}

/// One line of the report: median, 95th percentile and extremes of rising `times`, and the target where there is one.
fn report(what: &str, times: &[f64], target_ms: Option<f64>) {
    let at = |share: f64| times[((times.len() - 1) as f64 * share).round() as usize];
    let verdict = target_ms.map_or_else(String::new, |target| {
        format!("   target < {target} ms: {}", if at(0.5) < target { "kept" } else { "MISSED" })
    });
    println!(
        "{what:<46} median {:>9.3} ms   p95 {:>9.3}   least {:>9.3}   most {:>9.3}   n {:>3}{verdict}",
        at(0.5),
        at(0.95),
        at(0.0),
        at(1.0),
        times.len()
    );
}

/// The whole archive into new stations, and once more into one that has it.
async fn import(service: &Service, archive: &Archive) -> Outcome<()> {
    const STATIONS: usize = 5;
    let send = |station: String| {
        let path = format!("/v1/stations/{station}/observations{}", archive.query);
        answer(service.post(&path).header("content-type", "text/csv").body(archive.body.clone()))
    };
    let mut times = Vec::new();
    for number in 0..STATIONS {
        let station = format!("lochaber{number}");
        service.station(&station).await?;
        let since = Instant::now();
        send(station).await?;
        times.push(since.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    report("import of the archive, a new station", &times, None);
    let again = timed(STATIONS, |_| async { send("lochaber0".to_owned()).await.map(drop) }).await?;
    report("import of the archive, nothing new in it", &again, None);
    Ok(())
}

/// Submits a training and gives the address of its job.
async fn submit(service: &Service, inputs: &Value) -> Outcome<String> {
    let job = json_of(service.post("/v1/processes/train-model/execution").json(&json!({"inputs": inputs}))).await?;
    Ok(format!("/v1/jobs/{}", job["jobID"].as_str().unwrap_or_default()))
}

/// The status document of a job that has ended well.
async fn ended(service: &Service, path: &str) -> Outcome<Value> {
    loop {
        let job = json_of(service.get(path)).await?;
        match job["status"].as_str() {
            Some("accepted" | "running") => tokio::time::sleep(Duration::from_millis(100)).await,
            Some("successful") => return Ok(job),
            _ => return Err(job.to_string().into()),
        }
    }
}

async fn train(service: &Service) -> Outcome<()> {
    let path = submit(service, &json!({"station": "lochaber0", "label": "observed", "lead": 0})).await?;
    let ended = ended(service, &path).await?;
    let stamp = |name: &str| ended[name].as_str().unwrap_or_default().parse::<Timestamp>();
    let seconds = stamp("finished")?.duration_since(stamp("started")?).as_secs_f64();
    report("training with grid search and evaluation", &[seconds * 1e3], Some(60_000.0));
    Ok(())
}

async fn forecast(service: &Service, store: &Store) -> Outcome<()> {
    let station: StationId = "lochaber0".parse()?;
    let days = store.day_records(&station, Date::MIN.max(date(0, 1, 1)), date(9999, 12, 31)).await?;
    let newest = days.last().map(|day| season_of(day.date)).ok_or("no days")?;
    // a season's history grows from day to day: all of them count
    let season: Vec<DayRecord> = days.into_iter().filter(|day| season_of(day.date) == newest).collect();
    let dates: Vec<Date> = season.iter().map(|day| day.date).collect();
    let date_of = |number: usize| dates[number % dates.len()];

    let path = |number: usize| format!("/v1/stations/lochaber0/forecasts/{}?lead=0", date_of(number));
    let http = timed(CALLS, |number| async move { answer(service.get(&path(number))).await.map(drop) }).await?;
    report("a forecast over HTTP, model loaded", &http, Some(5.0));
    let similar = |number: usize| format!("/v1/stations/lochaber0/forecasts/{}/similar-days", date_of(number));
    let http = timed(CALLS, |number| async move { answer(service.get(&similar(number))).await.map(drop) }).await?;
    report("similar days over HTTP", &http, None);

    let active = store.active_model(&Place::Station(station.clone()), 0).await?.ok_or("no active model")?;
    let model = store.trained_model(active.model).await?.ok_or("no model")?;
    let (model, season) = (&model, &season);
    let inside = timed(CALLS, |number| async move {
        black_box(model.forecast(season, date_of(number))?);
        Ok(())
    })
    .await?;
    report("a forecast inside, model and days in memory", &inside, None);
    Ok(())
}

/// One question a day of the newest winter: two variables changed, and the response to a third at 25 points.
async fn what_if(service: &Service) -> Outcome<()> {
    let list = json_of(service.get("/v1/stations/lochaber0/forecasts")).await?;
    let dates: Vec<&str> =
        list["forecasts"].as_array().into_iter().flatten().filter_map(|day| day["date"].as_str()).collect();
    if dates.is_empty() {
        return Err("no forecasts".into());
    }
    let dates = &dates;
    let ask = |number: usize| {
        let changes = json!([{"values": {"air_temperature": 2.5, "snow_drift": true}}]);
        let response = json!({"variable": "wind_speed", "from": 0, "to": 30});
        let question = json!({"date": dates[number % dates.len()], "changes": changes, "response": response});
        service.post("/v1/stations/lochaber0/forecasts/what-if").json(&question)
    };
    let http = timed(CALLS, |number| async move { answer(ask(number)).await.map(drop) }).await?;
    report("a what-if with a response of 25 points", &http, Some(20.0));
    Ok(())
}

/// Many stations: 100,000 observations in, and the forecast of all of them in one answer.
async fn fleet(service: &Service) -> Outcome<()> {
    const STATIONS: u16 = 50;
    const DAYS: usize = 2000;
    let mut bodies = Vec::new();
    for station in 0..STATIONS {
        let days = synthetic_station(u64::from(station), 2000, 20);
        let dated = |day: &DayRecord| {
            let record = AvalancheRecord::of(day.activity);
            Observation::from_values(&day.values, Some(&record)).map(|observation| observation.on(day.date))
        };
        let rows = days.iter().take(DAYS).map(dated).collect::<Result<Vec<_>, _>>()?;
        if rows.len() != DAYS {
            return Err(format!("{} days", rows.len()).into());
        }
        bodies.push((format!("fleet{station}"), observations_csv::write(rows)));
        service.station(&format!("fleet{station}")).await?;
    }
    let since = Instant::now();
    for (station, body) in &bodies {
        let path = format!("/v1/stations/{station}/observations");
        answer(service.post(&path).header("content-type", "text/csv").body(body.clone())).await?;
    }
    let import_ms = since.elapsed().as_secs_f64() * 1e3;
    report("100,000 observations of 50 stations, CSV", &[import_ms], Some(20_000.0));

    let mut jobs = Vec::new();
    for (station, _) in &bodies {
        // five winters: what is timed is the forecast
        let inputs = json!({"station": station, "label": "observed", "lead": 0, "to": "2005-06-30"});
        jobs.push(submit(service, &inputs).await?);
    }
    for job in &jobs {
        ended(service, job).await?;
    }
    let path = |number: usize| format!("/v1/forecasts?date=2011-02-{:02}", 1 + number % 28);
    let all = json_of(service.get(&path(0))).await?;
    let forecasts = all["forecasts"].as_array().into_iter().flatten();
    let there = forecasts.filter(|station| station["forecast"].is_object()).count();
    let http = timed(CALLS, |number| async move { answer(service.get(&path(number))).await.map(drop) }).await?;
    report(&format!("the forecasts of {there} stations in one answer"), &http, Some(100.0));
    Ok(())
}

async fn season(service: &Service, store: &Store) -> Outcome<()> {
    let station: StationId = "lochaber0".parse()?;
    let (from, to) = (date(2005, 7, 1), date(2006, 6, 30));
    let path = format!("/v1/stations/lochaber0/observations?from={from}&to={to}");
    let (path, station) = (&path, &station);
    let days = json_of(service.get(path)).await?["observations"].as_array().map_or(0, Vec::len);
    let read = timed(CALLS, |_| async move { answer(service.get(path)).await.map(drop) }).await?;
    report(&format!("a season of {days} days over HTTP, JSON"), &read, Some(10.0));
    let csv = timed(CALLS, |_| async move { answer(service.get(path).header("accept", "text/csv")).await.map(drop) });
    report("the same as CSV", &csv.await?, None);
    let inside = timed(CALLS, |_| async move {
        black_box(store.days(station, from, to, 1000).await?);
        Ok(())
    })
    .await?;
    report("the same from the store", &inside, None);
    Ok(())
}

/// What ran this, and how busy it was.
fn machine() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let cpus = read("/proc/cpuinfo");
    let model = cpus.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": ").map(|(_, name)| name));
    let load = read("/proc/loadavg");
    let load = load.split_whitespace().next().unwrap_or("unknown");
    let build = if cfg!(debug_assertions) { "DEBUG build: its times mean nothing" } else { "release build" };
    let (system, architecture) = (std::env::consts::OS, std::env::consts::ARCH);
    format!("{}, {cores} cores, {system} {architecture}, load {load}, {build}", model.unwrap_or("unknown processor"))
}
