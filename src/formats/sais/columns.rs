//! The header of the export: columns by name, in any order, some missing.

use super::rows::Field;
use crate::formats::FormatError;
use crate::formats::text::place;

/// A column that the reader knows by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Column {
    Date,
    Area,
    AirTemp,
    WindDir,
    WindSpeed,
    Cloud,
    PrecipCode,
    Drift,
    TotalSnowDepth,
    FootPen,
    RainAt900,
    SummitAirTemp,
    SummitWindDir,
    SummitWindSpeed,
    AvalancheCode,
    NoSettle,
    SnowIndex,
    Insolation,
    SnowTemp,
    Comments,
    Alt,
    Aspect,
    Incline,
    SkiPen,
    MaxTempGrad,
    MaxHardnessGrad,
    Crystals,
    Wetness,
}

use Column as C;

/// What is done with a column.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Use {
    /// Its values are read.
    Read,
    /// Its values are read; a column of nothing but 0 was never filled in.
    Optional,
    /// It is not read, but it is said whether it was filled in.
    Unread,
    /// It is not read and never repeated.
    Private,
}

const KNOWN: [(Column, &str, Use); 28] = [
    (C::Date, "Date", Use::Read),
    (C::Area, "Area", Use::Read),
    (C::AirTemp, "Air Temp", Use::Read),
    (C::WindDir, "Wind Dir", Use::Read),
    (C::WindSpeed, "Wind Speed", Use::Read),
    (C::Cloud, "Cloud", Use::Read),
    (C::PrecipCode, "Precip Code", Use::Read),
    (C::Drift, "Drift", Use::Read),
    (C::TotalSnowDepth, "Total Snow Depth", Use::Optional),
    (C::FootPen, "Foot Pen", Use::Read),
    (C::RainAt900, "Rain at 900", Use::Read),
    (C::SummitAirTemp, "Summit Air Temp", Use::Unread),
    (C::SummitWindDir, "Summit Wind Dir", Use::Optional),
    (C::SummitWindSpeed, "Summit Wind Speed", Use::Optional),
    (C::AvalancheCode, "Avalanche Code", Use::Read),
    (C::NoSettle, "No Settle", Use::Read),
    (C::SnowIndex, "Snow Index", Use::Read),
    (C::Insolation, "Insolation", Use::Read),
    (C::SnowTemp, "Snow Temp", Use::Read),
    (C::Comments, "Comments", Use::Private),
    (C::Alt, "Alt", Use::Unread),
    (C::Aspect, "Aspect", Use::Unread),
    (C::Incline, "Incline", Use::Unread),
    (C::SkiPen, "Ski Pen", Use::Unread),
    (C::MaxTempGrad, "Max Temp Grad", Use::Unread),
    (C::MaxHardnessGrad, "Max Hardness Grad", Use::Unread),
    (C::Crystals, "Crystals", Use::Unread),
    (C::Wetness, "Wetness", Use::Unread),
];

/// Columns that a file may have.
const MOST_COLUMNS: usize = 500;

/// Where each column stands in this file.
#[derive(Debug)]
pub(super) struct Columns {
    at: [Option<usize>; KNOWN.len()],
    /// Names of columns nobody reads, as given.
    unknown: Vec<String>,
    /// Fields of the header, nameless ones at the end included.
    width: usize,
    /// Fewest fields of a complete row: all columns with a name, without the comments if they are last.
    pub(super) fewest: usize,
}

impl Columns {
    /// Reads the header, whose text is `header`, on line `line`.
    pub(super) fn read(header: &str, fields: &[Field<'_>], line: u64) -> Result<Self, FormatError> {
        // the export has 35; each name of a longer header would be held against all before it
        if fields.len() > MOST_COLUMNS {
            return Err(FormatError::TooManyColumns { line, most: MOST_COLUMNS });
        }
        let mut columns = Self { at: [None; KNOWN.len()], unknown: Vec::new(), width: fields.len(), fewest: 0 };
        for (position, field) in fields.iter().enumerate() {
            let name = field.text.split_whitespace().collect::<Vec<_>>().join(" ");
            if name.is_empty() {
                continue;
            }
            columns.fewest = position + 1;
            let known = KNOWN.iter().find(|(_, known, _)| known.eq_ignore_ascii_case(&name));
            let twice = match known {
                Some((column, ..)) => columns.at[*column as usize].replace(position).is_some(),
                None => columns.unknown.contains(&name),
            };
            if twice {
                let (line, column) = place(header, field.at, line);
                return Err(FormatError::DuplicateColumn { line, column, name: name.chars().take(40).collect() });
            }
            if known.is_none() {
                columns.unknown.push(name);
            }
        }
        // a table of another origin has a date too, and would replace good days with empty ones
        let known = columns.at.iter().flatten().count();
        let foreign = columns.unknown.len() > known && !columns.has(C::Area);
        let missing = if columns.has(C::Date) { foreign.then_some("Area") } else { Some("Date") };
        if let Some(column) = missing {
            let expected = "the names of the export: Date, Area, Air Temp, Wind Dir, Wind Speed ...".to_owned();
            return Err(FormatError::MissingColumn { line, column, expected });
        }
        columns.fewest -= usize::from(columns.position(C::Comments) == Some(columns.fewest - 1));
        Ok(columns)
    }

    /// Whether the file has the column.
    pub(super) const fn has(&self, column: Column) -> bool {
        self.position(column).is_some()
    }

    /// A field of a row; commas in the comments do not shift what stands behind them.
    pub(super) fn field<'r, 'a>(&self, row: &'r [Field<'a>], column: Column) -> Option<&'r Field<'a>> {
        let position = self.position(column)?;
        let behind_comments = self.position(C::Comments).is_some_and(|comments| position > comments);
        let surplus = if behind_comments { row.len().saturating_sub(self.width) } else { 0 };
        row.get(position + surplus)
    }

    /// The text of a field; nothing where the file has no such column.
    pub(super) fn text<'a>(&self, row: &[Field<'a>], column: Column) -> &'a str {
        self.field(row, column).map_or("", |field| field.text)
    }

    /// The first field of a row that has no column: commas in comments and nameless blanks are none.
    pub(super) fn surplus<'r, 'a>(&self, row: &'r [Field<'a>]) -> Option<&'r Field<'a>> {
        if self.has(C::Comments) {
            return None;
        }
        row.iter().skip(self.width).find(|field| !field.text.trim().is_empty())
    }

    /// Columns of this file whose 0 on every row says that nobody filled them in.
    pub(super) fn optional(&self) -> impl Iterator<Item = (Column, &'static str)> + '_ {
        self.used(|used| matches!(used, Use::Optional | Use::Unread))
    }

    /// Columns of this file whose values are read and mean what they say, 0 included.
    pub(super) fn ordinary(&self) -> impl Iterator<Item = (Column, &'static str)> + '_ {
        self.used(|used| used == Use::Read)
            .filter(|(column, _)| !matches!(column, C::Date | C::Area | C::AvalancheCode))
    }

    /// Names of the columns of this file that are not read.
    pub(super) fn ignored(&self) -> impl Iterator<Item = &str> {
        let unread = self.used(|used| matches!(used, Use::Unread | Use::Private)).map(|(_, name)| name);
        unread.chain(self.unknown.iter().map(String::as_str))
    }

    fn used(&self, wanted: impl Fn(Use) -> bool) -> impl Iterator<Item = (Column, &'static str)> {
        let here = KNOWN.iter().filter(move |(column, _, used)| self.has(*column) && wanted(*used));
        here.map(|(column, name, _)| (*column, *name))
    }

    const fn position(&self, column: Column) -> Option<usize> {
        self.at[column as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::super::rows::split;
    use super::*;

    fn columns(header: &str) -> Result<Columns, FormatError> {
        Columns::read(header, &split(header).fields, 1)
    }

    #[test]
    fn the_table_is_in_the_order_of_the_columns() {
        for (position, (column, ..)) in KNOWN.iter().enumerate() {
            assert_eq!(*column as usize, position);
        }
    }

    #[test]
    fn names_are_found_with_spaces_in_any_order() {
        let found = columns("Comments, AREA,  air  temp,Date,Obs").unwrap();
        let row = split("stormy, cold,Lochaber,-3,05/01/2004,XY").fields;
        assert_eq!(found.text(&row, C::AirTemp), "-3");
        assert_eq!(found.text(&row, C::Date), "05/01/2004");
        assert_eq!(found.text(&row, C::Cloud), "");
        assert_eq!(found.ignored().collect::<Vec<_>>(), ["Comments", "Obs"]);
    }

    #[test]
    fn commas_in_trailing_comments_are_no_surplus() {
        let found = columns("Date, Area, Cloud, Comments,").unwrap();
        assert_eq!(found.fewest, 3);
        let row = split("05/01/2004,Lochaber,90,wind slab on NE, deep \"stuff\",").fields;
        assert_eq!(found.text(&row, C::Cloud), "90");
        assert_eq!(found.surplus(&row), None);
        let found = columns("Date,Area,Cloud").unwrap();
        assert_eq!(found.surplus(&split("05/01/2004,Lochaber,90,,").fields), None);
        let row = split("05/01/2004,Lochaber,90,7").fields;
        assert_eq!(found.surplus(&row).map(|field| field.at), Some(23));
    }

    #[test]
    fn a_header_of_another_table_or_with_a_column_twice_is_refused() {
        let other = columns("date,season,air_temp_c,snow_temp_c").unwrap_err();
        assert!(matches!(other, FormatError::MissingColumn { line: 1, column: "Area", .. }), "{other}");
        assert!(matches!(columns("Area,Cloud"), Err(FormatError::MissingColumn { line: 1, column: "Date", .. })));
        let twice = columns("Date,Cloud, cloud").unwrap_err();
        assert!(matches!(twice, FormatError::DuplicateColumn { line: 1, column: 12, .. }), "{twice}");
        let wide = columns(&(0..600).map(|at| at.to_string()).collect::<Vec<_>>().join(",")).unwrap_err();
        assert!(matches!(wide, FormatError::TooManyColumns { line: 1, most: 500 }), "{wide}");
        assert!(matches!(columns("Date,X,X"), Err(FormatError::DuplicateColumn { column: 8, .. })));
    }
}
