//! Parquet files: flat columns of numbers, by the same names and units as in text.

use std::{collections::BTreeMap, fs::File};

use ::parquet::{
    basic::{LogicalType, Repetition, Type as Physical},
    column::reader::{ColumnReader, ColumnReaderImpl},
    data_type::DataType,
    errors::ParquetError,
    file::reader::{FileReader, SerializedFileReader},
    schema::types::ColumnDescriptor,
};

use super::{FileError, MOST_ROWS, ReadOptions, Reading, plan::Plan};
use crate::science::emission::catalogue::Column;

/// Records that are read at once.
const BATCH: usize = 16 * 1024;

fn malformed(error: impl std::fmt::Display) -> FileError {
    FileError::Malformed { format: "parquet", detail: error.to_string() }
}

/// Reads the known columns of a file.
///
/// # Errors
/// [`FileError`]: no Parquet, no known columns, amplitudes without a unit or in two, or a column that is no number.
pub fn read(file: File, options: &ReadOptions) -> Result<Reading, FileError> {
    // the crate panics on some damaged pages (a page that claims a dictionary where there is none); nothing of what it
    // worked on is used afterwards
    let read = std::panic::AssertUnwindSafe(|| read_whole(file, options));
    std::panic::catch_unwind(read).unwrap_or_else(|_| Err(malformed("a page is damaged")))
}

fn read_whole(file: File, options: &ReadOptions) -> Result<Reading, FileError> {
    let reader = SerializedFileReader::new(file).map_err(malformed)?;
    let metadata = reader.metadata();
    let rows = usize::try_from(metadata.file_metadata().num_rows()).unwrap_or(usize::MAX);
    if rows > MOST_ROWS {
        return Err(FileError::TooManyRows);
    }
    let schema = metadata.file_metadata().schema_descr();
    let names: Vec<String> = schema.columns().iter().map(|column| column.path().string()).collect();
    let Plan { fields, mut reading, .. } = Plan::new(&names, options)?;
    if fields.is_empty() {
        return Err(FileError::NoHeader(super::canonical_names()));
    }
    let mut columns: BTreeMap<Column, Vec<f64>> = BTreeMap::new();
    for field in fields {
        let descriptor = schema.column(field.at);
        check(&field.header, &descriptor)?;
        let mut values = Vec::with_capacity(rows);
        for group in 0..reader.num_row_groups() {
            let group = reader.get_row_group(group).map_err(malformed)?;
            let column = group.get_column_reader(field.at).map_err(malformed)?;
            numbers(column, descriptor.max_def_level(), &mut values).map_err(malformed)?;
        }
        if values.len() != rows {
            return Err(malformed(format!("column {} has {} values, not {rows}", field.header, values.len())));
        }
        if field.factor != 1.0 {
            values.iter_mut().for_each(|value| *value *= field.factor);
        }
        columns.insert(field.column, values);
    }
    reading.columns = columns;
    Ok(reading)
}

/// Whether a column holds plain numbers, one a row.
fn check(name: &str, descriptor: &ColumnDescriptor) -> Result<(), FileError> {
    let physical = descriptor.physical_type();
    let numbers =
        matches!(physical, Physical::BOOLEAN | Physical::INT32 | Physical::INT64 | Physical::FLOAT | Physical::DOUBLE);
    let repeated =
        descriptor.max_rep_level() > 0 || descriptor.self_type().get_basic_info().repetition() == Repetition::REPEATED;
    let is_else = match descriptor.logical_type_ref() {
        None | Some(LogicalType::Integer { .. }) => None,
        Some(other) => Some(format!("{other:?}")),
    };
    if numbers && !repeated && is_else.is_none() {
        return Ok(());
    }
    let is = is_else.unwrap_or_else(|| if repeated { "a list".into() } else { format!("{physical}") });
    Err(malformed(format!("column {name} is {is}; one plain number a row is accepted")))
}

/// Appends the values of one column of one row group; NaN where one is null.
fn numbers(reader: ColumnReader, definition: i16, into: &mut Vec<f64>) -> Result<(), ParquetError> {
    match reader {
        ColumnReader::BoolColumnReader(reader) => all(reader, definition, into, |value| f64::from(u8::from(value))),
        ColumnReader::Int32ColumnReader(reader) => all(reader, definition, into, f64::from),
        ColumnReader::Int64ColumnReader(reader) => all(reader, definition, into, |value| value as f64),
        ColumnReader::FloatColumnReader(reader) => all(reader, definition, into, f64::from),
        ColumnReader::DoubleColumnReader(reader) => all(reader, definition, into, |value| value),
        _ => Err(ParquetError::General("a column that is no number".into())),
    }
}

fn all<T: DataType>(
    mut reader: ColumnReaderImpl<T>,
    definition: i16,
    into: &mut Vec<f64>,
    number: impl Fn(T::T) -> f64,
) -> Result<(), ParquetError> {
    loop {
        let (mut values, mut levels) = (Vec::new(), Vec::new());
        let (records, ..) = reader.read_records(BATCH, Some(&mut levels), None, &mut values)?;
        if records == 0 {
            return Ok(());
        }
        let mut values = values.into_iter();
        if definition == 0 {
            into.extend(values.map(&number));
        } else {
            let mut next =
                |level: &i16| if *level == definition { values.next().map_or(f64::NAN, &number) } else { f64::NAN };
            into.extend(levels.iter().map(&mut next));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Seek as _, Write as _};

    use ::parquet::{
        data_type::{ByteArrayType, DoubleType, Int64Type},
        file::{properties::WriterProperties, writer::SerializedFileWriter},
        schema::parser::parse_message_type,
    };
    use proptest::prelude::*;

    use super::*;
    use crate::formats::emission::AmplitudeUnit;

    fn spooled(bytes: &[u8]) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytes).unwrap();
        file.rewind().unwrap();
        file
    }

    fn of(bytes: &[u8], unit: Option<AmplitudeUnit>) -> Result<Reading, FileError> {
        read(spooled(bytes), &ReadOptions { amplitude_unit: unit, ..ReadOptions::default() })
    }

    /// Two row groups of times, amplitudes, counts, positions that may be missing, and a note.
    fn file() -> Vec<u8> {
        let schema = "message hits { required double time_s; required double AMP; required int64 counts; optional double x_mm; \
                      required binary note (UTF8); }";
        let schema = parse_message_type(schema).unwrap().into();
        let mut bytes = Vec::new();
        let mut writer = SerializedFileWriter::new(&mut bytes, schema, WriterProperties::default().into()).unwrap();
        for begin in [0.0, 2.0] {
            let mut group = writer.next_row_group().unwrap();
            let doubles =
                |values: &[f64],
                 levels: Option<&[i16]>,
                 group: &mut ::parquet::file::writer::SerializedRowGroupWriter<'_, &mut Vec<u8>>| {
                    let mut column = group.next_column().unwrap().unwrap();
                    column.typed::<DoubleType>().write_batch(values, levels, None).unwrap();
                    column.close().unwrap();
                };
            doubles(&[begin, begin + 1.0], None, &mut group);
            doubles(&[45.0, 50.0 + begin], None, &mut group);
            let mut column = group.next_column().unwrap().unwrap();
            column.typed::<Int64Type>().write_batch(&[3, 4], None, None).unwrap();
            column.close().unwrap();
            doubles(&[12.0], Some(&[1, 0]), &mut group);
            let mut column = group.next_column().unwrap().unwrap();
            column.typed::<ByteArrayType>().write_batch(&["a".into(), "b".into()], None, None).unwrap();
            column.close().unwrap();
            group.close().unwrap();
        }
        writer.close().unwrap();
        bytes
    }

    #[test]
    fn known_columns_are_read_and_nulls_are_missing() {
        let reading = of(&file(), Some(AmplitudeUnit::DecibelAe)).unwrap();
        assert_eq!(reading.columns[&Column::TimeS], [0.0, 1.0, 2.0, 3.0]);
        assert_eq!(reading.columns[&Column::AmplitudeDb], [45.0, 50.0, 45.0, 52.0]);
        assert_eq!(reading.columns[&Column::Counts], [3.0, 4.0, 3.0, 4.0]);
        let x = &reading.columns[&Column::XM];
        assert!((x[0] - 0.012).abs() < 1e-15 && x[1].is_nan() && x[3].is_nan());
        assert_eq!(reading.ignored_columns, ["note"]);
        assert!(matches!(of(&file(), None), Err(FileError::NoUnit { .. })));
    }

    #[test]
    fn what_is_cut_off_or_no_number_is_refused() {
        let whole = file();
        for cut in [0, 4, 100, whole.len() - 1] {
            assert!(matches!(of(&whole[..cut], None), Err(FileError::Malformed { .. })), "{cut}");
        }
        let schema = parse_message_type("message hits { required binary amplitude_v (UTF8); }").unwrap().into();
        let mut bytes = Vec::new();
        SerializedFileWriter::new(&mut bytes, schema, WriterProperties::default().into()).unwrap().close().unwrap();
        assert!(of(&bytes, None).unwrap_err().to_string().contains("amplitude_v is"));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]
        #[test]
        fn a_flipped_byte_never_makes_it_panic(at: prop::sample::Index, to: u8) {
            let mut bytes = file();
            let at = at.index(bytes.len());
            bytes[at] = to;
            let _ = of(&bytes, Some(AmplitudeUnit::DecibelAe));
        }
    }
}
