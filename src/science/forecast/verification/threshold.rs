//! From which probability on the event is forecast.

use serde::{Deserialize, Serialize};

use super::roc::Ranking;

/// How the threshold of a yes/no forecast is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ThresholdRule {
    /// The largest Peirce skill score on out-of-fold probabilities of the training seasons.
    #[default]
    Peirce,
    /// The ratio of the cost of protecting to the loss it saves, which is the best threshold of a calibrated probability
    /// whoever the user (Richardson 2000, Q. J. R. Meteorol. Soc. 126, 649-667, eq. 6).
    CostLoss {
        /// Cost / loss, above 0 and below 1.
        ratio: f64,
    },
}

impl ThresholdRule {
    /// The threshold: the event is forecast where the probability is at least this.
    ///
    /// `probability` and `event` are those of training days; [`ThresholdRule::CostLoss`] does not read them. `None` where the
    /// Peirce score is undefined: a class is absent, a probability is NaN, or the lengths differ.
    #[must_use]
    pub fn choose(self, probability: &[f64], event: &[bool]) -> Option<f64> {
        match self {
            Self::Peirce => most_skilful(probability, event),
            Self::CostLoss { ratio } => Some(ratio),
        }
    }

    /// The cost/loss ratio, where the rule states one.
    #[must_use]
    pub const fn cost_loss(self) -> Option<f64> {
        match self {
            Self::Peirce => None,
            Self::CostLoss { ratio } => Some(ratio),
        }
    }
}

/// The cut of largest Peirce skill, half-way between two probabilities that occur; of equals the one with fewest warnings.
fn most_skilful(probability: &[f64], event: &[bool]) -> Option<f64> {
    let ranking = Ranking::new(probability, event)?;
    let events = event.iter().filter(|&&o| o).count() as i128;
    let others = event.len() as i128 - events;
    if events == 0 || others == 0 {
        return None;
    }
    let values: Vec<f64> = ranking.groups().filter_map(|group| ranking.score_of(group)).collect();
    let (mut hits, mut alarms) = (0_i128, 0_i128);
    let mut best: Option<(i128, usize)> = None;
    for (cut, group) in ranking.groups().enumerate() {
        let (tied_events, tied_others) = ranking.count(group, |_| 1);
        hits += i128::from(tied_events);
        alarms += i128::from(tied_others);
        // PSS times events times non-events: an integer, so that equal skill compares equal
        let skill = hits * others - alarms * events;
        if best.is_none_or(|(most, _)| skill > most) {
            best = Some((skill, cut));
        }
    }
    let (_, cut) = best?;
    let next = values.get(cut + 1).copied().unwrap_or(values[cut]);
    Some(f64::midpoint(values[cut], next))
}
