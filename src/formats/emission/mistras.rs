//! Mistras `.DTA` files: the hits among the messages that AEwin writes.
//!
//! Layout (Mistras user's manual, appendix II), little-endian: messages of a length (u16), an id (u8; the ids 40 to 49 have a second
//! byte) and a body. Message 42 holds the hardware set-up in submessages of the same form, of which number 5 lists the characteristics of a
//! hit and number 109 says how long the one of partial powers is. Message 1 is a hit: its time in quarters of a microsecond
//! (6 bytes), its channel and the characteristics. Amplitudes are whole dB_AE by definition of the format.

use std::{collections::BTreeMap, io::Read};

use super::{AmplitudeUnit, FileError, MOST_ROWS, ReadOptions, Reading};
use crate::science::emission::catalogue::Column;

const FORMAT: &str = "dta";
/// The clock of a test, s.
const TICK_S: f64 = 0.25e-6;
/// Absolute energies are counted in so many aJ.
const ABSOLUTE_ENERGY_AJ: f64 = 9.31e-4;

/// A characteristic of a hit: what it is called, its bytes, the column that it fills.
struct Characteristic {
    id: u8,
    name: &'static str,
    bytes: usize,
    column: Option<Column>,
}

const fn known(id: u8, name: &'static str, bytes: usize, column: Option<Column>) -> Characteristic {
    Characteristic { id, name, bytes, column }
}

const PARTIAL_POWER: u8 = 22;
const KNOWN: [Characteristic; 17] = [
    known(1, "RISE", 2, Some(Column::RiseTimeUs)),
    known(2, "PCNTS", 2, None),
    known(3, "COUN", 2, Some(Column::Counts)),
    known(4, "ENER", 2, None),
    known(5, "DURATION", 4, Some(Column::DurationUs)),
    known(6, "AMP", 1, Some(Column::AmplitudeDb)),
    known(8, "ASL", 1, None),
    known(10, "THR", 1, Some(Column::ThresholdDb)),
    known(13, "A-FRQ", 2, None),
    known(17, "RMS", 2, None),
    known(18, "R-FRQ", 2, None),
    known(19, "I-FRQ", 2, None),
    known(20, "SIG STRENGTH", 4, None),
    known(21, "ABS-ENERGY", 4, Some(Column::EnergyEu)),
    known(PARTIAL_POWER, "FREQPPX", 0, None),
    known(23, "FRQ-C", 2, None),
    known(24, "P-FRQ", 2, None),
];

fn malformed(detail: impl Into<String>) -> FileError {
    FileError::Malformed { format: FORMAT, detail: detail.into() }
}

/// Reads the hits of a file, in the order of time.
///
/// # Errors
/// [`FileError`]: a message that breaks off, a characteristic that is not known, or a unit that is not dB_AE.
pub fn read(mut source: impl Read, options: &ReadOptions) -> Result<Reading, FileError> {
    if let Some(said) = options.amplitude_unit.filter(|unit| *unit != AmplitudeUnit::DecibelAe) {
        let named = AmplitudeUnit::DecibelAe.name();
        return Err(FileError::MixedUnits { column: "AMP".into(), named, said: said.name() });
    }
    let mut hits = Hits::default();
    let mut body = Vec::new();
    let mut at = 0_u64;
    loop {
        let mut length = [0; 2];
        let got = fill(&mut source, &mut length)?;
        if got == 0 {
            break;
        }
        let size = usize::from(u16::from_le_bytes(length));
        body.resize(size, 0);
        if got < length.len() || size == 0 || fill(&mut source, &mut body)? < size {
            return Err(malformed(format!("the message at byte {at} breaks off: the file was cut, or is no DTA file")));
        }
        hits.take(&body).map_err(|detail| malformed(format!("the message at byte {at}: {detail}")))?;
        if hits.rows.len() > MOST_ROWS {
            return Err(FileError::TooManyRows);
        }
        at += 2 + size as u64;
    }
    hits.into_reading()
}

/// Reads as many bytes as there are, at most those of `bytes`.
fn fill(source: &mut impl Read, bytes: &mut [u8]) -> std::io::Result<usize> {
    let mut got = 0;
    while got < bytes.len() {
        match source.read(&mut bytes[got..])? {
            0 => break,
            more => got += more,
        }
    }
    Ok(got)
}

/// A hit: its time in ticks, its channel, its characteristics in their order.
type Row = (u64, u8, Vec<f64>);

/// The hits as they come.
#[derive(Default)]
struct Hits {
    characteristics: Vec<&'static Characteristic>,
    partial_powers: usize,
    rows: Vec<Row>,
}

impl Hits {
    fn take(&mut self, message: &[u8]) -> Result<(), String> {
        match message {
            [1, hit @ ..] => self.hit(hit),
            // the second byte of the id and the version of the message
            [42, _, _, _, setup @ ..] => self.setup(setup),
            _ => Ok(()),
        }
    }

    fn setup(&mut self, mut setup: &[u8]) -> Result<(), String> {
        while let [low, high, rest @ ..] = setup {
            let size = usize::from(u16::from_le_bytes([*low, *high]));
            let (sub, after) = rest.split_at_checked(size).ok_or("a part of the hardware set-up breaks off")?;
            match sub {
                [5, count, ids @ ..] => {
                    let ids = ids.get(..usize::from(*count)).ok_or("the list of characteristics breaks off")?;
                    let find = |id: &u8| {
                        let found = KNOWN.iter().find(|known| known.id == *id);
                        found.ok_or_else(|| format!("the characteristic {id} is not known"))
                    };
                    self.characteristics = ids.iter().map(find).collect::<Result<_, _>>()?;
                }
                [109, _, low, high, ..] => self.partial_powers = usize::from(u16::from_le_bytes([*low, *high])),
                _ => {}
            }
            setup = after;
        }
        Ok(())
    }

    fn hit(&mut self, hit: &[u8]) -> Result<(), String> {
        let broken = || "a hit breaks off".to_owned();
        let [a, b, c, d, e, f, channel, rest @ ..] = hit else { return Err(broken()) };
        let time = u64::from_le_bytes([*a, *b, *c, *d, *e, *f, 0, 0]);
        if self.characteristics.is_empty() {
            return Err("a hit before the list of its characteristics".into());
        }
        let mut values = Vec::with_capacity(self.characteristics.len());
        let mut rest = rest;
        for characteristic in &self.characteristics {
            let size = if characteristic.id == PARTIAL_POWER { self.partial_powers } else { characteristic.bytes };
            let (bytes, after) = rest.split_at_checked(size).ok_or_else(broken)?;
            values.push(value(characteristic, bytes));
            rest = after;
        }
        self.rows.push((time, *channel, values));
        Ok(())
    }

    fn into_reading(mut self) -> Result<Reading, FileError> {
        // a hit is written when it ends, and a long one may end after a later one of another channel
        let sorted = self.rows.windows(2).all(|pair| pair[0].0 <= pair[1].0);
        self.rows.sort_by_key(|row| row.0);
        let mut reading = Reading::default();
        if !sorted {
            reading.notes.push("hits were brought into the order of time".into());
        }
        let width = self.characteristics.len();
        if self.rows.iter().any(|row| row.2.len() != width) {
            return Err(malformed("the list of characteristics changes within the file"));
        }
        let mut columns: BTreeMap<Column, Vec<f64>> = BTreeMap::new();
        columns.insert(Column::TimeS, self.rows.iter().map(|row| row.0 as f64 * TICK_S).collect());
        columns.insert(Column::Channel, self.rows.iter().map(|row| f64::from(row.1)).collect());
        for (place, characteristic) in self.characteristics.iter().enumerate() {
            match characteristic.column {
                Some(column) => drop(columns.insert(column, self.rows.iter().map(|row| row.2[place]).collect())),
                None => reading.ignored_columns.push(characteristic.name.to_owned()),
            }
        }
        reading.columns = columns;
        Ok(reading)
    }
}

fn value(characteristic: &Characteristic, bytes: &[u8]) -> f64 {
    match (characteristic.column, bytes) {
        (Some(Column::EnergyEu), [a, b, c, d]) => f64::from(f32::from_le_bytes([*a, *b, *c, *d])) * ABSOLUTE_ENERGY_AJ,
        (_, [a]) => f64::from(*a),
        (_, [a, b]) => f64::from(u16::from_le_bytes([*a, *b])),
        (_, [a, b, c, d]) => f64::from(i32::from_le_bytes([*a, *b, *c, *d])),
        _ => f64::NAN,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn message(body: &[u8]) -> Vec<u8> {
        [&u16::try_from(body.len()).unwrap().to_le_bytes()[..], body].concat()
    }

    /// The set-up of hits with rise time, counts, duration, amplitude and absolute energy.
    fn setup() -> Vec<u8> {
        let sub = message(&[5, 5, 1, 3, 5, 6, 21, 0]);
        let other = message(&[23, 1, 40]);
        message(&[&[42, 0, 200, 0][..], &other, &sub].concat())
    }

    fn hit(ticks: u64, channel: u8, rise: u16, counts: u16, duration: i32, amplitude: u8, energy: f32) -> Vec<u8> {
        let body = [
            &[1][..],
            &ticks.to_le_bytes()[..6],
            &[channel],
            &rise.to_le_bytes(),
            &counts.to_le_bytes(),
            &duration.to_le_bytes(),
            &[amplitude],
            &energy.to_le_bytes(),
            // a parametric channel behind it
            &[1, 0, 0],
        ];
        message(&body.concat())
    }

    fn file() -> Vec<u8> {
        let label = message(b"\x07a test");
        let late = hit(8_000_000, 2, 12, 5, 340, 45, 1000.0);
        let early = hit(4_000_000, 1, 30, 9, 120_000, 60, 2000.0);
        [label, setup(), message(&[128, 0, 0, 0, 0, 0, 0]), late, early].concat()
    }

    #[test]
    fn hits_are_found_among_the_messages_in_the_units_of_the_manual() {
        let reading = read(file().as_slice(), &ReadOptions::default()).unwrap();
        let column = |column: Column| reading.columns[&column].clone();
        assert_eq!(column(Column::TimeS), [1.0, 2.0]);
        assert_eq!(column(Column::Channel), [1.0, 2.0]);
        assert_eq!(column(Column::AmplitudeDb), [60.0, 45.0]);
        assert_eq!(column(Column::DurationUs), [120_000.0, 340.0]);
        assert_eq!(column(Column::RiseTimeUs), [30.0, 12.0]);
        assert_eq!(column(Column::Counts), [9.0, 5.0]);
        assert!((column(Column::EnergyEu)[0] - 1.862).abs() < 1e-12);
        assert_eq!(reading.notes, ["hits were brought into the order of time"]);
    }

    #[test]
    fn files_that_are_none_say_why() {
        let said = |bytes: &[u8]| read(bytes, &ReadOptions::default()).unwrap_err().to_string();
        let whole = file();
        for cut in 1..whole.len() {
            // a cut between two messages cannot be seen
            if let Err(error) = read(&whole[..cut], &ReadOptions::default()) {
                assert!(error.to_string().contains("breaks off"), "{error}");
            }
        }
        assert!(said(&whole[..whole.len() - 1]).contains("breaks off"));
        assert!(said(&hit(1, 1, 1, 1, 1, 1, 1.0)).contains("before the list"));
        let strange = message(&[&[42, 0, 200, 0][..], &message(&[5, 1, 99])].concat());
        assert!(said(&strange).contains("characteristic 99"));
        let volts = ReadOptions { amplitude_unit: Some(AmplitudeUnit::Volt), ..ReadOptions::default() };
        assert!(matches!(read(whole.as_slice(), &volts), Err(FileError::MixedUnits { .. })));
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(bytes: Vec<u8>, head in prop::bool::ANY) {
            let bytes = if head { [setup(), bytes].concat() } else { bytes };
            let _ = read(bytes.as_slice(), &ReadOptions::default());
        }
    }
}
