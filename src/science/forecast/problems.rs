//! Samples that Rust and Python make alike, so that tests can compare with scikit-learn.

use super::matrix::Matrix;

/// 60 rows of 4 features and their labels; in Python with numpy, `i` a column of 0 to 59 and `j` a row of 0 to 3:
/// ```python
/// X = np.sin(1.7*i + 2.3*j*j + 0.5*i*j) + 0.3*np.cos(0.9*i*(j + 1))
/// z = 1.2*X[:,0] - 0.8*X[:,1] + 0.5*X[:,2]*X[:,3] + 0.7*np.sin(5.1*np.arange(60))
/// y = z > 0.4
/// ```
/// 24 rows are events; no `z` is within 0.017 of 0.4, so rounding cannot move a label.
pub(crate) fn waves() -> (Matrix, Vec<bool>) {
    let entry = |i: f64, j: f64| (1.7 * i + 2.3 * j * j + 0.5 * i * j).sin() + 0.3 * (0.9 * i * (j + 1.0)).cos();
    let data: Vec<f64> = (0..240).map(|k| entry(f64::from(k / 4), f64::from(k % 4))).collect();
    let x = Matrix::from_rows(60, 4, data).unwrap();
    let event = |i: usize| {
        let row = x.row(i);
        1.2 * row[0] - 0.8 * row[1] + 0.5 * row[2] * row[3] + 0.7 * (5.1 * i as f64).sin() > 0.4
    };
    let labels = (0..60).map(event).collect();
    (x, labels)
}

/// 90 rows of 8 features by the formulas of [`waves`] (its entries and labels are the beginning of these).
///
/// No `z` is within 0.007 of 0.4, so rounding cannot move a label.
pub(crate) fn eight_waves() -> (Matrix, Vec<bool>) {
    let entry = |i: f64, j: f64| (1.7 * i + 2.3 * j * j + 0.5 * i * j).sin() + 0.3 * (0.9 * i * (j + 1.0)).cos();
    let data: Vec<f64> = (0..720).map(|k| entry(f64::from(k / 8), f64::from(k % 8))).collect();
    let x = Matrix::from_rows(90, 8, data).unwrap();
    let event = |i: usize| {
        let row = x.row(i);
        1.2 * row[0] - 0.8 * row[1] + 0.5 * row[2] * row[3] + 0.7 * (5.1 * i as f64).sin() > 0.4
    };
    let labels = (0..90).map(event).collect();
    (x, labels)
}
