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

    /// The preparation of the columns named by `index`, in that order. Indices must be those of fitted columns.
    #[must_use]
    pub fn select(&self, index: &[usize]) -> Self {
        Self { columns: index.iter().map(|&j| self.columns[j]).collect() }
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const NAN: f64 = f64::NAN;

    fn close(x: f64, expected: f64) -> bool {
        (x - expected).abs() < 1e-13
    }

    /// Expected values by scikit-learn 1.9.1 (NumPy 2.4.6): `SimpleImputer(strategy="median")`, then `StandardScaler()`,
    /// whose `statistics_`, `mean_`, `scale_` and transformed matrix these are.
    #[test]
    fn agrees_with_scikit_learn() {
        let raw = [
            [1.0, -3.5, NAN],
            [4.0, NAN, 0.25],
            [NAN, 2.0, 8.0],
            [-2.0, 1e3, -1.5],
            [7.5, NAN, NAN],
            [0.1, -40.0, 3.0],
        ];
        let fitted = [
            (1.0, 1.933_333_333_333_333_3, 3.050_500_869_620_521),
            (-0.75, 159.5, 376.159_512_928_580_17),
            (1.625, 2.166_666_666_666_666_5, 2.955_984_983_422_991_4),
        ];
        let standardised = [
            [-0.305_960_684_236_565_75, -0.433_326_805_245_380_36, -0.183_244_052_220_936_43],
            [0.677_484_372_238_109_8, -0.426_016_076_936_025_8, -0.648_402_030_935_621_3],
            [-0.305_960_684_236_565_75, -0.418_705_348_626_671_2, 1.973_397_485_456_239],
            [-1.289_405_740_711_241_4, 2.234_424_416_004_553, -1.240_421_276_572_493],
            [1.824_836_938_125_231_2, -0.426_016_076_936_025_8, -0.183_244_052_220_936_43],
            [-0.600_994_201_178_968_4, -0.530_360_108_260_450_2, 0.281_913_926_493_748_47],
        ];
        let x = Matrix::from_rows(6, 3, raw.concat()).unwrap();
        let preparation = Preparation::fit(&x);
        for (column, (median, mean, scale)) in preparation.columns().iter().zip(fitted) {
            assert!(close(column.median, median) && close(column.mean, mean) && close(column.scale, scale));
        }
        let prepared = preparation.transform(&x);
        for (i, row) in standardised.iter().enumerate() {
            assert!(prepared.row(i).iter().zip(row).all(|(&x, &expected)| close(x, expected)), "row {i}");
        }
    }

    #[test]
    fn a_row_tells_what_was_imputed_and_what_is_out_of_range() {
        let x = Matrix::from_rows(3, 3, vec![0.0, 1.0, NAN, 2.0, 3.0, NAN, 4.0, 8.0, NAN]).unwrap();
        let preparation = Preparation::fit(&x);
        let row = preparation.transform_row(&[NAN, 8.0, NAN]);
        assert_eq!((row.imputed, row.out_of_range), (vec![0, 2], vec![]));
        let row = preparation.transform_row(&[-0.1, 8.1, 1.0]);
        assert_eq!((row.imputed, row.out_of_range), (vec![], vec![0, 1, 2]));
        // shorter and longer rows
        let row = preparation.transform_row(&[2.0]);
        assert_eq!((row.values.len(), row.imputed), (3, vec![1, 2]));
        assert_eq!(preparation.transform_row(&[2.0; 9]).values.len(), 3);
    }

    #[test]
    fn a_column_without_spread_is_zero_and_keeps_its_place() {
        let x = Matrix::from_rows(3, 3, vec![0.1, 1.0, NAN, 0.1, 2.0, NAN, NAN, 3.0, f64::INFINITY]).unwrap();
        let preparation = Preparation::fit(&x);
        assert_eq!(preparation.unused(), [0, 2]);
        assert_eq!(preparation.columns()[2].range, None);
        let row = preparation.transform_row(&[0.7, 2.0, 5.0]);
        assert_eq!(row.values, [0.0, 0.0, 0.0]);
        assert_eq!(row.out_of_range, [0, 2]);
        assert_eq!(Preparation::fit(&Matrix::filled(0, 2, 0.0)).unused(), [0, 1]);
    }

    proptest! {
        #[test]
        fn prepared_training_rows_are_finite_and_the_same_by_row_and_by_matrix(
            rows in prop::collection::vec(prop::array::uniform4(prop_oneof![4 => -1e3..1e3, 1 => any::<f64>(), 1 => Just(NAN)]), 0..20),
        ) {
            let x = Matrix::from_rows(rows.len(), 4, rows.concat()).unwrap();
            let preparation = Preparation::fit(&x);
            let prepared = preparation.transform(&x);
            prop_assert!((0..rows.len()).all(|i| prepared.row(i).iter().all(|z| z.is_finite())));
            for (i, raw) in rows.iter().enumerate() {
                let row = preparation.transform_row(raw);
                prop_assert_eq!(prepared.row(i), &row.values[..]);
                prop_assert!(row.out_of_range.is_empty());
            }
            for j in (0..4).filter(|&j| preparation.columns()[j].used) {
                let column = prepared.column(j);
                let mean = column.iter().sum::<f64>() / column.len() as f64;
                let square = column.iter().map(|z| z * z).sum::<f64>() / column.len() as f64;
                // a spread that is small beside the mean loses digits, whatever the algorithm
                let fitted = preparation.columns()[j];
                if fitted.scale > 1e-3 * fitted.mean.abs() {
                    prop_assert!(mean.abs() < 1e-9 && (square - 1.0).abs() < 1e-9);
                }
            }
        }
    }
}
