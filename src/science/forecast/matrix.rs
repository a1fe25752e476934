//! A dense row-major matrix: one row a sample (a day), one column a feature.

/// Dense row-major `rows x cols` matrix of `f64`; a missing entry is NaN until it is imputed.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    rows: usize,
    cols: usize,
    data: Vec<f64>,
}

impl Matrix {
    /// A matrix of `rows x cols` entries that are all `value`.
    #[must_use]
    pub fn filled(rows: usize, cols: usize, value: f64) -> Self {
        Self { rows, cols, data: vec![value; rows * cols] }
    }

    /// Takes row-major `data`; `None` unless its length is `rows * cols`.
    #[must_use]
    pub fn from_rows(rows: usize, cols: usize, data: Vec<f64>) -> Option<Self> {
        (data.len() == rows * cols).then_some(Self { rows, cols, data })
    }

    /// Number of rows (samples).
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns (features).
    #[must_use]
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// Row `i` as a slice of length `cols`.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        &self.data[i * self.cols..(i + 1) * self.cols]
    }

    /// Row `i` as a mutable slice of length `cols`.
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.data[i * self.cols..(i + 1) * self.cols]
    }

    /// Column `j`, copied.
    #[must_use]
    pub fn column(&self, j: usize) -> Vec<f64> {
        (0..self.rows).map(|i| self.data[i * self.cols + j]).collect()
    }

    /// A new matrix of the columns named by `index`, in that order.
    #[must_use]
    pub fn select_columns(&self, index: &[usize]) -> Self {
        let data = (0..self.rows).flat_map(|i| index.iter().map(move |&j| self.data[i * self.cols + j])).collect();
        Self { rows: self.rows, cols: index.len(), data }
    }

    /// A new matrix of the rows named by `index`, in that order.
    #[must_use]
    pub fn select_rows(&self, index: &[usize]) -> Self {
        let data = index.iter().flat_map(|&i| self.row(i).iter().copied()).collect();
        Self { rows: index.len(), cols: self.cols, data }
    }
}
