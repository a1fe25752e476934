//! Single fields of the export: numbers with their sentinels, precipitation codes and avalanche codes.

use crate::domain::avalanche::{AvalancheRecord, AvalancheTrigger, AvalancheType};
use crate::domain::units::AvalancheCount;
use crate::science::forecast::day::Activity;

/// A field that should hold a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Field {
    /// Blank, or a sentinel.
    Missing,
    /// A number in the unit of the export.
    Number(f64),
    /// Text that is no number.
    Unreadable,
}

/// Whether a quantity can be below zero: only then is -1 a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Negative {
    Possible,
    Impossible,
}

/// A field without white space, quotes and the `="..."` with which spreadsheets protect numbers.
pub(super) fn unwrapped(field: &str) -> &str {
    let field = field.trim();
    let inner = field.strip_prefix('=').unwrap_or(field);
    inner.strip_prefix('"').and_then(|inner| inner.strip_suffix('"')).map_or(field, str::trim)
}

/// Reads a number; blank and -9999 are missing everywhere, -1 only where a quantity cannot be negative.
pub(super) fn number(field: &str, negative: Negative) -> Field {
    let field = unwrapped(field);
    if field.is_empty() {
        return Field::Missing;
    }
    let plain = field.bytes().all(|byte| byte.is_ascii_digit() || matches!(byte, b'.' | b'-' | b'+'));
    match field.parse::<f64>() {
        Ok(-9999.0) => Field::Missing,
        Ok(-1.0) if negative == Negative::Impossible => Field::Missing,
        Ok(value) if plain && value.is_finite() => Field::Number(value),
        _ => Field::Unreadable,
    }
}

/// The new-snow index of a precipitation code like `8 - Snow`: the number before the words.
pub(super) fn precipitation(field: &str) -> Field {
    let field = unwrapped(field);
    match number(field, Negative::Impossible) {
        Field::Unreadable => match field.split_once('-') {
            Some((code, _)) if !code.trim().is_empty() => number(code, Negative::Impossible),
            _ => Field::Unreadable,
        },
        read => read,
    }
}

/// What an avalanche code says, and whether the code is one of those that are documented.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Decoded {
    pub(super) record: AvalancheRecord,
    pub(super) documented: bool,
}

/// Reads an avalanche code, whose meaning was inferred from counts in the archive: `0` none; `N0TT` N avalanches seen
/// (9 is nine or more) with type and trigger; `44`, `88` or `99` with up to two more digits, none seen but judged
/// likely; 7777, 77777, -9999 and blank unknown, and so is whatever else.
pub(super) fn avalanche(field: &str) -> Decoded {
    let code = unwrapped(field);
    let code = match code.split_once('.') {
        Some((whole, zeros)) if zeros.bytes().all(|byte| byte == b'0') => whole,
        _ => code,
    };
    let record = match code.as_bytes() {
        b"0" => {
            Some(AvalancheRecord { count: AvalancheCount::try_from(0.0).ok(), ..AvalancheRecord::of(Activity::None) })
        }
        [count @ b'1'..=b'9', b'0', kind, trigger] => seen(*count, *kind, *trigger),
        [b'4', b'4', rest @ ..] | [b'8', b'8', rest @ ..] | [b'9', b'9', rest @ ..]
            if rest.len() <= 2 && rest.iter().all(u8::is_ascii_digit) =>
        {
            let count = AvalancheCount::try_from(0.0).ok();
            Some(AvalancheRecord { count, ..AvalancheRecord::of(Activity::Presumed) })
        }
        _ => None,
    };
    let documented = record.is_some() || matches!(code, "" | "7777" | "77777" | "-9999");
    Decoded { record: record.unwrap_or(AvalancheRecord::of(Activity::Unknown)), documented }
}

fn seen(count: u8, kind: u8, trigger: u8) -> Option<AvalancheRecord> {
    let kind = match kind {
        b'1' => AvalancheType::Dry,
        b'2' => AvalancheType::Wet,
        b'3' => AvalancheType::Mixed,
        b'9' => AvalancheType::Unknown,
        _ => return None,
    };
    let trigger = match trigger {
        b'1' => AvalancheTrigger::Natural,
        b'2' => AvalancheTrigger::Triggered,
        b'3' => AvalancheTrigger::NaturalAndTriggered,
        b'4' => AvalancheTrigger::Cornice,
        b'9' => AvalancheTrigger::Unknown,
        _ => return None,
    };
    let count = AvalancheCount::try_from(f64::from(count - b'0')).ok();
    let (r#type, trigger) = (Some(kind), Some(trigger));
    Some(AvalancheRecord { activity: Activity::Observed, count, r#type, trigger, size: None })
}

/// What a field says, fit for a report: numbers as given, text only described, because it could be an observer's name
/// or a comment that slipped into another column.
pub(super) fn shown(field: &str) -> String {
    let field = field.trim();
    let count = field.chars().count();
    let private = count > 20 || field.chars().any(char::is_alphabetic);
    if private { format!("text of {count} characters") } else { field.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minus_one_is_a_temperature_and_no_cloud_cover() {
        assert_eq!(number("-1", Negative::Possible), Field::Number(-1.0));
        assert_eq!(number("-1.00", Negative::Impossible), Field::Missing);
        for missing in ["", "  ", "-9999", "-9999.0", "=\"-9999\"", "=\"\""] {
            assert_eq!(number(missing, Negative::Possible), Field::Missing, "{missing}");
        }
    }

    #[test]
    fn spreadsheet_armour_is_taken_off() {
        assert_eq!(number("=\"192744\"", Negative::Impossible), Field::Number(192_744.0));
        assert_eq!(number("\" 315.00\"", Negative::Impossible), Field::Number(315.0));
        assert_eq!(unwrapped("=\""), "=\"");
        assert_eq!(unwrapped("\""), "\"");
    }

    #[test]
    fn text_is_not_a_number() {
        for text in ["NaN", "inf", "1e3", "abc", "1,5", "--1", "Considerable -"] {
            assert_eq!(number(text, Negative::Possible), Field::Unreadable, "{text}");
        }
    }

    #[test]
    fn precipitation_codes_start_with_the_index() {
        assert_eq!(precipitation("0 - None"), Field::Number(0.0));
        assert_eq!(precipitation("8 - Snow"), Field::Number(8.0));
        assert_eq!(precipitation("10-Heavy Snow"), Field::Number(10.0));
        assert_eq!(precipitation("4"), Field::Number(4.0));
        assert_eq!(precipitation("-9999"), Field::Missing);
        assert_eq!(precipitation("-1"), Field::Missing);
        assert_eq!(precipitation(""), Field::Missing);
        assert_eq!(precipitation("Snow"), Field::Unreadable);
        assert_eq!(precipitation("- Snow"), Field::Unreadable);
    }

    #[test]
    fn seen_avalanches_have_count_type_and_trigger() {
        let read = |code| {
            let record = avalanche(code).record;
            assert!(record.contradictions().is_empty(), "{code}");
            (record.activity, record.count.map(AvalancheCount::get), record.r#type, record.trigger)
        };
        let (dry, wet, mixed) = (Some(AvalancheType::Dry), Some(AvalancheType::Wet), Some(AvalancheType::Mixed));
        use Activity::{None as Nothing, Observed, Presumed, Unknown};
        assert_eq!(read("1012"), (Observed, Some(1), dry, Some(AvalancheTrigger::Triggered)));
        assert_eq!(read("4013"), (Observed, Some(4), dry, Some(AvalancheTrigger::NaturalAndTriggered)));
        assert_eq!(read("3021"), (Observed, Some(3), wet, Some(AvalancheTrigger::Natural)));
        assert_eq!(read("9034"), (Observed, Some(9), mixed, Some(AvalancheTrigger::Cornice)));
        assert_eq!(read("1029"), (Observed, Some(1), wet, Some(AvalancheTrigger::Unknown)));
        assert_eq!(read("2091"), (Observed, Some(2), Some(AvalancheType::Unknown), Some(AvalancheTrigger::Natural)));
        assert_eq!(read("0"), (Nothing, Some(0), None, None));
        for code in ["44", "88", "99", "990", "4400", "8812", "9931", "9931.0"] {
            assert_eq!(read(code), (Presumed, Some(0), None, None), "{code}");
        }
        for code in ["7777", "77777", "-9999", "", "-1", "1", "1052", "1017", "44123", "440x", "text", "4 4"] {
            assert_eq!(read(code), (Unknown, None, None, None), "{code}");
        }
    }

    #[test]
    fn undocumented_codes_are_told_from_documented_ones() {
        for code in ["0", "1012", "44", "7777", "77777", "-9999", ""] {
            assert!(avalanche(code).documented, "{code}");
        }
        for code in ["1", "1052", "123456", "text"] {
            assert!(!avalanche(code).documented, "{code}");
        }
    }

    #[test]
    fn reports_repeat_numbers_and_never_text() {
        assert_eq!(shown(" -42.5 "), "-42.5");
        assert_eq!(shown("J. Smith"), "text of 8 characters");
    }
}
