//! Pickers: where in a waveform the burst begins.

/// Onset by Akaike's information criterion on the signal itself (Maeda 1985, J. Seism. Soc. Japan 38, 365-379): the sample k that
/// minimises `k ln var(x[..k]) + (n - k - 1) ln var(x[k..])`; `None` for fewer than 8 samples or a signal without two parts.
///
/// The window should hold noise before and signal after the onset, and end near the peak.
#[must_use]
pub fn aic(samples: &[f64]) -> Option<usize> {
    const EDGE: usize = 3;
    let n = samples.len();
    if n < 2 * EDGE + 2 {
        return None;
    }
    // sums about the mean, so that an offset does not swallow the variance
    let centre = samples.iter().sum::<f64>() / n as f64;
    let mut sums = vec![(0.0, 0.0)];
    let (mut sum, mut squares) = (0.0, 0.0);
    for sample in samples {
        let x = sample - centre;
        sum += x;
        squares += x * x;
        sums.push((sum, squares));
    }
    let variance = |from: usize, to: usize| {
        let count = (to - from) as f64;
        let (s, q) = (sums[to].0 - sums[from].0, sums[to].1 - sums[from].1);
        (q / count - (s / count) * (s / count)).max(0.0)
    };
    // what is constant to rounding has no logarithm of its own
    let floor = 1e-24 * variance(0, n);
    let value = |k: usize| {
        let (before, after) = (variance(0, k).max(floor), variance(k, n).max(floor));
        k as f64 * before.ln() + (n - k - 1) as f64 * after.ln()
    };
    if floor == 0.0 {
        return None;
    }
    (EDGE..n - EDGE).min_by(|&a, &b| value(a).total_cmp(&value(b)))
}

/// Onset by Hinkley's criterion: the sample that minimises the partial energy less a trend, `sum x^2 - i E / (alpha n)` with E the whole
/// energy (Hinkley 1971, Biometrika 58, 509-523; Kurz, Grosse & Reinhardt 2005, Ultrasonics 43, 538-546).
///
/// A larger `alpha` (1 and more) weakens the trend and picks earlier. `None` without samples or energy, or for an alpha below 1.
#[must_use]
pub fn hinkley(samples: &[f64], alpha: f64) -> Option<usize> {
    let energy: f64 = samples.iter().map(|x| x * x).sum();
    if !(energy > 0.0 && alpha >= 1.0) {
        return None;
    }
    let trend = energy / (alpha * samples.len() as f64);
    let mut partial = 0.0;
    let mut best = (f64::INFINITY, 0);
    for (i, x) in samples.iter().enumerate() {
        partial += x * x - trend;
        if partial < best.0 {
            best = (partial, i);
        }
    }
    // the minimum is the last sample of the noise
    Some((best.1 + 1).min(samples.len() - 1))
}
