//! Squared distances that lose one feature after the other, and what follows from them: kernel values, and the decision
//! values of the machine so far under the new kernel.
//!
//! Dropping a feature subtracts `(x_if - x_jf)^2` from the squared distance of each pair: rows^2 work instead of
//! rows^2 x features. Distances are kept in double precision, since what is left of a sum of 60 terms after 59 subtractions must
//! still be good for a kernel; of the symmetric matrix only the lower triangle is. It lies in tiles of [`TILE`] x [`TILE`] pairs:
//! a tile stays in the cache while its kernel values are computed, written to both halves of the Gram matrix and multiplied with
//! the machine, so that the memory is passed once.

use multiversion::multiversion;
use rayon::prelude::*;

use super::columns::Columns;
use super::gram::{Gnomon, Gram, TILE};
use super::kernel::KernelFamily;
use super::lanes::{dot, exp_of_negative_single, padded};
use crate::forecast::matrix::Matrix;

/// Pairs of a tile.
const PAIRS: usize = TILE * TILE;

/// Entries that are turned at once, in registers.
const SQUARE: usize = 8;

/// Squared distances of the rows of a training set among themselves, in tiles: for each block of [`TILE`] rows the tiles of the
/// blocks up to its own, each row by row. Pairs with a row beyond the last are 0.
pub(super) struct Triangle {
    rows: usize,
    tiles: Vec<f64>,
}

impl Triangle {
    /// Of the rows of `x` (finite, standardised); 4 bytes a pair (i, j), of either order.
    pub(super) fn new(x: &Matrix) -> Self {
        let columns = Columns::of_rows(x, 0..x.rows());
        let mut tiles = vec![0.0; entries(x.rows())];
        bands(&mut tiles, x.rows()).into_par_iter().enumerate().for_each(|(block, band)| {
            let mut row = vec![0.0; (block + 1) * TILE];
            for i in block * TILE..((block + 1) * TILE).min(x.rows()) {
                columns.pairs(KernelFamily::Gaussian, x.row(i), &mut row);
                for (tile, part) in band.chunks_exact_mut(PAIRS).zip(row.chunks_exact(TILE)) {
                    tile[i % TILE * TILE..][..TILE].copy_from_slice(part);
                }
            }
        });
        Self { rows: x.rows(), tiles }
    }

    /// Bytes that a triangle of so many rows takes.
    pub(super) const fn bytes(rows: usize) -> usize {
        entries(rows).saturating_mul(size_of::<f64>())
    }

    /// False where a distance overflowed.
    pub(super) fn is_finite(&self) -> bool {
        self.tiles.par_iter().all(|pair| pair.is_finite())
    }

    /// Squared distance of the rows `i` and `j`, where `j <= i` and `i` is below the number of rows.
    pub(super) fn pair(&self, i: usize, j: usize) -> f64 {
        let block = i / TILE;
        self.tiles[(block * (block + 1) / 2 + j / TILE) * PAIRS + i % TILE * TILE + j % TILE]
    }

    /// Takes the feature with values `column`, one a row, out of every pair, and writes the kernel values of what is left to
    /// `gram`, which has as many rows and a Gaussian kernel. Returns their products with `beta` (padded to whole lanes), one
    /// a row: the decision values of that machine without its threshold.
    ///
    /// Rounding may leave a squared distance just below 0, which becomes 0. A column of zeros takes nothing out. The sums are
    /// taken in the order of the tiles, whichever thread had them.
    pub(super) fn remove_feature(&mut self, column: &[f64], gamma: f64, beta: &[f64], gram: &mut Gram) -> Vec<f64> {
        let stride = padded(self.rows);
        let mut padded_column = column.to_vec();
        padded_column.resize(stride, 0.0);
        let (rows, column) = (self.rows, &padded_column);
        let tasks = bands(&mut self.tiles, rows).into_par_iter().zip(gram.gnomons()).enumerate();
        let parts: Vec<Vec<f64>> = tasks
            .map(|(block, (band, gnomon))| {
                let mut products = vec![0.0; (block + 1) * TILE];
                renew_band(&Band { block, rows, column, gamma, beta }, band, gnomon, &mut products);
                products
            })
            .collect();
        let mut products = vec![0.0; stride];
        for part in parts {
            products.iter_mut().zip(part).for_each(|(sum, product)| *sum += product);
        }
        products
    }
}

/// Entries of a triangle of so many rows.
const fn entries(rows: usize) -> usize {
    let blocks = rows.div_ceil(TILE);
    (blocks * (blocks + 1) / 2).saturating_mul(PAIRS)
}

/// The tiles of each block of rows.
fn bands(tiles: &mut [f64], rows: usize) -> Vec<&mut [f64]> {
    let mut rest = tiles;
    let mut bands = Vec::with_capacity(rows.div_ceil(TILE));
    for block in 0..rows.div_ceil(TILE) {
        let (band, others) = rest.split_at_mut((block + 1) * PAIRS);
        bands.push(band);
        rest = others;
    }
    bands
}

/// What a task of [`Triangle::remove_feature`] reads.
struct Band<'a> {
    block: usize,
    rows: usize,
    column: &'a [f64],
    gamma: f64,
    beta: &'a [f64],
}

/// Renews the tiles of a block of rows, their kernel values in both halves of the matrix, and the share of the tiles in the
/// products of the rows up to the last of the block.
#[multiversion(targets = "simd")]
fn renew_band(band: &Band<'_>, tiles: &mut [f64], mut gnomon: Gnomon<'_>, products: &mut [f64]) {
    let own = band.block * TILE;
    let (x, beta): (&[f64], &[f64]) = (&band.column[own..own + TILE], &band.beta[own..own + TILE]);
    let used = (band.rows - own).min(TILE);
    let mut values = [[0.0_f32; TILE]; TILE];
    let mut turned = [[0.0_f32; TILE]; TILE];
    for (other, tile) in tiles.as_chunks_mut::<PAIRS>().0.iter_mut().enumerate() {
        let start = other * TILE;
        let (column, others) = (&band.column[start..start + TILE], &band.beta[start..start + TILE]);
        for ((pairs, values), &x) in tile.as_chunks_mut::<TILE>().0.iter_mut().zip(&mut values).zip(x) {
            for ((pair, value), &other) in pairs.iter_mut().zip(values).zip(column) {
                let left = *pair - (x - other) * (x - other);
                *pair = if left > 0.0 { left } else { 0.0 };
                // Rounding u = gamma pair to single precision moves exp(-u) by at most 6e-8 u exp(-u), below 3e-8: no more
                // than rounding the value does, and the Gram matrices are in single precision anyway.
                *value = exp_of_negative_single((-band.gamma * *pair) as f32);
            }
        }
        // what lies beyond the last row is padding
        values[used..].iter_mut().for_each(|row| row.fill(0.0));
        if other == band.block {
            values.iter_mut().for_each(|row| row[used..].fill(0.0));
        } else {
            turn(&values, &mut turned);
            for (piece, line) in gnomon.down[start..start + TILE].iter_mut().zip(&turned) {
                piece.copy_from_slice(line);
            }
            add_rows(&mut products[start..start + TILE], beta, &values);
        }
        for (row, line) in gnomon.across.iter_mut().zip(&values) {
            row[start..start + TILE].copy_from_slice(line);
        }
        // a tile on the diagonal is its own transpose
        let columns = if other == band.block { &values } else { &turned };
        add_rows(&mut products[own..own + TILE], others, columns);
    }
}

/// Adds `weights_i rows_i`, row after row, to `sums`.
#[inline(always)]
fn add_rows(sums: &mut [f64], weights: &[f64], rows: &[[f32; TILE]; TILE]) {
    let mut total = [0.0; TILE];
    for (row, &weight) in rows.iter().zip(weights) {
        if weight != 0.0 {
            for (sum, &value) in total.iter_mut().zip(row) {
                *sum += weight * f64::from(value);
            }
        }
    }
    sums.iter_mut().zip(total).for_each(|(sum, total)| *sum += total);
}

/// The transpose of a tile.
#[inline(always)]
fn turn(values: &[[f32; TILE]; TILE], turned: &mut [[f32; TILE]; TILE]) {
    for (down, lines) in values.as_chunks::<SQUARE>().0.iter().enumerate() {
        for (across, rows) in turned.as_chunks_mut::<SQUARE>().0.iter_mut().enumerate() {
            let mut block = [[0.0; SQUARE]; SQUARE];
            for (part, line) in block.iter_mut().zip(lines) {
                part.copy_from_slice(&line[across * SQUARE..][..SQUARE]);
            }
            for (i, row) in rows.iter_mut().enumerate() {
                row[down * SQUARE..][..SQUARE].copy_from_slice(&block.map(|line| line[i]));
            }
        }
    }
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
        pairs
            .par_chunks_exact_mut(stride.max(1))
            .enumerate()
            .for_each(|(i, row)| columns.pairs(KernelFamily::Gaussian, other.row(i), row));
        Self { training: training.rows(), stride, pairs }
    }

    /// Takes a feature out, with its values on both sides, and returns for each other row the sum of the kernel values of what
    /// is left, weighted by `beta` (padded to whole lanes). Columns of zeros take nothing out.
    pub(super) fn remove_feature(&mut self, other: &[f64], training: &[f64], gamma: f64, beta: &[f64]) -> Vec<f64> {
        let (count, stride) = (self.training, self.stride);
        let rows = self.pairs.par_chunks_exact_mut(stride.max(1)).zip(other);
        rows.map_init(
            || vec![0.0; stride],
            |values, (row, &x)| renew_row(x, training, gamma, beta, &mut row[..count], values),
        )
        .collect()
    }
}

/// Takes a feature out of a row of squared distances and returns the sum of its kernel values, weighted by `beta`. `values` is
/// scratch whose padding is 0.
#[multiversion(targets = "simd")]
fn renew_row(x: f64, column: &[f64], gamma: f64, beta: &[f64], pairs: &mut [f64], values: &mut [f32]) -> f64 {
    for ((pair, value), &other) in pairs.iter_mut().zip(values.iter_mut()).zip(column) {
        let left = *pair - (x - other) * (x - other);
        *pair = if left > 0.0 { left } else { 0.0 };
        *value = exp_of_negative_single((-gamma * *pair) as f32);
    }
    dot(beta, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::svm::kernel::Kernel;
    use crate::forecast::svm::problems::seasons;

    /// After any number of removals distances and kernel values are those of the columns that are left.
    #[test]
    fn what_is_left_is_what_the_other_features_give() {
        let (x, _, _) = seasons(3, 3, 37);
        let (other, _, _) = seasons(4, 1, 11);
        let kernel = Kernel::Gaussian { gamma: 0.4 };
        let (mut triangle, mut across) = (Triangle::new(&x), CrossTable::new(&other, &x));
        let mut gram = Gram::empty(kernel, x.rows());
        // every third row is none of the machine
        let weight = |i: usize| if i % 3 == 0 { 0.0 } else { (i as f64 * 0.7).sin() };
        let beta: Vec<f64> = (0..padded(x.rows())).map(|i| if i < x.rows() { weight(i) } else { 0.0 }).collect();
        let sum_of = |rest: &Matrix, row: &[f64]| -> f64 {
            (0..rest.rows()).map(|j| beta[j] * kernel.value(rest.row(j), row)).sum()
        };
        for (step, removed) in [5, 0, 3, 6, 1, 4].into_iter().enumerate() {
            let products = triangle.remove_feature(&x.column(removed), 0.4, &beta, &mut gram);
            let sums = across.remove_feature(&other.column(removed), &x.column(removed), 0.4, &beta);
            let left: Vec<usize> = (0..7).filter(|c| ![5, 0, 3, 6, 1, 4][..=step].contains(c)).collect();
            let (rest, rest_other) = (x.select_columns(&left), other.select_columns(&left));
            for i in 0..x.rows() {
                for j in 0..x.rows() {
                    let exact = kernel.value(rest.row(i), rest.row(j));
                    assert!((f64::from(gram.padded_row(i)[j]) - exact).abs() < 1.5e-7, "{step}: {i} {j}");
                }
                let nearest: f64 = rest.row(i).iter().zip(rest.row(0)).map(|(a, b)| (a - b) * (a - b)).sum();
                assert!((triangle.pair(i, 0) - nearest).abs() < 1e-13 * (1.0 + nearest));
                assert!((products[i] - sum_of(&rest, rest.row(i))).abs() < 1e-5, "{step}: {i}");
                assert!(gram.padded_row(i)[x.rows()..].iter().all(|&padding| padding == 0.0));
            }
            assert!(products[x.rows()..].iter().all(|&padding| padding == 0.0));
            assert_eq!(sums.len(), 11);
            for (i, sum) in sums.iter().enumerate() {
                assert!((sum - sum_of(&rest, rest_other.row(i))).abs() < 1e-5, "{step}: {i}");
            }
        }
        assert!(triangle.is_finite());
        assert!(!Triangle::new(&Matrix::from_rows(2, 1, vec![1e200, -1e200]).unwrap()).is_finite());
    }
}
