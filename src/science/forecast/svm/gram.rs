//! What all pairs of rows share: squared distances or inner products once, and the Gram matrix of each gamma from them.

use rayon::prelude::*;

use super::columns::{Columns, kernel_of_pairs};
use super::kernel::{Kernel, KernelFamily};
use super::lanes::{BLOCK, padded};
use crate::forecast::matrix::Matrix;

/// Squared distances (Gaussian) or inner products (linear) of all pairs of rows, computed once a feature set.
///
#[derive(Clone, Debug)]
pub struct PairTable {
    family: KernelFamily,
    rows: usize,
    stride: usize,
    pairs: Vec<f64>,
}

impl PairTable {
    /// The table of the rows of `x` (samples x features, finite, standardised); 8 bytes a pair.
    #[must_use]
    pub fn new(x: &Matrix, family: KernelFamily) -> Self {
        let columns = Columns::of_rows(x, 0..x.rows());
        let stride = columns.stride();
        let mut pairs = vec![0.0; x.rows() * stride];
        if stride > 0 {
            let lower = |(i, row): (usize, &mut [f64])| columns.pairs(family, x.row(i), &mut row[..=i]);
            pairs.par_chunks_mut(stride).enumerate().with_max_len(1).for_each(lower);
        }
        mirror(&mut pairs, x.rows(), stride);
        Self { family, rows: x.rows(), stride, pairs }
    }

    /// Number of rows (samples).
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// The family the table was made for.
    #[must_use]
    pub const fn family(&self) -> KernelFamily {
        self.family
    }

    /// Squared distance or inner product of rows `i` and `j`; `None` outside the table.
    #[must_use]
    pub fn pair(&self, i: usize, j: usize) -> Option<f64> {
        (i < self.rows && j < self.rows).then(|| self.pairs[i * self.stride + j])
    }

    /// The Gram matrix of that `gamma` (> 0, ignored for a linear table); 4 bytes a pair.
    #[must_use]
    pub fn gram(&self, gamma: f64) -> Gram {
        let kernel = self.family.with_gamma(gamma);
        let mut gram = Gram::empty(kernel, self.rows);
        gram.fill(|i, _, row| kernel_of_pairs(&kernel, &self.pairs[i * self.stride..][..self.rows], row));
        gram
    }
}

/// The kernel values of all pairs of rows, `rows x rows`, in single precision (as in LIBSVM).
#[derive(Clone, Debug)]
pub struct Gram {
    kernel: Kernel,
    rows: usize,
    stride: usize,
    finite: bool,
    values: Vec<f32>,
}

impl Gram {
    /// The Gram matrix of the rows of `x` without a table in between.
    #[must_use]
    pub fn of_rows(x: &Matrix, kernel: Kernel) -> Self {
        let columns = Columns::of_rows(x, 0..x.rows());
        let mut gram = Self::empty(kernel, x.rows());
        gram.fill(|i, pairs, row| {
            columns.pairs(kernel.family(), x.row(i), &mut pairs[..=i]);
            kernel_of_pairs(&kernel, &pairs[..=i], row);
        });
        mirror(&mut gram.values, gram.rows, gram.stride);
        gram
    }

    /// Bytes that [`Gram`] takes for `rows` rows.
    #[must_use]
    pub const fn bytes(rows: usize) -> usize {
        rows.saturating_mul(padded(rows)).saturating_mul(size_of::<f32>())
    }

    /// All zeros, to be filled.
    pub(super) fn empty(kernel: Kernel, rows: usize) -> Self {
        let stride = padded(rows);
        Self { kernel, rows, stride, finite: true, values: vec![0.0; rows * stride] }
    }

    /// Lets `work` write each row (its number, scratch of one row, the row), and looks whether all are finite.
    fn fill(&mut self, work: impl Fn(usize, &mut [f64], &mut [f32]) + Sync) {
        let stride = self.stride;
        self.finite = self
            .values
            .par_chunks_mut(stride.max(1))
            .enumerate()
            .map_init(
                || vec![0.0; stride],
                |pairs, (i, row)| {
                    work(i, pairs, row);
                    row.iter().all(|v| v.is_finite())
                },
            )
            .reduce(|| true, |a, b| a && b);
    }

    /// The matrix taken apart for whoever writes the lower triangle in bands of [`TILE`] rows together with its mirror image.
    /// What is written must be finite.
    pub(super) fn gnomons(&mut self) -> Vec<Gnomon<'_>> {
        let blocks = self.stride / TILE;
        let of = |block: usize| Gnomon { across: Vec::with_capacity(TILE), down: Vec::with_capacity(block * TILE) };
        let mut gnomons: Vec<Gnomon<'_>> = (0..blocks).map(of).collect();
        for (i, row) in self.values.chunks_exact_mut(self.stride.max(1)).enumerate() {
            let block = i / TILE;
            let (across, beyond) = row.split_at_mut((block + 1) * TILE);
            gnomons[block].across.push(across);
            for (gnomon, piece) in gnomons[block + 1..].iter_mut().zip(beyond.chunks_exact_mut(TILE)) {
                gnomon.down.push(piece);
            }
        }
        gnomons
    }

    /// Number of rows (samples).
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// The kernel the matrix was made with.
    #[must_use]
    pub const fn kernel(&self) -> &Kernel {
        &self.kernel
    }

    /// False if any value is NaN or infinite.
    #[must_use]
    pub const fn is_finite(&self) -> bool {
        self.finite
    }

    /// Kernel values of row `i` with every row; `None` outside the matrix.
    #[must_use]
    pub fn row(&self, i: usize) -> Option<&[f32]> {
        (i < self.rows).then(|| &self.padded_row(i)[..self.rows])
    }

    /// Row `i` with its padding of zeros.
    #[inline(always)]
    pub(super) fn padded_row(&self, i: usize) -> &[f32] {
        &self.values[i * self.stride..(i + 1) * self.stride]
    }

    /// [`Self::rows`] rounded up to whole lanes.
    pub(super) const fn stride(&self) -> usize {
        self.stride
    }

    /// The sub-matrix of the selected rows and columns. Indices must be below [`Self::rows`].
    pub(super) fn select(&self, selection: &Selection) -> Self {
        let (rows, stride) = (selection.index.len(), padded(selection.index.len()));
        let mut values = vec![0.0_f32; rows * stride];
        for (row, &i) in values.chunks_exact_mut(stride.max(1)).zip(&selection.index) {
            selection.gather(self.padded_row(i), row);
        }
        Self { kernel: self.kernel, rows, stride, finite: self.finite, values }
    }
}

/// Rows that are taken at a time: a square of them stays in the first-level cache.
pub(super) const TILE: usize = BLOCK;

/// The part of a symmetric matrix that a band of [`TILE`] rows decides: together they are the whole, each entry once.
pub(super) struct Gnomon<'a> {
    /// The rows of the band up to their own tile.
    pub(super) across: Vec<&'a mut [f32]>,
    /// Of every row above the band the [`TILE`] entries above it.
    pub(super) down: Vec<&'a mut [f32]>,
}

/// Side of the squares that are turned in registers.
const SQUARE: usize = 8;

/// Copies the lower triangle of a symmetric matrix to the upper one. `stride` is a multiple of [`TILE`].
fn mirror<T: Copy + Default>(values: &mut [T], rows: usize, stride: usize) {
    // a square in which tiles are turned: rows a power of two apart push each other out of the cache, so each is read once
    let mut turned = [[T::default(); TILE]; TILE];
    for start in (0..rows).step_by(TILE) {
        let end = (start + TILE).min(rows);
        let (head, tail) = values.split_at_mut(end * stride);
        let band = &mut head[start * stride..];
        for i in 0..end - start {
            for j in 0..i {
                band[j * stride + start + i] = band[i * stride + start + j];
            }
        }
        for (tile, below) in tail.chunks(TILE * stride).enumerate() {
            let mut height = 0;
            for sources in below.chunks(SQUARE * stride) {
                turn(sources, start, stride, height, &mut turned);
                height += sources.len() / stride;
            }
            let first = end + tile * TILE;
            for (row, turned) in band.chunks_mut(stride).zip(&turned) {
                row[first..first + height].copy_from_slice(&turned[..height]);
            }
        }
    }
}

/// Writes the columns from `start` on of up to [`SQUARE`] rows as rows of `turned`, from the entry `at` on.
#[inline(always)]
fn turn<T: Copy + Default>(sources: &[T], start: usize, stride: usize, at: usize, turned: &mut [[T; TILE]; TILE]) {
    for (square, rows) in turned.chunks_exact_mut(SQUARE).enumerate() {
        let mut block = [[T::default(); SQUARE]; SQUARE];
        for (line, source) in block.iter_mut().zip(sources.chunks_exact(stride)) {
            line.copy_from_slice(&source[start + square * SQUARE..][..SQUARE]);
        }
        for (i, row) in rows.iter_mut().enumerate() {
            row[at..at + SQUARE].copy_from_slice(&block.map(|line| line[i]));
        }
    }
}

/// Rows of a problem inside a larger matrix, as runs (start, length) of consecutive numbers: with rows ordered by season the
/// training part of a fold is a handful of them.
pub(super) struct Selection {
    index: Vec<usize>,
    runs: Vec<(usize, usize)>,
}

impl Selection {
    /// The rows named by `index`, in that order.
    pub(super) fn new(index: &[usize]) -> Self {
        let mut runs: Vec<(usize, usize)> = Vec::new();
        for &i in index {
            match runs.last_mut() {
                Some((start, length)) if *start + *length == i => *length += 1,
                _ => runs.push((i, 1)),
            }
        }
        Self { index: index.to_vec(), runs }
    }

    /// Copies the selected entries of `source` to the front of `out`.
    pub(super) fn gather(&self, source: &[f32], out: &mut [f32]) {
        let mut position = 0;
        for &(start, length) in &self.runs {
            out[position..position + length].copy_from_slice(&source[start..start + length]);
            position += length;
        }
    }
}
