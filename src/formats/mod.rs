//! What comes in and goes out as files: pure functions from bytes to rows, without HTTP and SQL.
//!
//! Every reader gives an [`Import`]: one line for each row with the day or the reason of its refusal. A field that
//! cannot be true becomes missing and leaves a [`Flag`]; only an unreadable date or a broken structure refuses a row,
//! and only a file that cannot be understood as a whole is a [`FormatError`].

pub mod caaml;
mod csv_source;
pub mod emission;
pub mod figures;
pub mod film;
pub mod json;
pub mod mapped_csv;
pub mod ndjson;
pub mod observations_csv;
mod report;
pub mod sais;
pub mod smet;
mod text;

pub use report::{
    Flag, FlagCode, FormatError, Import, ImportedDay, ImportedRow, MAX_ROWS, MergedRow, RowError, RowErrorCode,
};
