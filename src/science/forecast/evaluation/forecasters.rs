//! Each model on one split: fitted to the training seasons, with probabilities for both sides.

use std::borrow::Cow;
use std::ops::Range;

use super::folds::inner_folds;
use super::per_model::PerModel;
use super::samples::Samples;
use super::share::Shares;
use crate::forecast::baselines::{Climatology, Persistence};
use crate::forecast::logistic::{self, Logistic};
use crate::forecast::matrix::Matrix;
use crate::forecast::model::{FeatureChoice, TrainingError, TrainingOptions};
use crate::forecast::neighbours::Neighbours;
use crate::forecast::preparation::Preparation;
use crate::forecast::svm::{self, Cost, Elimination, EliminationRecipe, GridPoint, Machine, Platt, SolverOptions};
use crate::progress::Progress;

/// Ridge penalties to choose from, per squared standardised weight; the largest first, as each fit starts from the one before.
const PENALTIES: [f64; 5] = [1000.0, 100.0, 10.0, 1.0, 0.1];

/// Where the fits of an elimination stop. They rank features and score sizes, and no forecast comes from them: LIBSVM's
/// own tolerance, at which the bench compares the curve with scikit-learn's.
const ELIMINATION_EPSILON: f64 = 1e-3;

/// Training rows of a split, prepared.
pub(crate) struct Part<'a> {
    samples: &'a Samples,
    rows: &'a [usize],
    /// Inner fold of each training row.
    fold: Vec<usize>,
    event: Vec<bool>,
    /// Fitted to the features of the training rows.
    pub(crate) preparation: Preparation,
    features: Matrix,
}

/// Probabilities of one model.
pub(crate) struct Probabilities {
    /// Of each training row, from a fit that did not see its fold.
    pub(crate) out_of_fold: Vec<f64>,
    /// Of each test row, from the fit to all training rows.
    pub(crate) test: Vec<f64>,
}

/// A machine with all that turns its decision values into a forecast.
pub(crate) struct FittedSvm {
    /// Columns that the machine reads, rising.
    pub(crate) columns: Vec<usize>,
    pub(crate) machine: Machine,
    pub(crate) platt: Platt,
    pub(crate) best: GridPoint,
    /// Probability of each training row, from a machine that did not see its fold.
    pub(crate) out_of_fold: Vec<f64>,
}

/// An elimination with what it was run with.
pub(crate) struct Eliminated {
    pub(crate) elimination: Elimination,
    /// Cost and gamma of the search on all features.
    pub(crate) best: GridPoint,
}

impl<'a> Part<'a> {
    /// Prepares the training `rows` of `samples`, which are in order of date.
    pub(crate) fn new(samples: &'a Samples, rows: &'a [usize]) -> Self {
        let raw = samples.features.select_rows(rows);
        let preparation = Preparation::fit(&raw);
        let season: Vec<usize> = rows.iter().map(|&i| samples.season[i]).collect();
        let event: Vec<bool> = rows.iter().map(|&i| samples.event[i]).collect();
        Self {
            samples,
            rows,
            fold: inner_folds(&season, &event),
            event,
            features: preparation.transform(&raw),
            preparation,
        }
    }

    /// Labels of the training rows.
    pub(crate) fn event(&self) -> &[bool] {
        &self.event
    }

    /// What a machine of this part says of the `test` rows.
    pub(crate) fn speak(&self, svm: &FittedSvm, test: &[usize]) -> Probabilities {
        let seen = self.prepare(test).select_columns(&svm.columns);
        let decision = |i| svm.platt.probability(svm.machine.decision_value(seen.row(i)));
        Probabilities { out_of_fold: svm.out_of_fold.clone(), test: (0..test.len()).map(decision).collect() }
    }

    /// Probabilities of all models for the `test` rows; those of the machine are given, as it may come from elsewhere.
    pub(crate) fn probabilities(
        &self,
        svm: Probabilities,
        test: &[usize],
        progress: &dyn Progress,
    ) -> Result<PerModel<Probabilities>, TrainingError> {
        let features = self.prepare(test);
        Ok(PerModel {
            svm,
            climatology: self.climatology(test),
            persistence: self.persistence(test),
            knn10: self.neighbours_by_variables(test, 10, progress)?,
            knn30: self.neighbours(&self.features, &features, 30, progress)?,
            logistic: self.logistic(&features, progress)?,
        })
    }

    /// Chooses the features where that is asked for; then a grid search over the inner folds, Platt on the out-of-fold
    /// decision values of the best point, and one fit to all rows.
    pub(crate) fn svm(&self, options: &TrainingOptions, progress: &dyn Progress) -> Result<FittedSvm, TrainingError> {
        let all = self.features.cols();
        let FeatureChoice::Eliminated { count } = options.features else {
            return self.svm_of((0..all).collect(), options, progress);
        };
        // an elimination costs about what a search does, and a search comes before and after it
        let shares = Shares::new(progress, vec![1.0, 1.0, 1.0]);
        let none = Matrix::filled(0, all, 0.0);
        let chosen = self.eliminate(&none, count, options, &shares, 0)?;
        self.svm_of(chosen.elimination.kept, options, &shares.part(2, "chosen features".to_owned()))
    }

    /// Takes features out until `least` are left, with the C and gamma that a search on all of them finds, and scores
    /// the prepared rows of `held_out` at every size. Reports to the parts `first` and `first + 1` of `shares`.
    pub(crate) fn eliminate(
        &self,
        held_out: &Matrix,
        least: usize,
        options: &TrainingOptions,
        shares: &Shares<'_>,
        first: usize,
    ) -> Result<Eliminated, TrainingError> {
        let (x, event, solver) = (&self.features, &self.event, SolverOptions::default());
        let share = shares.part(first, "all features".to_owned());
        let found = svm::grid_search(x, event, &self.fold, options.kernel, &options.grid, &solver, &share)?;
        let recipe = EliminationRecipe { c: found.best.c, gamma: found.best.gamma.unwrap_or(1.0), least };
        let solver = SolverOptions { epsilon: ELIMINATION_EPSILON, ..solver };
        let share = shares.part(first + 1, "elimination".to_owned());
        let elimination = svm::eliminate(x, event, held_out, &recipe, &solver, &share)?;
        Ok(Eliminated { elimination, best: found.best })
    }

    fn svm_of(
        &self,
        columns: Vec<usize>,
        options: &TrainingOptions,
        progress: &dyn Progress,
    ) -> Result<FittedSvm, TrainingError> {
        let (event, solver) = (&self.event, SolverOptions::default());
        let x = if columns.len() == self.features.cols() {
            Cow::Borrowed(&self.features)
        } else {
            Cow::Owned(self.features.select_columns(&columns))
        };
        let found = svm::grid_search(&x, event, &self.fold, options.kernel, &options.grid, &solver, progress)?;
        let platt = svm::fit_platt(&found.decision_values, event)?;
        let kernel = options.kernel.with_gamma(found.best.gamma.unwrap_or(1.0));
        let (cost, stop) = (Cost::balanced(found.best.c, event), || progress.cancelled());
        let machine = svm::train_unless(&x, event, kernel, cost, &solver, &stop)?;
        let out_of_fold = found.decision_values.iter().map(|&f| platt.probability(f)).collect();
        Ok(FittedSvm { columns, machine, platt, best: found.best, out_of_fold })
    }

    /// Other rows as the machines of this part read them.
    pub(crate) fn prepare(&self, rows: &[usize]) -> Matrix {
        self.preparation.transform(&self.samples.features.select_rows(rows))
    }

    fn climatology(&self, test: &[usize]) -> Probabilities {
        let day = |rows: &[usize]| rows.iter().map(|&i| self.samples.day_of_season[i]).collect::<Vec<_>>();
        let fit = |rows: &[usize]| Climatology::fit(&day(rows), &self.event_of(rows));
        self.baseline(test, fit, |fit, i| fit.probability(self.samples.day_of_season[i]))
    }

    fn persistence(&self, test: &[usize]) -> Probabilities {
        let yesterday = |rows: &[usize]| rows.iter().map(|&i| self.samples.yesterday[i]).collect::<Vec<_>>();
        let fit = |rows: &[usize]| Persistence::fit(&yesterday(rows), &self.event_of(rows));
        self.baseline(test, fit, |fit, i| fit.probability(self.samples.yesterday[i]))
    }

    /// A model that is fitted to rows of the samples and asked for others.
    fn baseline<F>(
        &self,
        test: &[usize],
        fit: impl Fn(&[usize]) -> F,
        probability: impl Fn(&F, usize) -> f64,
    ) -> Probabilities {
        let mut out_of_fold = vec![0.0; self.rows.len()];
        for fold in self.folds() {
            let others: Vec<usize> = self.training(fold).map(|k| self.rows[k]).collect();
            let fitted = fit(&others);
            for k in self.held_out(fold) {
                out_of_fold[k] = probability(&fitted, self.rows[k]);
            }
        }
        let fitted = fit(self.rows);
        Probabilities { out_of_fold, test: test.iter().map(|&i| probability(&fitted, i)).collect() }
    }

    fn neighbours_by_variables(
        &self,
        test: &[usize],
        k: usize,
        progress: &dyn Progress,
    ) -> Result<Probabilities, TrainingError> {
        let raw = self.samples.variables.select_rows(self.rows);
        let preparation = Preparation::fit(&raw);
        let test = preparation.transform(&self.samples.variables.select_rows(test));
        self.neighbours(&preparation.transform(&raw), &test, k, progress)
    }

    /// `training` and `test` are standardised.
    fn neighbours(
        &self,
        training: &Matrix,
        test: &Matrix,
        k: usize,
        progress: &dyn Progress,
    ) -> Result<Probabilities, TrainingError> {
        let neighbours = Neighbours::new(training, &self.event);
        // of many days each takes its time
        let wanted = || if progress.cancelled() { Err(TrainingError::Cancelled) } else { Ok(()) };
        let other_fold = |i: usize| {
            wanted()?;
            let nearest = neighbours.probability(training.row(i), k, |j| self.fold[j] != self.fold[i]);
            Ok(nearest.unwrap_or_default())
        };
        let of_test = |i| {
            wanted()?;
            Ok(neighbours.probability(test.row(i), k, |_| true).unwrap_or_default())
        };
        Ok(Probabilities {
            out_of_fold: (0..training.rows()).map(other_fold).collect::<Result<_, TrainingError>>()?,
            test: (0..test.rows()).map(of_test).collect::<Result<_, TrainingError>>()?,
        })
    }

    /// The penalty is that of the highest out-of-fold likelihood.
    fn logistic(&self, test: &Matrix, progress: &dyn Progress) -> Result<Probabilities, TrainingError> {
        let mut out_of_fold = [const { Vec::new() }; PENALTIES.len()];
        out_of_fold.iter_mut().for_each(|p| p.resize(self.rows.len(), 0.0));
        for fold in self.folds() {
            let others: Vec<usize> = self.training(fold).collect();
            let x = self.features.select_rows(&others);
            let event: Vec<bool> = others.iter().map(|&k| self.event[k]).collect();
            let mut fitted: Option<Logistic> = None;
            for (penalty, probability) in PENALTIES.into_iter().zip(&mut out_of_fold) {
                if progress.cancelled() {
                    return Err(TrainingError::Cancelled);
                }
                let next = logistic::fit(&x, &event, penalty, fitted.as_ref())?;
                for k in self.held_out(fold) {
                    probability[k] = next.probability(self.features.row(k));
                }
                fitted = Some(next);
            }
        }
        let surprise = out_of_fold.each_ref().map(|p| surprise(p, &self.event));
        let best = (0..PENALTIES.len()).fold(0, |best, i| if surprise[i] < surprise[best] { i } else { best });
        let fitted = logistic::fit(&self.features, &self.event, PENALTIES[best], None)?;
        Ok(Probabilities {
            out_of_fold: std::mem::take(&mut out_of_fold[best]),
            test: (0..test.rows()).map(|i| fitted.probability(test.row(i))).collect(),
        })
    }

    fn event_of(&self, rows: &[usize]) -> Vec<bool> {
        rows.iter().map(|&i| self.samples.event[i]).collect()
    }

    fn folds(&self) -> Range<usize> {
        0..self.fold.iter().max().map_or(0, |&last| last + 1)
    }

    /// Positions in the training rows outside of an inner fold.
    fn training(&self, fold: usize) -> impl Iterator<Item = usize> {
        (0..self.fold.len()).filter(move |&k| self.fold[k] != fold)
    }

    /// Positions in the training rows of an inner fold.
    fn held_out(&self, fold: usize) -> impl Iterator<Item = usize> {
        (0..self.fold.len()).filter(move |&k| self.fold[k] == fold)
    }
}

/// Negative log likelihood of the labels; a probability that rounded to 0 or 1 counts as the nearest that did not.
fn surprise(probability: &[f64], event: &[bool]) -> f64 {
    let happened = probability.iter().zip(event).map(|(&p, &event)| if event { p } else { 1.0 - p });
    happened.map(|p| -p.max(f64::MIN_POSITIVE).ln()).sum()
}
