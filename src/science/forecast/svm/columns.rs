//! Rows of features stored by column, so that one row against all others runs over contiguous memory.

use multiversion::multiversion;

use super::kernel::{Kernel, KernelFamily};
use super::lanes::padded;
use crate::forecast::matrix::Matrix;

/// Features of `rows` samples, column after column, each padded with zeros to `stride` entries.
pub(super) struct Columns {
    rows: usize,
    stride: usize,
    data: Vec<f64>,
}

impl Columns {
    /// The rows of `x` named by `index`, in that order.
    pub(super) fn of_rows(x: &Matrix, index: impl ExactSizeIterator<Item = usize> + Clone) -> Self {
        let (rows, stride) = (index.len(), padded(index.len()));
        let mut data = vec![0.0; stride * x.cols()];
        for (position, row) in index.enumerate() {
            for (column, &value) in x.row(row).iter().enumerate() {
                data[column * stride + position] = value;
            }
        }
        Self { rows, stride, data }
    }

    /// Number of samples.
    pub(super) const fn rows(&self) -> usize {
        self.rows
    }

    /// [`Self::rows`] rounded up to whole lanes.
    pub(super) const fn stride(&self) -> usize {
        self.stride
    }

    /// Squared distances (Gaussian) or inner products (linear) of `point` with the first `out.len()` samples.
    pub(super) fn pairs(&self, family: KernelFamily, point: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        match family {
            KernelFamily::Gaussian => add_squared_distances(&self.data, self.stride, point, out),
            KernelFamily::Linear => add_inner_products(&self.data, self.stride, point, out),
        }
    }

    /// One row of kernel values of `point` with every sample, rounded to `f32`; padding is 0. `pairs` is scratch.
    pub(super) fn kernel_row(&self, kernel: &Kernel, point: &[f64], pairs: &mut [f64], out: &mut [f32]) {
        self.pairs(kernel.family(), point, pairs);
        kernel_of_pairs(kernel, pairs, out);
        out[self.rows..].fill(0.0);
    }
}

/// Elements of a row that are kept in the first-level cache while the features pass by.
const SPAN: usize = 1024;

#[inline(always)]
fn add_terms(family: KernelFamily, data: &[f64], stride: usize, point: &[f64], out: &mut [f64]) {
    for (block, out) in out.chunks_mut(SPAN).enumerate() {
        let start = block * SPAN;
        // four features a pass save three of four loads and stores; the sums stay in feature order
        let (fours, rest) = point.as_chunks::<4>();
        for (group, p) in fours.iter().enumerate() {
            let column = |k: usize| &data[(4 * group + k) * stride + start..][..out.len()];
            let (a, b, c, d) = (column(0), column(1), column(2), column(3));
            for (t, o) in out.iter_mut().enumerate() {
                let sum = *o + family.term(p[0], a[t]);
                let sum = sum + family.term(p[1], b[t]);
                let sum = sum + family.term(p[2], c[t]);
                *o = sum + family.term(p[3], d[t]);
            }
        }
        for (k, &p) in rest.iter().enumerate() {
            let column = &data[(4 * fours.len() + k) * stride + start..][..out.len()];
            for (o, &x) in out.iter_mut().zip(column) {
                *o += family.term(p, x);
            }
        }
    }
}

#[multiversion(targets = "simd")]
fn add_squared_distances(data: &[f64], stride: usize, point: &[f64], out: &mut [f64]) {
    add_terms(KernelFamily::Gaussian, data, stride, point, out);
}

#[multiversion(targets = "simd")]
fn add_inner_products(data: &[f64], stride: usize, point: &[f64], out: &mut [f64]) {
    add_terms(KernelFamily::Linear, data, stride, point, out);
}

/// `out = kernel(pairs)`, rounded to `f32`.
///
/// Single precision is enough: |d exp(-u)| = u exp(-u) |du / u| <= |du / u| / e, so rounding moves a value by less than 6e-8,
/// and LIBSVM keeps its rows in single precision for the same reason.
pub(super) fn kernel_of_pairs(kernel: &Kernel, pairs: &[f64], out: &mut [f32]) {
    match kernel {
        Kernel::Gaussian { gamma } => gaussian_of_squared_distances(*gamma, pairs, out),
        Kernel::Linear => round(pairs, out),
    }
}

#[multiversion(targets = "simd")]
fn gaussian_of_squared_distances(gamma: f64, pairs: &[f64], out: &mut [f32]) {
    let kernel = Kernel::Gaussian { gamma };
    for (o, &p) in out.iter_mut().zip(pairs) {
        *o = kernel.of_pair(p) as f32;
    }
}

#[multiversion(targets = "simd")]
fn round(pairs: &[f64], out: &mut [f32]) {
    for (o, &p) in out.iter_mut().zip(pairs) {
        *o = p as f32;
    }
}
