//! Rates after main shocks: Omori's law, productivity.

use serde::{Deserialize, Serialize};

use super::error::{EmissionError, positive};
use super::numerics::{Z95, errors_from_curvature, line, log_spaced, maximum};
use crate::progress::Progress;

/// How main shocks are chosen and followed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct AftershockOptions {
    /// Rising edges of the classes of main-shock amplitude, V; empty takes half decades from the smallest amplitude on.
    pub class_edges_v: Vec<f64>,
    /// How long after a main shock events are counted, s; none takes a hundredth of the length of the catalogue.
    pub window_s: Option<f64>,
    /// Bins of the rate, in equal ratios of time.
    pub bins: usize,
}

impl Default for AftershockOptions {
    fn default() -> Self {
        Self { class_edges_v: Vec::new(), window_s: None, bins: 20 }
    }
}

/// The stacked rate in one bin of time since the main shock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RatePoint {
    /// Beginning, s after the main shock.
    pub from_s: f64,
    /// End, s after the main shock.
    pub to_s: f64,
    /// Events of all main shocks of the class.
    pub events: usize,
    /// Events a second and main shock.
    pub rate_per_s: f64,
    /// Its standard error from the Poisson number of events.
    pub error_per_s: f64,
}

/// `K / (t + c)^p + background`, by maximum likelihood (Ogata 1983, J. Phys. Earth 31, 115-124).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct OmoriFit {
    /// Exponent p.
    pub p: f64,
    /// Its standard error; missing where the likelihood has no inner maximum.
    pub p_se: Option<f64>,
    /// 95 % interval of p.
    pub p_ci95: Option<[f64; 2]>,
    /// c, s.
    pub c_s: f64,
    /// Share of the counted events that are aftershocks and not background.
    pub aftershock_share: f64,
    /// Rate of aftershocks of a main shock at its time, `K c^-p` of `K (t + c)^-p`, 1/s.
    pub first_rate_per_s: f64,
    /// Rate of the background, 1/s.
    pub background_per_s: f64,
    /// Twice the log likelihood over that of a constant rate; three parameters more.
    pub likelihood_ratio: f64,
}

impl OmoriFit {
    /// Rate of hits at a delay, 1/s a main shock.
    #[must_use]
    pub fn rate_per_s(&self, delay_s: f64) -> f64 {
        self.first_rate_per_s * (-self.p * (delay_s / self.c_s).ln_1p()).exp() + self.background_per_s
    }
}

/// One class of main shocks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct AftershockClass {
    /// Smallest amplitude, V.
    pub from_v: f64,
    /// Largest amplitude, V; missing for the last class.
    pub to_v: Option<f64>,
    /// Main shocks.
    pub main_shocks: usize,
    /// Rates.
    pub rate: Vec<RatePoint>,
    /// Aftershocks a main shock: the share of Omori's law in the events of the window; 0 where nothing decays.
    pub productivity: f64,
    /// Its standard error.
    pub productivity_se: f64,
    /// Omori's law; missing where fewer than 50 events were counted or nothing decays.
    pub omori: Option<OmoriFit>,
}

/// What [`aftershocks`] finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Aftershocks {
    /// Window in use, s.
    pub window_s: f64,
    /// Classes with a main shock, rising.
    pub classes: Vec<AftershockClass>,
    /// Exponent of productivity ~ amplitude^a over the classes; missing with fewer than three productive ones.
    pub productivity_exponent: Option<f64>,
}

const FEWEST: usize = 50;

/// Follows main shocks: an event is one if no larger event (or equal one before it) lies within the window before it.
///
/// Counting stops at the next larger event and at the end of the catalogue. `times_s` do not fall.
///
/// # Errors
/// Options out of range, fewer than 50 events, or [`EmissionError::Cancelled`].
pub fn aftershocks(
    times_s: &[f64],
    amplitude_v: &[f64],
    options: &AftershockOptions,
    progress: &dyn Progress,
) -> Result<Aftershocks, EmissionError> {
    const WHAT: &str = "aftershocks";
    let n = times_s.len().min(amplitude_v.len());
    if n < FEWEST {
        return Err(EmissionError::TooFewEvents { what: WHAT, found: n, needed: FEWEST });
    }
    options.check()?;
    let length = times_s[n - 1] - times_s[0];
    if length <= 0.0 {
        return Err(EmissionError::Degenerate { what: "time_s" });
    }
    let window = positive("window_s", options.window_s.unwrap_or(length / 100.0))?;
    let edges = class_edges(options, amplitude_v);
    let mut classes: Vec<Vec<Followed>> = vec![Vec::new(); edges.len()];
    for (main, followed) in main_shocks(times_s, amplitude_v, window, progress)? {
        let class = edges.partition_point(|&edge| edge <= amplitude_v[main]);
        if class > 0 {
            classes[class - 1].push(followed);
        }
    }
    let mut found: Vec<AftershockClass> = Vec::new();
    for (k, followed) in classes.iter().enumerate().filter(|(_, followed)| !followed.is_empty()) {
        progress.report(k as f64 / classes.len() as f64, WHAT);
        found.push(class((edges[k], edges.get(k + 1).copied()), followed, window, options.bins, progress));
        if progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
    }
    Ok(Aftershocks { window_s: window, productivity_exponent: productivity_exponent(&found), classes: found })
}

impl AftershockOptions {
    pub(super) fn check(&self) -> Result<(), EmissionError> {
        if !(2..=200).contains(&self.bins) {
            return Err(EmissionError::option("bins", self.bins, "2 to 200"));
        }
        let rising = self.class_edges_v.windows(2).all(|pair| pair[0] < pair[1]);
        if !rising || !self.class_edges_v.iter().all(|edge| edge.is_finite() && *edge > 0.0) {
            let given = format!("{:?}", self.class_edges_v);
            return Err(EmissionError::option("class_edges_v", given, "rising finite numbers above 0"));
        }
        self.window_s.map(|window| positive("window_s", window)).transpose().map(|_| ())
    }
}

fn class_edges(options: &AftershockOptions, amplitudes: &[f64]) -> Vec<f64> {
    if options.class_edges_v.is_empty() {
        let low = amplitudes.iter().copied().fold(f64::INFINITY, f64::min);
        let high = amplitudes.iter().copied().fold(0.0, f64::max);
        let classes = ((high / low).log10() * 2.0).ceil().max(1.0) as usize;
        return (0..classes.min(40)).map(|k| low * 10f64.powf(k as f64 / 2.0)).collect();
    }
    options.class_edges_v.clone()
}

/// What came after one main shock.
#[derive(Clone, Debug)]
struct Followed {
    /// Delays of the events, s.
    delays: Vec<f64>,
    /// How long events were counted, s.
    span: f64,
}

/// The main shocks with their followers.
fn main_shocks(
    times: &[f64],
    amplitudes: &[f64],
    window: f64,
    progress: &dyn Progress,
) -> Result<Vec<(usize, Followed)>, EmissionError> {
    let n = times.len();
    let end = times[n - 1];
    let mut found = Vec::new();
    for main in 0..n {
        if main.is_multiple_of(256) && progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
        let (time, amplitude) = (times[main], amplitudes[main]);
        let earlier = (0..main).rev().take_while(|&i| time - times[i] <= window);
        if earlier.into_iter().any(|i| amplitudes[i] >= amplitude) {
            continue;
        }
        let mut followed = Followed { delays: Vec::new(), span: window.min(end - time) };
        for i in main + 1..n {
            let delay = times[i] - time;
            if delay > window {
                break;
            }
            if amplitudes[i] > amplitude {
                followed.span = delay;
                break;
            }
            followed.delays.push(delay);
        }
        if followed.span > 0.0 {
            found.push((main, followed));
        }
    }
    Ok(found)
}

fn class(
    (from_v, to_v): (f64, Option<f64>),
    followed: &[Followed],
    window: f64,
    bins: usize,
    progress: &dyn Progress,
) -> AftershockClass {
    let edges = log_spaced(window * 1e-4, window, bins + 1);
    let rate = edges.windows(2).filter_map(|edge| {
        let (from_s, to_s) = (edge[0], edge[1]);
        let events: usize =
            followed.iter().map(|f| f.delays.iter().filter(|d| (from_s..to_s).contains(*d)).count()).sum();
        let exposure: f64 = followed.iter().map(|f| (f.span.min(to_s) - from_s).max(0.0)).sum();
        let rate = events as f64 / exposure;
        let error_per_s = (events as f64).sqrt() / exposure;
        (exposure > 0.0).then_some(RatePoint { from_s, to_s, events, rate_per_s: rate, error_per_s })
    });
    let events: usize = followed.iter().map(|f| f.delays.len()).sum();
    let shocks = followed.len() as f64;
    let omori = omori(followed, progress);
    AftershockClass {
        from_v,
        to_v,
        main_shocks: followed.len(),
        rate: rate.collect(),
        productivity: omori.map_or(0.0, |fit| fit.aftershock_share) * events as f64 / shocks,
        productivity_se: (events as f64).sqrt() / shocks,
        omori,
    }
}

/// Fits Omori's law with a background to stacked delays.
///
/// For c and p given, the share s of aftershocks maximises `sum ln(s f(t_i) + (1 - s) g)`, where f and g are the densities of
/// both kinds over all spans; the total number of events fixes the remaining factor. `None` once it is cancelled.
fn omori(followed: &[Followed], progress: &dyn Progress) -> Option<OmoriFit> {
    let delays: Vec<f64> = followed.iter().flat_map(|f| f.delays.iter().copied()).collect();
    if delays.len() < FEWEST {
        return None;
    }
    let exposure: f64 = followed.iter().map(|f| f.span).sum();
    let spans: Vec<f64> = followed.iter().map(|f| f.span).collect();
    let longest = spans.iter().copied().fold(0.0, f64::max);
    let integral = |c: f64, p: f64, t: f64| {
        let log = (t / c).ln_1p();
        let q = 1.0 - p;
        if (q * log).abs() < 1e-9 { log } else { (q * log).exp_m1() / q }
    };
    let total = |c: f64, p: f64| spans.iter().map(|&span| integral(c, p, span)).sum::<f64>();
    let mixture = |c: f64, p: f64| {
        if progress.cancelled() {
            // nowhere better than a constant rate: the search ends at once
            return (0.0, 0.0);
        }
        let total = total(c, p);
        // f(t) relative to g = 1 / exposure
        let ratio: Vec<f64> = delays.iter().map(|&t| (-p * (t / c).ln_1p()).exp() / c * exposure / total).collect();
        best_share(&ratio)
    };
    let value = |c: f64, p: f64| mixture(c, p).1;
    let best_p = |log_c: f64| maximum(|p| value(log_c.exp(), p), 0.05, 5.0);
    let (low, high) = ((longest * 1e-6).ln(), longest.ln());
    let (log_c, likelihood) = maximum(|log_c| best_p(log_c).1, low, high);
    let (c, p) = (log_c.exp(), best_p(log_c).0);
    let (share, _) = mixture(c, p);
    if likelihood < 2.0 {
        return None;
    }
    let inside = log_c > low + 0.01 && log_c < high - 0.01 && p > 0.06 && p < 4.9;
    let p_se = errors_from_curvature(|[log_c, p]| value(log_c.exp(), p), [log_c, p]).map(|se| se[1]);
    let p_se = p_se.filter(|se| inside && se.is_finite());
    Some(OmoriFit {
        p,
        p_se,
        p_ci95: p_se.map(|se| [p - Z95 * se, p + Z95 * se]),
        c_s: c,
        aftershock_share: share,
        first_rate_per_s: share * delays.len() as f64 / (c * total(c, p)),
        background_per_s: (1.0 - share) * delays.len() as f64 / exposure,
        likelihood_ratio: 2.0 * likelihood,
    })
}

/// The share s that maximises `sum ln(s r_i + 1 - s)`, and the maximum: concave, by Newton's method kept within 0..1.
fn best_share(ratio: &[f64]) -> (f64, f64) {
    let (mut low, mut high, mut share) = (0.0, 1.0, 0.5_f64);
    for _ in 0..60 {
        let (mut slope, mut curve) = (0.0, 0.0);
        for r in ratio {
            let d = (r - 1.0) / (1.0 + share * (r - 1.0));
            slope += d;
            curve -= d * d;
        }
        if slope > 0.0 {
            low = share
        } else {
            high = share
        }
        let next = share - slope / curve;
        let next = if next > low && next < high { next } else { 0.5 * (low + high) };
        if (next - share).abs() < 1e-12 {
            break;
        }
        share = next;
    }
    (share, ratio.iter().map(|r| (share * (r - 1.0)).ln_1p()).sum())
}

fn productivity_exponent(classes: &[AftershockClass]) -> Option<f64> {
    let productive: Vec<&AftershockClass> =
        classes.iter().filter(|c| c.productivity > 2.0 * c.productivity_se && c.to_v.is_some()).collect();
    let x: Vec<f64> = productive.iter().map(|c| (c.from_v * c.to_v.unwrap_or(c.from_v)).ln() / 2.0).collect();
    let y: Vec<f64> = productive.iter().map(|c| c.productivity.ln()).collect();
    let weights: Vec<f64> = productive.iter().map(|c| (c.productivity / c.productivity_se).powi(2)).collect();
    line(&x, &y, &weights).map(|line| line.slope)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::emission::catalogue::Column;
    use crate::emission::close;
    use crate::emission::synthetic::{Clustering, SyntheticOptions, synthetic};
    use crate::progress::Unobserved;

    #[test]
    fn omori_comes_back_from_stacked_main_shocks() {
        // 400 main shocks, each with 10 aftershocks of c = 0.05 s and p = 1.4 within 20 s, and a background of 0.3 1/s
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (c, p, window) = (0.05_f64, 1.4_f64, 20.0);
        let share = 1.0 - (1.0 + window / c).powf(1.0 - p);
        let followed: Vec<Followed> = (0..400)
            .map(|_| {
                let mut delays: Vec<f64> =
                    (0..10).map(|_| c * ((1.0 - share * rng.random::<f64>()).powf(-1.0 / (p - 1.0)) - 1.0)).collect();
                delays.extend((0..6).map(|_| window * rng.random::<f64>()));
                Followed { delays, span: window }
            })
            .collect();
        let fit = omori(&followed, &Unobserved).unwrap();
        close(fit.p, p, 4.0 * fit.p_se.unwrap());
        assert!(fit.p_se.unwrap() < 0.1, "{fit:?}");
        close(fit.c_s / c, 1.0, 0.35);
        close(fit.aftershock_share, 0.625, 0.06);
        // a background alone decays nowhere
        let flat: Vec<Followed> = (0..200)
            .map(|_| Followed { delays: (0..5).map(|_| window * rng.random::<f64>()).collect(), span: window })
            .collect();
        assert!(omori(&flat, &Unobserved).is_none_or(|fit| fit.likelihood_ratio < 12.0));
    }

    #[test]
    fn larger_main_shocks_of_the_generator_have_more_aftershocks() {
        let clustering = Some(Clustering { branching_ratio: 0.5, c_s: 0.02, p: 1.5 });
        let options = SyntheticOptions { events: 20_000, clustering, length_s: 36_000.0, ..Default::default() };
        let catalogue = synthetic(&options, 1).unwrap().0;
        let times = catalogue.column(Column::TimeS).unwrap();
        let amplitudes = catalogue.amplitudes_v("x").unwrap();
        let options = AftershockOptions { window_s: Some(20.0), ..Default::default() };
        let found = aftershocks(times, &amplitudes, &options, &Unobserved).unwrap();
        let classes: Vec<&AftershockClass> = found.classes.iter().filter(|c| c.main_shocks > 20).collect();
        assert!(classes.len() >= 3);
        assert!(classes.windows(2).all(|pair| pair[1].productivity > pair[0].productivity));
        // aftershocks of aftershocks flatten the exponent of 0.5 a little
        close(found.productivity_exponent.unwrap(), 0.5, 0.2);
        let rate = &classes[2].rate;
        assert!(rate[0].rate_per_s > 20.0 * rate[rate.len() - 1].rate_per_s);
        let omori = classes[2].omori.unwrap();
        assert!((1.1..2.2).contains(&omori.p), "{omori:?}");
    }

    #[test]
    fn counting_stops_at_a_larger_event_by_hand() {
        let found = main_shocks(&[0.0, 1.0, 2.0, 3.0, 20.0], &[2.0, 1.0, 5.0, 1.0, 1.0], 10.0, &Unobserved).unwrap();
        let mains: Vec<usize> = found.iter().map(|f| f.0).collect();
        // the last event has no time left to be followed
        assert_eq!(mains, [0, 2]);
        assert_eq!((found[0].1.delays.clone(), found[0].1.span), (vec![1.0], 2.0));
        assert_eq!((found[1].1.delays.clone(), found[1].1.span), (vec![1.0], 10.0));
    }

    #[test]
    fn nonsense_is_refused_by_name() {
        let times: Vec<f64> = (0..60).map(f64::from).collect();
        let run = |options| aftershocks(&times, &[1.0; 60], &options, &Unobserved).unwrap_err().to_string();
        let base = AftershockOptions::default;
        assert!(run(AftershockOptions { window_s: Some(0.0), ..base() }).starts_with("window_s is 0"));
        assert!(run(AftershockOptions { bins: 1, ..base() }).starts_with("bins is 1"));
        assert!(run(AftershockOptions { class_edges_v: vec![2.0, 1.0], ..base() }).starts_with("class_edges_v is"));
        assert!(aftershocks(&times[..9], &[1.0; 9], &base(), &Unobserved).is_err());
    }
}
