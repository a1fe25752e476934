//! Squared distances that lose one feature after the other, and the kernel values that follow from them.
//!
//! Dropping a feature subtracts `(x_if - x_jf)^2` from the squared distance of each pair: rows^2 work instead of
//! rows^2 x features. Distances are kept in double precision, since what is left of a sum of 60 terms after 59 subtractions must
//! still be good for a kernel; of the symmetric matrix only the lower triangle is.

use multiversion::multiversion;
use rayon::prelude::*;

use super::columns::Columns;
use super::gram::Gram;
use super::kernel::{Kernel, KernelFamily};
use super::lanes::exp_of_negative_single;
use crate::forecast::matrix::Matrix;

/// Squared distances of the rows of a training set among themselves: row `i` holds those to rows 0 to `i`.
pub(super) struct Triangle {
    rows: usize,
    pairs: Vec<f64>,
}

impl Triangle {
    /// Of the rows of `x` (finite, standardised); 4 bytes a pair (i, j), of either order.
    pub(super) fn new(x: &Matrix) -> Self {
        let columns = Columns::of_rows(x, 0..x.rows());
        let mut pairs = vec![0.0; entries(x.rows())];
        let mut rows = slices(&mut pairs, x.rows());
        rows.par_iter_mut().enumerate().for_each(|(i, row)| columns.pairs(KernelFamily::Gaussian, x.row(i), row));
        Self { rows: x.rows(), pairs }
    }

    /// Bytes that a triangle of so many rows takes.
    pub(super) const fn bytes(rows: usize) -> usize {
        entries(rows).saturating_mul(size_of::<f64>())
    }

    /// False where a distance overflowed.
    pub(super) fn is_finite(&self) -> bool {
        self.pairs.par_iter().all(|pair| pair.is_finite())
    }

    /// Squared distances of row `i` to rows 0 to `i`. `i` must be below the number of rows.
    pub(super) fn row(&self, i: usize) -> &[f64] {
        &self.pairs[entries(i)..entries(i + 1)]
    }

    /// Takes the feature with values `column`, one a row, out of every pair, and writes the kernel values of what is left, in
    /// one pass over the memory, to `gram`, which has as many rows and a Gaussian kernel.
    ///
    /// Rounding may leave a squared distance just below 0, which becomes 0. A column of zeros takes nothing out.
    pub(super) fn remove_feature(&mut self, column: &[f64], gamma: f64, gram: &mut Gram) {
        let rows = slices(&mut self.pairs, self.rows);
        gram.fill_symmetric(rows, |i, pairs, kernel| {
            subtract_feature(column[i], column, pairs);
            single_kernel(gamma, pairs, kernel);
        });
    }
}

/// Entries of a triangle of so many rows.
const fn entries(rows: usize) -> usize {
    rows * (rows + 1) / 2
}

/// The rows of a triangle.
fn slices(pairs: &mut [f64], rows: usize) -> Vec<&mut [f64]> {
    let mut rest = pairs;
    let mut slices = Vec::with_capacity(rows);
    for i in 0..rows {
        let (row, others) = rest.split_at_mut(i + 1);
        slices.push(row);
        rest = others;
    }
    slices
}

/// Squared distances of other rows (held-out days) from the rows of a training set.
pub(super) struct CrossTable {
    training: usize,
    stride: usize,
    pairs: Vec<f64>,
}

impl CrossTable {
    /// The table of the rows of `other` and of `training`, which have the same features.
    pub(super) fn new(other: &Matrix, training: &Matrix) -> Self {
        let columns = Columns::of_rows(training, 0..training.rows());
        let stride = columns.stride();
        let mut pairs = vec![0.0; other.rows() * stride];
        for (i, row) in pairs.chunks_exact_mut(stride.max(1)).enumerate() {
            columns.pairs(KernelFamily::Gaussian, other.row(i), row);
        }
        Self { training: training.rows(), stride, pairs }
    }

    /// Takes a feature out, with its values on both sides.
    pub(super) fn remove_feature(&mut self, other: &[f64], training: &[f64]) {
        for (row, &a) in self.pairs.chunks_exact_mut(self.stride.max(1)).zip(other) {
            subtract_feature(a, training, &mut row[..self.training]);
        }
    }

    /// Kernel values of each other row in turn with the training rows, padded with zeros to whole lanes.
    pub(super) fn for_each_row(&self, kernel: &Kernel, mut work: impl FnMut(&[f32])) {
        let gamma = kernel.gamma().unwrap_or(0.0);
        let mut values = vec![0.0; self.stride];
        for row in self.pairs.chunks_exact(self.stride.max(1)) {
            single_kernel(gamma, &row[..self.training], &mut values);
            work(&values);
        }
    }
}

/// `pairs_j -= (x - column_j)^2`, no less than 0.
#[multiversion(targets = "simd")]
fn subtract_feature(x: f64, column: &[f64], pairs: &mut [f64]) {
    for (pair, &other) in pairs.iter_mut().zip(column) {
        let left = *pair - (x - other) * (x - other);
        *pair = if left > 0.0 { left } else { 0.0 };
    }
}

/// `out = exp(-gamma pairs)` in single precision.
///
/// Rounding `u = gamma pair` to single precision moves `exp(-u)` by at most 6e-8 u exp(-u), below 3e-8: no more than rounding the
/// value does, and the Gram matrices are in single precision anyway.
#[multiversion(targets = "simd")]
fn single_kernel(gamma: f64, pairs: &[f64], out: &mut [f32]) {
    for (value, &pair) in out.iter_mut().zip(pairs) {
        *value = exp_of_negative_single((-gamma * pair) as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::svm::problems::seasons;

    /// After any number of removals distances and kernel values are those of the columns that are left.
    #[test]
    fn what_is_left_is_what_the_other_features_give() {
        let (x, _, _) = seasons(3, 3, 37);
        let (other, _, _) = seasons(4, 1, 11);
        let kernel = Kernel::Gaussian { gamma: 0.4 };
        let (mut triangle, mut across) = (Triangle::new(&x), CrossTable::new(&other, &x));
        let mut gram = Gram::of_rows(&x, kernel);
        for (step, removed) in [5, 0, 3, 6, 1, 4].into_iter().enumerate() {
            triangle.remove_feature(&x.column(removed), 0.4, &mut gram);
            across.remove_feature(&other.column(removed), &x.column(removed));
            let left: Vec<usize> = (0..7).filter(|c| ![5, 0, 3, 6, 1, 4][..=step].contains(c)).collect();
            let (rest, rest_other) = (x.select_columns(&left), other.select_columns(&left));
            for i in 0..x.rows() {
                for j in 0..x.rows() {
                    let exact = kernel.value(rest.row(i), rest.row(j));
                    assert!((f64::from(gram.padded_row(i)[j]) - exact).abs() < 1.5e-7, "{step}: {i} {j}");
                }
                let nearest: f64 = rest.row(i).iter().zip(rest.row(0)).map(|(a, b)| (a - b) * (a - b)).sum();
                assert!((triangle.row(i)[0] - nearest).abs() < 1e-13 * (1.0 + nearest));
            }
            let mut i = 0;
            across.for_each_row(&kernel, |row| {
                for (j, &value) in row[..x.rows()].iter().enumerate() {
                    assert!((f64::from(value) - kernel.value(rest_other.row(i), rest.row(j))).abs() < 1.5e-7);
                }
                assert!(row[x.rows()..].iter().all(|&padding| padding == 0.0));
                i += 1;
            });
            assert_eq!(i, 11);
        }
        assert!(triangle.is_finite());
        assert!(!Triangle::new(&Matrix::from_rows(2, 1, vec![1e200, -1e200]).unwrap()).is_finite());
    }
}
