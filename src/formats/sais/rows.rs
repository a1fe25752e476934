//! From physical lines to rows.
//!
//! The export quotes comments only sometimes and never doubles the quotes inside, so a CSV reader would swallow the
//! rows behind an unbalanced quote. Here a quote spans lines only where it is properly closed before the next row
//! begins; otherwise it is an ordinary character. A row begins with a line that has a date in the date column, or that
//! has as many fields as a complete row; other lines belong to the comment before them.

use super::columns::{Column, Columns};
use super::dates;

/// A field and where it starts in the text of its row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Field<'a> {
    /// Byte of the row's text at which the content starts.
    pub(super) at: usize,
    /// The content without its quotes.
    pub(super) text: &'a str,
}

/// The fields of a text, and whether a quote was opened and not closed.
#[derive(Debug, PartialEq)]
pub(super) struct Split<'a> {
    pub(super) fields: Vec<Field<'a>>,
    pub(super) open: bool,
}

/// A row of the file.
#[derive(Debug)]
pub(super) struct Row<'a> {
    /// 1-based line of the file in which it starts.
    pub(super) line: u64,
    /// Its text, which can span lines.
    pub(super) text: &'a str,
    pub(super) fields: Vec<Field<'a>>,
}

/// More lines than this are no comment: bounds the search for a closing quote.
const LONGEST_QUOTE: usize = 50;

/// A line with more fields than this is not a line of a comment, even inside of quotes.
const LONGEST_LIST: usize = 20;

/// Splits at the commas outside of quotes; a quote that is not closed is an ordinary character, and so are all behind it.
pub(super) fn split(text: &str) -> Split<'_> {
    let bytes = text.as_bytes();
    let (mut fields, mut open, mut at) = (Vec::new(), false, 0);
    loop {
        let content = at + bytes[at..].iter().take_while(|&&byte| byte == b' ').count();
        let quoted = !open && bytes.get(content) == Some(&b'"');
        let closing = if quoted { closing_quote(bytes, content + 1) } else { None };
        open |= quoted && closing.is_none();
        let (from, to, rest) = match closing {
            Some(quote) => (content + 1, quote, quote),
            None => (at, comma_after(bytes, at), at),
        };
        fields.push(Field { at: from, text: &text[from..to] });
        let comma = comma_after(bytes, rest);
        if comma == bytes.len() {
            return Split { fields, open };
        }
        at = comma + 1;
    }
}

/// The next comma at or after `from`, or the end.
fn comma_after(bytes: &[u8], from: usize) -> usize {
    bytes[from..].iter().position(|&byte| byte == b',').map_or(bytes.len(), |ahead| from + ahead)
}

/// The quote that ends a field whose content starts at `from`: one before a comma or the end of a line.
fn closing_quote(bytes: &[u8], mut from: usize) -> Option<usize> {
    loop {
        let quote = from + bytes.get(from..)?.iter().position(|&byte| byte == b'"')?;
        match bytes.get(quote + 1) {
            None | Some(b',' | b'\n' | b'\r') => return Some(quote),
            Some(b'"') => from = quote + 2,
            Some(_) => from = quote + 1,
        }
    }
}

/// The physical lines of a text as byte ranges without their ends; a lone carriage return ends a line only in a text
/// that has no other line ends.
fn physical_lines(text: &str) -> Vec<(usize, usize)> {
    let end = if text.contains('\n') { '\n' } else { '\r' };
    let mut start = 0;
    let ranges = text.split(end).map(|line| {
        let range = (start, start + line.strip_suffix('\r').unwrap_or(line).len());
        start += line.len() + 1;
        range
    });
    ranges.collect()
}

/// The rows of a file, the header first.
pub(super) struct Rows<'a> {
    text: &'a str,
    lines: Vec<(usize, usize)>,
    /// Index of the line behind the rows already given.
    next: usize,
}

impl<'a> Rows<'a> {
    pub(super) fn of(text: &'a str) -> Self {
        Self { text, lines: physical_lines(text), next: 0 }
    }

    /// The first line that is not blank.
    pub(super) fn header(&mut self) -> Option<Row<'a>> {
        self.skip_blank();
        let first = self.next;
        (first < self.lines.len()).then(|| {
            self.next += 1;
            self.row(first, first).0
        })
    }

    /// The next row below the header.
    pub(super) fn next(&mut self, columns: &Columns) -> Option<Row<'a>> {
        self.skip_blank();
        let first = self.next;
        if first >= self.lines.len() {
            return None;
        }
        let (mut row, open) = self.row(first, first);
        let mut last = first;
        if open {
            last = self.closing_line(first, columns).unwrap_or(first);
        }
        if columns.has(Column::Comments) {
            while self.continues_comment(last + 1, columns) {
                last += 1;
            }
        }
        self.next = last + 1;
        if last > first {
            row = self.row(first, last).0;
        }
        Some(row)
    }

    fn skip_blank(&mut self) {
        while self.lines.get(self.next).is_some_and(|&(start, end)| self.text[start..end].trim().is_empty()) {
            self.next += 1;
        }
    }

    /// The lines `first` to `last` as one row, and whether a quote stays open in them.
    fn row(&self, first: usize, last: usize) -> (Row<'a>, bool) {
        let text = &self.text[self.lines[first].0..self.lines[last].1];
        let Split { fields, open } = split(text);
        (Row { line: first as u64 + 1, text, fields }, open)
    }

    fn line(&self, at: usize) -> Option<&'a str> {
        self.lines.get(at).map(|&(start, end)| &self.text[start..end])
    }

    /// The line in which the quotes that line `first` opens are all closed, if that is before the next row.
    fn closing_line(&self, first: usize, columns: &Columns) -> Option<usize> {
        for at in first + 1..=first + LONGEST_QUOTE {
            let line = self.line(at)?;
            let fields = split(line).fields;
            let complete = fields.len() >= columns.fewest;
            if complete && (is_dated(&fields, columns) || fields.len() > LONGEST_LIST) {
                return None;
            }
            let closed = closing_quote(line.as_bytes(), 0);
            if closed.is_some_and(|quote| !split(&line[quote + 1..]).open) {
                return Some(at);
            }
        }
        None
    }

    /// Whether a line belongs to an unquoted comment before it.
    fn continues_comment(&self, at: usize, columns: &Columns) -> bool {
        let Some(line) = self.line(at).filter(|line| !line.trim().is_empty()) else { return false };
        let fields = split(line).fields;
        !is_dated(&fields, columns) && fields.len() < columns.fewest
    }
}

fn is_dated(fields: &[Field<'_>], columns: &Columns) -> bool {
    dates::has_shape(columns.text(fields, Column::Date))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "Date, Area, Air Temp, Cloud, Comments,";

    /// Line and date of each row of a file with that body.
    fn rows(body: &str) -> Vec<(u64, String)> {
        let text = format!("{HEADER}\n{body}");
        let mut rows = Rows::of(&text);
        let header = rows.header().unwrap();
        let columns = Columns::read(header.text, &header.fields, header.line).unwrap();
        let mut found = Vec::new();
        while let Some(row) = rows.next(&columns) {
            found.push((row.line, columns.text(&row.fields, Column::Date).to_owned()));
        }
        found
    }

    fn dated(expected: &[(u64, &str)]) -> Vec<(u64, String)> {
        expected.iter().map(|(line, date)| (*line, (*date).to_owned())).collect()
    }

    fn texts(line: &str) -> Vec<&str> {
        split(line).fields.iter().map(|field| field.text).collect()
    }

    #[test]
    fn quotes_hold_commas_only_where_they_are_closed() {
        assert_eq!(texts("a,\"b,c\",d"), ["a", "b,c", "d"]);
        assert_eq!(texts("a, \"b\",=\"192744\""), ["a", "b", "=\"192744\""]);
        assert_eq!(texts("a,\"\",\"b \"\"c\"\"\",d"), ["a", "", "b \"\"c\"\"", "d"]);
        assert_eq!(texts("a,wind slab on NE, deep \"stuff\",d"), ["a", "wind slab on NE", " deep \"stuff\"", "d"]);
        assert_eq!(texts("a,\"deep \"stuff\", hard\",d"), ["a", "deep \"stuff", " hard\"", "d"]);
        let open = split("a,\"b,c");
        assert!(open.open);
        assert_eq!(texts("a,\"b,c"), ["a", "\"b", "c"]);
        assert_eq!(texts(""), [""]);
        assert_eq!(texts("a,"), ["a", ""]);
    }

    #[test]
    fn a_line_break_in_quotes_belongs_to_the_comment() {
        let body = "05/01/2004,Lochaber,-3,90,\"windy,\n then, calm, and, cold, too\",\n04/01/2004,Lochaber,1,5,,\n";
        assert_eq!(rows(body), dated(&[(2, "05/01/2004"), (4, "04/01/2004")]));
    }

    #[test]
    fn a_line_break_without_quotes_belongs_to_the_comment_too() {
        let body = "05/01/2004,Lochaber,-3,90,windy\nthen calm\n\n04/01/2004,Lochaber,1,5,,";
        assert_eq!(rows(body), dated(&[(2, "05/01/2004"), (5, "04/01/2004")]));
    }

    #[test]
    fn an_unbalanced_quote_does_not_swallow_the_next_row() {
        let body =
            "05/01/2004,Lochaber,-3,90,\"deep \"stuff, see\n04/01/2004,Lochaber,1,5,\"calm\",\n2004-01-03,L,1,5,";
        assert_eq!(rows(body), dated(&[(2, "05/01/2004"), (3, "04/01/2004"), (4, "2004-01-03")]));
    }

    #[test]
    fn a_row_with_an_unreadable_date_is_not_swallowed_either_in_a_wide_file() {
        let names: Vec<_> = (0..29).map(|column| format!("C{column}")).collect();
        let wide = format!(
            "Date,Area,{},Comments\n05/01/2004{},\"open\nyesterday{},\"calm\"",
            names.join(","),
            ",1".repeat(30),
            ",1".repeat(30)
        );
        let mut rows = Rows::of(&wide);
        let header = rows.header().unwrap();
        let columns = Columns::read(header.text, &header.fields, header.line).unwrap();
        let lines: Vec<_> = std::iter::from_fn(|| rows.next(&columns)).map(|row| row.line).collect();
        assert_eq!(lines, [2, 3]);
    }

    #[test]
    fn a_quoted_line_that_starts_with_a_date_is_a_row_only_if_it_is_complete() {
        let body = "05/01/2004,Lochaber,-3,90,\"see the pit of\n04/01/2004, deep\",\n03/01/2004,Lochaber,1,5,,";
        assert_eq!(rows(body), dated(&[(2, "05/01/2004"), (4, "03/01/2004")]));
    }

    #[test]
    fn a_row_cut_short_or_with_a_wrong_date_stays_a_row() {
        let body = "05/01/2004,Lochaber,-3,90,,\n04/01/2004,Loch\nyesterday,Lochaber,1,5,,\n31/02/2004,Lochaber,1,5,,";
        let expected = [(2, "05/01/2004"), (3, "04/01/2004"), (4, "yesterday"), (5, "31/02/2004")];
        assert_eq!(rows(body), dated(&expected));
    }

    #[test]
    fn every_kind_of_line_end_is_one() {
        for end in ["\n", "\r\n", "\r"] {
            let body = format!("{HEADER}{end}05/01/2004,L,1,1,,{end}{end}04/01/2004,L,1,1,,{end}");
            let mut rows = Rows::of(&body);
            let header = rows.header().unwrap();
            let columns = Columns::read(header.text, &header.fields, 1).unwrap();
            let lines: Vec<_> = std::iter::from_fn(|| rows.next(&columns)).map(|row| row.line).collect();
            assert_eq!(lines, [2, 4], "{end:?}");
        }
    }
}
