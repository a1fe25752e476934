//! Files of acoustic emission on their way in: read, checked, described, and only then stored.

use std::{
    fs::File,
    io::{BufReader, Read as _},
    path::{Path, PathBuf},
};

use super::desk::Desk;
use crate::{
    clock,
    domain::{
        dataset::{Dataset, DatasetBody, Description, Source},
        ids::new_id,
        problem::{Code, FieldError, Problem},
    },
    formats::emission::{
        AmplitudeUnit, FileError, FileFormat, MOST_ROWS, ReadOptions, Reading, columns, mistras, parquet, text,
        waves::{self, Wave},
    },
    science::emission::{
        EmissionError,
        catalogue::{Catalogue, Metadata},
    },
    store::{self, vallen::VallenError},
};

/// Bytes that are read at once.
const BUFFER: usize = 256 * 1024;

/// A file that is wholly here.
#[derive(Clone, Debug)]
pub struct Upload {
    /// Where it lies.
    pub path: PathBuf,
    /// What it is; none finds it out.
    pub format: Option<FileFormat>,
    /// What the sender says of it.
    pub options: ReadOptions,
    /// Name and metadata.
    pub body: DatasetBody,
    /// Its length, bytes.
    pub bytes: u64,
    /// Its SHA-256 (hex).
    pub sha256: String,
    /// Who sent it.
    pub by: Option<String>,
}

/// A file that was read.
#[derive(Debug)]
pub struct Taken {
    /// Its hits.
    pub catalogue: Catalogue,
    /// What can be seen in them.
    pub description: Description,
}

/// Reads a file as a catalogue. It waits for databases: call it where waiting is allowed, on a thread of its own.
///
/// # Errors
/// [`FileError`].
pub fn read(upload: &Upload) -> Result<Taken, FileError> {
    let format = format_of(&upload.path, upload.format)?;
    let reading = read_file(&upload.path, format, &upload.options)?;
    let source = Source { format: format.name().into(), bytes: upload.bytes, sha256: upload.sha256.clone() };
    described(reading, upload.body.metadata.clone(), source)
}

fn described(mut reading: Reading, metadata: Metadata, source: Source) -> Result<Taken, FileError> {
    let (ignored, notes) = (std::mem::take(&mut reading.ignored_columns), std::mem::take(&mut reading.notes));
    let waveform = reading.waveform.take();
    let catalogue = reading.into_catalogue(metadata)?;
    let description = Description { waveform, ..Description::of(&catalogue, ignored, notes, source) };
    Ok(Taken { catalogue, description })
}

/// What a file is: what was said of it, or what its first bytes say.
fn format_of(path: &Path, said: Option<FileFormat>) -> Result<FileFormat, FileError> {
    if let Some(format) = said {
        return Ok(format);
    }
    let mut head = Vec::new();
    File::open(path)?.take(64).read_to_end(&mut head)?;
    Ok(FileFormat::of_content(&head))
}

fn read_file(path: &Path, format: FileFormat, options: &ReadOptions) -> Result<Reading, FileError> {
    let file = File::open(path)?;
    let buffered = |file: File| BufReader::with_capacity(BUFFER, file);
    match format {
        FileFormat::Csv | FileFormat::Tsv => text::read(buffered(file), options),
        FileFormat::Parquet => parquet::read(file, options),
        FileFormat::Dta => mistras::read(buffered(file), options),
        FileFormat::Wav => waves::into_hits(&waves::read_wav(buffered(file), &options.wave)?, &options.wave),
        FileFormat::Npy => waves::into_hits(&waves::read_npy(file, options)?, &options.wave),
        FileFormat::Pridb => pridb(path, options),
        FileFormat::Tradb => tradb(path, options),
    }
}

/// Waits for a database from a thread that may wait.
fn wait<T>(work: impl Future<Output = T>) -> Result<T, FileError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    Ok(runtime.block_on(work))
}

fn vallen(format: FileFormat, error: VallenError) -> FileError {
    match error {
        VallenError::Io(error) => FileError::Io(error),
        VallenError::TooMany(_) => FileError::TooManyRows,
        error => FileError::Malformed { format: format.name(), detail: error.to_string() },
    }
}

fn pridb(path: &Path, options: &ReadOptions) -> Result<Reading, FileError> {
    if let Some(said) = options.amplitude_unit.filter(|unit| *unit != AmplitudeUnit::Volt) {
        let named = AmplitudeUnit::Volt.name();
        return Err(FileError::MixedUnits { column: "Amp".into(), named, said: said.name() });
    }
    let hits = wait(store::vallen::read_hits(path, MOST_ROWS))?.map_err(|error| vallen(FileFormat::Pridb, error))?;
    let mut notes = vec!["amplitudes are those at the sensor: the file has the gain taken out".to_owned()];
    if hits.test_pulses > 0 {
        notes.push(format!("{} test pulses were left out", hits.test_pulses));
    }
    if hits.saturated > 0 {
        notes.push(format!("{} hits are marked as saturated by the recorder", hits.saturated));
    }
    Ok(Reading { columns: hits.columns, ignored_columns: hits.ignored, notes, waveform: None })
}

fn tradb(path: &Path, options: &ReadOptions) -> Result<Reading, FileError> {
    let (mut found, mut samples) = (Vec::new(), 0);
    let take = |record: store::vallen::Record| {
        let counts = waves::counts(record.format, &record.data, record.volts)?;
        samples += counts.len();
        if samples > waves::MOST_SAMPLES {
            return Err(FileError::TooManySamples.to_string());
        }
        let (channel, rate_hz, start_s) = (record.channel, record.rate_hz, record.start_s);
        found.push(Wave { channel, rate_hz, start_s, samples: counts });
        Ok(())
    };
    wait(store::vallen::read_waveforms(path, take))?.map_err(|error| vallen(FileFormat::Tradb, error))?;
    waves::into_hits(&found, &options.wave)
}

/// Reads a file and stores it as a data set, whole or not at all.
///
/// # Errors
/// A [`Problem`] that says what is wrong with the file; then nothing was stored.
pub async fn take_in(desk: &Desk, upload: Upload) -> Result<Dataset, Problem> {
    // megabytes are read on a thread of their own: the server goes on answering meanwhile
    let work = tokio::task::spawn_blocking(move || {
        let Taken { catalogue, description } = read(&upload)?;
        let bytes = columns::write(&catalogue.into_columns());
        Ok::<_, FileError>((dataset(upload.body, description, upload.by), bytes))
    });
    let (dataset, bytes) = work.await.map_err(Problem::internal)?.map_err(|error| refused(&error))?;
    desk.keep_dataset(dataset, bytes).await
}

/// A new data set; its columns are named by whoever stores them.
#[must_use]
pub fn dataset(body: DatasetBody, description: Description, by: Option<String>) -> Dataset {
    let now = clock::now();
    Dataset {
        id: new_id(),
        body,
        description,
        truth: None,
        job: None,
        sha256: String::new(),
        size: 0,
        revision: 1,
        created: now,
        created_by: by,
        updated: now,
    }
}

/// The refusal of a file, with the column and line at fault.
#[must_use]
pub fn refused(error: &FileError) -> Problem {
    let detail = error.to_string();
    let field = |pointer: &str, code: &str| {
        Problem::new(Code::DatasetRefused, detail.clone()).with_errors(vec![FieldError::new(
            pointer,
            code,
            detail.clone(),
        )])
    };
    match error {
        FileError::Io(error) => Problem::internal(error),
        FileError::Malformed { .. } => Problem::new(Code::MalformedFile, detail),
        FileError::Needed { option, .. } => field(&column(option), "needed"),
        FileError::TooManyRows | FileError::TooManySamples => Problem::new(Code::PayloadTooLarge, detail),
        FileError::NoHeader(_) => field("", "no_header"),
        FileError::Empty => field("", "no_hits"),
        FileError::NoUnit { .. } => field("/amplitude_unit", "unit_unknown"),
        FileError::MixedUnits { .. } => field("/amplitude_unit", "mixed_units"),
        FileError::TwoAmplitudes { second, .. } => field(&column(second), "mixed_units"),
        FileError::Twice { second, .. } => field(&column(second), "column_twice"),
        FileError::Rows(faults) => {
            let fault = |fault: &crate::formats::emission::RowFault| {
                FieldError::new(column(&fault.column), "row", format!("line {}: {}", fault.place, fault.detail))
            };
            Problem::new(Code::DatasetRefused, detail).with_errors(faults.iter().map(fault).collect())
        }
        FileError::Catalogue(EmissionError::Value { column: name, .. }) => field(&column(name), "row"),
        FileError::Catalogue(EmissionError::Option { option, .. }) => field(&column(option), "out_of_range"),
        FileError::Catalogue(_) => field("", "refused"),
    }
}

fn column(name: &str) -> String {
    if name.is_empty() { String::new() } else { format!("/{}", crate::domain::schema::escape(name)) }
}
