//! Verification of probability and yes/no forecasts of a rare event.
//!
//! A score that is undefined (a class that never occurs, a forecast that is never made) is `None`, never NaN.
//! Definitions after Jolliffe & Stephenson (2012, Forecast Verification, 2nd ed., ch. 3 and 7); the Peirce skill score
//! is the headline, as the others vanish or can be hedged where the event is rare (Ebert & Milne 2022, Nat. Hazards Earth
//! Syst. Sci. 22, 539-557).

use serde::{Deserialize, Serialize};

pub mod bootstrap;
pub mod brier;
pub mod contingency;
pub mod reliability;
pub mod roc;
pub mod threshold;

pub use contingency::Contingency;
pub use roc::auc;
pub use threshold::ThresholdRule;

/// One forecast and what happened.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Forecast probability of the event, 0 to 1.
    pub probability: f64,
    /// Whether the event was forecast: the probability reached the threshold that was in force.
    pub warned: bool,
    /// Whether the event happened.
    pub event: bool,
    /// Probability that the reference (climatology) gave on that day, 0 to 1; it fixes the zero of the Brier skill.
    pub reference: f64,
}

/// The scores of a series of forecasts; `None` where undefined.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Scores {
    /// Area under the ROC curve, 0.5 without skill: see [`auc`].
    pub auc: Option<f64>,
    /// Brier score, 0 (perfect) to 1: see [`brier::score`].
    pub brier: Option<f64>,
    /// Brier skill against the reference, 1 perfect, 0 as good as the reference: see [`brier::skill`].
    pub brier_skill: Option<f64>,
    /// Probability of detection: see [`Contingency::pod`].
    pub pod: Option<f64>,
    /// False alarm ratio: see [`Contingency::far`].
    pub far: Option<f64>,
    /// Probability of false detection: see [`Contingency::pofd`].
    pub pofd: Option<f64>,
    /// Peirce skill score: see [`Contingency::pss`].
    pub pss: Option<f64>,
    /// Heidke skill score: see [`Contingency::hss`].
    pub hss: Option<f64>,
    /// Critical success index: see [`Contingency::csi`].
    pub csi: Option<f64>,
    /// Frequency bias: see [`Contingency::bias`].
    pub bias: Option<f64>,
    /// Mean expense a day in units of the loss, where a cost/loss ratio was given: see [`Contingency::expected_cost`].
    pub expected_cost: Option<f64>,
    /// The table of warned and happened.
    pub contingency: Contingency,
}

impl Scores {
    /// Scores `outcomes`, whose order does not matter but for rounding; `cost_loss` is a cost/loss ratio, 0 to 1.
    #[must_use]
    pub fn of(outcomes: &[Outcome], cost_loss: Option<f64>) -> Self {
        let probability: Vec<f64> = outcomes.iter().map(|o| o.probability).collect();
        let event: Vec<bool> = outcomes.iter().map(|o| o.event).collect();
        let reference: Vec<f64> = outcomes.iter().map(|o| o.reference).collect();
        let table = Contingency::of(outcomes.iter().map(|o| (o.warned, o.event)));
        let brier = brier::score(&probability, &event);
        Self {
            auc: auc(&probability, &event),
            brier,
            brier_skill: brier::skill(brier, brier::score(&reference, &event)),
            pod: table.pod(),
            far: table.far(),
            pofd: table.pofd(),
            pss: table.pss(),
            hss: table.hss(),
            csi: table.csi(),
            bias: table.bias(),
            expected_cost: cost_loss.and_then(|ratio| table.expected_cost(ratio)),
            contingency: table,
        }
    }
}

/// `numerator / denominator`, `None` where that is no finite number.
fn ratio(numerator: f64, denominator: f64) -> Option<f64> {
    let ratio = numerator / denominator;
    ratio.is_finite().then_some(ratio)
}

#[cfg(test)]
mod tests;
