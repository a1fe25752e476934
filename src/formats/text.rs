//! Bytes to text, and places in a text.

use std::borrow::Cow;

use super::FormatError;

/// What Windows-1252 puts at 0x80 to 0x9f (WHATWG Encoding, index windows-1252); the rest is Latin-1.
const WINDOWS_1252: [char; 32] = [
    '\u{20ac}', '\u{81}', '\u{201a}', '\u{192}', '\u{201e}', '\u{2026}', '\u{2020}', '\u{2021}', '\u{2c6}', '\u{2030}',
    '\u{160}', '\u{2039}', '\u{152}', '\u{8d}', '\u{17d}', '\u{8f}', '\u{90}', '\u{2018}', '\u{2019}', '\u{201c}',
    '\u{201d}', '\u{2022}', '\u{2013}', '\u{2014}', '\u{2dc}', '\u{2122}', '\u{161}', '\u{203a}', '\u{153}', '\u{9d}',
    '\u{17e}', '\u{178}',
];

/// The text of a file in UTF-8, with or without a byte-order mark, or else in Windows-1252.
///
/// # Errors
/// [`FormatError::NotText`] for control bytes that no table holds: binary files and UTF-16.
/// [`FormatError::Empty`] where there is nothing but white space.
pub(super) fn decode(bytes: &[u8]) -> Result<Cow<'_, str>, FormatError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let control = |byte: u8| byte < 0x20 && !matches!(byte, b'\t' | b'\n' | b'\r' | 0x0c | 0x1a);
    if let Some(at) = bytes.iter().position(|&byte| control(byte)) {
        let before = &bytes[..at];
        let line_start = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |newline| newline + 1);
        let newlines = before.iter().filter(|&&byte| byte == b'\n').count();
        let (line, column) = (newlines as u64 + 1, (at - line_start) as u64 + 1);
        return Err(FormatError::NotText { line, column, byte: bytes[at] });
    }
    let text = std::str::from_utf8(bytes)
        .map_or_else(|_| bytes.iter().copied().map(windows_1252).collect::<String>().into(), Cow::Borrowed);
    if text.trim().is_empty() { Err(FormatError::Empty) } else { Ok(text) }
}

fn windows_1252(byte: u8) -> char {
    match byte {
        0x80..=0x9f => WINDOWS_1252[usize::from(byte - 0x80)],
        _ => char::from(byte),
    }
}

/// The 1-based line and column, in characters, of byte `at` of `text`, whose first line is line `first_line`.
pub(super) fn place(text: &str, at: usize, first_line: u64) -> (u64, u64) {
    let before = text.get(..at).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
    let newlines = before.bytes().filter(|&byte| byte == b'\n').count();
    (first_line + newlines as u64, before[line_start..].chars().count() as u64 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn utf8_with_and_without_a_mark_and_windows_1252_are_text() {
        assert_eq!(decode(b"\xef\xbb\xbfDate").unwrap(), "Date");
        assert_eq!(decode("Cr\u{e8}che".as_bytes()).unwrap(), "Cr\u{e8}che");
        assert_eq!(decode(b"Cr\xe8che \x96 \x93deep\x94").unwrap(), "Cr\u{e8}che \u{2013} \u{201c}deep\u{201d}");
    }

    #[test]
    fn binary_and_empty_files_are_not() {
        assert_eq!(decode(b"ab\nc\0").unwrap_err(), FormatError::NotText { line: 2, column: 2, byte: 0 });
        assert!(matches!(decode(b"D\0a\0"), Err(FormatError::NotText { line: 1, column: 2, .. })));
        assert_eq!(decode(b"\xef\xbb\xbf \r\n"), Err(FormatError::Empty));
    }

    #[test]
    fn places_count_characters_from_one() {
        assert_eq!(place("a\u{e8}b\ncd", 3, 7), (7, 3));
        assert_eq!(place("a\u{e8}b\ncd", 6, 7), (8, 2));
    }
}
