//! The relative operating characteristic: POD against POFD as the threshold falls.

use std::cmp::Ordering;

use serde::{Deserialize, Serialize};

/// Area under the ROC curve: the chance that an event scores above a non-event, ties counting one half.
///
/// That is the Mann-Whitney statistic over the number of pairs (Hanley & McNeil 1982, Radiology 143, 29-36; Mason & Graham
/// 2002, Q. J. R. Meteorol. Soc. 128, 2145-2166), computed from integer ranks, so it is exact but for the last division and
/// does not depend on the order of the days. `score` may be a probability or a decision value; -0 equals 0.
///
/// `None` where a class is absent, a score is NaN, or the lengths differ.
#[must_use]
pub fn auc(score: &[f64], event: &[bool]) -> Option<f64> {
    Ranking::new(score, event)?.auc(|_| 1)
}

/// Days in order of falling score, made once and used for many weightings of the days.
pub(super) struct Ranking<'a> {
    order: Vec<usize>,
    score: &'a [f64],
    event: &'a [bool],
}

impl<'a> Ranking<'a> {
    /// `None` where a score is NaN or the lengths differ.
    pub(super) fn new(score: &'a [f64], event: &'a [bool]) -> Option<Self> {
        if score.len() != event.len() || score.iter().any(|s| s.is_nan()) {
            return None;
        }
        let mut order: Vec<usize> = (0..score.len()).collect();
        order.sort_by(|&i, &j| score[j].partial_cmp(&score[i]).unwrap_or(Ordering::Equal));
        Some(Self { order, score, event })
    }

    /// The AUC where day `i` counts `weight(i)` times.
    pub(super) fn auc(&self, weight: impl Fn(usize) -> u64) -> Option<f64> {
        // pairs are counted twice so that a tie is the integer 1; 2^31 days of each class still fit
        let (mut events, mut others, mut twice_won) = (0_u64, 0_u64, 0_u64);
        for group in self.groups() {
            let (tied_events, tied_others) = self.count(group, &weight);
            twice_won += tied_others * (2 * events + tied_events);
            events += tied_events;
            others += tied_others;
        }
        (events > 0 && others > 0).then(|| twice_won as f64 / (2.0 * events as f64 * others as f64))
    }

    /// Runs of equal score, from the highest.
    pub(super) fn groups(&self) -> impl Iterator<Item = &[usize]> {
        self.order.chunk_by(|&i, &j| self.score[i] == self.score[j])
    }

    /// Weights of the (events, non-events) among `days`.
    pub(super) fn count(&self, days: &[usize], weight: impl Fn(usize) -> u64) -> (u64, u64) {
        days.iter().fold((0, 0), |(events, others), &i| {
            if self.event[i] { (events + weight(i), others) } else { (events, others + weight(i)) }
        })
    }

    /// The score of a run of equal scores.
    pub(super) fn score_of(&self, group: &[usize]) -> Option<f64> {
        group.first().map(|&i| self.score[i])
    }
}

/// One corner of the ROC curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RocPoint {
    /// Events are forecast where the probability is at least this; `None` at the origin, where none is.
    pub threshold: Option<f64>,
    /// Probability of false detection, 0 to 1.
    pub pofd: f64,
    /// Probability of detection, 0 to 1.
    pub pod: f64,
}

/// The corners of the ROC curve from (0, 0) to (1, 1); a point on the straight line between its neighbours is left out.
///
/// Empty where [`auc`] is `None`.
#[must_use]
pub fn curve(score: &[f64], event: &[bool]) -> Vec<RocPoint> {
    let Some(ranking) = Ranking::new(score, event) else { return Vec::new() };
    let events = event.iter().filter(|&&e| e).count() as u64;
    let others = event.len() as u64 - events;
    if events == 0 || others == 0 {
        return Vec::new();
    }
    let mut corners: Vec<(Option<f64>, u64, u64)> = vec![(None, 0, 0)];
    let (mut hits, mut alarms) = (0, 0);
    for group in ranking.groups() {
        let (tied_events, tied_others) = ranking.count(group, |_| 1);
        (hits, alarms) = (hits + tied_events, alarms + tied_others);
        if let [.., (_, alarms0, hits0), (_, alarms1, hits1)] = corners[..] {
            // equal slopes, compared as integers
            if (alarms1 - alarms0) * (hits - hits1) == (alarms - alarms1) * (hits1 - hits0) {
                corners.pop();
            }
        }
        corners.push((ranking.score_of(group), alarms, hits));
    }
    let point = |(threshold, alarms, hits): (Option<f64>, u64, u64)| RocPoint {
        threshold,
        pofd: alarms as f64 / others as f64,
        pod: hits as f64 / events as f64,
    };
    corners.into_iter().map(point).collect()
}
