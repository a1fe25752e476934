//! How much the objective of a Gaussian machine changes when a feature is taken out of its kernel: DJ of Guyon et al. (2002).

use multiversion::multiversion;
use rayon::prelude::*;

use super::downdate::Triangle;
use super::gram::Gram;
use super::kernel::Kernel;
use crate::forecast::matrix::Matrix;

/// Pairs that are summed side by side.
const LANES: usize = 32;

/// Support vectors that are one task.
const BLOCK: usize = 32;

/// Largest argument of the polynomial of [`growth_of_small`].
const SMALL: f64 = 0.25;

/// Doublings of the argument in single precision; features that need more are summed in double precision.
const MOST_DOUBLINGS: u32 = 6;

/// The features of a training set as the criterion reads them.
pub(super) struct Criterion {
    gamma: f64,
    columns: Vec<Column>,
}

/// A feature, scaled so that the squared difference of two rows is `gamma (x_i - x_j)^2 / 2^doublings`.
struct Column {
    raw: Vec<f64>,
    scaled: Vec<f32>,
    /// `None` for a feature so wide that its kernel leaves the range of single precision.
    doublings: Option<u32>,
}

/// The support vectors of a machine.
struct Support {
    row: Vec<usize>,
    beta: Vec<f64>,
}

impl Criterion {
    /// Of the rows of `x` (standardised features) and a kernel of that `gamma`.
    pub(super) fn new(x: &Matrix, gamma: f64) -> Self {
        Self { gamma, columns: (0..x.cols()).map(|j| Column::new(x.column(j), gamma)).collect() }
    }

    /// |DJ| of each of the `kept` features, in their order, for the machine `beta` (`alpha_i y_i`) on the kernel of `gram`, whose
    /// squared distances are `table`.
    ///
    /// As `DJ = sum over pairs i < j of beta_i beta_j K_ij (1 - exp(gamma (x_if - x_jf)^2))`, only the last factor is
    /// computed a feature. It is computed without cancellation, so single precision costs parts in 1e6 of a sum whose machine
    /// is known to `epsilon`.
    pub(super) fn changes(&self, table: &Triangle, gram: &Gram, beta: &[f64], kept: &[usize]) -> Vec<f64> {
        let support = Support::of(beta, gram.rows());
        let stride = support.row.len().next_multiple_of(LANES);
        let gathered: Vec<f32> = kept
            .iter()
            .flat_map(|&f| {
                let scaled = &self.columns[f].scaled;
                let padding = std::iter::repeat_n(0.0, stride - support.row.len());
                support.row.iter().map(|&i| scaled[i]).chain(padding)
            })
            .collect();
        let narrow: Vec<(usize, u32)> =
            kept.iter().enumerate().filter_map(|(k, &f)| Some((k, self.columns[f].doublings?))).collect();
        let wide: Vec<usize> = (0..kept.len()).filter(|&k| self.columns[kept[k]].doublings.is_none()).collect();
        let blocks: Vec<Vec<f64>> = (0..support.row.len().div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let mut sums = vec![0.0; kept.len()];
                let mut weights = vec![0.0_f32; stride];
                for i in block * BLOCK..((block + 1) * BLOCK).min(support.row.len()) {
                    support.weigh(gram, i, &mut weights);
                    let used = i.next_multiple_of(LANES);
                    for &(k, doublings) in &narrow {
                        let column = &gathered[k * stride..][..stride];
                        let sum = growth(doublings, column[i], &column[..used], &weights[..used]);
                        sums[k] += support.beta[i] * sum;
                    }
                    for &k in &wide {
                        sums[k] += support.beta[i] * self.wide(table, &support, i, &self.columns[kept[k]].raw);
                    }
                }
                sums
            })
            .collect();
        // in the order of the blocks, whichever thread had them
        let mut changes = vec![0.0; kept.len()];
        for sums in blocks {
            changes.iter_mut().zip(sums).for_each(|(change, sum)| *change += sum);
        }
        changes.into_iter().map(f64::abs).collect()
    }

    /// The sum of `beta_j (K(-f)_ij - K_ij)` over `j < i` in double precision, for a feature of any width.
    fn wide(&self, table: &Triangle, support: &Support, i: usize, raw: &[f64]) -> f64 {
        let kernel = Kernel::Gaussian { gamma: self.gamma };
        let row = support.row[i];
        support.row[..i].iter().zip(&support.beta).fold(0.0, |sum, (&j, &beta)| {
            let difference = raw[row] - raw[j];
            let distance = table.pair(row, j);
            let without = (distance - difference * difference).max(0.0);
            sum + beta * (kernel.of_pair(without) - kernel.of_pair(distance))
        })
    }
}

impl Column {
    fn new(raw: Vec<f64>, gamma: f64) -> Self {
        let (least, most) = raw.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &x| (a.min(x), b.max(x)));
        let largest = gamma * (most - least) * (most - least);
        let doublings = (0..=MOST_DOUBLINGS).find(|&k| largest <= SMALL * f64::from(1_u32 << k));
        let scale = (gamma / f64::from(1_u32 << doublings.unwrap_or(0))).sqrt();
        Self { scaled: raw.iter().map(|x| (x * scale) as f32).collect(), raw, doublings }
    }
}

impl Support {
    fn of(beta: &[f64], rows: usize) -> Self {
        let row: Vec<usize> = (0..rows).filter(|&i| beta[i] != 0.0).collect();
        Self { beta: row.iter().map(|&i| beta[i]).collect(), row }
    }

    /// `beta_j K_ij` of every `j < i`, then zeros.
    fn weigh(&self, gram: &Gram, i: usize, weights: &mut [f32]) {
        let kernel = gram.padded_row(self.row[i]);
        for ((weight, &j), &beta) in weights.iter_mut().zip(&self.row[..i]).zip(&self.beta) {
            *weight = beta as f32 * kernel[j];
        }
        weights[i..].fill(0.0);
    }
}

/// `exp(z) - 1` for `z` from 0 to [`SMALL`], relative error below 1.5e-6: five terms of the series.
#[inline(always)]
fn growth_of_small(z: f32) -> f32 {
    let tail = z * (1.0 / 120.0) + 1.0 / 24.0;
    let tail = tail * z + 1.0 / 6.0;
    let tail = tail * z + 0.5;
    let tail = tail * z + 1.0;
    tail * z
}

/// The sum of `weights_j (exp(2^doublings (x - column_j)^2) - 1)`.
#[multiversion(targets = "simd")]
fn growth(doublings: u32, x: f32, column: &[f32], weights: &[f32]) -> f64 {
    match doublings {
        0 => growth_doubled::<0>(x, column, weights),
        1 => growth_doubled::<1>(x, column, weights),
        2 => growth_doubled::<2>(x, column, weights),
        3 => growth_doubled::<3>(x, column, weights),
        4 => growth_doubled::<4>(x, column, weights),
        5 => growth_doubled::<5>(x, column, weights),
        _ => growth_doubled::<MOST_DOUBLINGS>(x, column, weights),
    }
}

#[inline(always)]
fn growth_doubled<const DOUBLINGS: u32>(x: f32, column: &[f32], weights: &[f32]) -> f64 {
    let mut sum = [0.0_f32; LANES];
    for (others, weights) in column.as_chunks::<LANES>().0.iter().zip(weights.as_chunks::<LANES>().0) {
        for lane in 0..LANES {
            let difference = x - others[lane];
            let mut grown = growth_of_small(difference * difference);
            // exp(2 z) - 1 = (exp(z) - 1) (exp(z) + 1)
            for _ in 0..DOUBLINGS {
                grown *= grown + 2.0;
            }
            sum[lane] += weights[lane] * grown;
        }
    }
    sum.iter().fold(0.0, |total, &lane| total + f64::from(lane))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The growth of every argument up to the widest that single precision takes, against the platform's `exp_m1`.
    #[test]
    fn growth_is_that_of_the_platform() {
        for doublings in 0..=MOST_DOUBLINGS {
            let mut worst = 0.0_f64;
            for step in 1..=20_000_u32 {
                // the difference of the arguments is exact: the second is 0
                let x = (SMALL * f64::from(step) / 20_000.0).sqrt() as f32;
                let column = [0.0; LANES];
                let mut weights = [0.0; LANES];
                weights[3] = 1.0;
                let exact = (f64::from(x) * f64::from(x) * f64::from(1_u32 << doublings)).exp_m1();
                worst = worst.max((growth(doublings, x, &column, &weights) / exact - 1.0).abs());
            }
            // the series ends at z^5 / 720 of z, and rounding the square moves exp(z) by z of that
            let allowed = (1.5e-6 + 3e-7) * (1.0 + SMALL * f64::from(1_u32 << doublings));
            assert!(worst < allowed, "{doublings} doublings: {worst:e}, allowed {allowed:e}");
        }
    }
}
