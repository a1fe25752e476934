//! How a data set is kept: its canonical columns one after the other, so that any rows of any column can be read by
//! themselves.
//!
//! Layout, little-endian: the 8 bytes `FIRNAEC1`; the number of rows (u64); the number of columns (u64); for each column its
//! canonical name in 24 bytes, filled up with 0; then the columns in the same order, each a f64 a row (NaN: missing).

use std::{collections::BTreeMap, ops::Range};

use crate::science::emission::catalogue::Column;

const MAGIC: &[u8; 8] = b"FIRNAEC1";
const NAME_BYTES: usize = 24;
/// Bytes before the names.
pub const HEADER_BYTES: u64 = 24;
const VALUE_BYTES: u64 = 8;

/// What lies where in a file of columns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Rows.
    pub rows: u64,
    /// The columns, in the order in which they lie.
    pub columns: Vec<Column>,
}

/// Bytes that are no file of columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("these bytes are no data set")]
pub struct Damaged;

impl Layout {
    /// The layout of some columns with so many rows; the columns lie in the order of [`Column`].
    #[must_use]
    pub fn new(rows: u64, columns: impl IntoIterator<Item = Column>) -> Self {
        let mut columns: Vec<Column> = columns.into_iter().collect();
        columns.sort_unstable();
        Self { rows, columns }
    }

    fn data_begins(&self) -> u64 {
        HEADER_BYTES + NAME_BYTES as u64 * self.columns.len() as u64
    }

    /// Where some rows of a column lie, cut at the last row; none where the column is not there.
    #[must_use]
    pub fn bytes_of(&self, column: Column, rows: Range<u64>) -> Option<Range<u64>> {
        let place = self.columns.iter().position(|other| *other == column)? as u64;
        let begin = self.data_begins() + place * self.rows * VALUE_BYTES;
        let at = |row: u64| begin + row.min(self.rows) * VALUE_BYTES;
        Some(at(rows.start)..at(rows.end.max(rows.start)))
    }
}

/// The file of some columns, all of one length.
#[must_use]
pub fn write(columns: &BTreeMap<Column, Vec<f64>>) -> Vec<u8> {
    let rows = columns.values().next().map_or(0, Vec::len);
    let layout = Layout::new(rows as u64, columns.keys().copied());
    let mut bytes = Vec::with_capacity(layout.data_begins() as usize + 8 * rows * columns.len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&layout.rows.to_le_bytes());
    bytes.extend_from_slice(&(layout.columns.len() as u64).to_le_bytes());
    for column in &layout.columns {
        let mut name = [0; NAME_BYTES];
        name[..column.name().len()].copy_from_slice(column.name().as_bytes());
        bytes.extend_from_slice(&name);
    }
    for values in columns.values() {
        values.iter().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
    }
    bytes
}

/// The columns of a file.
///
/// # Errors
/// [`Damaged`] for other bytes.
pub fn read(bytes: &[u8]) -> Result<BTreeMap<Column, Vec<f64>>, Damaged> {
    let number = |at: usize| {
        let bytes = bytes.get(at..at + 8).ok_or(Damaged)?;
        Ok(u64::from_le_bytes(bytes.try_into().map_err(|_| Damaged)?))
    };
    if !bytes.starts_with(MAGIC) {
        return Err(Damaged);
    }
    let (rows, count) = (number(8)?, number(16)?);
    if count > Column::ALL.len() as u64 {
        return Err(Damaged);
    }
    let begin = HEADER_BYTES as usize;
    let names = bytes.get(begin..begin + NAME_BYTES * count as usize).ok_or(Damaged)?;
    let column = |name: &[u8]| {
        let name = std::str::from_utf8(name).map_err(|_| Damaged)?;
        Column::from_name(name.trim_end_matches('\0')).ok_or(Damaged)
    };
    let columns = names.chunks_exact(NAME_BYTES).map(column).collect::<Result<Vec<_>, _>>()?;
    let layout = Layout { rows, columns };
    let size = rows.checked_mul(VALUE_BYTES * count).and_then(|size| size.checked_add(layout.data_begins()));
    if size != Some(bytes.len() as u64) || layout.columns.windows(2).any(|pair| pair[0] >= pair[1]) {
        return Err(Damaged);
    }
    let values = |column: Column| {
        let range = layout.bytes_of(column, 0..rows).ok_or(Damaged)?;
        let bytes = bytes.get(range.start as usize..range.end as usize).ok_or(Damaged)?;
        Ok((column, values(bytes)))
    };
    layout.columns.iter().copied().map(values).collect()
}

/// The values of some rows of one column from the bytes that [`Layout::bytes_of`] finds.
#[must_use]
pub fn values(bytes: &[u8]) -> Vec<f64> {
    bytes.as_chunks::<8>().0.iter().map(|value| f64::from_le_bytes(*value)).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_name_has_room() {
        assert!(Column::ALL.iter().all(|column| column.name().len() < NAME_BYTES));
    }

    proptest! {
        #[test]
        fn columns_come_back_whole_and_in_parts(rows in prop::collection::vec((any::<f64>(), any::<f64>()), 1..40), from in 0_u64..50, more in 0_u64..50) {
            let (time, x): (Vec<f64>, Vec<f64>) = rows.into_iter().unzip();
            let columns: BTreeMap<Column, Vec<f64>> = [(Column::TimeS, time.clone()), (Column::XM, x)].into();
            let bytes = write(&columns);
            let bits = |columns: &BTreeMap<Column, Vec<f64>>| -> Vec<Vec<u64>> {
                columns.values().map(|values| values.iter().map(|value| value.to_bits()).collect()).collect()
            };
            prop_assert_eq!(bits(&read(&bytes).unwrap()), bits(&columns));
            let layout = Layout::new(time.len() as u64, columns.keys().copied());
            let part = layout.bytes_of(Column::TimeS, from..from + more).unwrap();
            let found = values(&bytes[part.start as usize..part.end as usize]);
            let expected: Vec<u64> = time.iter().skip(from as usize).take(more as usize).map(|value| value.to_bits()).collect();
            prop_assert_eq!(found.iter().map(|value| value.to_bits()).collect::<Vec<_>>(), expected);
            prop_assert_eq!(layout.bytes_of(Column::Strain, 0..1), None);
            // a file that was cut off is no file
            prop_assert!(read(&bytes[..bytes.len() - 1]).is_err());
        }

        #[test]
        fn other_bytes_are_refused_and_never_panic(head in prop::bool::ANY, bytes: Vec<u8>) {
            let bytes = if head { [&MAGIC[..], &bytes].concat() } else { bytes };
            let _ = read(&bytes);
        }
    }
}
