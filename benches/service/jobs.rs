//! How many jobs that do nothing the embedded engine gets done in a second, and how soon a status poll is answered while
//! every core computes. See `README.md` beside this file.
#![expect(clippy::print_stdout, reason = "a bench reports on the terminal")]

use std::{
    error::Error,
    sync::Arc,
    time::{Duration, Instant},
};

use firn::{
    config::{Config, Settings},
    domain::job::{Job, Labels, Priority, Wanted},
    jobs::{
        Desk, Rules, Submission, Submitted,
        artifacts::Artifacts,
        engine::{Engine, local::Local},
        link::Output,
        processes::Process,
        worker::{Worker, WorkerOptions},
    },
    science::progress::Progress,
    server::Server,
    store::{Store, jobs::Answer},
};
use serde_json::{Value, json};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Jobs that wait before the clock runs.
const JOBS: usize = 1000;

/// Callers that poll at once, and how often each of them does.
const CALLERS: usize = 200;
const POLLS: usize = 25;

/// Trainings that keep the cores busy meanwhile.
const TRAININGS: usize = 20;

#[tokio::main]
async fn main() -> Outcome<()> {
    let cores = std::thread::available_parallelism()?;
    println!("{cores} cores; data on {}", std::env::temp_dir().display());
    for round in 1..=3 {
        queue(round).await?;
    }
    for mib in [1, 16] {
        states(mib).await?;
    }
    polls().await
}

fn config(folder: &tempfile::TempDir, slots: usize) -> Outcome<Config> {
    let settings = Settings { data_dir: Some(folder.path().into()), ..Settings::default() };
    let mut config = settings.over(Settings::default());
    config.listen = "127.0.0.1:0".parse()?;
    config.job_slots = slots;
    Ok(config)
}

fn echo(message: usize) -> Submission {
    Submission {
        process: Process::Echo,
        inputs: json!({"message": message.to_string()}),
        labels: Labels::new(),
        wanted: Wanted::default(),
        priority: Priority::default(),
        submitted_by: None,
        anew: false,
        reservation: None,
    }
}

/// Accepts the jobs behind one that holds the only worker back, then lets it go.
async fn queue(round: usize) -> Outcome<()> {
    let folder = tempfile::tempdir()?;
    let server = Server::bind(config(&folder, 4)?).await?;
    let state = server.state().clone();
    let mut held = Vec::new();
    for _ in 0..4 {
        let mut long = echo(0);
        long.inputs = json!({"message": "held", "delay_s": 600});
        let render = |job: &Job, _: bool| Answer { location: String::new(), body: json!(job.id) };
        if let Submitted::New(answer) = state.desk.submit(long, render).await.map_err(|problem| problem.to_string())? {
            held.push(serde_json::from_value(answer.body)?);
        }
    }
    let since = Instant::now();
    for number in 0..JOBS {
        let render = |job: &Job, _: bool| Answer { location: String::new(), body: json!(job.id) };
        state.desk.submit(echo(number), render).await.map_err(|problem| problem.to_string())?;
    }
    let accepted = since.elapsed();
    let since = Instant::now();
    for id in held {
        state.desk.dismiss(id).await?;
    }
    while state.store.waiting_jobs().await? > 0 || state.store.jobs_with_tickets().await? > 0 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let done = since.elapsed();
    let rate = |time: Duration| JOBS as f64 / time.as_secs_f64();
    println!(
        "round {round}: {JOBS} jobs accepted one after another at {:.0} a second, done at {:.0} a second (target: 500)",
        rate(accepted),
        rate(done)
    );
    state.store.close().await;
    Ok(())
}

/// Computes on every core while states of so many MiB are saved as often as the worker wishes.
async fn states(mib: usize) -> Outcome<()> {
    const SECONDS: f64 = 22.0;
    let folder = tempfile::tempdir()?;
    let store = Store::open(folder.path()).await?;
    let engine: Arc<dyn Engine> = Arc::new(Local::default());
    let rules = Rules { most_waiting: 10, lease: Duration::from_secs(30), runout_memory_bytes: 2 << 30 };
    let artifacts = Artifacts::folder(&folder.path().join("artifacts"))?;
    let desk = Desk::new(store.clone(), Arc::clone(&engine), artifacts, rules);
    let state = vec![1_u8; mib * 1024 * 1024];
    let compute = move |_: Process, _: &[u8], progress: &dyn Progress| {
        let since = Instant::now();
        while since.elapsed().as_secs_f64() < SECONDS {
            progress.report(since.elapsed().as_secs_f64() / SECONDS, "computing");
            progress.checkpoint(&|| state.clone());
            let step = Instant::now();
            while step.elapsed() < Duration::from_millis(20) {
                std::hint::spin_loop();
            }
        }
        Ok(Output { results: json!({}), ..Output::default() })
    };
    let cores = std::thread::available_parallelism()?.get();
    let options = WorkerOptions { name: "bench".into(), threads: 1, slots: cores, stall: Duration::from_secs(60) };
    let worker = Worker::start_with(engine, Arc::new(desk.clone()), Arc::new(compute), options)?;
    let mut jobs: Vec<uuid::Uuid> = Vec::new();
    for number in 0..cores {
        let render = |job: &Job, _: bool| Answer { location: String::new(), body: json!(job.id) };
        if let Submitted::New(answer) =
            desk.submit(echo(number), render).await.map_err(|problem| problem.to_string())?
        {
            jobs.push(serde_json::from_value(answer.body)?);
        }
    }
    for id in jobs {
        let job = loop {
            let job = store.job(id).await?.ok_or("the job is gone")?;
            if job.status.ended() {
                break job;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        };
        let spent = job.spent;
        let share = |ms: u64| 100.0 * ms as f64 / spent.compute_ms as f64;
        println!(
            "states of {mib} MiB: {} in {:.1} s of computing; it stood still for {:.3} % of the time to save them, and \
             storing them took {:.2} % beside it (target: 3 % together)",
            spent.states,
            spent.compute_ms as f64 / 1e3,
            share(spent.saving_ms),
            share(spent.storing_ms)
        );
    }
    worker.stop(Duration::from_secs(5)).await;
    store.close().await;
    Ok(())
}

/// Polls the status of a training while it keeps every core busy.
async fn polls() -> Outcome<()> {
    let folder = tempfile::tempdir()?;
    let server = Server::bind(config(&folder, 2)?).await?;
    let base = format!("http://{}", server.address()?);
    let stop = CancellationToken::new();
    let running = tokio::spawn(server.run(stop.clone()));
    let client = reqwest::Client::builder().no_proxy().pool_max_idle_per_host(CALLERS).build()?;
    client.put(format!("{base}/v1/stations/synthetic")).json(&json!({"name": "SYNTHETIC"})).send().await?;
    let days = firn::science::forecast::synthetic::synthetic_station(1, 1993, 14);
    let rows = days.iter().map(|day| {
        let record = firn::domain::avalanche::AvalancheRecord::of(day.activity);
        firn::domain::observation::Observation::from_values(&day.values, Some(&record)).map(|seen| seen.on(day.date))
    });
    let csv = firn::formats::observations_csv::write(rows.collect::<Result<Vec<_>, _>>()?);
    let import = client.post(format!("{base}/v1/stations/synthetic/observations")).header("content-type", "text/csv");
    import.body(csv).send().await?.error_for_status()?;
    // more than can end while it is measured: both slots must compute to the last poll
    let mut trainings = Vec::new();
    for seed in 0..TRAININGS {
        let inputs = json!({"inputs": {"station": "synthetic", "label": "observed", "lead": 0, "seed": seed}});
        let execution = client.post(format!("{base}/v1/processes/train-model/execution")).json(&inputs);
        let job: Value = execution.send().await?.error_for_status()?.json().await?;
        trainings.push(format!("{base}/v1/jobs/{}", job["jobID"].as_str().unwrap_or_default()));
    }
    let address = trainings[0].clone();
    tokio::time::sleep(Duration::from_secs(1)).await;

    let mut callers = JoinSet::new();
    for caller in 0..CALLERS {
        let (client, address) = (client.clone(), address.clone());
        callers.spawn(async move {
            let mut times = Vec::new();
            // spread over half a second, as callers that do not know of each other are
            tokio::time::sleep(Duration::from_millis(caller as u64 * 500 / CALLERS as u64)).await;
            for _ in 0..POLLS {
                let since = Instant::now();
                client.get(&address).send().await?.error_for_status()?.bytes().await?;
                times.push(since.elapsed());
                tokio::time::sleep(Duration::from_millis(500)).await;
            }
            Outcome::Ok(times)
        });
    }
    let mut times = Vec::new();
    while let Some(done) = callers.join_next().await {
        times.extend(done??);
    }
    times.sort();
    let list = client.get(format!("{base}/v1/jobs?status=running")).send().await?.json::<Value>().await?;
    let running_still = list["jobs"].as_array().map_or(0, Vec::len);
    if running_still < 2 {
        return Err(format!("{running_still} trainings run at the end: the cores were not busy all the time").into());
    }
    let ms = |share: usize| times[(times.len() - 1) * share / 100].as_secs_f64() * 1e3;
    println!(
        "{CALLERS} callers, a status poll each half second, while two trainings run: median {:.2} ms (target: 2), \
         95 % {:.2} ms, 99 % {:.2} ms",
        ms(50),
        ms(95),
        ms(99)
    );
    for training in trainings {
        client.delete(&training).send().await?;
    }
    stop.cancel();
    running.await??;
    Ok(())
}
