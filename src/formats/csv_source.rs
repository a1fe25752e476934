//! What a CSV reader does not tell: where a row and a field stand in the file, and whether its quotes are sound.

use super::FormatError;
use super::text::place;

/// Counts lines up to growing places of one text, so that every row can be named by its line.
pub(super) struct Lines<'a> {
    text: &'a str,
    at: usize,
    line: u64,
}

impl<'a> Lines<'a> {
    pub(super) const fn of(text: &'a str) -> Self {
        Self { text, at: 0, line: 1 }
    }

    /// Where the first character at or after byte `start` stands that does not end a line.
    pub(super) fn source_at(&mut self, start: usize) -> Source<'a> {
        let rest = self.text.as_bytes().get(self.at..).unwrap_or_default();
        let ahead = start.saturating_sub(self.at).min(rest.len());
        let skipped = rest[ahead..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
        let passed = &rest[..ahead + skipped];
        self.line += passed
            .iter()
            .enumerate()
            .filter(|&(at, &byte)| byte == b'\n' || (byte == b'\r' && rest.get(at + 1) != Some(&b'\n')))
            .count() as u64;
        self.at += passed.len();
        Source { line: self.line, text: self.text.get(self.at..).unwrap_or_default() }
    }
}

/// Where a row stands in the file.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    /// Line in which the row starts.
    pub(super) line: u64,
    /// The file from the row on.
    text: &'a str,
}

impl Source<'_> {
    /// Line and column at which a field starts, counted from 0; the end of the row where it has not as many.
    pub(super) fn place_of(self, field: usize) -> (u64, u64) {
        let (mut quoted, mut before) = (false, field);
        let starts_or_ends = |(_, byte): &(usize, u8)| {
            quoted ^= *byte == b'"';
            before -= usize::from(*byte == b',' && !quoted && before > 0);
            before == 0 || (!quoted && matches!(*byte, b'\n' | b'\r'))
        };
        let at = match field {
            0 => 0,
            _ => self
                .text
                .bytes()
                .enumerate()
                .find(starts_or_ends)
                .map_or(self.text.len(), |(at, byte)| if byte == b',' { at + 1 } else { at }),
        };
        place(self.text, at, self.line)
    }
}

/// Quotes as RFC 4180 wants them: a CSV reader that forgives them swallows rows without a word.
pub(super) fn check_quotes(text: &str) -> Result<(), FormatError> {
    let malformed = |at, detail| {
        let (line, column) = place(text, at, 1);
        Err(FormatError::Malformed { line, column, detail })
    };
    let bytes = text.as_bytes();
    let mut at = 0;
    let mut field_starts = true;
    while at < bytes.len() {
        if bytes[at] != b'"' {
            field_starts = matches!(bytes[at], b',' | b'\n' | b'\r');
            at += 1;
            continue;
        }
        if !field_starts {
            return malformed(at, "a quote inside a field that is not quoted");
        }
        let Some(end) = end_of_quoted(bytes, at + 1) else {
            return malformed(at, "a quote that is never closed");
        };
        if !matches!(bytes.get(end), None | Some(b',' | b'\n' | b'\r')) {
            return malformed(end, "text after a closing quote");
        }
        at = end;
        field_starts = false;
    }
    Ok(())
}

/// The place after the closing quote of a field whose content starts at `from`.
fn end_of_quoted(bytes: &[u8], mut from: usize) -> Option<usize> {
    loop {
        let quote = from + bytes.get(from..)?.iter().position(|&byte| byte == b'"')?;
        if bytes.get(quote + 1) != Some(&b'"') {
            return Some(quote + 1);
        }
        from = quote + 2;
    }
}
