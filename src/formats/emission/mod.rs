//! Acoustic-emission data as files: from bytes to the canonical columns of [`crate::science::emission::catalogue`].
//!
//! [`text`] reads CSV, TSV and the tables of Mistras, [`parquet`] Parquet, [`mistras`] `.DTA`; [`waves`] makes hits of waveforms (WAV,
//! NPY, `.tradb`); [`columns`] is how data sets are kept. Every reader gives a [`Reading`] or a [`FileError`] that names the
//! place; none panics whatever the bytes are. Vallen's databases are read by `store::vallen`, where SQL lives.

pub mod columns;
pub mod mistras;
mod names;
pub mod parquet;
mod plan;
pub mod text;
pub mod waves;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use names::{AmplitudeUnit, UnknownUnit};
pub use waves::WaveOptions;

use crate::{
    domain::dataset::WaveformOrigin,
    science::emission::{
        EmissionError,
        catalogue::{Catalogue, Column, Metadata},
    },
};

/// Most rows that a data set may have: they are held in memory while they are read and analysed.
pub const MOST_ROWS: usize = 5_000_000;

/// Rows at fault that are named; reading ends with the last of them.
pub const MOST_FAULTS: usize = 20;

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FileFormat {
    /// A table of text: the separator (comma, semicolon, tab or white space) is found out.
    Csv,
    /// The same; the name for tables with tabs.
    Tsv,
    /// Apache Parquet.
    Parquet,
    /// Hits of a Vallen recorder, a SQLite database.
    Pridb,
    /// Waveforms of a Vallen recorder, a SQLite database.
    Tradb,
    /// Messages of a Mistras recorder.
    Dta,
    /// Waveforms.
    Wav,
    /// Waveforms as an array of NumPy.
    Npy,
}

impl FileFormat {
    /// Every format.
    pub const ALL: [Self; 8] =
        [Self::Csv, Self::Tsv, Self::Parquet, Self::Pridb, Self::Tradb, Self::Dta, Self::Wav, Self::Npy];

    /// The name that requests and descriptions use.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Tsv => "tsv",
            Self::Parquet => "parquet",
            Self::Pridb => "pridb",
            Self::Tradb => "tradb",
            Self::Dta => "dta",
            Self::Wav => "wav",
            Self::Npy => "npy",
        }
    }

    /// The format of that [`FileFormat::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// What a file is by its first bytes: a table of text unless they say something else. A `.tradb` begins as a `.pridb`
    /// does, and a `.DTA` as nothing does: those must be named.
    #[must_use]
    pub fn of_content(head: &[u8]) -> Self {
        let signs: [(&[u8], Self); 4] = [
            (b"PAR1", Self::Parquet),
            (b"SQLite format 3\0", Self::Pridb),
            (b"RIFF", Self::Wav),
            (b"\x93NUMPY", Self::Npy),
        ];
        signs.into_iter().find(|(sign, _)| head.starts_with(sign)).map_or(Self::Csv, |(_, format)| format)
    }
}

/// What the sender says of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// The unit of the column of amplitudes, where its name does not say it.
    pub amplitude_unit: Option<AmplitudeUnit>,
    /// How waveforms become hits.
    pub wave: WaveOptions,
}

/// What was found in a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// The canonical columns, all of one length.
    pub columns: BTreeMap<Column, Vec<f64>>,
    /// Columns of the file that are not read, by the names that it gives them.
    pub ignored_columns: Vec<String>,
    /// What was done to read the file, in sentences for whoever sent it.
    pub notes: Vec<String>,
    /// How the hits were found in waveforms, where they were.
    pub waveform: Option<WaveformOrigin>,
}

/// The names of all columns, in words.
fn canonical_names() -> String {
    Column::ALL.map(Column::name).join(", ")
}

impl Reading {
    /// The catalogue with what is known of the test.
    ///
    /// # Errors
    /// Values that no catalogue holds, and [`FileError::Empty`] where there is no row.
    pub fn into_catalogue(self, metadata: Metadata) -> Result<Catalogue, FileError> {
        if self.columns.values().next().is_none_or(Vec::is_empty) {
            return Err(FileError::Empty);
        }
        Ok(Catalogue::new(self.columns, metadata)?)
    }
}

/// A row of a file that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RowFault {
    /// The column, by the name that the file gives it; empty where the whole row is at fault.
    pub column: String,
    /// Where it stands: the line of a text, else the row; both counted from 1.
    pub place: u64,
    /// What is wrong and what is accepted.
    pub detail: String,
}

/// A file that is not taken.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The bytes could not be had.
    #[error("the file could not be read: {0}")]
    Io(#[from] std::io::Error),
    /// The bytes are not of that format.
    #[error("not a file of the format {format}: {detail}")]
    Malformed {
        /// The format.
        format: &'static str,
        /// What is wrong with it, and where.
        detail: String,
    },
    /// No line of a text names columns that are known.
    #[error("no line names the columns; one of the first lines must, with names such as {0}")]
    NoHeader(String),
    /// There is no row.
    #[error("the file holds no hits")]
    Empty,
    /// Something must be known that the file does not say.
    #[error("{option} is needed: {why}")]
    Needed {
        /// What must be said.
        option: &'static str,
        /// Why.
        why: &'static str,
    },
    /// More samples than are held in memory.
    #[error("the file has more than {} samples; send it in parts", waves::MOST_SAMPLES)]
    TooManySamples,
    /// More rows than a data set may have.
    #[error("the file has more than {} rows; send it in parts", MOST_ROWS)]
    TooManyRows,
    /// A column is there twice.
    #[error("the columns {first} and {second} are both {column}; one is accepted")]
    Twice {
        /// The canonical column.
        column: &'static str,
        /// The name of the first in the file.
        first: String,
        /// The name of the second in the file.
        second: String,
    },
    /// Nothing says in which unit the amplitudes are.
    #[error(
        "the unit of the amplitudes in column {column} is not known: say amplitude_unit ({}) or name the column \
         amplitude_v or amplitude_db; it is never guessed",
        AmplitudeUnit::LIST
    )]
    NoUnit {
        /// The name of the column in the file.
        column: String,
    },
    /// The name of a column and the sender say different units.
    #[error("column {column} says {named}, amplitude_unit says {said}: mixed units are refused")]
    MixedUnits {
        /// The name of the column in the file.
        column: String,
        /// The unit that it names.
        named: &'static str,
        /// The unit that was said.
        said: &'static str,
    },
    /// Two columns of amplitudes in different units.
    #[error("the columns {first} and {second} both hold amplitudes: mixed units are refused, send one of them")]
    TwoAmplitudes {
        /// The name of the first in the file.
        first: String,
        /// The name of the second in the file.
        second: String,
    },
    /// Rows that cannot be read; at least one.
    #[error("{}", rows_in_words(.0))]
    Rows(Vec<RowFault>),
    /// Values that no catalogue holds.
    #[error(transparent)]
    Catalogue(#[from] EmissionError),
}

fn rows_in_words(faults: &[RowFault]) -> String {
    let Some(first) = faults.first() else { return "rows are at fault".into() };
    let column = if first.column.is_empty() { String::new() } else { format!(", column {}", first.column) };
    let more = match faults.len() {
        1 => String::new(),
        all if all >= MOST_FAULTS => format!("; and more, of which {} are named", all - 1),
        all => format!("; {} more", all - 1),
    };
    format!("line {}{column}: {}{more}", first.place, first.detail)
}
