//! CSV of anybody, read by a mapping that its sender declares: which column is which variable, in which unit.

use std::collections::{BTreeMap, HashMap};

use jiff::civil::Date;
use serde::Deserialize;

use super::csv_source::{Lines, check_quotes};
use super::text::decode;
use super::{Flag, FlagCode, FormatError, Import, ImportedDay, ImportedRow, MAX_ROWS, RowError, RowErrorCode};
use crate::domain::avalanche::{AvalancheRecord, activity_from_name};
use crate::domain::problem::FieldError;
use crate::science::forecast::day::Variable;

/// The name that stands for the avalanche activity, in our words.
const ACTIVITY: &str = "avalanche_activity";

/// What the columns of a file are.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// Name of the column of the day.
    pub date: String,
    /// How the day is written: `YYYY-MM-DD` unless this says `DD/MM/YYYY`, `MM/DD/YYYY`, `DD.MM.YYYY` or `YYYYMMDD`.
    #[serde(default)]
    pub date_format: Option<String>,
    /// The other columns that are read, by their name.
    pub columns: BTreeMap<String, MappedColumn>,
    /// Texts that stand for missing, besides blank, `NA` and `null`.
    #[serde(default)]
    pub missing: Vec<String>,
}

/// What a column is.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappedColumn {
    /// Name of a variable, or `avalanche_activity`.
    pub variable: String,
    /// Its unit in the file; left out: ours.
    #[serde(default)]
    pub unit: Option<String>,
}

/// A mapping whose names and units are all known.
#[derive(Clone, Debug)]
pub struct CheckedMapping {
    date: String,
    order: DateOrder,
    columns: Vec<(String, Target)>,
    missing: Vec<String>,
}

#[derive(Clone, Copy, Debug)]
enum DateOrder {
    Iso,
    Compact,
    DayFirst(char),
    MonthFirst,
}

#[derive(Clone, Copy, Debug)]
enum Target {
    /// Ours is `value * factor + offset`.
    Value {
        variable: Variable,
        factor: f64,
        offset: f64,
    },
    Activity,
}

/// The units in which a variable can come, each with factor and offset to ours; the first is ours.
const fn units(variable: Variable) -> &'static [(&'static str, f64, f64)] {
    match variable {
        Variable::AirTemperature | Variable::SnowTemperature => {
            &[("degC", 1.0, 0.0), ("K", 1.0, -273.15), ("degF", 5.0 / 9.0, -160.0 / 9.0)]
        }
        Variable::WindSpeed => {
            &[("m/s", 1.0, 0.0), ("km/h", 1.0 / 3.6, 0.0), ("mph", 0.447_04, 0.0), ("kn", 1852.0 / 3600.0, 0.0)]
        }
        Variable::WindDirection => &[("deg", 1.0, 0.0), ("rad", 180.0 / std::f64::consts::PI, 0.0)],
        Variable::CloudCover => &[("%", 1.0, 0.0), ("fraction", 100.0, 0.0), ("okta", 12.5, 0.0)],
        Variable::SnowHeight | Variable::NewSnow24h | Variable::FootPenetration => {
            &[("cm", 1.0, 0.0), ("m", 100.0, 0.0), ("mm", 0.1, 0.0), ("in", 2.54, 0.0)]
        }
        Variable::Precipitation24h => {
            &[("mm", 1.0, 0.0), ("kg/m2", 1.0, 0.0), ("cm", 10.0, 0.0), ("m", 1000.0, 0.0), ("in", 25.4, 0.0)]
        }
        Variable::RainAt900m | Variable::SnowDrift => &[("bool", 1.0, 0.0)],
        Variable::NewSnowIndex | Variable::InsolationIndex | Variable::CumulativeSnowIndex => &[("1", 1.0, 0.0)],
    }
}

impl Mapping {
    /// Looks every name and unit up.
    ///
    /// # Errors
    /// A pointer below `/mapping` to each that is not known, with what is.
    pub fn check(self) -> Result<CheckedMapping, Vec<FieldError>> {
        let mut faults = Vec::new();
        let order = match self.date_format.as_deref() {
            None | Some("YYYY-MM-DD") => DateOrder::Iso,
            Some("YYYYMMDD") => DateOrder::Compact,
            Some("DD/MM/YYYY") => DateOrder::DayFirst('/'),
            Some("DD.MM.YYYY") => DateOrder::DayFirst('.'),
            Some("MM/DD/YYYY") => DateOrder::MonthFirst,
            Some(_) => {
                let detail = "must be YYYY-MM-DD, DD/MM/YYYY, MM/DD/YYYY, DD.MM.YYYY or YYYYMMDD";
                faults.push(FieldError::new("/mapping/date_format", "unknown_format", detail));
                DateOrder::Iso
            }
        };
        let mut columns: Vec<(String, Target)> = Vec::new();
        let mut named: HashMap<String, String> = HashMap::new();
        for (column, mapped) in self.columns {
            let pointer = format!("/mapping/columns/{}", column.replace('~', "~0").replace('/', "~1"));
            if let Some(other) = named.insert(mapped.variable.clone(), column.clone()) {
                let detail = format!("{} is column {other:?} already", mapped.variable);
                faults.push(FieldError::new(format!("{pointer}/variable"), "duplicate", detail));
            }
            match mapped.target() {
                Ok(target) => columns.push((column, target)),
                Err((member, code, detail)) => {
                    faults.push(FieldError::new(format!("{pointer}/{member}"), code, detail))
                }
            }
        }
        if columns.is_empty() && faults.is_empty() {
            faults.push(FieldError::new("/mapping/columns", "required", "must name at least one column"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        Ok(CheckedMapping { date: self.date, order, columns, missing: self.missing })
    }
}

impl MappedColumn {
    fn target(&self) -> Result<Target, (&'static str, &'static str, String)> {
        if self.variable == ACTIVITY {
            return match self.unit {
                None => Ok(Target::Activity),
                Some(_) => Err(("unit", "unknown_unit", "must be left out: an activity has no unit".to_owned())),
            };
        }
        let variable = Variable::from_name(&self.variable).ok_or_else(|| {
            let known: Vec<&str> = Variable::ALL.iter().map(|variable| variable.name()).chain([ACTIVITY]).collect();
            ("variable", "unknown_variable", format!("must be one of {}", known.join(", ")))
        })?;
        let units = units(variable);
        let unit = self.unit.as_deref().unwrap_or(units[0].0);
        let (_, factor, offset) = units.iter().find(|(name, ..)| *name == unit).ok_or_else(|| {
            let known: Vec<&str> = units.iter().map(|(name, ..)| *name).collect();
            ("unit", "unknown_unit", format!("{} can come in {}, not in {unit:?}", self.variable, known.join(", ")))
        })?;
        Ok(Target::Value { variable, factor: *factor, offset: *offset })
    }
}

/// Reads days. A value outside of its range, or that cannot be read, becomes missing with a flag; a row is refused where its date
/// cannot be read, where an earlier row has the same day, or where it has not as many fields as the header.
///
/// # Errors
/// [`FormatError`] for a file that is empty, not text or not CSV, without a column of the mapping, or of more than [`MAX_ROWS`] rows.
pub fn read(bytes: &[u8], mapping: &CheckedMapping) -> Result<Import, FormatError> {
    let text = decode(bytes)?;
    check_quotes(&text)?;
    let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(text.as_bytes());
    let mut lines = Lines::of(&text);
    let mut record = csv::StringRecord::new();
    let mut header: Option<Places> = None;
    let mut seen = HashMap::new();
    let mut import = Import::default();
    // the text is UTF-8 in memory and rows may be ragged, so reading cannot fail
    while reader.read_record(&mut record).unwrap_or(false) {
        let start = record.position().map_or(0, csv::Position::byte);
        let line = lines.source_at(usize::try_from(start).unwrap_or(usize::MAX)).line;
        if record.iter().all(|field| field.trim().is_empty()) {
            continue;
        }
        let Some(places) = &header else {
            header = Some(Places::of(&record, line, mapping)?);
            continue;
        };
        if import.rows.len() == MAX_ROWS {
            return Err(FormatError::TooManyRows { line });
        }
        let (date, outcome) = places.read_row(&record, line, mapping, &mut seen);
        import.rows.push(ImportedRow { line, date, outcome });
    }
    let places = header.ok_or(FormatError::Empty)?;
    import.ignored_columns = places.ignored;
    let days = || import.rows.iter().filter_map(|row| row.outcome.as_ref().ok());
    for (_, target) in &mapping.columns {
        if let Target::Value { variable, .. } = target
            && days().next().is_some()
            && days().all(|day| day.values[variable.index()].is_none())
        {
            import.not_reported.push(variable.name().to_owned());
        }
    }
    Ok(import)
}

/// Where in a row the mapped columns are.
struct Places {
    fields: usize,
    date: usize,
    columns: Vec<(usize, Target)>,
    ignored: Vec<String>,
}

impl Places {
    fn of(header: &csv::StringRecord, line: u64, mapping: &CheckedMapping) -> Result<Self, FormatError> {
        let names: Vec<&str> = header.iter().map(str::trim).collect();
        let find = |name: &str| {
            let mut places = (0..names.len()).filter(|&at| names[at] == name);
            let detail = match (places.next(), places.next()) {
                (Some(at), None) => return Ok(at),
                (None, _) => format!("the header has no column {name:?}, which the mapping names"),
                (Some(_), Some(_)) => format!("the header has two columns {name:?}"),
            };
            Err(FormatError::Header { line, detail })
        };
        let date = find(&mapping.date)?;
        let columns: Vec<(usize, Target)> = mapping
            .columns
            .iter()
            .map(|(name, target)| Ok((find(name)?, *target)))
            .collect::<Result<_, FormatError>>()?;
        let is_read = |at: usize| at == date || columns.iter().any(|(place, _)| *place == at);
        let ignored = (0..names.len()).filter(|&at| !is_read(at)).map(|at| names[at].chars().take(40).collect());
        Ok(Self { fields: names.len(), date, ignored: ignored.collect(), columns })
    }

    fn read_row(
        &self,
        record: &csv::StringRecord,
        line: u64,
        mapping: &CheckedMapping,
        seen: &mut HashMap<Date, u64>,
    ) -> (Option<Date>, Result<ImportedDay, RowError>) {
        let refuse = |field: Option<&str>, code, detail| {
            Err(RowError { line, column: None, field: field.map(str::to_owned), code, detail })
        };
        if record.len() != self.fields {
            let detail = format!("{} fields where the header has {}", record.len(), self.fields);
            return (None, refuse(None, RowErrorCode::RaggedRow, detail));
        }
        let Some(date) = mapping.order.read(record.get(self.date).unwrap_or_default().trim()) else {
            let detail = format!("the date must be written {}", mapping.order.name());
            return (None, refuse(Some("date"), RowErrorCode::UnreadableDate, detail));
        };
        if let Some(earlier) = seen.get(&date) {
            let detail = format!("line {earlier} already reports {date}: keep one of them");
            return (Some(date), refuse(Some("date"), RowErrorCode::DuplicateDay, detail));
        }
        seen.insert(date, line);
        let mut day = ImportedDay::default();
        for &(at, target) in &self.columns {
            let field = record.get(at).unwrap_or_default().trim();
            let blank = field.is_empty() || field.eq_ignore_ascii_case("na") || field.eq_ignore_ascii_case("null");
            if !blank && !mapping.missing.iter().any(|missing| missing == field) {
                target.read(&mut day, field);
            }
        }
        (Some(date), Ok(day))
    }
}

impl Target {
    fn read(self, day: &mut ImportedDay, field: &str) {
        let given = || field.chars().take(40).collect::<String>();
        let mut unreadable = |name: &str, accepted: &str| {
            let detail = format!("must be {accepted}, or blank where it is missing; kept as missing");
            day.flags.push(Flag { field: name.into(), code: FlagCode::Unreadable, value: given(), detail });
        };
        match self {
            Self::Activity => match activity_from_name(&field.to_ascii_lowercase()) {
                Some(activity) => day.set_avalanche(AvalancheRecord::of(activity)),
                None => unreadable(ACTIVITY, "observed, presumed, none or unknown"),
            },
            Self::Value { variable, factor, offset } => {
                let word = field.to_ascii_lowercase();
                let number = match word.as_str() {
                    "true" | "yes" if variable.is_boolean() => Some(1.0),
                    "false" | "no" if variable.is_boolean() => Some(0.0),
                    _ => field.parse::<f64>().ok().filter(|number| number.is_finite()),
                };
                match number {
                    Some(number) => day.set_checked(variable, rounded(number, factor, offset), given()),
                    None if variable.is_boolean() => unreadable(variable.name(), "true or false"),
                    None => unreadable(variable.name(), "a number"),
                }
            }
        }
    }
}

/// `number * factor + offset`, without the dust of binary fractions: 271.15 K are -2 degC and not -1.999999999999943.
fn rounded(number: f64, factor: f64, offset: f64) -> f64 {
    if (factor, offset) == (1.0, 0.0) {
        return number;
    }
    let value = number * factor + offset;
    let short = (value * 1e6).round() / 1e6;
    if (value - short).abs() < 1e-9 { short } else { value }
}

impl DateOrder {
    const fn name(self) -> &'static str {
        match self {
            Self::Iso => "YYYY-MM-DD, like 2007-03-01",
            Self::Compact => "YYYYMMDD, like 20070301",
            Self::DayFirst('/') => "DD/MM/YYYY, like 01/03/2007",
            Self::DayFirst(_) => "DD.MM.YYYY, like 01.03.2007",
            Self::MonthFirst => "MM/DD/YYYY, like 03/01/2007",
        }
    }

    fn read(self, text: &str) -> Option<Date> {
        let number = |text: &str, digits: std::ops::RangeInclusive<usize>| -> Option<i16> {
            let plain = digits.contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
            plain.then(|| text.parse().ok()).flatten()
        };
        let parts = |year: &str, month: &str, day: &str| {
            let (month, day) = (i8::try_from(number(month, 1..=2)?).ok()?, i8::try_from(number(day, 1..=2)?).ok()?);
            Date::new(number(year, 4..=4)?, month, day).ok()
        };
        let split = |sign: char| -> Option<[&str; 3]> { text.split(sign).collect::<Vec<_>>().try_into().ok() };
        match self {
            Self::Iso => split('-').and_then(|[year, month, day]| parts(year, month, day)),
            Self::Compact if text.len() == 8 && text.is_ascii() => parts(&text[..4], &text[4..6], &text[6..]),
            Self::Compact => None,
            Self::DayFirst(sign) => split(sign).and_then(|[day, month, year]| parts(year, month, day)),
            Self::MonthFirst => split('/').and_then(|[month, day, year]| parts(year, month, day)),
        }
    }
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;
    use serde_json::json;

    use super::*;

    fn mapping(value: serde_json::Value) -> Result<CheckedMapping, Vec<FieldError>> {
        serde_json::from_value::<Mapping>(value).unwrap().check()
    }

    fn pointers(value: serde_json::Value) -> Vec<String> {
        mapping(value).unwrap_err().into_iter().map(|fault| fault.pointer).collect()
    }

    #[test]
    fn columns_come_in_their_units() {
        let mapping =
            mapping(json!({"date": "Day", "date_format": "DD/MM/YYYY", "missing": ["-", "-9999"], "columns": {
            "T": {"variable": "air_temperature", "unit": "degF"}, "ff": {"variable": "wind_speed", "unit": "kn"},
            "dd": {"variable": "wind_direction"}, "n": {"variable": "cloud_cover", "unit": "okta"},
            "hs": {"variable": "snow_height", "unit": "in"}, "TS": {"variable": "snow_temperature", "unit": "K"},
            "blow": {"variable": "snow_drift"}, "aval": {"variable": "avalanche_activity"}}}))
            .unwrap();
        let text = "Day,T,ff,dd,n,hs,TS,blow,aval,who\n01/03/2007,14,10,270,8,40,271.15,yes,Observed,x\n2/3/2007,-,-9999,,9,a,300,no,,x\n";
        let import = read(text.as_bytes(), &mapping).unwrap();
        let day = import.rows[0].outcome.as_ref().unwrap();
        assert_eq!(import.rows[0].date, Some(date(2007, 3, 1)));
        let value = |variable: Variable| day.values[variable.index()];
        // 14 F are -10 C; 10 knots are 5.1444 m/s; 8 oktas are all; 40 inches are 101.6 cm
        assert_eq!((value(Variable::AirTemperature), value(Variable::CloudCover)), (Some(-10.0), Some(100.0)));
        assert!((value(Variable::WindSpeed).unwrap() - 5.144_444_444).abs() < 1e-9);
        assert_eq!((value(Variable::SnowHeight), value(Variable::SnowTemperature)), (Some(101.6), Some(-2.0)));
        assert_eq!((value(Variable::SnowDrift), value(Variable::WindDirection)), (Some(1.0), Some(270.0)));
        assert!(day.avalanche.is_some() && day.flags.is_empty());
        let second = import.rows[1].outcome.as_ref().unwrap();
        let flags: Vec<_> = second.flags.iter().map(|flag| (flag.field.as_str(), flag.code)).collect();
        assert_eq!(
            flags,
            [
                ("snow_temperature", FlagCode::OutOfRange),
                ("snow_height", FlagCode::Unreadable),
                ("cloud_cover", FlagCode::OutOfRange),
            ]
        );
        assert_eq!(second.values.iter().flatten().count(), 1);
        assert_eq!(import.ignored_columns, ["who"]);
    }

    #[test]
    fn what_a_mapping_does_not_know_is_pointed_at() {
        let of = |column: serde_json::Value| json!({"date": "d", "columns": {"a/b": column}});
        assert_eq!(
            pointers(of(json!({"variable": "wind_speed", "unit": "furlong/fortnight"}))),
            ["/mapping/columns/a~1b/unit"]
        );
        assert_eq!(pointers(of(json!({"variable": "air_temperature", "unit": "m"}))), ["/mapping/columns/a~1b/unit"]);
        assert_eq!(pointers(of(json!({"variable": "pressure"}))), ["/mapping/columns/a~1b/variable"]);
        assert_eq!(
            pointers(of(json!({"variable": "avalanche_activity", "unit": "1"}))),
            ["/mapping/columns/a~1b/unit"]
        );
        assert_eq!(pointers(json!({"date": "d", "columns": {}})), ["/mapping/columns"]);
        let twice = json!({"date": "d", "date_format": "YY", "columns": {"a": {"variable": "wind_speed"}, "b": {"variable": "wind_speed"}}});
        assert_eq!(pointers(twice), ["/mapping/date_format", "/mapping/columns/b/variable"]);
        let fault = mapping(of(json!({"variable": "wind_speed", "unit": "Bft"}))).unwrap_err().remove(0);
        assert!(fault.detail.contains("m/s, km/h, mph, kn"), "{}", fault.detail);
    }

    #[test]
    fn files_that_do_not_fit_are_refused() {
        let mapping = mapping(json!({"date": "d", "columns": {"t": {"variable": "air_temperature"}}})).unwrap();
        let said = |text: &str| read(text.as_bytes(), &mapping).unwrap_err().to_string();
        assert!(said("d,x\n").contains("no column \"t\"") && said("d,t,t\n").contains("two columns"));
        assert_eq!(read(b"", &mapping).unwrap_err(), FormatError::Empty);
        let rows = read(b"d,t\n2007-03-01,1\n2007-03-01,2\n1.3.2007,1\n2007-03-02\n", &mapping).unwrap().rows;
        let codes: Vec<_> = rows.iter().filter_map(|row| row.outcome.as_ref().err().map(|error| error.code)).collect();
        assert_eq!(codes, [RowErrorCode::DuplicateDay, RowErrorCode::UnreadableDate, RowErrorCode::RaggedRow]);
        for (order, text) in [
            (DateOrder::MonthFirst, "03/01/2007"),
            (DateOrder::DayFirst('.'), "1.3.2007"),
            (DateOrder::Compact, "20070301"),
            (DateOrder::Iso, "2007-03-01"),
        ] {
            assert_eq!(order.read(text), Some(date(2007, 3, 1)), "{text}");
            assert_eq!(order.read("2007/30/02"), None);
            assert_eq!(order.read("\u{e9}\u{e9}\u{e9}\u{e9}"), None);
        }
    }
}
