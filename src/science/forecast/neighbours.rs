//! k nearest neighbours: the share of avalanche days among the most similar past days, as in NXD2000 and Cornice
//! (Buser 1983, Cold Reg. Sci. Technol. 8, 83-90; Purves et al. 2003, Nat. Hazards 30, 213-231).

use super::matrix::Matrix;

/// Past days to compare with: standardised rows and their labels.
#[derive(Clone, Copy, Debug)]
pub struct Neighbours<'a> {
    x: &'a Matrix,
    event: &'a [bool],
}

/// Lanes of the distance sum: a fixed number, so that every machine adds in the same order.
const LANES: usize = 4;

impl<'a> Neighbours<'a> {
    /// `x` is training days x standardised features, `event` their labels; a row without a label is never a neighbour.
    #[must_use]
    pub const fn new(x: &'a Matrix, event: &'a [bool]) -> Self {
        Self { x, event }
    }

    /// Share of avalanche days among the `k` training days nearest to `row` by Euclidean distance, each counting the same.
    ///
    /// Of training days at an equal distance the earlier row is nearer. `keep(i)` says whether training row `i` may be a
    /// neighbour; where fewer than `k` may, all of them are. `None` where none may or `k` is 0.
    #[must_use]
    pub fn probability(&self, row: &[f64], k: usize, keep: impl Fn(usize) -> bool) -> Option<f64> {
        let mut near: Vec<(f64, usize)> = (0..self.x.rows().min(self.event.len()))
            .filter(|&i| keep(i))
            .map(|i| (squared_distance(self.x.row(i), row), i))
            .collect();
        let k = k.min(near.len());
        if k == 0 {
            return None;
        }
        near.select_nth_unstable_by(k - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let events = near[..k].iter().filter(|&&(_, i)| self.event[i]).count();
        Some(events as f64 / k as f64)
    }
}

fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; LANES];
    let (a_blocks, a_rest) = a.as_chunks::<LANES>();
    let (b_blocks, b_rest) = b.as_chunks::<LANES>();
    for (p, q) in a_blocks.iter().zip(b_blocks) {
        for lane in 0..LANES {
            lanes[lane] += (p[lane] - q[lane]) * (p[lane] - q[lane]);
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(p, q)| (p - q) * (p - q)).sum();
    lanes.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::problems::waves;

    /// `KNeighborsClassifier(k, algorithm="brute").fit(X[:45], y[:45]).predict_proba(X[45:])` of scikit-learn 1.9.1 on
    /// [`waves`].
    #[test]
    fn shares_are_those_of_scikit_learn() {
        let (x, event) = waves();
        let training: Vec<usize> = (0..45).collect();
        let past = x.select_rows(&training);
        let neighbours = Neighbours::new(&past, &event[..45]);
        let thirds = [1, 1, 0, 1, 2, 2, 0, 2, 3, 0, 1, 3, 2, 0, 0];
        let tenths = [5, 3, 3, 4, 8, 6, 0, 6, 6, 2, 3, 7, 5, 3, 2];
        for row in 45..60 {
            let share = |k| neighbours.probability(x.row(row), k, |_| true);
            assert_eq!(share(3), Some(f64::from(thirds[row - 45]) / 3.0), "row {row}");
            assert_eq!(share(10), Some(f64::from(tenths[row - 45]) / 10.0), "row {row}");
        }
    }

    #[test]
    fn the_earlier_of_equals_is_nearer_and_a_fold_can_be_left_out() {
        let x = Matrix::from_rows(4, 1, vec![1.0, -1.0, 1.0, 5.0]).unwrap();
        let neighbours = Neighbours::new(&x, &[true, false, false, true]);
        assert_eq!(neighbours.probability(&[0.0], 1, |_| true), Some(1.0));
        assert_eq!(neighbours.probability(&[0.0], 2, |_| true), Some(0.5));
        assert_eq!(neighbours.probability(&[0.0], 1, |i| i != 0), Some(0.0));
        assert_eq!(neighbours.probability(&[0.0], 9, |i| i >= 2), Some(0.5));
        assert_eq!(neighbours.probability(&[0.0], 1, |_| false), None);
        assert_eq!(neighbours.probability(&[0.0], 0, |_| true), None);
    }
}
