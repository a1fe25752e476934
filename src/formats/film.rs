//! Frames of a run-out simulation in one file, each of which can be read by itself.
//!
//! Layout, little-endian: the 8 bytes `FIRNFLM1`; the number of frames (u32) and 4 bytes of 0; for each frame its time since
//! release in s (f64), where it begins in the file (u64) and its length in bytes (u64); then the frames, each in the layout
//! of [`crate::science::runout::frames`].

use std::ops::Range;

const MAGIC: &[u8; 8] = b"FIRNFLM1";
/// Bytes before the table.
pub const HEADER_BYTES: u64 = 16;
/// Bytes of one line of the table.
const LINE_BYTES: u64 = 24;

/// Where one frame lies.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Time since release, s.
    pub time_s: f64,
    /// Its bytes in the file.
    pub bytes: Range<u64>,
}

/// A film that is not one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("these bytes are no film of frames")]
pub struct Damaged;

/// Header and table of a film, which its frames follow one after the other: of each its time since release in s and its
/// length in bytes.
#[must_use]
pub fn head(frames: &[(f64, u64)]) -> Vec<u8> {
    let mut begin = HEADER_BYTES + LINE_BYTES * frames.len() as u64;
    let mut bytes = Vec::with_capacity(begin as usize);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&(frames.len() as u64).to_le_bytes());
    for (time_s, length) in frames {
        bytes.extend_from_slice(&time_s.to_le_bytes());
        bytes.extend_from_slice(&begin.to_le_bytes());
        bytes.extend_from_slice(&length.to_le_bytes());
        begin += length;
    }
    bytes
}

/// Bytes of header and table, from the first [`HEADER_BYTES`] of a film.
///
/// # Errors
/// [`Damaged`] where they are not a film's.
pub fn table_bytes(header: &[u8]) -> Result<Range<u64>, Damaged> {
    let (magic, count) = header.split_at_checked(MAGIC.len()).ok_or(Damaged)?;
    let count = count.get(..8).and_then(|count| count.try_into().ok()).map(u64::from_le_bytes).ok_or(Damaged)?;
    if magic != MAGIC || count > u64::from(u32::MAX) {
        return Err(Damaged);
    }
    Ok(HEADER_BYTES..HEADER_BYTES + LINE_BYTES * count)
}

/// Where the frames lie, from the table that [`table_bytes`] finds.
///
/// # Errors
/// [`Damaged`] where a frame would end before it begins.
pub fn read_table(table: &[u8]) -> Result<Vec<Entry>, Damaged> {
    let (lines, rest) = table.as_chunks::<{ LINE_BYTES as usize }>();
    if !rest.is_empty() {
        return Err(Damaged);
    }
    let entry = |line: &[u8; LINE_BYTES as usize]| {
        let number = |at: usize| std::array::from_fn(|byte| line[at + byte]);
        let (begin, length) = (u64::from_le_bytes(number(8)), u64::from_le_bytes(number(16)));
        let end = begin.checked_add(length).ok_or(Damaged)?;
        Ok(Entry { time_s: f64::from_le_bytes(number(0)), bytes: begin..end })
    };
    lines.iter().map(entry).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn every_frame_is_found_again(frames in prop::collection::vec((0.0..60.0, prop::collection::vec(any::<u8>(), 0..50)), 0..20)) {
            let table: Vec<(f64, u64)> = frames.iter().map(|(time_s, frame)| (*time_s, frame.len() as u64)).collect();
            let film: Vec<u8> = std::iter::chain([head(&table)], frames.iter().map(|(_, frame)| frame.clone())).flatten().collect();
            let table = table_bytes(&film[..HEADER_BYTES as usize]).unwrap();
            let entries = read_table(&film[table.start as usize..table.end as usize]).unwrap();
            let found: Vec<_> = entries
                .into_iter()
                .map(|entry| (entry.time_s, film[entry.bytes.start as usize..entry.bytes.end as usize].to_vec()))
                .collect();
            prop_assert_eq!(found, frames);
        }

        #[test]
        fn other_bytes_are_refused_or_read_but_never_panic(bytes: Vec<u8>) {
            let _ = table_bytes(&bytes);
            let _ = read_table(&bytes);
        }
    }
}
