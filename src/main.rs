//! The `firn` command.

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, Parser, Subcommand};
use firn::{
    analyse::{self, Analyse},
    api::openapi,
    clock,
    config::{EngineAddress, Settings},
    demo,
    jobs::worker::WorkerOptions,
    server::{self, Server, ServerError},
    shutdown,
    store::{Store, keys::Role},
    telemetry,
};

/// Avalanche forecasting and simulation service.
#[derive(Parser)]
#[command(name = "firn", version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Serve the API and the pages
    Serve(Box<Serve>),
    /// Compute jobs for a server on another machine, over NATS
    Worker(Box<Work>),
    /// Make, list and revoke the keys of the API
    #[command(subcommand)]
    Key(Key),
    /// Analyse a file of acoustic emission and print what was found as JSON
    Analyse(Box<Analyse>),
    /// Print the OpenAPI document
    Openapi,
}

#[derive(Args)]
struct Serve {
    #[command(flatten)]
    settings: Settings,
    /// TOML file with the same settings, `_` for `-`; flags and environment win over it
    #[arg(long, env = "FIRN_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Add a synthetic station with a trained model, so that there is something to look at
    #[arg(long)]
    demo: bool,
}

#[derive(Args)]
struct Work {
    #[command(flatten)]
    settings: Settings,
    /// What the worker is called in the record of its jobs [default: host name and process id]
    #[arg(long, env = "FIRN_WORKER_NAME", value_name = "NAME")]
    name: Option<String>,
}

#[derive(Subcommand)]
enum Key {
    /// Make a key; it is shown once and cannot be shown again
    Create {
        #[command(flatten)]
        data: DataDir,
        /// Whose key, or what for; goes into the history of what is written with it
        #[arg(long, value_parser = key_name)]
        name: String,
        /// What the key allows: each role may do what the ones before it may
        #[arg(long, value_enum, default_value = "forecaster")]
        role: Role,
        /// Days until the key ends to be valid [default: it never does]
        #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(i64).range(1..=36500))]
        expires_in_days: Option<i64>,
        /// Do nothing where there is a valid key already
        #[arg(long)]
        if_none: bool,
    },
    /// List the keys, without their secrets
    List {
        #[command(flatten)]
        data: DataDir,
    },
    /// Withdraw a key for good
    Revoke {
        #[command(flatten)]
        data: DataDir,
        /// The id of the key: its middle part
        id: String,
    },
}

#[derive(Args)]
struct DataDir {
    /// Folder of the database
    #[arg(long, env = "FIRN_DATA_DIR", default_value = "firn-data", value_name = "DIR")]
    data_dir: PathBuf,
}

fn key_name(text: &str) -> Result<String, &'static str> {
    let good = (1..=100).contains(&text.chars().count()) && !text.trim().is_empty() && !text.contains(char::is_control);
    if good { Ok(text.to_owned()) } else { Err("must be 1 to 100 characters") }
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Command::Serve(serve) => block_on(run_server(*serve)),
        Command::Worker(work) => block_on(run_worker(*work)),
        Command::Key(key) => block_on(run_key(key)),
        Command::Analyse(options) => analyse::run(&options).map(|found| print(&found)),
        Command::Openapi => {
            print(openapi::text().trim_end());
            Ok(())
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln(&format!("firn: {error}"));
            ExitCode::FAILURE
        }
    }
}

fn print(text: &str) {
    use std::io::Write as _;
    // a reader that has seen enough (`| head`) is no failure
    let _ = writeln!(std::io::stdout(), "{text}");
}

fn eprintln(text: &str) {
    eprintln!("{text}");
}

fn block_on<F: Future<Output = Result<(), ServerError>>>(future: F) -> Result<(), ServerError> {
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(future)
}

async fn run_server(serve: Serve) -> Result<(), ServerError> {
    let file = serve.config.as_deref().map(Settings::from_file).transpose()?.unwrap_or_default();
    let config = serve.settings.over(file);
    telemetry::init(&config.log, config.log_format)?;
    let stop = shutdown::on_signal()?;
    let server = Server::bind(config).await?;
    let address = server.address()?;
    tracing::info!(version = env!("CARGO_PKG_VERSION"), "firn listens on http://{address}");
    if serve.demo {
        demo::start(server.state(), address).await?;
    }
    server.run(stop).await
}

async fn run_worker(work: Work) -> Result<(), ServerError> {
    let config = work.settings.over(Settings::default());
    let EngineAddress::Nats(address) = &config.engine else {
        return Err("a worker needs --engine nats://HOST:PORT; without it `firn serve` computes by itself".into());
    };
    telemetry::init(&config.log, config.log_format)?;
    let stop = shutdown::on_signal()?;
    let host = std::env::var("HOSTNAME").unwrap_or_else(|_| "worker".into());
    let name = work.name.unwrap_or_else(|| format!("{host}-{}", std::process::id()));
    let options = WorkerOptions { name, threads: config.compute_threads, slots: config.job_slots, stall: config.stall };
    tracing::info!(name = options.name, slots = options.slots, "firn works for {}", config.engine);
    server::work(address, options, config.shutdown_timeout, stop).await
}

async fn run_key(command: Key) -> Result<(), ServerError> {
    match command {
        Key::Create { data, name, role, expires_in_days, if_none } => {
            let store = Store::open(&data.data_dir).await?;
            let now = clock::now();
            if if_none && store.keys().await?.iter().any(|key| key.is_valid(now)) {
                print("there is a valid key already");
                store.close().await;
                return Ok(());
            }
            let expires =
                expires_in_days.map(|days| now.checked_add(jiff::SignedDuration::from_hours(24 * days))).transpose()?;
            let key = store.create_key(&name, role, expires, now).await?;
            print(&format!("{key}\nKeep it: it is stored as a hash and cannot be shown again."));
            store.close().await;
        }
        Key::List { data } => {
            let store = Store::open(&data.data_dir).await?;
            for key in store.keys().await? {
                let state = if key.is_valid(clock::now()) { "valid" } else { "not valid" };
                let used = key.last_used.map_or_else(|| "never used".to_owned(), |at| format!("last used {at}"));
                print(&format!(
                    "{}  {:10}  {state}  made {}  {used}  {}",
                    key.id,
                    key.role.name(),
                    key.created,
                    key.name
                ));
            }
            store.close().await;
        }
        Key::Revoke { data, id } => {
            let store = Store::open(&data.data_dir).await?;
            let done = store.revoke_key(&id, clock::now()).await?;
            store.close().await;
            if !done {
                return Err(format!("there is no valid key of the id {id}; `firn key list` lists them").into());
            }
            print("revoked");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }
}
