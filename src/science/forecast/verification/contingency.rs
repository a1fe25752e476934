//! The 2 x 2 table of a yes/no forecast and its scores.

use serde::{Deserialize, Serialize};

use super::ratio;

/// Counts of days. Every score is `None` where its denominator is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Contingency {
    /// Hits: forecast and happened.
    pub a: u64,
    /// False alarms: forecast, did not happen.
    pub b: u64,
    /// Misses: not forecast, happened.
    pub c: u64,
    /// Correct rejections: neither forecast nor happened.
    pub d: u64,
}

impl Contingency {
    /// Counts pairs of (forecast, happened).
    #[must_use]
    pub fn of(pairs: impl IntoIterator<Item = (bool, bool)>) -> Self {
        let mut table = Self::default();
        for (forecast, happened) in pairs {
            let cell = match (forecast, happened) {
                (true, true) => &mut table.a,
                (true, false) => &mut table.b,
                (false, true) => &mut table.c,
                (false, false) => &mut table.d,
            };
            *cell += 1;
        }
        table
    }

    /// This table with every count multiplied by `times`, added to `sum`.
    #[must_use]
    pub(super) const fn added_to(self, sum: Self, times: u64) -> Self {
        Self {
            a: sum.a + times * self.a,
            b: sum.b + times * self.b,
            c: sum.c + times * self.c,
            d: sum.d + times * self.d,
        }
    }

    const fn cells(self) -> [f64; 4] {
        [self.a as f64, self.b as f64, self.c as f64, self.d as f64]
    }

    /// Probability of detection `a / (a + c)`, 0 to 1.
    #[must_use]
    pub fn pod(self) -> Option<f64> {
        let [a, _, c, _] = self.cells();
        ratio(a, a + c)
    }

    /// False alarm ratio `b / (a + b)`, 0 to 1.
    #[must_use]
    pub fn far(self) -> Option<f64> {
        let [a, b, _, _] = self.cells();
        ratio(b, a + b)
    }

    /// Probability of false detection `b / (b + d)`, 0 to 1.
    #[must_use]
    pub fn pofd(self) -> Option<f64> {
        let [_, b, _, d] = self.cells();
        ratio(b, b + d)
    }

    /// Peirce skill score POD - POFD (Peirce 1884), -1 to 1, 0 without skill.
    #[must_use]
    pub fn pss(self) -> Option<f64> {
        Some(self.pod()? - self.pofd()?)
    }

    /// Heidke skill score `2 (ad - bc) / ((a+c)(c+d) + (a+b)(b+d))`, -1 to 1, 0 without skill.
    #[must_use]
    pub fn hss(self) -> Option<f64> {
        let [a, b, c, d] = self.cells();
        ratio(2.0 * (a * d - b * c), (a + c) * (c + d) + (a + b) * (b + d))
    }

    /// Critical success index `a / (a + b + c)` (Gilbert 1884), 0 to 1.
    #[must_use]
    pub fn csi(self) -> Option<f64> {
        let [a, b, c, _] = self.cells();
        ratio(a, a + b + c)
    }

    /// Frequency bias `(a + b) / (a + c)`: forecast events per event.
    #[must_use]
    pub fn bias(self) -> Option<f64> {
        let [a, b, c, _] = self.cells();
        ratio(a + b, a + c)
    }

    /// Mean expense `(r (a + b) + c) / n` in units of the loss: protecting costs `r` losses a warning, a miss costs one
    /// (Richardson 2000, Q. J. R. Meteorol. Soc. 126, 649-667).
    #[must_use]
    pub fn expected_cost(self, cost_loss_ratio: f64) -> Option<f64> {
        let [a, b, c, d] = self.cells();
        ratio(cost_loss_ratio * (a + b) + c, a + b + c + d)
    }
}
