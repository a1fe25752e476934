//! What a reader found in a file: days, flags, refused rows.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::domain::avalanche::{AvalancheRecord, Contradiction};
use crate::domain::observation::Observation;
use crate::domain::units::{OutOfRange, bounds};
use crate::science::forecast::day::{Activity, DayRecord, VARIABLES, Variable};

/// Most rows that one file may have: more than a century of days, and little enough to report on each.
pub const MAX_ROWS: usize = 50_000;

/// Everything found in one file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Import {
    /// One entry a row, in the order of the file; at most one accepted row for each date.
    pub rows: Vec<ImportedRow>,
    /// Rows that went into another row of the same day and are not in `rows`.
    pub merged: Vec<MergedRow>,
    /// Columns that hold nothing: missing on every row, or an optional column that is 0 on every row.
    pub not_reported: Vec<String>,
    /// Columns whose content is not read.
    pub ignored_columns: Vec<String>,
    /// What was assumed to read the file, in sentences for the person who sent it.
    pub notes: Vec<String>,
}

/// A row of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedRow {
    /// 1-based line of the file in which the row starts.
    pub line: u64,
    /// The station's local calendar day; `None` where it could not be read.
    pub date: Option<Date>,
    /// The day, or why the row is refused.
    pub outcome: Result<ImportedDay, RowError>,
}

/// A row that repeats the day of another row, in a format where both count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MergedRow {
    /// 1-based line of the file in which the row starts.
    pub line: u64,
    /// Line of the row whose values were kept.
    pub into_line: u64,
    /// The day of both.
    pub date: Date,
}

/// What a row says of its day.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportedDay {
    /// Values in the order of [`Variable::ALL`] and the units of [`Variable::unit`]; each within its [`bounds`].
    pub values: [Option<f64>; VARIABLES],
    /// What is stated of avalanches; `None` where the file says nothing of them. Never contradicts itself.
    pub avalanche: Option<AvalancheRecord>,
    /// What was noticed.
    pub flags: Vec<Flag>,
}

impl ImportedDay {
    /// The day in the words of the API.
    ///
    /// # Errors
    /// [`OutOfRange`] where a value is outside of its [`bounds`]; no reader of this module gives such a value.
    pub fn observation(&self) -> Result<Observation, OutOfRange> {
        Observation::from_values(&self.values, self.avalanche.as_ref())
    }

    /// The day as the engines read it; an activity that was not stated is unknown.
    #[must_use]
    pub fn day_record(&self, date: Date) -> DayRecord {
        let activity = self.avalanche.map_or(Activity::Unknown, |record| record.activity);
        DayRecord { date, values: self.values, activity }
    }

    /// Keeps `value`, in [`Variable::unit`], or flags it as impossible; `given` is what the file says.
    pub(super) fn set_checked(&mut self, variable: Variable, value: f64, given: String) {
        let bounds = bounds(variable);
        if bounds.contain(value) {
            self.values[variable.index()] = Some(value + 0.0);
        } else {
            let detail = format!("must be {bounds}; kept as missing");
            self.flags.push(Flag { field: variable.name().into(), code: FlagCode::OutOfRange, value: given, detail });
        }
    }

    /// Takes away what contradicts itself in `record` and keeps the rest.
    pub(super) fn set_avalanche(&mut self, mut record: AvalancheRecord) {
        for contradiction in record.contradictions() {
            let given = match contradiction.record_field() {
                "count" => record.count.take().map(|count| count.get().to_string()),
                "type" => record.r#type.take().map(|kind| kind.name().to_owned()),
                "trigger" => record.trigger.take().map(|trigger| trigger.name().to_owned()),
                _ => record.size.take().map(|size| size.get().to_string()),
            };
            self.flag_contradiction(contradiction, given.unwrap_or_default());
        }
        self.avalanche = Some(record);
    }

    /// Notes that a field was dropped because it cannot be true beside the others.
    pub(super) fn flag_contradiction(&mut self, contradiction: Contradiction, value: String) {
        self.flags.push(Flag {
            field: contradiction.observation_field(),
            code: FlagCode::Contradiction,
            value,
            detail: format!("{contradiction}; kept as missing"),
        });
    }
}

/// Something noticed in an accepted row.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Flag {
    /// The field of the observation.
    pub field: String,
    /// What was noticed.
    pub code: FlagCode,
    /// What the file says; free text is only described.
    pub value: String,
    /// What was done about it, and what would be accepted.
    pub detail: String,
}

/// What can be noticed in an accepted row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FlagCode {
    /// A value outside of the physical range; kept as missing.
    OutOfRange,
    /// Text where a number or a known word should be; kept as missing.
    Unreadable,
    /// A code that is not documented; kept as unknown.
    UnknownCode,
    /// A value in a unit that cannot be told; kept as missing.
    UnknownUnit,
    /// A 0 that fills an unused column; kept as missing.
    NotReported,
    /// Two columns that should agree do not.
    ColumnsDisagree,
    /// Measured at another place than the rest of the file.
    OtherSite,
    /// More than one row of the file reports the day.
    DuplicateDay,
    /// A field that cannot be true beside the others; kept as missing.
    Contradiction,
}

/// Why a row is refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, thiserror::Error)]
#[error("line {line}: {detail}")]
pub struct RowError {
    /// 1-based line of the file.
    pub line: u64,
    /// 1-based column in the line, in characters; null where no single place is to blame.
    pub column: Option<u64>,
    /// The field of the observation; null where the whole row is to blame.
    pub field: Option<String>,
    /// The kind of error.
    pub code: RowErrorCode,
    /// What is wrong and what would be accepted.
    pub detail: String,
}

/// Why rows are refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RowErrorCode {
    /// The date cannot be read.
    UnreadableDate,
    /// The row has more or fewer fields than the header.
    RaggedRow,
    /// The row belongs to another area than the rest of the import.
    OtherArea,
    /// A row before it in the file reports the same day.
    DuplicateDay,
}

/// Why a file cannot be read at all.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FormatError {
    /// Nothing but white space.
    #[error("the file is empty: its first line must be a header")]
    Empty,
    /// Binary content, or text in UTF-16.
    #[error("line {line}, column {column}: byte {byte:#04x} is not text: send UTF-8 or Windows-1252")]
    NotText {
        /// 1-based line.
        line: u64,
        /// 1-based column, in bytes.
        column: u64,
        /// The offending byte.
        byte: u8,
    },
    /// A column that must be there is not.
    #[error("line {line}: the header has no column `{column}`; it must have {expected}")]
    MissingColumn {
        /// 1-based line of the header.
        line: u64,
        /// Name of the missing column.
        column: &'static str,
        /// What a header looks like.
        expected: String,
    },
    /// More columns than any export has.
    #[error("line {line}: the header has more than {most} columns")]
    TooManyColumns {
        /// 1-based line of the header.
        line: u64,
        /// Columns that a file may have.
        most: usize,
    },
    /// A header that breaks the rules of its format.
    #[error("line {line}: {detail}")]
    Header {
        /// 1-based line.
        line: u64,
        /// What is wrong and what would be accepted.
        detail: String,
    },
    /// A column that nobody knows.
    #[error("line {line}, column {column}: unknown column `{name}`; accepted are {accepted}")]
    UnknownColumn {
        /// 1-based line of the header.
        line: u64,
        /// 1-based column, in characters.
        column: u64,
        /// The name as given.
        name: String,
        /// The names that are accepted, with commas.
        accepted: String,
    },
    /// Two columns of one name.
    #[error("line {line}, column {column}: column `{name}` occurs twice")]
    DuplicateColumn {
        /// 1-based line of the header.
        line: u64,
        /// 1-based column, in characters, of the second.
        column: u64,
        /// The name.
        name: String,
    },
    /// Quotes that break the rules of CSV.
    #[error("line {line}, column {column}: malformed CSV: {detail}")]
    Malformed {
        /// 1-based line.
        line: u64,
        /// 1-based column, in characters.
        column: u64,
        /// What is wrong.
        detail: &'static str,
    },
    /// More rows than [`MAX_ROWS`].
    #[error("line {line}: more than {MAX_ROWS} rows: send the file in parts")]
    TooManyRows {
        /// 1-based line of the first row too many.
        line: u64,
    },
    /// A time zone that the time-zone database does not hold.
    #[error("unknown time zone `{zone}`: give a name like Europe/London")]
    UnknownZone {
        /// The name as given.
        zone: String,
    },
}

impl FormatError {
    /// The 1-based line and column to blame, where there is one.
    #[must_use]
    pub const fn place(&self) -> Option<(u64, Option<u64>)> {
        match self {
            Self::Empty | Self::UnknownZone { .. } => None,
            Self::MissingColumn { line, .. }
            | Self::TooManyRows { line }
            | Self::TooManyColumns { line, .. }
            | Self::Header { line, .. } => Some((*line, None)),
            Self::NotText { line, column, .. }
            | Self::UnknownColumn { line, column, .. }
            | Self::DuplicateColumn { line, column, .. }
            | Self::Malformed { line, column, .. } => Some((*line, Some(*column))),
        }
    }
}
