//! `firn analyse FILE`: what the process `emission-analysis` does, without a server.

use std::path::{Path, PathBuf};

use clap::Args;
use firn_science::{
    emission::{
        analysis::{self, Request},
        catalogue::{Metadata, Phase},
    },
    progress::Unobserved,
};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::{
    domain::{
        dataset::{DatasetBody, DatasetName},
        problem::FieldError,
    },
    formats::emission::{AmplitudeUnit, FileFormat, ReadOptions, WaveOptions},
    jobs::{
        intake::{self, Taken, Upload},
        link::Artifact,
        processes::emission_analysis::{self, Figures, Found, Head, KINDS},
    },
    server::ServerError,
};

/// What to analyse, and how.
#[derive(Args, Debug)]
pub struct Analyse {
    /// File of hits
    file: PathBuf,
    /// Unit of the amplitudes where the column's name does not say it: v, mv, uv or db_ae
    #[arg(long, value_name = "UNIT")]
    amplitude_unit: Option<AmplitudeUnit>,
    /// What the file is [default: found out]
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    format: Option<FileFormat>,
    /// An analysis: its kind, or a JSON object with `kind` and options; may be given several times [default: all that the
    /// columns allow]
    #[arg(long = "analysis", value_name = "KIND|JSON")]
    analyses: Vec<String>,
    /// Seed of everything random
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u64).range(..=9_007_199_254_740_991))]
    seed: u64,
    /// Folder for the figures, made where it is not there [default: no figures]
    #[arg(long, value_name = "DIR")]
    figures: Option<PathBuf>,
    /// Figures as PNG instead of SVG
    #[arg(long, requires = "figures")]
    png: bool,
    /// JSON file with what is known about the test: the `metadata` of a data set
    #[arg(long, value_name = "FILE")]
    metadata: Option<PathBuf>,
    /// Temperature, degC
    #[arg(long, value_name = "DEGC", allow_negative_numbers = true)]
    temperature_c: Option<f64>,
    /// Mean grain size, mm; left out for a single crystal
    #[arg(long, value_name = "MM")]
    grain_size_mm: Option<f64>,
    /// Gain of the preamplifier, dB
    #[arg(long, value_name = "DB", allow_negative_numbers = true)]
    preamp_gain_db: Option<f64>,
    /// Detection threshold behind the preamplifier, V; of waveforms the one that hits are found with
    #[arg(long, value_name = "V")]
    threshold_v: Option<f64>,
    /// Of waveforms: hit definition time T1, s
    #[arg(long, value_name = "S")]
    hit_definition_s: Option<f64>,
    /// Of waveforms: hit lock-out time T2, s
    #[arg(long, value_name = "S")]
    hit_lockout_s: Option<f64>,
    /// Of waveforms: peak definition time, s
    #[arg(long, value_name = "S")]
    peak_definition_s: Option<f64>,
    /// Of NPY: samples a second, Hz
    #[arg(long, value_name = "HZ")]
    sample_rate_hz: Option<f64>,
    /// Of WAV: volts of the largest sample that the file can hold
    #[arg(long, value_name = "V")]
    full_scale_v: Option<f64>,
    /// Phase of all hits: loading or unloading
    #[arg(long, value_name = "PHASE", value_parser = phase)]
    phase: Option<Phase>,
}

fn format(text: &str) -> Result<FileFormat, String> {
    let names: Vec<&str> = FileFormat::ALL.into_iter().map(FileFormat::name).collect();
    FileFormat::from_name(text).ok_or_else(|| format!("must be one of {}", names.join(", ")))
}

fn phase(text: &str) -> Result<Phase, &'static str> {
    match text {
        "loading" => Ok(Phase::Loading),
        "unloading" => Ok(Phase::Unloading),
        _ => Err("must be loading or unloading"),
    }
}

/// Analyses a file and writes the figures; gives the document that a job's results are, as JSON.
///
/// # Errors
/// What is wrong with the file, the options or the analyses, in words.
pub fn run(options: &Analyse) -> Result<String, ServerError> {
    let upload = upload(options)?;
    let Taken { catalogue, description } = intake::read(&upload)?;
    let requests = requests(options, &catalogue)?;
    let head = Head {
        id: None,
        name: upload.body.name.as_str().to_owned(),
        sha256: upload.sha256.clone(),
        synthetic: false,
        events: catalogue.len(),
        metadata: catalogue.metadata.clone(),
    };
    let wanted = match (&options.figures, options.png) {
        (None, _) => Figures::None,
        (Some(_), false) => Figures::Svg,
        (Some(_), true) => Figures::Png,
    };
    let Found { analyses, figures, artifacts } =
        emission_analysis::analyse(&catalogue, &head, &requests, options.seed, wanted, &Unobserved)?;
    if let Some(folder) = &options.figures {
        write(folder, &artifacts)?;
    }
    let document = json!({
        "dataset": head,
        "description": description,
        "analyses": analyses,
        "figures": figures,
        "provenance": {"version": env!("CARGO_PKG_VERSION"), "seed": options.seed},
    });
    Ok(serde_json::to_string_pretty(&document)?)
}

/// The file with what is said of it.
fn upload(options: &Analyse) -> Result<Upload, ServerError> {
    let at = |error: std::io::Error| format!("{}: {error}", options.file.display());
    let mut file = std::fs::File::open(&options.file).map_err(at)?;
    let mut hasher = Hashed(Sha256::new());
    let bytes = std::io::copy(&mut file, &mut hasher).map_err(at)?;
    let stem = options.file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let name = DatasetName::try_from(stem).or_else(|_| DatasetName::try_from("a file".to_owned()))?;
    Ok(Upload {
        path: options.file.clone(),
        format: options.format,
        options: ReadOptions {
            amplitude_unit: options.amplitude_unit,
            wave: WaveOptions {
                threshold_v: options.threshold_v,
                hit_definition_s: options.hit_definition_s,
                hit_lockout_s: options.hit_lockout_s,
                peak_definition_s: options.peak_definition_s,
                sample_rate_hz: options.sample_rate_hz,
                full_scale_v: options.full_scale_v,
            },
        },
        body: DatasetBody { name, metadata: metadata(options)? },
        bytes,
        sha256: hasher.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect(),
        by: None,
    })
}

/// Counts what is written into a digest.
struct Hashed(Sha256);

impl std::io::Write for Hashed {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn metadata(options: &Analyse) -> Result<Metadata, ServerError> {
    let mut metadata = match &options.metadata {
        Some(path) => {
            let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
            serde_json::from_str(&text).map_err(|error| format!("{}: {error}", path.display()))?
        }
        None => Metadata::default(),
    };
    metadata.temperature_c = options.temperature_c.or(metadata.temperature_c);
    metadata.grain_size_mm = options.grain_size_mm.or(metadata.grain_size_mm);
    metadata.preamp_gain_db = options.preamp_gain_db.or(metadata.preamp_gain_db);
    metadata.threshold_v = options.threshold_v.or(metadata.threshold_v);
    metadata.phase = options.phase.or(metadata.phase);
    Ok(metadata)
}

/// The analyses that were asked for, all of which must be possible; or all that are.
fn requests(
    options: &Analyse,
    catalogue: &firn_science::emission::catalogue::Catalogue,
) -> Result<Vec<Request>, ServerError> {
    let in_words = |faults: Vec<FieldError>| -> ServerError {
        let faults: Vec<String> = faults.iter().map(|fault| format!("{} {}", fault.pointer, fault.detail)).collect();
        faults.join("; ").replace("/inputs/analyses/", "--analysis ").into()
    };
    if options.analyses.is_empty() {
        let all: Vec<Value> = KINDS.iter().map(|kind| json!({"kind": kind})).collect();
        let all = emission_analysis::requests(&all).map_err(in_words)?;
        let possible = all.into_iter().filter(|one| analysis::check(catalogue, std::slice::from_ref(one)).is_ok());
        return Ok(possible.collect());
    }
    let read = |text: &String| match text.trim_start().starts_with('{') {
        true => serde_json::from_str(text).map_err(|error| format!("--analysis {text}: not JSON: {error}")),
        false => Ok(json!({"kind": text})),
    };
    let wanted = options.analyses.iter().map(read).collect::<Result<Vec<Value>, String>>()?;
    let wanted = emission_analysis::requests(&wanted).map_err(in_words)?;
    let refusals = emission_analysis::refusals(catalogue, &wanted);
    if refusals.is_empty() { Ok(wanted) } else { Err(in_words(refusals)) }
}

fn write(folder: &Path, artifacts: &[Artifact]) -> Result<(), ServerError> {
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    for artifact in artifacts {
        let path = folder.join(&artifact.name);
        std::fs::write(&path, &artifact.bytes).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(())
}
