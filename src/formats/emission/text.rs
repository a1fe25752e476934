//! Tables of hits as text: CSV, TSV, semicolons or white space, with or without lines before the header.
//!
//! The file is read line by line and kept as numbers only. The header is the first line that names known columns; lines above
//! it (the block that Mistras exports begin with) are passed over. Lines that begin with `#` and empty lines are no rows.

use std::{collections::BTreeMap, io::BufRead};

use super::{
    FileError, MOST_FAULTS, MOST_ROWS, ReadOptions, Reading, RowFault,
    names::meaning,
    plan::{Field, Plan},
};
use crate::science::emission::catalogue::Column;

/// Lines that may stand before the header.
const MOST_PREAMBLE: usize = 200;
/// Bytes of a line; a longer one is no line of a table.
const LONGEST_LINE: u64 = 1024 * 1024;

/// Reads a table.
///
/// # Errors
/// [`FileError`]: no header, amplitudes without a unit or in two, or rows at fault, each named by its line.
pub fn read(source: impl BufRead, options: &ReadOptions) -> Result<Reading, FileError> {
    let mut lines = Lines { source, bytes: Vec::new(), number: 0 };
    let header = Header::find(&mut lines)?;
    let Plan { fields, hit_mark, mut reading } = Plan::new(&header.fields, options)?;
    let mut table = Table::new(fields, header.fields.len());
    let mut ranges = Vec::new();
    let mut not_hits = 0_usize;
    while lines.next()? {
        let line = lines.line();
        if line.is_empty() || line.starts_with(b"#") {
            continue;
        }
        header.separator.split(line, &mut ranges);
        let field = |at: usize| ranges.get(at).map(|range: &std::ops::Range<usize>| &line[range.clone()]);
        if hit_mark.is_some_and(|at| field(at) != Some(b"1")) {
            not_hits += 1;
            continue;
        }
        table.take(lines.number, ranges.len(), field)?;
        if table.faults.len() >= MOST_FAULTS {
            break;
        }
    }
    if !table.faults.is_empty() {
        return Err(FileError::Rows(table.faults));
    }
    if not_hits > 0 {
        reading.notes.push(format!("{not_hits} lines whose ID is not 1 are no hits and were passed over"));
    }
    reading.columns = table.columns();
    Ok(reading)
}

/// Lines of a source, counted from 1.
struct Lines<R> {
    source: R,
    bytes: Vec<u8>,
    number: u64,
}

impl<R: BufRead> Lines<R> {
    /// Goes to the next line; false at the end.
    fn next(&mut self) -> Result<bool, FileError> {
        self.bytes.clear();
        let read = std::io::Read::take(&mut self.source, LONGEST_LINE).read_until(b'\n', &mut self.bytes)?;
        self.number += 1;
        if read as u64 == LONGEST_LINE {
            let detail = format!("line {} is longer than {LONGEST_LINE} bytes", self.number);
            return Err(FileError::Malformed { format: "csv", detail });
        }
        Ok(read > 0)
    }

    /// The line without what ends it and the white space around it.
    fn line(&self) -> &[u8] {
        // a tab at an end is an empty field
        let is_space = |byte: &u8| matches!(byte, b' ' | b'\r' | b'\n');
        let begin = self.bytes.iter().take_while(|byte| is_space(byte)).count();
        let end = self.bytes.len() - self.bytes[begin..].iter().rev().take_while(|byte| is_space(byte)).count();
        &self.bytes[begin..end]
    }
}

/// What stands between two fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Separator {
    Byte(u8),
    Space,
}

impl Separator {
    const ALL: [Self; 4] = [Self::Byte(b'\t'), Self::Byte(b';'), Self::Byte(b','), Self::Space];

    /// The places of the fields of a line, without quotes and the white space around them.
    fn split(self, line: &[u8], ranges: &mut Vec<std::ops::Range<usize>>) {
        ranges.clear();
        let is_end = |byte: u8| match self {
            Self::Byte(separator) => byte == separator,
            Self::Space => byte.is_ascii_whitespace(),
        };
        let mut at = 0;
        loop {
            let begin = at;
            let mut quoted = false;
            while at < line.len() && (quoted || !is_end(line[at])) {
                quoted ^= line[at] == b'"';
                at += 1;
            }
            ranges.push(bare(line, begin..at));
            if at >= line.len() {
                return;
            }
            at += 1;
            while self == Self::Space && at < line.len() && line[at].is_ascii_whitespace() {
                at += 1;
            }
        }
    }
}

/// A field without the white space and the quotes around it.
fn bare(line: &[u8], range: std::ops::Range<usize>) -> std::ops::Range<usize> {
    let std::ops::Range { mut start, mut end } = range;
    let around = |byte: u8| byte.is_ascii_whitespace() || byte == b'"';
    while start < end && around(line[start]) {
        start += 1;
    }
    while end > start && around(line[end - 1]) {
        end -= 1;
    }
    start..end
}

/// The line that names the columns.
struct Header {
    separator: Separator,
    fields: Vec<String>,
}

impl Header {
    fn find(lines: &mut Lines<impl BufRead>) -> Result<Self, FileError> {
        while lines.number < MOST_PREAMBLE as u64 && lines.next()? {
            let line = lines.line();
            if line.contains(&0) {
                let detail = format!("line {} holds bytes that are no text", lines.number);
                return Err(FileError::Malformed { format: "csv", detail });
            }
            let line = line.strip_prefix("\u{feff}".as_bytes()).unwrap_or(line);
            if let Some(header) = Separator::ALL.into_iter().find_map(|separator| Self::of(line, separator)) {
                return Ok(header);
            }
        }
        Err(FileError::NoHeader(super::canonical_names()))
    }

    /// The header that `line` is: at least two of its fields name known columns, or one does where it stands alone or has a
    /// canonical name. A line such as `Date Time` above the table is none.
    fn of(line: &[u8], separator: Separator) -> Option<Self> {
        let mut ranges = Vec::new();
        separator.split(line.strip_prefix(b"#").unwrap_or(line), &mut ranges);
        let line = line.strip_prefix(b"#").unwrap_or(line);
        let fields: Vec<String> =
            ranges.into_iter().map(|range| String::from_utf8_lossy(&line[range]).into_owned()).collect();
        let known = fields.iter().filter(|field| meaning(field).is_some()).count();
        let canonical = fields.iter().any(|field| Column::from_name(field).is_some());
        let is_header = known >= 2 || (known == 1 && (fields.len() == 1 || canonical));
        is_header.then_some(Self { separator, fields })
    }
}

/// The columns as they fill.
struct Table {
    fields: Vec<Field>,
    width: usize,
    values: Vec<Vec<f64>>,
    faults: Vec<RowFault>,
    last_time: f64,
}

impl Table {
    fn new(fields: Vec<Field>, width: usize) -> Self {
        let values = fields.iter().map(|_| Vec::new()).collect();
        Self { fields, width, values, faults: Vec::new(), last_time: f64::NEG_INFINITY }
    }

    /// Takes a row of `found` fields in; what is wrong with it is kept as a fault.
    fn take<'a>(
        &mut self,
        line: u64,
        found: usize,
        field: impl Fn(usize) -> Option<&'a [u8]>,
    ) -> Result<(), FileError> {
        // a separator at the end of each line is a habit of some programs
        let spare = found > self.width && (self.width..found).all(|at| field(at).is_some_and(<[u8]>::is_empty));
        if found != self.width && !spare {
            let detail = format!("has {found} fields; the header has {}", self.width);
            self.faults.push(RowFault { column: String::new(), place: line, detail });
            return Ok(());
        }
        for (place, values) in self.fields.iter().zip(&mut self.values) {
            match value(place, field(place.at).unwrap_or_default(), &mut self.last_time) {
                Ok(value) => values.push(value),
                Err(detail) => {
                    self.faults.push(RowFault { column: place.header.clone(), place: line, detail });
                    return Ok(());
                }
            }
        }
        if self.values.first().is_some_and(|values| values.len() > MOST_ROWS) {
            return Err(FileError::TooManyRows);
        }
        Ok(())
    }

    fn columns(self) -> BTreeMap<Column, Vec<f64>> {
        self.fields.iter().map(|field| field.column).zip(self.values).collect()
    }
}

/// The number in a field, in the unit of its column; or what is wrong with it.
fn value(field: &Field, text: &[u8], last_time: &mut f64) -> Result<f64, String> {
    let (accepted, accepts) = field.column.accepts();
    let text = std::str::from_utf8(text).unwrap_or("\u{fffd}");
    let missing = text.is_empty() || ["nan", "na", "null", "-"].iter().any(|word| text.eq_ignore_ascii_case(word));
    if missing {
        return if field.column.may_be_missing() {
            Ok(f64::NAN)
        } else {
            Err(format!("is missing; {accepted} is accepted"))
        };
    }
    let number = match (field.column, text) {
        (Column::Phase, word) if word.eq_ignore_ascii_case("loading") => Some(0.0),
        (Column::Phase, word) if word.eq_ignore_ascii_case("unloading") => Some(1.0),
        (_, text) => text.parse::<f64>().ok(),
    };
    let Some(number) = number else {
        let shown: String = text.chars().take(40).collect();
        return Err(format!("{shown:?} is no number; {accepted} is accepted"));
    };
    let value = number * field.factor;
    if !accepts(value) {
        return Err(format!("{text} is refused; {accepted} is accepted"));
    }
    if field.column == Column::TimeS {
        if value < *last_time {
            return Err(format!("{text} is before the time of the hit above; hits are accepted in the order of time"));
        }
        *last_time = value;
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::formats::emission::AmplitudeUnit;

    fn with(text: &str, unit: Option<AmplitudeUnit>) -> Result<Reading, FileError> {
        read(text.as_bytes(), &ReadOptions { amplitude_unit: unit, ..ReadOptions::default() })
    }

    fn column(reading: &Reading, column: Column) -> &[f64] {
        &reading.columns[&column]
    }

    #[test]
    fn any_separator_and_any_order_of_columns_will_do() {
        let texts = [
            "time_s,amplitude_v,note\n0.5,0.01,a\n1.5,0.02,\"b, c\"\n",
            "\u{feff}note;amplitude_v;time_s\r\na;0.01;0.5\r\n\r\nb;0.02;1.5",
            "# made by hand\ntime_s\tnote\tamplitude_v\n0.5\ta\t0.01\n# between\n1.5\t\t0.02\n",
            "  time_s amplitude_v   note\n  0.5   0.01  a\n1.5 0.02 b\n",
        ];
        for text in texts {
            let reading = with(text, None).unwrap();
            assert_eq!(column(&reading, Column::TimeS), [0.5, 1.5], "{text}");
            assert_eq!(column(&reading, Column::AmplitudeV), [0.01, 0.02], "{text}");
            assert_eq!(reading.ignored_columns, ["note"], "{text}");
        }
    }

    #[test]
    fn an_export_of_mistras_is_read_with_its_block_of_lines() {
        let text = "Physical Acoustics Corporation\nDate Time\nWed Nov 25 10:00:00 2026\n\n\
                    ID  SSSSSSSS.mmmuuun  CH   RISE  COUN  ENER  DURATION  AMP  A-FRQ  ABS-ENERGY\n\
                    1   0.0157380  1  12  5  0  120  45  41  1.5E+01\n\
                    211 0.5\n\
                    1   0.9000000  2  30  9  1  300  60  30  9.0E+02\n";
        let reading = with(text, Some(AmplitudeUnit::DecibelAe)).unwrap();
        assert_eq!(column(&reading, Column::TimeS), [0.015738, 0.9]);
        assert_eq!(column(&reading, Column::AmplitudeDb), [45.0, 60.0]);
        assert_eq!(column(&reading, Column::DurationUs), [120.0, 300.0]);
        assert_eq!(column(&reading, Column::EnergyEu), [15.0, 900.0]);
        assert_eq!(reading.ignored_columns, ["ID", "ENER", "A-FRQ"]);
        assert!(reading.notes[0].starts_with("1 lines"), "{:?}", reading.notes);
    }

    #[test]
    fn units_are_taken_from_the_name_or_the_sender_and_never_guessed() {
        let volts = |text, unit| column(&with(text, unit).unwrap(), Column::AmplitudeV).to_vec();
        assert_eq!(volts("amplitude_mv\n12\n", None), [0.012]);
        assert_eq!(volts("AMP\n12\n", Some(AmplitudeUnit::Microvolt)), [12e-6]);
        assert!(matches!(with("time,AMP\n0,12\n", None), Err(FileError::NoUnit { column }) if column == "AMP"));
        let mixed = with("time,amp_db\n0,12\n", Some(AmplitudeUnit::Volt)).unwrap_err();
        assert!(matches!(mixed, FileError::MixedUnits { .. }), "{mixed}");
        let two = with("amplitude_v,amplitude_db\n1,120\n", None).unwrap_err();
        assert!(matches!(two, FileError::TwoAmplitudes { .. }), "{two}");
        let twice = with("time,t,amplitude_v\n1,1,1\n", None).unwrap_err();
        assert!(matches!(twice, FileError::Twice { .. }), "{twice}");
    }

    #[test]
    fn a_row_at_fault_is_named_by_its_line_and_column() {
        let fault = |row: &str| -> (u64, String, String) {
            let text = format!("made by hand\ntime_s,amplitude_v,x_m\n0,0.1,\n1,0.1,0.5\n{row}\n2,0.1,1\n");
            let Err(FileError::Rows(faults)) = with(&text, None) else { panic!("{row}") };
            (faults[0].place, faults[0].column.clone(), faults[0].detail.clone())
        };
        for (row, column, words) in [
            ("1.5,abc,0", "amplitude_v", "\"abc\" is no number"),
            ("1.5,12 mV,0", "amplitude_v", "no number"),
            ("1.5,-0.1,0", "amplitude_v", "a finite number above 0"),
            ("1.5,0,0", "amplitude_v", "a finite number above 0"),
            ("1.5,NaN,0", "amplitude_v", "is missing"),
            ("1.5,inf,0", "amplitude_v", "inf is refused"),
            ("0.5,0.1,0", "time_s", "before the time of the hit above"),
            (",0.1,0", "time_s", "is missing"),
            ("1.5,0.1", "", "has 2 fields; the header has 3"),
            ("1.5,0.1,0,7", "", "has 4 fields; the header has 3"),
        ] {
            let (line, at, detail) = fault(row);
            assert_eq!((line, at.as_str()), (5, column), "{row}");
            assert!(detail.contains(words), "{row}: {detail}");
        }
        let Err(FileError::Rows(all)) = with(&("amplitude_v\n".to_owned() + &"x\n".repeat(100)), None) else {
            panic!()
        };
        assert_eq!(all.len(), MOST_FAULTS);
    }

    #[test]
    fn what_is_no_table_is_said_to_be_none() {
        assert!(matches!(with("", None), Err(FileError::NoHeader(_))));
        assert!(matches!(with("1,2,3\n4,5,6\n", None), Err(FileError::NoHeader(_))));
        assert!(matches!(with("a\0b", None), Err(FileError::Malformed { .. })));
        assert!(matches!(with(&"x".repeat(2_000_000), None), Err(FileError::Malformed { .. })));
        let empty = with("time_s,amplitude_v\n", None).unwrap().into_catalogue(Default::default());
        assert!(matches!(empty, Err(FileError::Empty)));
    }

    proptest! {
        #[test]
        fn numbers_come_back_bit_for_bit(rows in prop::collection::vec((1e-6..10.0_f64, 0.0..1e4_f64), 1..50), separator in "[,;\t ]") {
            let mut text = format!("amplitude_v{separator}duration_us\n");
            for (amplitude, duration) in &rows {
                text += &format!("{amplitude}{separator}{duration}\n");
            }
            let reading = with(&text, None).unwrap();
            let (amplitudes, durations): (Vec<f64>, Vec<f64>) = rows.into_iter().unzip();
            prop_assert_eq!(column(&reading, Column::AmplitudeV), amplitudes);
            prop_assert_eq!(column(&reading, Column::DurationUs), durations);
        }

        #[test]
        fn no_bytes_make_it_panic(bytes: Vec<u8>, head in prop::bool::ANY) {
            let mut file = if head { b"time_s,amplitude_v,x_m\n".to_vec() } else { Vec::new() };
            file.extend(bytes);
            let _ = read(file.as_slice(), &ReadOptions::default());
        }

        #[test]
        fn nor_do_tables_that_are_nearly_good(text in "(time_s|AMP|x_m|,|;|\t| |\n|\"|1.5|-1|1e999|#){0,60}") {
            let _ = with(&text, Some(AmplitudeUnit::Volt));
        }
    }
}
