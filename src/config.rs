//! Settings of the server: flags, then environment, then a TOML file, then defaults.

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    num::NonZeroUsize,
    ops::RangeInclusive,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use serde::Deserialize;

use crate::{formats::caaml::Provider, jobs::artifacts::ArtifactAddress};

/// What a lease may be, s.
const LEASES_S: RangeInclusive<u64> = 1..=3600;

/// What the patience with a computation may be, s.
const STALLS_S: RangeInclusive<u64> = 1..=1_000_000;

/// What can be set; every field may come from a flag, an environment variable or the TOML file.
#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Address and port to listen on [default: 127.0.0.1:8080]
    #[arg(long, env = "FIRN_LISTEN", value_name = "ADDRESS:PORT")]
    pub listen: Option<SocketAddr>,
    /// Folder of the database [default: firn-data]
    #[arg(long, env = "FIRN_DATA_DIR", value_name = "DIR")]
    pub data_dir: Option<PathBuf>,
    /// Serve any address without keys: everybody who reaches the port may read and write everything
    #[arg(long, env = "FIRN_ALLOW_ANONYMOUS", num_args = 0..=1, default_missing_value = "true", value_name = "BOOL")]
    pub allow_anonymous: Option<bool>,
    /// Largest request body in MiB [default: 32]
    #[arg(long, env = "FIRN_MAX_BODY_MIB", value_name = "MIB")]
    pub max_body_mib: Option<NonZeroUsize>,
    /// Largest file of a data set in MiB [default: 1024]
    #[arg(long, env = "FIRN_MAX_DATASET_MIB", value_name = "MIB")]
    pub max_dataset_mib: Option<u64>,
    /// Seconds that the upload of a data set may take [default: 600]
    #[arg(long, env = "FIRN_UPLOAD_TIMEOUT_S", value_name = "S")]
    pub upload_timeout_s: Option<u64>,
    /// Seconds that a request may take [default: 30]
    #[arg(long, env = "FIRN_REQUEST_TIMEOUT_S", value_name = "S")]
    pub request_timeout_s: Option<u64>,
    /// Requests that are worked on at once, and streams of events that are open at once; more are refused with 503
    /// [default: 512]
    #[arg(long, env = "FIRN_MAX_REQUESTS", value_name = "N")]
    pub max_requests: Option<NonZeroUsize>,
    /// Threads that each job computes with; jobs that run at once share the cores [default: the number of cores]
    #[arg(long, env = "FIRN_COMPUTE_THREADS", value_name = "N")]
    pub compute_threads: Option<NonZeroUsize>,
    /// Jobs that run at once [default: 2]
    #[arg(long, env = "FIRN_JOB_SLOTS", value_name = "N")]
    pub job_slots: Option<NonZeroUsize>,
    /// Jobs that may wait; more are refused with 503 [default: 10000]
    #[arg(long, env = "FIRN_MAX_QUEUE", value_name = "N")]
    pub max_queue: Option<u32>,
    /// Where large outputs lie: a folder or, built with the feature `s3`, s3://BUCKET/PREFIX with address and credentials
    /// of the service in AWS_ENDPOINT, AWS_REGION, AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY [default: `artifacts` below
    /// the folder of the database]
    #[arg(long, env = "FIRN_ARTIFACTS", value_name = "PLACE")]
    pub artifacts: Option<ArtifactAddress>,
    /// What carries jobs to workers: `local` (in this process) or the address of a NATS server with JetStream, such as
    /// nats://127.0.0.1:4222 [default: local]
    #[arg(long, env = "FIRN_ENGINE", value_name = "ENGINE")]
    pub engine: Option<EngineAddress>,
    /// Seconds that a worker on another machine may be silent before its job is given to another [default: 30]
    #[arg(long, env = "FIRN_LEASE_S", value_name = "S", value_parser = clap::value_parser!(u64).range(LEASES_S))]
    pub lease_s: Option<u64>,
    /// Seconds for which a computation may make no step before its job is failed as `stalled` [default: 900]
    #[arg(long, env = "FIRN_STALL_S", value_name = "S", value_parser = clap::value_parser!(u64).range(STALLS_S))]
    pub stall_s: Option<u64>,
    /// MiB of memory that the particles and the grid of a run-out simulation may take; what would take more is refused
    /// [default: 2048]
    #[arg(long, env = "FIRN_RUNOUT_MEMORY_MIB", value_name = "MIB")]
    pub runout_memory_mib: Option<u64>,
    /// Name of the warning service, which bulletins give as their source [default: firn]
    #[arg(long, env = "FIRN_PROVIDER_NAME", value_name = "NAME")]
    pub provider_name: Option<String>,
    /// Its address in the web, for bulletins
    #[arg(long, env = "FIRN_PROVIDER_WEBSITE", value_name = "URL", value_parser = website)]
    pub provider_website: Option<String>,
    /// Days that ended jobs are kept [default: 90]
    #[arg(long, env = "FIRN_KEEP_JOBS_DAYS", value_name = "DAYS")]
    pub keep_jobs_days: Option<u32>,
    /// MiB that ended jobs may need before the oldest go [default: 20480]
    #[arg(long, env = "FIRN_KEEP_JOBS_MIB", value_name = "MIB")]
    pub keep_jobs_mib: Option<u64>,
    /// Seconds that a shutdown may take [default: 20]
    #[arg(long, env = "FIRN_SHUTDOWN_TIMEOUT_S", value_name = "S")]
    pub shutdown_timeout_s: Option<u64>,
    /// Seconds after a signal for which requests are still answered, `/readyz` with 503, so that whoever balances the load
    /// looks elsewhere before the port closes [default: 1]
    #[arg(long, env = "FIRN_GRACE_S", value_name = "S")]
    pub grace_s: Option<u64>,
    /// `text` for a terminal, `json` for a collector of logs [default: text]
    #[arg(long, env = "FIRN_LOG_FORMAT", value_name = "FORMAT")]
    pub log_format: Option<LogFormat>,
    /// What to log, as `level` or `target=level,...` [default: info]
    #[arg(long, env = "FIRN_LOG", value_name = "FILTER")]
    pub log: Option<String>,
}

/// An address in the web as it may stand in a bulletin.
fn website(text: &str) -> Result<String, &'static str> {
    let rest = text.strip_prefix("https://").or_else(|| text.strip_prefix("http://"));
    match rest {
        Some(rest) if !rest.is_empty() && rest.bytes().all(|letter| letter.is_ascii_graphic()) => Ok(text.to_owned()),
        _ => Err("must be an address that begins with http:// or https://"),
    }
}

/// What carries jobs to workers.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum EngineAddress {
    /// A queue in this process.
    Local,
    /// A NATS server.
    Nats(String),
}

/// As it may be logged: without the name and password that an address may hold.
impl std::fmt::Display for EngineAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Local => f.write_str("local"),
            Self::Nats(address) => {
                let (scheme, rest) = address.split_once("://").unwrap_or(("nats", address));
                let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
                write!(f, "{scheme}://{host}")
            }
        }
    }
}

impl std::str::FromStr for EngineAddress {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "local" => Ok(Self::Local),
            address if address.starts_with("nats://") || address.starts_with("tls://") => {
                Ok(Self::Nats(address.into()))
            }
            _ => Err("must be `local` or the address of a NATS server: nats://HOST:PORT or tls://HOST:PORT"),
        }
    }
}

impl TryFrom<String> for EngineAddress {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

/// How log lines look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For a person.
    Text,
    /// One JSON object a line.
    Json,
}

/// The settings in force.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Address and port to listen on.
    pub listen: SocketAddr,
    /// Folder of the database.
    pub data_dir: PathBuf,
    /// Whether an address other than loopback is served without keys.
    pub allow_anonymous: bool,
    /// Largest request body, bytes.
    pub max_body_bytes: usize,
    /// Largest file of a data set, bytes.
    pub max_dataset_bytes: u64,
    /// How long the upload of a data set may take.
    pub upload_timeout: Duration,
    /// How long a request may take.
    pub request_timeout: Duration,
    /// Requests that are worked on at once.
    pub max_requests: usize,
    /// Threads that each job computes with.
    pub compute_threads: usize,
    /// Jobs that run at once.
    pub job_slots: usize,
    /// Jobs that may wait.
    pub max_queue: u32,
    /// Where large outputs lie.
    pub artifacts: ArtifactAddress,
    /// What carries jobs to workers.
    pub engine: EngineAddress,
    /// How long a worker may be silent.
    pub lease: Duration,
    /// How long a computation may make no step.
    pub stall: Duration,
    /// Bytes that the particles and the grid of a run-out simulation may take.
    pub runout_memory_bytes: u64,
    /// Who answers for bulletins.
    pub provider: Provider,
    /// Days that ended jobs are kept.
    pub keep_jobs_days: u32,
    /// Bytes that ended jobs may need before the oldest go.
    pub keep_jobs_bytes: u64,
    /// How long a shutdown may take.
    pub shutdown_timeout: Duration,
    /// For how long after a signal requests are still answered.
    pub grace: Duration,
    /// How log lines look.
    pub log_format: LogFormat,
    /// What to log.
    pub log: String,
}

/// Settings that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{path}: {source}")]
    Read {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not what we accept.
    #[error("{path}: {message}")]
    Parse {
        /// Which file.
        path: PathBuf,
        /// Where and why.
        message: String,
    },
}

impl Settings {
    /// Reads a TOML file with the names of the long flags, `_` for `-`; an unknown name is an error.
    ///
    /// # Errors
    /// [`ConfigError`] naming the file, the line and what is accepted.
    pub fn from_file(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Read { path: path.into(), source })?;
        let refuse = |message: String| ConfigError::Parse { path: path.into(), message };
        let settings: Self = toml::from_str(&text).map_err(|error| refuse(error.to_string()))?;
        settings.check_bounds().map_err(refuse)?;
        Ok(settings)
    }

    /// What the command line refuses by itself.
    fn check_bounds(&self) -> Result<(), String> {
        if let Some(website) = &self.provider_website {
            self::website(website).map_err(|rule| format!("provider_website {rule}, not {website}"))?;
        }
        let bounds = [("lease_s", self.lease_s, LEASES_S), ("stall_s", self.stall_s, STALLS_S)];
        for (name, value, accepted) in bounds {
            if let Some(value) = value.filter(|value| !accepted.contains(value)) {
                return Err(format!("{name} must be from {} to {}, not {value}", accepted.start(), accepted.end()));
            }
        }
        Ok(())
    }

    /// The settings in force: `self` where it says something, then `file`, then the default.
    #[must_use]
    pub fn over(self, file: Self) -> Config {
        const MIB: usize = 1024 * 1024;
        let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let loopback = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8080);
        let data_dir = self.data_dir.or(file.data_dir).unwrap_or_else(|| "firn-data".into());
        Config {
            listen: self.listen.or(file.listen).unwrap_or(loopback),
            artifacts: self
                .artifacts
                .or(file.artifacts)
                .unwrap_or_else(|| ArtifactAddress::Folder(data_dir.join("artifacts"))),
            data_dir,
            allow_anonymous: self.allow_anonymous.or(file.allow_anonymous).unwrap_or(false),
            max_body_bytes: self.max_body_mib.or(file.max_body_mib).map_or(32, NonZeroUsize::get).saturating_mul(MIB),
            max_dataset_bytes: self
                .max_dataset_mib
                .or(file.max_dataset_mib)
                .unwrap_or(1024)
                .saturating_mul(1024 * 1024),
            upload_timeout: Duration::from_secs(self.upload_timeout_s.or(file.upload_timeout_s).unwrap_or(600)),
            request_timeout: Duration::from_secs(self.request_timeout_s.or(file.request_timeout_s).unwrap_or(30)),
            max_requests: self.max_requests.or(file.max_requests).map_or(512, NonZeroUsize::get),
            compute_threads: self.compute_threads.or(file.compute_threads).map_or(cores, NonZeroUsize::get),
            job_slots: self.job_slots.or(file.job_slots).map_or(2, NonZeroUsize::get),
            max_queue: self.max_queue.or(file.max_queue).unwrap_or(10_000),
            engine: self.engine.or(file.engine).unwrap_or(EngineAddress::Local),
            lease: Duration::from_secs(self.lease_s.or(file.lease_s).unwrap_or(30)),
            stall: Duration::from_secs(self.stall_s.or(file.stall_s).unwrap_or(900)),
            runout_memory_bytes: self
                .runout_memory_mib
                .or(file.runout_memory_mib)
                .unwrap_or(2048)
                .saturating_mul(1024 * 1024),
            provider: Provider {
                name: self.provider_name.or(file.provider_name).unwrap_or_else(|| "firn".into()),
                website: self.provider_website.or(file.provider_website),
            },
            keep_jobs_days: self.keep_jobs_days.or(file.keep_jobs_days).unwrap_or(90),
            keep_jobs_bytes: self.keep_jobs_mib.or(file.keep_jobs_mib).unwrap_or(20 * 1024).saturating_mul(1024 * 1024),
            shutdown_timeout: Duration::from_secs(self.shutdown_timeout_s.or(file.shutdown_timeout_s).unwrap_or(20)),
            grace: Duration::from_secs(self.grace_s.or(file.grace_s).unwrap_or(1)),
            log_format: self.log_format.or(file.log_format).unwrap_or(LogFormat::Text),
            log: self.log.or(file.log).unwrap_or_else(|| "info".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_win_over_the_file_and_the_file_over_defaults() {
        let file: Settings = toml::from_str("listen = '127.0.0.1:9000'\nmax_body_mib = 1").unwrap();
        let flags = Settings { listen: Some("127.0.0.1:9001".parse().unwrap()), ..Settings::default() };
        let config = flags.over(file);
        assert_eq!(config.listen.port(), 9001);
        assert_eq!(config.max_body_bytes, 1024 * 1024);
        assert_eq!(config.job_slots, 2);
    }

    #[test]
    fn a_file_is_held_to_the_same_bounds_as_the_command_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("firn.toml");
        for (text, name) in [
            ("stall_s = 0", "stall_s"),
            ("lease_s = 4000", "lease_s"),
            ("max_body_mib = 0", "max_body_mib"),
            ("provider_website = 'avalanche.report'", "provider_website"),
        ] {
            std::fs::write(&path, text).unwrap();
            let refusal = Settings::from_file(&path).unwrap_err().to_string();
            assert!(refusal.contains(name) && refusal.contains("firn.toml"), "{refusal}");
        }
    }

    #[test]
    fn no_password_is_logged() {
        let address: EngineAddress = "tls://bob:s3cret@nats.example:4222".parse().unwrap();
        assert_eq!(address.to_string(), "tls://nats.example:4222");
    }

    #[test]
    fn an_unknown_name_is_an_error_that_lists_what_is_known() {
        let error = toml::from_str::<Settings>("listne = '127.0.0.1:9000'").unwrap_err().to_string();
        assert!(error.contains("listne") && error.contains("data_dir"), "{error}");
    }
}
