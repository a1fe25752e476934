//! Samples that the tests share.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::tails::distribution::Distribution;

/// 200 values `0.003 + 0.05 (-ln(1 - v))^1.7` with v the fractional parts of multiples of the golden ratio; rising. The
/// reference values of other programs are of this sample.
pub(super) fn reference_sample() -> Vec<f64> {
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let value = |i: u32| 0.003 + 0.05 * (-(1.0 - (f64::from(i) * golden) % 1.0).ln()).powf(1.7);
    let mut x: Vec<f64> = (1..=200).map(value).collect();
    x.sort_by(f64::total_cmp);
    x
}

/// `n` rising draws from `x^-alpha exp(-x / cutoff)`, x >= xmin.
pub(super) fn cutoff_sample(n: usize, alpha: f64, cutoff: f64, xmin: f64, seed: u64) -> Vec<f64> {
    let draw = Distribution::cutoff(alpha - 1.0, xmin / cutoff, f64::INFINITY).sampler();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut x: Vec<f64> = (0..n).map(|_| xmin * draw.draw(&mut rng).exp()).collect();
    x.sort_by(f64::total_cmp);
    x
}

/// `n` rising draws from `x^-alpha`, x >= xmin.
pub(super) fn pareto_sample(n: usize, alpha: f64, xmin: f64, seed: u64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let draw = |rng: &mut ChaCha8Rng| xmin * (1.0 - rng.random::<f64>()).powf(-1.0 / (alpha - 1.0));
    let mut x: Vec<f64> = (0..n).map(|_| draw(&mut rng)).collect();
    x.sort_by(f64::total_cmp);
    x
}
