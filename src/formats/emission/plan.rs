//! Which column of a file is which canonical column.

use super::{
    FileError, ReadOptions, Reading,
    names::{Meaning, meaning},
};
use crate::science::emission::catalogue::Column;

/// Which field is which column.
pub(super) struct Plan {
    pub(super) fields: Vec<Field>,
    /// The field that tells hits from other lines in exports of Mistras.
    pub(super) hit_mark: Option<usize>,
    pub(super) reading: Reading,
}

/// A field that is read.
pub(super) struct Field {
    /// Its place among the columns of the file.
    pub(super) at: usize,
    /// Its name in the file.
    pub(super) header: String,
    /// What it holds.
    pub(super) column: Column,
    /// What makes its values those of the column.
    pub(super) factor: f64,
}

impl Plan {
    /// What columns of those names hold.
    pub(super) fn new(names: &[String], options: &ReadOptions) -> Result<Self, FileError> {
        let mut fields: Vec<Field> = Vec::new();
        let mut reading = Reading::default();
        for (at, name) in names.iter().enumerate() {
            let (column, factor) = match meaning(name) {
                None => {
                    reading.ignored_columns.push(name.clone());
                    continue;
                }
                Some(Meaning::Values(column, factor)) => (column, factor),
                Some(Meaning::Amplitude(named)) => match (named, options.amplitude_unit) {
                    (Some(named), Some(said)) if named != said => {
                        let (named, said) = (named.name(), said.name());
                        return Err(FileError::MixedUnits { column: name.clone(), named, said });
                    }
                    (named, said) => named
                        .or(said)
                        .ok_or_else(|| FileError::NoUnit { column: name.clone() })
                        .map(super::AmplitudeUnit::column)?,
                },
            };
            let is_amplitude = |column| matches!(column, Column::AmplitudeV | Column::AmplitudeDb);
            let same = |other: &&Field| other.column == column || is_amplitude(other.column) && is_amplitude(column);
            if let Some(other) = fields.iter().find(same) {
                let (first, second) = (other.header.clone(), name.clone());
                return Err(if other.column == column {
                    FileError::Twice { column: column.name(), first, second }
                } else {
                    FileError::TwoAmplitudes { first, second }
                });
            }
            fields.push(Field { at, header: name.clone(), column, factor });
        }
        let has_mistras_time = names.iter().any(|name| name.eq_ignore_ascii_case("SSSSSSSS.mmmuuun"));
        let mark = names.iter().position(|name| name.eq_ignore_ascii_case("id"));
        Ok(Self { fields, hit_mark: mark.filter(|_| has_mistras_time), reading })
    }
}
