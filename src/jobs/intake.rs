//! Files of acoustic emission on their way in: read, checked, described, and only then stored.

use std::{
    fs::File,
    io::{BufReader, Read as _, Seek as _},
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
    formats::emission::{FileError, FileFormat, ReadOptions, Reading, columns, text},
    science::emission::{
        EmissionError,
        catalogue::{Catalogue, Metadata},
    },
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

/// Reads a file as a catalogue.
///
/// # Errors
/// [`FileError`].
pub fn read(upload: &Upload) -> Result<Taken, FileError> {
    let (format, reading) = read_file(&upload.path, upload.format, &upload.options)?;
    let source = Source { format: format.name().into(), bytes: upload.bytes, sha256: upload.sha256.clone() };
    described(reading, upload.body.metadata.clone(), source)
}

fn described(mut reading: Reading, metadata: Metadata, source: Source) -> Result<Taken, FileError> {
    let (ignored, notes) = (std::mem::take(&mut reading.ignored_columns), std::mem::take(&mut reading.notes));
    let catalogue = reading.into_catalogue(metadata)?;
    let description = Description::of(&catalogue, ignored, notes, source);
    Ok(Taken { catalogue, description })
}

fn read_file(
    path: &Path,
    format: Option<FileFormat>,
    options: &ReadOptions,
) -> Result<(FileFormat, Reading), FileError> {
    let mut file = File::open(path)?;
    let format = match format {
        Some(format) => format,
        None => {
            let mut head = Vec::new();
            file.by_ref().take(64).read_to_end(&mut head)?;
            file.rewind()?;
            FileFormat::of_content(&head)
        }
    };
    let reading = match format {
        FileFormat::Csv | FileFormat::Tsv => text::read(BufReader::with_capacity(BUFFER, file), options)?,
    };
    Ok((format, reading))
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
        FileError::TooManyRows => Problem::new(Code::PayloadTooLarge, detail),
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
