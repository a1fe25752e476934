//! Counting pairs of points by their distance, exactly.
//!
//! The points are split into blocks of neighbours. The boxes of two blocks bound the distances between them: radii below count none of
//! their pairs and radii above all, so that only the few radii between are compared with squared distances, many at a time.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use multiversion::multiversion;
use rayon::prelude::*;

use super::error::EmissionError;
use crate::progress::Progress;

/// Most points of a block.
const BLOCK: usize = 32;
/// By how much the bounds of distances are widened: more than their rounding, which no count may hang on.
const WIDER: f64 = 1e-12;
/// Sets of points that errors are estimated from by leaving each out: enough to know an error to 5 %.
const SETS: usize = 1000;

/// Points in blocks of neighbours.
pub(super) struct Blocks {
    /// Coordinates, block by block.
    axes: [Vec<f64>; 3],
    /// For each of them its place in the list of points.
    places: Vec<usize>,
    blocks: Vec<Block>,
}

struct Block {
    range: Range<usize>,
    low: [f64; 3],
    high: [f64; 3],
}

/// What [`Blocks::interior`] counts, for each radius; the vectors of the sets have one entry a radius.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Interior {
    /// Points that are at least the radius away from the border.
    pub(super) centres: Vec<u64>,
    /// Pairs of a centre and another point that are at most the radius apart.
    pub(super) pairs: Vec<u64>,
    /// Centres of each set.
    pub(super) set_centres: Vec<Vec<u64>>,
    /// Ordered pairs in which the centre or the other point is of the set.
    pub(super) set_pairs: Vec<Vec<u64>>,
}

impl Blocks {
    pub(super) fn new(points: &[[f64; 3]]) -> Self {
        let mut places: Vec<usize> = (0..points.len()).collect();
        let mut blocks = Vec::new();
        split(points, &mut places, 0, &mut blocks);
        let axis = |k: usize| places.iter().map(|&place| points[place][k]).collect();
        Self { axes: [axis(0), axis(1), axis(2)], blocks, places }
    }

    /// Pairs that are at most each of the rising `radii` apart.
    ///
    /// # Errors
    /// [`EmissionError::Cancelled`].
    pub(super) fn count(&self, radii: &[f64], progress: &dyn Progress) -> Result<Vec<u64>, EmissionError> {
        let squares: Vec<f64> = radii.iter().map(|r| r * r).collect();
        let done = AtomicUsize::new(0);
        let one = |first: usize| {
            self.step(&done, "counting pairs", progress)?;
            Ok(self.count_from(first, &squares))
        };
        // the order of whole-number sums does not matter
        let add = |a: Vec<u64>, b: Vec<u64>| Ok(sum(a, &b));
        let whole = (0..self.blocks.len()).into_par_iter().map(one);
        let counts = whole.try_reduce(|| vec![0; 2 * squares.len() + 1], add)?;
        let (some, all) = counts.split_at(squares.len());
        let mut below = 0;
        let total = |(some, all): (&u64, &u64)| {
            below += all;
            some + below
        };
        Ok(some.iter().zip(all).map(total).collect())
    }

    fn step(&self, done: &AtomicUsize, phase: &str, progress: &dyn Progress) -> Result<(), EmissionError> {
        if progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
        let count = done.fetch_add(1, Ordering::Relaxed);
        if count.is_multiple_of(32) {
            progress.report(count as f64 / self.blocks.len() as f64, phase);
        }
        Ok(())
    }

    /// Pairs of the block `first` with itself and those after it: for each radius those that were compared with it, then for each
    /// radius the pairs that are known to lie below it and above the one before.
    fn count_from(&self, first: usize, squares: &[f64]) -> Vec<u64> {
        let mut counts = vec![0; 2 * squares.len() + 1];
        let mut buffer = [0.0; BLOCK * BLOCK];
        for second in first..self.blocks.len() {
            let (a, b) = (&self.blocks[first], &self.blocks[second]);
            let (near, far) = between(a, b);
            let begin = squares.partition_point(|&square| square < near);
            let end = squares.partition_point(|&square| square < far);
            let (n, m) = (a.range.len(), b.range.len());
            let pairs = if first == second { n * (n - 1) / 2 } else { n * m };
            counts[squares.len() + end] += pairs as u64;
            if begin == end {
                continue;
            }
            let buffer = &mut buffer[..pairs];
            if first == second {
                let mut rest = &mut *buffer;
                for i in a.range.clone() {
                    let (now, later) = rest.split_at_mut(a.range.end - i - 1);
                    squared_distances(self.points(i..i + 1), self.points(i + 1..a.range.end), now);
                    rest = later;
                }
            } else {
                squared_distances(self.points(a.range.clone()), self.points(b.range.clone()), buffer);
            }
            for (count, square) in counts[begin..end].iter_mut().zip(&squares[begin..end]) {
                *count += at_most(buffer, *square);
            }
        }
        counts
    }

    fn points(&self, range: Range<usize>) -> [&[f64]; 3] {
        [&self.axes[0][range.clone()], &self.axes[1][range.clone()], &self.axes[2][range]]
    }

    /// Pairs whose first point is at least the radius away from the border, for each of the rising `radii`: where the sample ends
    /// is then of no influence (border method; Ripley 1988, Statistical inference for spatial processes, chapter 3). `border` is
    /// the distance of each point from the border.
    ///
    /// # Errors
    /// [`EmissionError::Cancelled`].
    pub(super) fn interior(
        &self,
        radii: &[f64],
        border: &[f64],
        progress: &dyn Progress,
    ) -> Result<Interior, EmissionError> {
        let sets = self.places.len().min(SETS);
        let squares: Vec<f64> = radii.iter().map(|r| r * r).collect();
        // radii for which a point is a centre: the first so many
        let radii_inside = |&place: &usize| squares.partition_point(|&square| square <= border[place] * border[place]);
        let inner: Vec<usize> = self.places.iter().map(radii_inside).collect();
        let done = AtomicUsize::new(0);
        let one = |mut found: Vec<u64>, first: usize| {
            self.step(&done, "counting neighbours", progress)?;
            self.neighbours(first, &inner, &squares, sets, &mut found);
            Ok(found)
        };
        // centres of each set, pairs of its centres, pairs of its points with centres: a number a radius
        let empty = || vec![0; 3 * sets * squares.len()];
        let parts = (0..self.blocks.len()).into_par_iter().try_fold(empty, one);
        let found = parts.try_reduce(empty, |a, b| Ok(sum(a, &b)))?;
        let part = |part: usize, set: usize, k: usize| found[(part * sets + set) * squares.len() + k];
        let of_set = |set: usize, value: &dyn Fn(usize, usize) -> u64| -> Vec<u64> {
            (0..squares.len()).map(|k| value(set, k)).collect()
        };
        let all = |value: &dyn Fn(usize, usize) -> u64| -> Vec<u64> {
            (0..squares.len()).map(|k| (0..sets).map(|set| value(set, k)).sum()).collect()
        };
        let (centres, pairs) = (|set, k| part(0, set, k), |set, k| part(1, set, k));
        let either = |set, k| part(1, set, k) + part(2, set, k);
        Ok(Interior {
            centres: all(&centres),
            pairs: all(&pairs),
            set_centres: (0..sets).map(|set| of_set(set, &centres)).collect(),
            set_pairs: (0..sets).map(|set| of_set(set, &either)).collect(),
        })
    }

    /// Adds what the points of the block `first` have to what [`Blocks::interior`] sums.
    fn neighbours(&self, first: usize, inner: &[usize], squares: &[f64], sets: usize, found: &mut [u64]) {
        let Some(&largest) = squares.last() else { return };
        let (a, radii) = (&self.blocks[first], squares.len());
        let near: Vec<&Block> = self.blocks.iter().filter(|b| between(a, b).0 <= largest).collect();
        let mut buffer = [0.0; BLOCK];
        for i in a.range.clone() {
            // how many more are within each radius than within the one before, and of them those that are centres
            let (mut all, mut centres) = (vec![0_i64; radii + 1], vec![0_i64; radii + 1]);
            for b in &near {
                let buffer = &mut buffer[..b.range.len()];
                squared_distances(self.points(i..i + 1), self.points(b.range.clone()), buffer);
                for (j, &square) in b.range.clone().zip(buffer.iter()) {
                    if square <= largest && i != j {
                        let from = squares.partition_point(|&limit| limit < square);
                        all[from] += 1;
                        if from < inner[j] {
                            centres[from] += 1;
                            centres[inner[j]] -= 1;
                        }
                    }
                }
            }
            let set = self.places[i] % sets;
            let (mut within, mut within_centres) = (0, 0);
            for k in 0..radii {
                within += all[k];
                within_centres += centres[k];
                let at = |part: usize| (part * sets + set) * radii + k;
                if k < inner[i] {
                    found[at(0)] += 1;
                    found[at(1)] += within.unsigned_abs();
                }
                // every step down follows its step up
                found[at(2)] += within_centres.unsigned_abs();
            }
        }
    }
}

fn sum(mut a: Vec<u64>, b: &[u64]) -> Vec<u64> {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
    a
}

/// Splits `places` at the middle of their longest axis until each part fits into a block.
fn split(points: &[[f64; 3]], places: &mut [usize], from: usize, blocks: &mut Vec<Block>) {
    if places.is_empty() {
        return;
    }
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for &place in places.iter() {
        for k in 0..3 {
            low[k] = low[k].min(points[place][k]);
            high[k] = high[k].max(points[place][k]);
        }
    }
    if places.len() <= BLOCK {
        blocks.push(Block { range: from..from + places.len(), low, high });
        return;
    }
    let extent = |k: usize| high[k] - low[k];
    let axis = if extent(0) >= extent(1).max(extent(2)) { 0 } else { 1 + usize::from(extent(2) > extent(1)) };
    let middle = places.len() / 2;
    places.select_nth_unstable_by(middle, |&a, &b| points[a][axis].total_cmp(&points[b][axis]));
    let (left, right) = places.split_at_mut(middle);
    split(points, left, from, blocks);
    split(points, right, from + middle, blocks);
}

/// Bounds of the squared distances between points of two blocks.
fn between(a: &Block, b: &Block) -> (f64, f64) {
    let (mut near, mut far) = (0.0, 0.0);
    for k in 0..3 {
        let gap = (a.low[k] - b.high[k]).max(b.low[k] - a.high[k]).max(0.0);
        let span = (a.high[k] - b.low[k]).max(b.high[k] - a.low[k]);
        near += gap * gap;
        far += span * span;
    }
    (near * (1.0 - WIDER), far * (1.0 + WIDER))
}

/// Squared distances of each of the points `a` to each of the points `b`.
#[multiversion(targets = "simd")]
fn squared_distances(a: [&[f64]; 3], [x, y, z]: [&[f64]; 3], squares: &mut [f64]) {
    let rows = squares.chunks_exact_mut(x.len().max(1));
    for (i, row) in rows.enumerate() {
        let at = [a[0][i], a[1][i], a[2][i]];
        for (((square, x), y), z) in row.iter_mut().zip(x).zip(y).zip(z) {
            let (dx, dy, dz) = (x - at[0], y - at[1], z - at[2]);
            *square = dx * dx + dy * dy + dz * dz;
        }
    }
}

/// How many of the `squares` are at most `limit`.
#[multiversion(targets = "simd")]
fn at_most(squares: &[f64], limit: f64) -> u64 {
    squares.iter().map(|&square| u64::from(square <= limit)).sum()
}
