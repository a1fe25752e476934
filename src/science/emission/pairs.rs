//! Counting pairs of points by their distance: all pairs, which below 1e5 points beats a tree.
//!
//! A table over the leading bits of the squared distance says how many radii are below; only in the few cells that hold a radius
//! the squared distance itself is compared, so that the counts are exact.

use std::sync::atomic::{AtomicUsize, Ordering};

use multiversion::multiversion;
use rayon::prelude::*;

use super::error::EmissionError;
use crate::progress::Progress;

/// Bits of the upper half of a squared distance that do not address the table: the exponent and 8 bits below it do.
const SHIFT: u32 = 20 - 8;
/// Points that are compared with one point at once.
const BLOCK: usize = 512;
/// Points of one task: a counter of 32 bits does not overflow below 6e7 points.
const TASK: usize = 64;
/// Sets of counters, so that equal neighbours do not wait for each other.
const LANES: usize = 4;
/// Entry of a cell that holds a radius.
const HOLDS_A_RADIUS: u8 = u8::MAX;

/// Counts pairs of at most each of some radii.
pub(super) struct PairCounter {
    /// Squared radii, rising.
    squares: Vec<f64>,
    first_cell: u32,
    last_cell: u32,
    /// Number of squares below each cell, or [`HOLDS_A_RADIUS`].
    below: Vec<u8>,
}

/// Counters of a task by the number of radii below a distance.
type Bins = [[u32; 256]; LANES];

impl PairCounter {
    /// For up to 254 rising radii.
    pub(super) fn new(radii: &[f64]) -> Self {
        let squares: Vec<f64> = radii.iter().map(|r| r * r).collect();
        let first_cell = cell(squares[0]).saturating_sub(1);
        let last_cell = cell(squares[squares.len() - 1]) + 1;
        let entry = |number: u32| {
            let below = squares.partition_point(|&square| cell(square) < number);
            let holds = squares.get(below).is_some_and(|&square| cell(square) == number);
            if holds { HOLDS_A_RADIUS } else { below as u8 }
        };
        let below = (first_cell..=last_cell).map(entry).collect();
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
            let mut bins: Bins = [[0; 256]; LANES];
            for i in task * TASK..((task + 1) * TASK).min(n) {
                self.count_after(&axes, i, &mut bins);
            }
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            if count.is_multiple_of(32) {
                progress.report(count as f64 / tasks as f64, phase);
            }
            let total = |bin: usize| bins.iter().map(|lane| u64::from(lane[bin])).sum();
            Ok((0..self.squares.len()).map(total).collect())
        };
        let add = |mut a: Vec<u64>, b: Vec<u64>| {
            a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
            Ok(a)
        };
        // the order of whole-number sums does not matter
        let bins = (0..tasks).into_par_iter().map(one).try_reduce(|| vec![0; self.squares.len()], add)?;
        let mut sum = 0;
        Ok(bins
            .into_iter()
            .map(|count| {
                sum += count;
                sum
            })
            .collect())
    }

    /// Adds the pairs of point `i` with those after it.
    fn count_after(&self, axes: &[Vec<f64>; 3], i: usize, bins: &mut Bins) {
        let (mut squares, mut cells) = ([0.0; BLOCK], [0; BLOCK]);
        let at = [axes[0][i], axes[1][i], axes[2][i]];
        let n = axes[0].len();
        let mut from = i + 1;
        while from < n {
            let to = (from + BLOCK).min(n);
            let (squares, cells) = (&mut squares[..to - from], &mut cells[..to - from]);
            let others = [&axes[0][from..to], &axes[1][from..to], &axes[2][from..to]];
            squared_distances(at, others, squares);
            table_cells(squares, self.first_cell, self.last_cell, cells);
            for (k, (&cell, &square)) in cells.iter().zip(squares.iter()).enumerate() {
                let mut bin = self.below[cell as usize];
                if bin == HOLDS_A_RADIUS {
                    bin = self.squares.partition_point(|&radius| radius < square) as u8;
                }
                bins[k % LANES][usize::from(bin)] += 1;
            }
            from = to;
        }
    }
}

/// The leading bits of a positive number.
const fn cell(square: f64) -> u32 {
    (square.to_bits() >> 32) as u32 >> SHIFT
}

#[multiversion(targets = "simd")]
fn squared_distances(at: [f64; 3], [x, y, z]: [&[f64]; 3], squares: &mut [f64]) {
    for (((square, x), y), z) in squares.iter_mut().zip(x).zip(y).zip(z) {
        let (dx, dy, dz) = (x - at[0], y - at[1], z - at[2]);
        *square = dx * dx + dy * dy + dz * dz;
    }
}

/// Cells of `squares` in the table, those beyond its ends in its first and last one.
#[multiversion(targets = "simd")]
fn table_cells(squares: &[f64], first: u32, last: u32, cells: &mut [u32]) {
    for (target, &square) in cells.iter_mut().zip(squares) {
        *target = cell(square).clamp(first, last) - first;
    }
}
