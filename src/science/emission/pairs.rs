//! Counting pairs of points by their distance: all pairs, which below 1e5 points beats a tree.
//!
//! A table over the leading bits of the squared distance says how many radii are below; one comparison decides the cells that
//! hold a radius, so that the counts are exact.

use std::sync::atomic::{AtomicUsize, Ordering};

use multiversion::multiversion;
use rayon::prelude::*;

use super::error::EmissionError;
use crate::progress::Progress;

/// Leading bits of a squared distance that address the table: the exponent and 11 bits below.
const SHIFT: u32 = 52 - 11;
/// Points that are compared with one point at once.
const BLOCK: usize = 512;
/// Points of one task.
const TASK: usize = 64;
/// Sets of counters, so that equal neighbours do not wait for each other.
const LANES: usize = 4;

/// Counts pairs of at most each of some radii.
pub(super) struct PairCounter {
    /// Squared radii, rising, and an infinite one.
    squares: Vec<f64>,
    first_cell: u64,
    last_cell: u64,
    /// Number of squares below the beginning of each cell.
    below: Vec<u8>,
}

impl PairCounter {
    /// For up to 254 rising radii, neighbours of which differ by more than 0.1 %.
    pub(super) fn new(radii: &[f64]) -> Self {
        let mut squares: Vec<f64> = radii.iter().map(|r| r * r).collect();
        let first_cell = (squares[0].to_bits() >> SHIFT).saturating_sub(1);
        let last_cell = (squares[squares.len() - 1].to_bits() >> SHIFT) + 1;
        let below = (first_cell..=last_cell).map(|cell| squares.partition_point(|s| s.to_bits() < cell << SHIFT) as u8);
        let below = below.collect();
        squares.push(f64::INFINITY);
        Self { squares, first_cell, last_cell, below }
    }

    /// Pairs of `points` that are at most each radius apart.
    pub(super) fn count(
        &self,
        points: &[[f64; 3]],
        progress: &dyn Progress,
        phase: &str,
    ) -> Result<Vec<u64>, EmissionError> {
        let axis = |k: usize| points.iter().map(|point| point[k]).collect::<Vec<f64>>();
        let axes = [axis(0), axis(1), axis(2)];
        let n = points.len();
        let tasks = n.div_ceil(TASK);
        let done = AtomicUsize::new(0);
        let one = |task: usize| {
            if progress.cancelled() {
                return Err(EmissionError::Cancelled);
            }
            let mut bins = vec![[0_u64; LANES]; self.squares.len()];
            for i in task * TASK..((task + 1) * TASK).min(n) {
                self.count_after(&axes, i, &mut bins);
            }
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            if count.is_multiple_of(32) {
                progress.report(count as f64 / tasks as f64, phase);
            }
            Ok(bins.iter().map(|lanes| lanes.iter().sum()).collect())
        };
        let add = |mut a: Vec<u64>, b: Vec<u64>| {
            a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
            Ok(a)
        };
        // the order of whole-number sums does not matter
        let bins = (0..tasks).into_par_iter().map(one).try_reduce(|| vec![0; self.squares.len()], add)?;
        let mut sum = 0;
        Ok(bins[..bins.len() - 1]
            .iter()
            .map(|count| {
                sum += count;
                sum
            })
            .collect())
    }

    /// Adds the pairs of point `i` with those after it.
    fn count_after(&self, axes: &[Vec<f64>; 3], i: usize, bins: &mut [[u64; LANES]]) {
        let mut squares = [0.0; BLOCK];
        let n = axes[0].len();
        let mut from = i + 1;
        while from < n {
            let to = (from + BLOCK).min(n);
            let at = [axes[0][i], axes[1][i], axes[2][i]];
            let block = &mut squares[..to - from];
            squared_distances(at, &axes[0][from..to], &axes[1][from..to], &axes[2][from..to], block);
            for (k, &square) in block.iter().enumerate() {
                let cell = (square.to_bits() >> SHIFT).clamp(self.first_cell, self.last_cell) - self.first_cell;
                let below = usize::from(self.below[cell as usize]);
                let bin = below + usize::from(self.squares[below] < square);
                bins[bin][k % LANES] += 1;
            }
            from = to;
        }
    }
}

#[multiversion(targets("x86_64+avx2", "x86_64+avx512f"))]
fn squared_distances(at: [f64; 3], x: &[f64], y: &[f64], z: &[f64], squares: &mut [f64]) {
    for (((square, x), y), z) in squares.iter_mut().zip(x).zip(y).zip(z) {
        let (dx, dy, dz) = (x - at[0], y - at[1], z - at[2]);
        *square = dx * dx + dy * dy + dz * dz;
    }
}
