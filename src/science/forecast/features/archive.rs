//! The decoded archive of Lochaber 1993/94 to 2006/07 for tests; it lies outside the project.

use std::path::PathBuf;

use jiff::civil::Date;

use crate::forecast::day::{Activity, DayRecord, Variable};

/// Columns of the decoded file, the variable each becomes and the factor to its unit.
const COLUMNS: [(&str, Variable, f64); 11] = [
    ("air_temp_c", Variable::AirTemperature, 1.0),
    ("wind_dir_deg", Variable::WindDirection, 1.0),
    ("wind_speed_mph", Variable::WindSpeed, 0.447_04),
    ("cloud_pct", Variable::CloudCover, 1.0),
    ("drift", Variable::SnowDrift, 1.0),
    ("foot_pen_cm", Variable::FootPenetration, 1.0),
    ("rain_900", Variable::RainAt900m, 1.0),
    ("no_settle", Variable::CumulativeSnowIndex, 1.0),
    ("snow_index", Variable::NewSnowIndex, 1.0),
    ("insolation", Variable::InsolationIndex, 1.0),
    ("snow_temp_c", Variable::SnowTemperature, 1.0),
];

/// The variables that the archive reports: the ten of the service and the exported cumulative index.
pub(crate) const REPORTED: [Variable; 11] = [
    Variable::AirTemperature,
    Variable::WindSpeed,
    Variable::WindDirection,
    Variable::CloudCover,
    Variable::NewSnowIndex,
    Variable::RainAt900m,
    Variable::SnowDrift,
    Variable::FootPenetration,
    Variable::SnowTemperature,
    Variable::InsolationIndex,
    Variable::CumulativeSnowIndex,
];

/// The 1,582 days of the archive, or `None`, said aloud, where the file is absent.
pub(crate) fn lochaber() -> Option<Vec<DayRecord>> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("FIRN_SHARED_DATA").map_or_else(beside, PathBuf::from);
    let path = folder.join("sais_lochaber_1993-2007_decoded.csv");
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("skipped: {} is absent", path.display());
        return None;
    };
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = |name: &str| header.iter().position(|&column| column == name).unwrap();
    let columns = COLUMNS.map(|(name, variable, factor)| (at(name), variable, factor));
    let (observed, presumed) = (at("aval_observed"), at("aval_presumed"));
    let day = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        let mut day = DayRecord::empty(fields[at("date")].parse::<Date>().unwrap());
        for (column, variable, factor) in columns {
            day.values[variable.index()] = match fields[column] {
                "" => None,
                number => Some(number.parse::<f64>().unwrap() * factor),
            };
        }
        day.activity = match (fields[observed], fields[presumed]) {
            ("1", _) => Activity::Observed,
            (_, "1") => Activity::Presumed,
            ("0", "0") => Activity::None,
            _ => Activity::Unknown,
        };
        day
    };
    Some(lines.map(day).collect())
}
