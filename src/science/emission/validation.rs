//! Monte-Carlo validation of an estimator: synthetic tails at the fitted truth, through the same fit.

use std::sync::atomic::{AtomicUsize, Ordering};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::goodness::replicate_tail;
use super::numerics::{mean, standard_deviation};
use super::tails::{Fitted, Tail, fit};
use crate::progress::Progress;

/// How well one parameter comes back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Recovery {
    /// Name of the parameter.
    pub name: String,
    /// Value at which the catalogues were made.
    pub truth: f64,
    /// Mean of the estimates.
    pub mean: f64,
    /// Mean less truth.
    pub bias: f64,
    /// Standard deviation of the estimates.
    pub spread: f64,
    /// Mean of the standard errors that the fits state; missing where they state none.
    pub mean_se: Option<f64>,
    /// Share of the 95 % intervals that hold the truth; missing where the fits state none. 0.92 to 0.98 is to be expected.
    pub coverage95: Option<f64>,
    /// Replicates in which the parameter could be estimated.
    pub estimated: usize,
}

/// What [`validate`] finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Validation {
    /// Catalogues.
    pub replicates: usize,
    /// Events in each.
    pub events: usize,
    /// Catalogues that could not be fitted.
    pub failed: usize,
    /// A line a parameter.
    pub parameters: Vec<Recovery>,
}

/// Fits `replicates` catalogues, drawn from `fitted` with the bounds, length and bins of `tail`, like the data.
///
/// # Errors
/// Fewer than 2 replicates, no replicate that could be fitted, or [`EmissionError::Cancelled`].
pub fn validate(
    tail: &Tail,
    fitted: &Fitted,
    replicates: usize,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Validation, EmissionError> {
    if replicates < 2 {
        return Err(EmissionError::option("replicates", replicates, "a whole number of at least 2"));
    }
    let draw = fitted.distribution.sampler();
    let done = AtomicUsize::new(0);
    let one = |replicate: usize| {
        if progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(replicate as u64);
        let fit = fit(&replicate_tail(tail, &draw, &mut rng), fitted.model).ok();
        let count = done.fetch_add(1, Ordering::Relaxed) + 1;
        if count.is_multiple_of(16) {
            progress.report(count as f64 / replicates as f64, "Monte-Carlo validation");
        }
        Ok(fit)
    };
    let fits: Vec<Option<Fitted>> = (0..replicates).into_par_iter().map(one).collect::<Result<_, _>>()?;
    let fits: Vec<Fitted> = fits.into_iter().flatten().collect();
    if fits.is_empty() {
        return Err(EmissionError::NotConverged { what: fitted.model.name() });
    }
    let parameters = fitted.parameters.iter().filter_map(|truth| recovery(&fits, &truth.name, truth.value)).collect();
    Ok(Validation { replicates, events: tail.len(), failed: replicates - fits.len(), parameters })
}

fn recovery(fits: &[Fitted], name: &str, truth: f64) -> Option<Recovery> {
    let found: Vec<_> = fits.iter().filter_map(|fit| fit.parameter(name)).collect();
    let values: Vec<f64> = found.iter().map(|parameter| parameter.value).collect();
    if values.len() < 2 {
        return None;
    }
    let errors: Vec<f64> = found.iter().filter_map(|parameter| parameter.se).collect();
    // an interval that is open on one side is one; an estimate without any is none
    let intervals: Vec<_> = found.iter().filter(|p| p.lower95.is_some() || p.upper95.is_some()).collect();
    let holds = intervals
        .iter()
        .filter(|p| p.lower95.is_none_or(|lower| lower <= truth) && p.upper95.is_none_or(|upper| truth <= upper));
    let coverage = holds.count() as f64 / intervals.len() as f64;
    let centre = mean(&values);
    Some(Recovery {
        name: name.to_owned(),
        truth,
        mean: centre,
        bias: centre - truth,
        spread: standard_deviation(&values),
        mean_se: (!errors.is_empty()).then(|| mean(&errors)),
        coverage95: (!intervals.is_empty()).then_some(coverage),
        estimated: values.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::close;
    use crate::emission::samples::{cutoff_sample, pareto_sample};
    use crate::emission::tails::Model;
    use crate::progress::Unobserved;

    #[test]
    fn a_power_law_comes_back_with_its_known_spread() {
        // alpha - 1 = n / sum u is inverse gamma: mean b n/(n - 1), standard deviation b n/((n - 1) sqrt(n - 2))
        let tail = Tail::exact(&pareto_sample(200, 2.0, 1.0, 1), 1.0, None).unwrap();
        let fitted = fit(&tail, Model::PowerLaw).unwrap();
        let validation = validate(&tail, &fitted, 2000, 1, &Unobserved).unwrap();
        let alpha = &validation.parameters[0];
        let b = alpha.truth - 1.0;
        let spread = b * 200.0 / (199.0 * 198.0_f64.sqrt());
        close(alpha.bias, b / 199.0, 4.0 * spread / 2000.0_f64.sqrt());
        close(alpha.spread / spread, 1.0, 0.07);
        assert!((0.92..=0.98).contains(&alpha.coverage95.unwrap()), "{alpha:?}");
        assert_eq!((validation.failed, alpha.estimated), (0, 2000));
    }

    #[test]
    fn the_same_bits_at_any_number_of_threads() {
        let tail = Tail::exact(&cutoff_sample(300, 1.35, 0.1, 0.003, 1), 0.003, None).unwrap();
        let fitted = fit(&tail, Model::CutoffPowerLaw).unwrap();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| validate(&tail, &fitted, 50, 3, &Unobserved).unwrap())
        };
        let one = run(1);
        assert_eq!(one, run(2));
        assert_eq!(one, run(8));
        assert!(validate(&tail, &fitted, 1, 3, &Unobserved).is_err());
    }
}
