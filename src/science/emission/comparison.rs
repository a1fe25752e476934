//! Which model: likelihood ratios and information criteria on one and the same tail.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::special::{chi_square_survival, normal_two_sided};
use super::tails::{Fitted, Model, Parameter, Tail, fit};

/// How one model contains another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Nesting {
    /// At an inner value of the extra parameter: twice the ratio is chi-square with one degree of freedom.
    Inner,
    /// At the edge of the extra parameter: twice the ratio is 0 with the probability 1/2, else chi-square with one degree
    /// (Self & Liang 1987, J. Am. Stat. Assoc. 82, 605-610).
    Boundary,
}

/// One line of the table of likelihood ratios.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct LikelihoodRatio {
    /// First model; where the two are nested, the simpler one.
    pub model_a: Model,
    /// Second model.
    pub model_b: Model,
    /// Log likelihood of `model_a` less that of `model_b`.
    pub loglik_ratio: f64,
    /// The ratio over its standard deviation (Vuong 1989, Econometrica 57, 307-333); missing where the models agree everywhere.
    pub vuong_z: Option<f64>,
    /// Two-sided probability of such a z for models equally near the truth.
    pub vuong_p: Option<f64>,
    /// How `model_b` contains `model_a`, if it does.
    pub nesting: Option<Nesting>,
    /// Of nested models: probability of such a ratio if `model_a` is true, by chi-square with one degree of freedom.
    pub nested_p: Option<f64>,
    /// The same with the boundary taken into account: half of it.
    pub boundary_p: Option<f64>,
    /// The model that the test prefers at 5 % (nested) or 10 % (not nested); missing where it cannot tell.
    pub preferred: Option<Model>,
}

/// One model of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModelSummary {
    /// Model.
    pub model: Model,
    /// Log likelihood.
    pub loglik: f64,
    /// Akaike's information criterion.
    pub aic: f64,
    /// Schwarz's (Bayesian) information criterion.
    pub bic: f64,
    /// Parameters; none where the model degenerates into the power law.
    pub parameters: Vec<Parameter>,
}

/// The model that was chosen, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Choice {
    /// Chosen model: the simplest of those within 2 of the lowest BIC.
    pub model: Model,
    /// The one with the lowest BIC of the others, if more than one model could be fitted.
    pub runner_up: Option<Model>,
    /// BIC of the runner-up less that of the chosen one: above 10 is very strong evidence; below 0 where the simpler model was kept.
    pub bic_margin: Option<f64>,
    /// The same in words.
    pub reason: String,
}

/// Fits of several models to one tail.
#[derive(Clone, Debug)]
pub struct Comparison {
    fits: Vec<Fitted>,
    /// Logarithm of the likelihood of each event (or bin), a list a fit, with the number of events.
    pointwise: Vec<Vec<f64>>,
    counts: Vec<f64>,
}

impl Comparison {
    /// Fits all models that are defined on `tail` (with an upper bound the power law is the bounded one); those without a maximum of
    /// the likelihood are left out.
    ///
    /// # Errors
    /// No model could be fitted.
    pub fn new(tail: &Tail) -> Result<Self, EmissionError> {
        let models: Vec<Model> =
            Model::ALL.into_iter().filter(|&model| model != Model::PowerLaw || tail.xmax.is_none()).collect();
        let fits: Vec<_> = models.par_iter().map(|&model| fit(tail, model)).collect();
        let refusal = fits.iter().find_map(|fit| fit.as_ref().err().cloned());
        let fits: Vec<Fitted> = fits.into_iter().flatten().collect();
        if let (true, Some(refusal)) = (fits.is_empty(), refusal) {
            return Err(refusal);
        }
        let (points, counts): (Vec<f64>, Vec<f64>) = match tail.width {
            Some(_) => tail.groups().into_iter().unzip(),
            None => (tail.u.clone(), vec![1.0; tail.len()]),
        };
        let logs = |fit: &Fitted| points.iter().map(|&u| fit.distribution.log_likelihood(u, tail.width)).collect();
        let pointwise = fits.par_iter().map(logs).collect();
        Ok(Self { fits, pointwise, counts })
    }

    /// The fits.
    #[must_use]
    pub fn fits(&self) -> &[Fitted] {
        &self.fits
    }

    /// What was fitted, a line a model.
    #[must_use]
    pub fn summaries(&self) -> Vec<ModelSummary> {
        let summary = |fit: &Fitted| ModelSummary {
            model: fit.model,
            loglik: fit.loglik,
            aic: fit.aic(),
            bic: fit.bic(),
            parameters: fit.parameters.clone(),
        };
        self.fits.iter().map(summary).collect()
    }

    /// Of the models within 2 of the lowest BIC (what is beyond is positive evidence; Kass & Raftery 1995, J. Am. Stat. Assoc. 90,
    /// 773-795) the one with the fewest parameters.
    #[must_use]
    pub fn choice(&self) -> Option<Choice> {
        const POSITIVE: f64 = 2.0;
        let lowest = self.fits.iter().map(Fitted::bic).fold(f64::INFINITY, f64::min);
        let key = |fit: &Fitted| (fit.bic() > lowest + POSITIVE, fit.free_parameters());
        let best = self.fits.iter().min_by(|a, b| {
            let by_bic = a.bic().total_cmp(&b.bic());
            let (a, b) = (key(a), key(b));
            // beyond the margin only BIC counts
            if a.0 && b.0 { by_bic } else { a.cmp(&b).then(by_bic) }
        })?;
        let others = self.fits.iter().filter(|fit| fit.model != best.model);
        let next = others.min_by(|a, b| a.bic().total_cmp(&b.bic()));
        let margin = next.map(|next| next.bic() - best.bic());
        let strength = match margin {
            Some(margin) if margin > 10.0 => "very strong evidence",
            Some(margin) if margin > 6.0 => "strong evidence",
            Some(margin) if margin > POSITIVE => "positive evidence",
            _ => "hardly any evidence",
        };
        let name = best.model.name();
        let reason = match (next, margin) {
            (Some(next), Some(margin)) if margin >= 0.0 => {
                let other = next.model.name();
                format!("{name} has the lowest BIC, {margin:.1} below {other}: {strength} (Kass & Raftery 1995)")
            }
            (Some(next), Some(margin)) => format!(
                "{name} has fewer parameters than {}, whose BIC is only {:.1} lower: {strength} (Kass & Raftery 1995)",
                next.model.name(),
                -margin
            ),
            _ => format!("{name} is the only model that could be fitted"),
        };
        Some(Choice { model: best.model, runner_up: next.map(|next| next.model), bic_margin: margin, reason })
    }

    /// The table of likelihood ratios: each pair of models once, the simpler one first.
    #[must_use]
    pub fn table(&self) -> Vec<LikelihoodRatio> {
        let pairs = (0..self.fits.len()).flat_map(|a| (a + 1..self.fits.len()).map(move |b| (a, b)));
        pairs.map(|(a, b)| self.ratio(a, b)).collect()
    }

    fn ratio(&self, first: usize, second: usize) -> LikelihoodRatio {
        let swapped = nesting(self.fits[second].model, self.fits[first].model).is_some();
        let (a, b) = if swapped { (second, first) } else { (first, second) };
        let (model_a, model_b) = (self.fits[a].model, self.fits[b].model);
        let differences = || self.pointwise[a].iter().zip(&self.pointwise[b]).map(|(x, y)| x - y).zip(&self.counts);
        let n: f64 = self.counts.iter().sum();
        let ratio: f64 = differences().map(|(d, count)| d * count).sum();
        let mean = ratio / n;
        let squares: f64 = differences().map(|(d, count)| count * (d - mean) * (d - mean)).sum();
        // a spread at the level of rounding is none
        let vuong_z = (squares > 1e-18 * n).then(|| ratio / squares.sqrt());
        let vuong_p = vuong_z.map(normal_two_sided);
        let nesting = nesting(model_a, model_b);
        let nested_p = nesting.map(|_| chi_square_survival(-2.0 * ratio, 1.0));
        let boundary_p = match nesting {
            Some(Nesting::Boundary) => nested_p.map(|p| if ratio < -1e-12 * n { p / 2.0 } else { 1.0 }),
            _ => None,
        };
        let preferred = match (boundary_p.or(nested_p), vuong_p) {
            (Some(p), _) => Some(if p < 0.05 { model_b } else { model_a }),
            (None, Some(p)) if p < 0.1 => Some(if ratio > 0.0 { model_a } else { model_b }),
            _ => None,
        };
        LikelihoodRatio {
            model_a,
            model_b,
            loglik_ratio: ratio,
            vuong_z,
            vuong_p,
            nesting,
            nested_p,
            boundary_p,
            preferred,
        }
    }
}

/// How `large` contains `small`.
///
/// The power law is the limit of the cut-off model at an infinite cut-off, of the lognormal at an infinite width and of the
/// stretched exponential at a stretching of 0; the exponential has alpha = 0 or a stretching of 1. The bounded power law is left
/// out: the largest value as its bound obeys no chi-square law.
fn nesting(small: Model, large: Model) -> Option<Nesting> {
    use Model::{CutoffPowerLaw, Exponential, Lognormal, PowerLaw, StretchedExponential};
    match (small, large) {
        (PowerLaw, CutoffPowerLaw | Lognormal | StretchedExponential) => Some(Nesting::Boundary),
        (Exponential, CutoffPowerLaw | StretchedExponential) => Some(Nesting::Inner),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
