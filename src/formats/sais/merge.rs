//! Several profiles of one day become one row.

use std::collections::HashMap;

use jiff::civil::DateTime;

use super::ImportedDay;
use crate::domain::avalanche::{AvalancheRecord, activity_name};
use crate::domain::units::AvalancheCount;
use crate::formats::{Flag, FlagCode, ImportedRow, MergedRow};
use crate::science::forecast::day::Activity;

/// A row and the local time of its profile.
pub(super) type Timed = (Option<DateTime>, ImportedRow);

/// Keeps one accepted row a day, at the place of the later profile; refused rows stay as they are.
pub(super) fn by_day(read: Vec<Timed>) -> (Vec<ImportedRow>, Vec<MergedRow>) {
    let mut kept: Vec<Option<Timed>> = Vec::with_capacity(read.len());
    let mut merged = Vec::new();
    let mut place_of_day = HashMap::with_capacity(read.len());
    for timed in read {
        let place = kept.len();
        let earlier = match (timed.1.date, &timed.1.outcome) {
            (Some(date), Ok(_)) => place_of_day.insert(date, place).and_then(|before: usize| kept[before].take()),
            _ => None,
        };
        let Some(before) = earlier else {
            kept.push(Some(timed));
            continue;
        };
        let (winner, loser) = if timed.0 >= before.0 { (timed, before) } else { (before, timed) };
        merged.extend(winner.1.date.map(|date| MergedRow { line: loser.1.line, into_line: winner.1.line, date }));
        kept.push(Some(combine(winner, &loser.1)));
    }
    let line_at: Vec<_> = kept.iter().map(|row| row.as_ref().map_or(0, |(_, row)| row.line)).collect();
    let mut rows: Vec<_> = kept.into_iter().flatten().map(|(_, row)| row).collect();
    rows.sort_by_key(|row| row.line);
    // of three profiles a day the first may have gone into the second, which then went into the third
    for gone in &mut merged {
        let kept_at = place_of_day.get(&gone.date).and_then(|place| line_at.get(*place));
        gone.into_line = kept_at.copied().unwrap_or(gone.into_line);
    }
    (rows, merged)
}

/// The winner's values with the stronger of both activities.
fn combine(mut winner: Timed, loser: &ImportedRow) -> Timed {
    if let (Ok(kept), Ok(dropped)) = (&mut winner.1.outcome, &loser.outcome) {
        let detail = match take_stronger(kept, dropped) {
            Some(activity) => {
                format!("the same day is on this line too: only its activity `{}` was kept", activity_name(activity))
            }
            None => "the same day is on this line too: its values were not used".to_owned(),
        };
        let value = format!("line {}", loser.line);
        kept.flags.push(Flag { field: "date".to_owned(), code: FlagCode::DuplicateDay, value, detail });
    }
    winner
}

/// Gives `kept` the avalanches of `dropped` where those are stronger, and says which activity it got.
fn take_stronger(kept: &mut ImportedDay, dropped: &ImportedDay) -> Option<Activity> {
    let strength = |record: Option<AvalancheRecord>| {
        record.map(|record| {
            let rank = match record.activity {
                Activity::Unknown => 0,
                Activity::None => 1,
                Activity::Presumed => 2,
                Activity::Observed => 3,
            };
            (rank, record.count.map(AvalancheCount::get))
        })
    };
    if strength(dropped.avalanche) > strength(kept.avalanche) {
        kept.avalanche = dropped.avalanche;
        return dropped.avalanche.map(|record| record.activity);
    }
    None
}
