//! Lines of newline-delimited JSON, with their numbers; what each line says is for the reader of the JSON type.

/// One line that is not blank.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JsonLine<'a> {
    /// 1-based line of the file.
    pub line: u64,
    /// The line without its end and without white space around it.
    pub json: &'a [u8],
}

/// The lines of `bytes` that are not blank; a byte-order mark is skipped.
pub fn lines(bytes: &[u8]) -> impl Iterator<Item = JsonLine<'_>> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let numbered = (1_u64..).zip(bytes.split(|&byte| byte == b'\n'));
    numbered.map(|(line, raw)| JsonLine { line, json: raw.trim_ascii() }).filter(|line| !line.json.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blank_lines_count_but_are_not_given() {
        let found: Vec<_> = lines(b"\xef\xbb\xbf{\"a\":1}\r\n\n  \r\n {}\n").collect();
        assert_eq!(found, [JsonLine { line: 1, json: b"{\"a\":1}" }, JsonLine { line: 4, json: b"{}" }]);
        assert_eq!(lines(b"").count(), 0);
    }
}
