//! Random problems for the tests, from well separated to degenerate.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::kernel::Kernel;
use super::solver::Cost;
use crate::forecast::matrix::Matrix;

/// A training set with everything a fit needs.
#[derive(Clone)]
pub(super) struct Problem {
    pub(super) name: String,
    pub(super) x: Matrix,
    pub(super) labels: Vec<bool>,
    pub(super) kernel: Kernel,
    pub(super) cost: Cost,
}

/// Standard normal, by Box & Muller.
fn normal(rng: &mut impl Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn pick<T: Copy>(rng: &mut impl Rng, values: &[T]) -> T {
    values[rng.random_range(0..values.len())]
}

/// Problem number `seed`: both kernels, all sizes to a few hundred, class weights, constant columns, duplicated rows with
/// equal and with opposite labels.
pub(super) fn problem(seed: u64) -> Problem {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rows = match seed % 4 {
        0 => rng.random_range(2..12),
        1 => rng.random_range(12..60),
        2 => rng.random_range(60..160),
        _ => rng.random_range(160..320),
    };
    let columns = rng.random_range(1..20);
    let constant = rng.random_range(0..columns + 3);
    let noise = pick(&mut rng, &[0.1, 1.0, 3.0]);
    let duplicates = pick(&mut rng, &[0, 0, rows / 4, rows / 2]);
    let direction: Vec<f64> = (0..columns).map(|_| normal(&mut rng)).collect();
    let mut data: Vec<Vec<f64>> = Vec::new();
    let mut labels: Vec<bool> = Vec::new();
    for row in 0..rows {
        if row >= rows - duplicates {
            let original = rng.random_range(0..rows - duplicates);
            data.push(data[original].clone());
            labels.push(labels[original] ^ (rng.random_range(0..3) == 0));
            continue;
        }
        let x: Vec<f64> = (0..columns).map(|c| if c == constant { 1.5 } else { normal(&mut rng) }).collect();
        let score: f64 = x.iter().zip(&direction).map(|(a, b)| a * b).sum::<f64>() + (x[0] * x[0] - 1.0);
        labels.push(score + noise * normal(&mut rng) > 0.8);
        data.push(x);
    }
    // both classes, whatever came out
    labels[0] = true;
    labels[1] = false;
    let (kernel, c) = if seed % 5 < 3 {
        let gamma = pick(&mut rng, &[0.001, 0.01, 0.1, 1.0, 5.0]);
        (Kernel::Gaussian { gamma }, pick(&mut rng, &[0.01, 0.1, 1.0, 10.0, 100.0]))
    } else {
        // beyond, a linear machine of few noisy features takes any SMO millions of iterations
        (Kernel::Linear, pick(&mut rng, &[0.001, 0.01, 0.1, 1.0]))
    };
    let cost = match rng.random_range(0..3) {
        0 => Cost::uniform(c),
        1 => Cost { positive: c * 3.0, negative: c * 0.4 },
        _ => Cost::balanced(c, &labels),
    };
    let name = format!("problem {seed}: {rows} x {columns}, {duplicates} duplicates, {kernel:?}, {cost:?}");
    Problem { name, x: Matrix::from_rows(rows, columns, data.concat()).unwrap(), labels, kernel, cost }
}

/// Decision values and labels number `seed` for a calibration: overlapping to separated classes, any base rate.
pub(super) fn decisions(seed: u64) -> (Vec<f64>, Vec<bool>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (rows, rate) = (rng.random_range(4..400), pick(&mut rng, &[0.05, 0.2, 0.5]));
    let (shift, width) = (pick(&mut rng, &[0.0, 0.5, 2.0, 6.0]), pick(&mut rng, &[0.1, 1.0, 5.0]));
    let mut labels: Vec<bool> = (0..rows).map(|_| rng.random::<f64>() < rate).collect();
    (labels[0], labels[1]) = (true, false);
    let decision = labels.iter().map(|&event| width * (normal(&mut rng) + if event { shift } else { 0.0 })).collect();
    (decision, labels)
}

/// A set ordered by season with its folds: `seasons` blocks of `length` days, a fifth of them events.
pub(super) fn seasons(seed: u64, seasons: usize, length: usize) -> (Matrix, Vec<bool>, Vec<usize>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (rows, columns) = (seasons * length, 7);
    let data: Vec<f64> = (0..rows * columns).map(|_| normal(&mut rng)).collect();
    let labels = data.chunks(columns).map(|x| x[0] + x[1] * x[2] + normal(&mut rng) > 1.3).collect();
    let fold = (0..rows).map(|row| row / length).collect();
    (Matrix::from_rows(rows, columns, data).unwrap(), labels, fold)
}
