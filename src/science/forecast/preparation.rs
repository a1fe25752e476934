//! Imputation and standardisation of a feature matrix, fitted on training rows only.
//!
//! A missing entry becomes the median of the known training values of its column; then each column is centred on the
//! mean and divided by the standard deviation (population, n in the denominator) of the *imputed* training column: what
//! scikit-learn computes as `SimpleImputer(strategy="median")` followed by `StandardScaler()`.
//!
//! A column without spread in training (constant, or never known) teaches a machine nothing. It is kept, so that columns
//! and features stay in step, and is 0 in every prepared row: it adds nothing to a distance or a scalar product.

use serde::{Deserialize, Serialize};

use super::matrix::Matrix;

/// What the training rows say of one column, in the unit of the feature.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Median of the known values, which takes the place of a missing one; 0 where none is known.
    pub median: f64,
    /// Mean after imputation.
    pub mean: f64,
    /// Standard deviation after imputation; 1 for a column without spread.
    pub scale: f64,
    /// Smallest and largest known value; `None` where none is known.
    pub range: Option<(f64, f64)>,
    /// Number of known values.
    pub known: usize,
    /// False for a column without spread, which is 0 in every prepared row.
    pub used: bool,
}

/// The fitted columns, in the order of the features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Preparation {
    columns: Vec<Column>,
}

/// One row, ready for a machine, and what had to be done to it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PreparedRow {
    /// Standardised values (without unit), one a column.
    pub values: Vec<f64>,
    /// Columns that were missing and took the training median.
    pub imputed: Vec<usize>,
    /// Columns outside the smallest and largest training value, or known now and never in training.
    pub out_of_range: Vec<usize>,
}

impl Preparation {
    /// Fits each column of `x` (training rows x features). An entry that is NaN or infinite is missing.
    #[must_use]
    pub fn fit(x: &Matrix) -> Self {
        Self { columns: (0..x.cols()).map(|j| Column::fit(x.column(j))).collect() }
    }

    /// What was fitted, one a feature.
    #[must_use]
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// Columns without spread in training, which are 0 in every prepared row.
    #[must_use]
    pub fn unused(&self) -> Vec<usize> {
        (0..self.columns.len()).filter(|&j| !self.columns[j].used).collect()
    }

    /// Imputes and standardises each row of `x`: as many rows, one column a fitted column.
    ///
    /// Where `x` has fewer columns than were fitted the rest is missing; columns beyond are ignored.
    #[must_use]
    pub fn transform(&self, x: &Matrix) -> Matrix {
        let mut prepared = Matrix::filled(x.rows(), self.columns.len(), 0.0);
        for i in 0..x.rows() {
            let raw = x.row(i);
            for (j, (out, column)) in prepared.row_mut(i).iter_mut().zip(&self.columns).enumerate() {
                *out = column.prepare(entry(raw, j));
            }
        }
        prepared
    }

    /// Imputes and standardises one row of features, and says which columns were missing or out of the training range.
    ///
    /// A row shorter than the fit is missing the rest; entries beyond are ignored.
    #[must_use]
    pub fn transform_row(&self, raw: &[f64]) -> PreparedRow {
        let (mut imputed, mut out_of_range) = (Vec::new(), Vec::new());
        let prepare = |(j, column): (usize, &Column)| {
            let x = entry(raw, j);
            match x {
                None => imputed.push(j),
                Some(x) if !column.covers(x) => out_of_range.push(j),
                Some(_) => {}
            }
            column.prepare(x)
        };
        let values = self.columns.iter().enumerate().map(prepare).collect();
        PreparedRow { values, imputed, out_of_range }
    }
}

impl Column {
    fn fit(mut values: Vec<f64>) -> Self {
        let rows = values.len();
        values.retain(|x| x.is_finite());
        values.sort_unstable_by(f64::total_cmp);
        let known = values.len();
        let (Some(&least), Some(&largest)) = (values.first(), values.last()) else {
            return Self { median: 0.0, mean: 0.0, scale: 1.0, range: None, known: 0, used: false };
        };
        let range = Some((least, largest));
        let median = f64::midpoint(values[(known - 1) / 2], values[known / 2]);
        // sorted order also makes the sums independent of the order of the rows
        values.resize(rows, median);
        let mean = values.iter().sum::<f64>() / rows as f64;
        let variance = values.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / rows as f64;
        let scale = variance.sqrt();
        // a spread so small or so large that it under- or overflows cannot be divided by
        if least < largest && scale > 0.0 && scale.is_finite() {
            Self { median, mean, scale, range, known, used: true }
        } else {
            Self { median, mean: median, scale: 1.0, range, known, used: false }
        }
    }

    fn prepare(&self, x: Option<f64>) -> f64 {
        if self.used { (x.unwrap_or(self.median) - self.mean) / self.scale } else { 0.0 }
    }

    fn covers(&self, x: f64) -> bool {
        self.range.is_some_and(|(least, largest)| (least..=largest).contains(&x))
    }
}

/// Entry `j` of a raw row, `None` where missing.
fn entry(raw: &[f64], j: usize) -> Option<f64> {
    raw.get(j).copied().filter(|x| x.is_finite())
}
