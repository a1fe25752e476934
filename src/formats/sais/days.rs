//! From the fields of a row to the values of a day.

use jiff::civil::{Date, date};

use super::Profile;
use super::codes::{self, Field, Negative, shown};
use super::columns::{Column, Columns};
use super::regimes::{self, Temperature};
use super::rows::Row;
use crate::domain::units::bounds;
use crate::formats::{Flag, FlagCode, ImportedDay};
use crate::science::forecast::day::Variable;

/// The exact length of the international mile, 1609.344 m, in an hour.
const METRES_PER_SECOND_OF_MPH: f64 = 0.44704;

/// First day of the winter in which Wind Speed and Wind Dir moved from the summit to the pit site, and in which Precip
/// Code took the place of Snow Index.
const WINTER_OF_CHANGES: Date = date(2007, 7, 1);

/// Columns that need nothing but their bounds.
const PLAIN: [(Column, Variable); 6] = [
    (Column::Cloud, Variable::CloudCover),
    (Column::RainAt900, Variable::RainAt900m),
    (Column::Drift, Variable::SnowDrift),
    (Column::FootPen, Variable::FootPenetration),
    (Column::Insolation, Variable::InsolationIndex),
    (Column::NoSettle, Variable::CumulativeSnowIndex),
];

/// Reads rows of one file: what a row means depends on its area and on which columns the whole file fills in.
pub(super) struct Reader<'c> {
    columns: &'c Columns,
    area: Option<&'c str>,
    snow_depth_reported: bool,
    summit_wind_reported: bool,
    assumed: Assumed,
}

/// Rows for which something was assumed.
#[derive(Default)]
struct Assumed {
    tenths_of_air: usize,
    tenths_of_snow: usize,
    pit_wind: usize,
}

impl<'c> Reader<'c> {
    /// A reader for the rows of `area` in a file with those `profiles`.
    pub(super) fn new<'p, 'a: 'p>(
        columns: &'c Columns,
        area: Option<&'c str>,
        profiles: impl Iterator<Item = &'p Profile<'a>>,
    ) -> Self {
        let (mut snow_depth_reported, mut summit_wind_reported) = (false, false);
        for profile in profiles {
            let filled = |column| is_filled(columns.text(&profile.row.fields, column));
            snow_depth_reported |= filled(Column::TotalSnowDepth);
            summit_wind_reported |= profile.local.is_some_and(|local| local.date() >= WINTER_OF_CHANGES)
                && (filled(Column::SummitWindSpeed) || filled(Column::SummitWindDir));
        }
        Self { columns, area, snow_depth_reported, summit_wind_reported, assumed: Assumed::default() }
    }

    /// Columns that say nothing in any of `profiles`.
    pub(super) fn not_reported<'p, 'a: 'p>(
        &self,
        profiles: impl Iterator<Item = &'p Profile<'a>> + Clone,
    ) -> Vec<String> {
        if profiles.clone().next().is_none() {
            return Vec::new();
        }
        let never = |column, says: fn(&str) -> bool| {
            !profiles.clone().any(|profile| says(self.columns.text(&profile.row.fields, column)))
        };
        let optional = self.columns.optional().filter(|(column, _)| never(*column, is_filled));
        let ordinary = self.columns.ordinary().filter(|(column, _)| never(*column, is_present));
        optional.chain(ordinary).map(|(_, name)| name.to_owned()).collect()
    }

    /// What was assumed about the rows read until now, for people.
    pub(super) fn notes(&self) -> Vec<String> {
        let Assumed { tenths_of_air, tenths_of_snow, pit_wind } = self.assumed;
        let area = self.area.map_or(String::new(), |area| format!(" of {area}"));
        let said = [
            (tenths_of_air, format!("Air Temp{area} was read as tenths of a degree on {tenths_of_air} rows")),
            (tenths_of_snow, format!("Snow Temp{area} was read as tenths of a degree on {tenths_of_snow} rows")),
            (
                pit_wind,
                format!(
                    "from 2007/08 on, the wind of {pit_wind} rows was measured at the pit site: no summit wind was reported"
                ),
            ),
        ];
        said.into_iter().filter(|(rows, _)| *rows > 0).map(|(_, note)| note).collect()
    }

    /// The day that a row reports.
    pub(super) fn day(&mut self, row: &Row<'_>, date: Date) -> ImportedDay {
        let mut day = ImportedDay::default();
        self.temperature(&mut day, row, date, Temperature::Air);
        self.wind(&mut day, row, date);
        for (column, variable) in PLAIN {
            self.plain(&mut day, row, column, variable, 1.0);
        }
        if self.snow_depth_reported {
            self.plain(&mut day, row, Column::TotalSnowDepth, Variable::SnowHeight, 1.0);
        }
        self.new_snow(&mut day, row, date);
        self.temperature(&mut day, row, date, Temperature::Snow);
        self.avalanches(&mut day, row);
        day
    }

    /// A quantity that cannot be negative, times `factor`.
    fn plain(&self, day: &mut ImportedDay, row: &Row<'_>, column: Column, variable: Variable, factor: f64) {
        let text = self.columns.text(&row.fields, column);
        match codes::number(text, Negative::Impossible) {
            Field::Missing => {}
            Field::Number(value) => day.set_checked(variable, value * factor, shown(text)),
            Field::Unreadable => unreadable(day, variable, text),
        }
    }

    fn temperature(&mut self, day: &mut ImportedDay, row: &Row<'_>, date: Date, what: Temperature) {
        let (column, variable) = match what {
            Temperature::Air => (Column::AirTemp, Variable::AirTemperature),
            Temperature::Snow => (Column::SnowTemp, Variable::SnowTemperature),
        };
        let text = self.columns.text(&row.fields, column);
        let exported = match codes::number(text, Negative::Possible) {
            Field::Missing => return,
            Field::Unreadable => return unreadable(day, variable, text),
            Field::Number(exported) => exported,
        };
        let Some(unit) = regimes::unit_of(what, self.area, date) else {
            let detail =
                "tenths or whole degrees, depending on the area, which is not given; kept as missing".to_owned();
            return flag(day, variable, FlagCode::UnknownUnit, shown(text), detail);
        };
        let tenths = match what {
            Temperature::Air => &mut self.assumed.tenths_of_air,
            Temperature::Snow => &mut self.assumed.tenths_of_snow,
        };
        *tenths += usize::from(unit.is_tenths());
        day.set_checked(variable, unit.degrees(exported), shown(text));
    }

    /// Speed and direction of one place: the summit, as long as it was reported.
    fn wind(&mut self, day: &mut ImportedDay, row: &Row<'_>, date: Date) {
        let (mut speed, mut direction) = (Column::WindSpeed, Column::WindDir);
        let filled = |column| is_filled(self.columns.text(&row.fields, column));
        let pit = [speed, direction].into_iter().any(|column| is_present(self.columns.text(&row.fields, column)));
        if date >= WINTER_OF_CHANGES && self.summit_wind_reported {
            // calm air at exactly 0 degC from exactly north is an empty form
            let summit = [Column::SummitWindSpeed, Column::SummitWindDir, Column::SummitAirTemp];
            if summit.into_iter().any(filled) {
                (speed, direction) = (Column::SummitWindSpeed, Column::SummitWindDir);
            } else if pit {
                let detail = "no summit wind on this row: the wind is that of the pit site".to_owned();
                flag(day, Variable::WindSpeed, FlagCode::OtherSite, String::new(), detail);
            }
        } else if date >= WINTER_OF_CHANGES && pit {
            self.assumed.pit_wind += 1;
        }
        self.plain(day, row, speed, Variable::WindSpeed, METRES_PER_SECOND_OF_MPH);
        self.plain(day, row, direction, Variable::WindDirection, 1.0);
    }

    fn new_snow(&self, day: &mut ImportedDay, row: &Row<'_>, date: Date) {
        let variable = Variable::NewSnowIndex;
        let index_text = self.columns.text(&row.fields, Column::SnowIndex);
        let code_text = self.columns.text(&row.fields, Column::PrecipCode);
        let index = codes::number(index_text, Negative::Impossible);
        let code = codes::precipitation(code_text);
        let changed = date >= WINTER_OF_CHANGES;
        if let (Field::Number(index), Field::Number(code)) = (index, code) {
            // a 0 in the column that is not in use fills it
            let unused = if changed { index } else { code };
            if unused != 0.0 && index != code {
                let kept = if changed { "Precip Code" } else { "Snow Index" };
                let value = format!("Snow Index {index}, Precip Code {code}");
                flag(day, variable, FlagCode::ColumnsDisagree, value, format!("{kept} was kept"));
            }
        }
        let in_use = if changed { (code, code_text) } else { (index, index_text) };
        let other = if changed { (index, index_text) } else { (code, code_text) };
        let (field, text) = if in_use.0 == Field::Missing { other } else { in_use };
        match field {
            Field::Missing => {}
            Field::Unreadable => unreadable(day, variable, text),
            Field::Number(0.0) if changed && in_use.0 == Field::Missing => {
                let detail = "Snow Index is 0 where Precip Code took its place; kept as missing".to_owned();
                flag(day, variable, FlagCode::NotReported, shown(text), detail);
            }
            Field::Number(value) => day.set_checked(variable, value, shown(text)),
        }
    }

    fn avalanches(&self, day: &mut ImportedDay, row: &Row<'_>) {
        if !self.columns.has(Column::AvalancheCode) {
            return;
        }
        let text = self.columns.text(&row.fields, Column::AvalancheCode);
        let decoded = codes::avalanche(text);
        if !decoded.documented {
            day.flags.push(Flag {
                field: "avalanche_activity".to_owned(),
                code: FlagCode::UnknownCode,
                value: shown(text),
                detail: "codes are 0, N0TT, and 44, 88 or 99 with up to two digits; kept as unknown".to_owned(),
            });
        }
        day.set_avalanche(decoded.record);
    }
}

/// Whether a field of an optional column holds more than a filler: anything but 0 and missing.
fn is_filled(text: &str) -> bool {
    !matches!(codes::number(text, Negative::Possible), Field::Missing | Field::Number(0.0 | -1.0))
}

/// Whether a field holds anything, 0 included.
fn is_present(text: &str) -> bool {
    codes::number(text, Negative::Possible) != Field::Missing
}

fn unreadable(day: &mut ImportedDay, variable: Variable, text: &str) {
    let detail = format!("must be a number {}, or blank where it is missing; kept as missing", bounds(variable));
    flag(day, variable, FlagCode::Unreadable, shown(text), detail);
}

fn flag(day: &mut ImportedDay, variable: Variable, code: FlagCode, value: String, detail: String) {
    day.flags.push(Flag { field: variable.name().to_owned(), code, value, detail });
}
