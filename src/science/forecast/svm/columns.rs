//! Rows of features stored by column, so that one row against all others runs over contiguous memory.

use multiversion::multiversion;
use nalgebra::DMatrix;

use super::kernel::{Kernel, KernelFamily};
use super::lanes::{dot, padded};
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

    /// The features, one padded column each.
    fn features(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.data.chunks_exact(self.stride.max(1))
    }

    /// Sum of the squared features of each sample.
    pub(super) fn square_norms(&self) -> Vec<f64> {
        let mut norms = vec![0.0; self.rows];
        for column in self.features() {
            norms.iter_mut().zip(column).for_each(|(norm, x)| *norm += x * x);
        }
        norms
    }

    /// `X' weights`: the sum of all samples, each with its weight; one entry a feature.
    pub(super) fn combination(&self, weights: &[f64]) -> Vec<f64> {
        let mut padded = weights.to_vec();
        padded.resize(self.stride, 0.0);
        combine(&self.data, self.stride, &padded)
    }

    /// `X normal`: the inner product of every sample with `normal`.
    pub(super) fn products(&self, normal: &[f64]) -> Vec<f64> {
        let mut products = vec![0.0; self.rows];
        add_inner_products(&self.data, self.stride, normal, &mut products);
        products
    }

    /// `I + X' diag(weights) X`, features x features.
    pub(super) fn weighted_products(&self, weights: &[f64]) -> DMatrix<f64> {
        let mut padded = weights.to_vec();
        padded.resize(self.stride, 0.0);
        let lower = weigh(&self.data, self.stride, &padded);
        let features = self.features().len();
        DMatrix::from_fn(features, features, |a, b| {
            lower[a.max(b) * features + a.min(b)] + if a == b { 1.0 } else { 0.0 }
        })
    }
}

#[multiversion(targets = "simd")]
fn combine(data: &[f64], stride: usize, weights: &[f64]) -> Vec<f64> {
    data.chunks_exact(stride.max(1)).map(|column| dot(weights, column)).collect()
}

/// The lower triangle of `X' diag(weights) X`, row after row; the rest is 0.
#[multiversion(targets = "simd")]
fn weigh(data: &[f64], stride: usize, weights: &[f64]) -> Vec<f64> {
    let features = data.len() / stride.max(1);
    let mut products = vec![0.0; features * features];
    let mut weighted = vec![0.0; stride];
    for (a, column) in data.chunks_exact(stride.max(1)).enumerate() {
        for ((target, weight), x) in weighted.iter_mut().zip(weights).zip(column) {
            *target = weight * x;
        }
        for (b, other) in data.chunks_exact(stride.max(1)).take(a + 1).enumerate() {
            products[a * features + b] = dot(&weighted, other);
        }
    }
    products
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
