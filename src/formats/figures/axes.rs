//! Where the ticks of an axis stand and what is written beside them.

/// An axis of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// What is drawn along it, with its unit.
    pub label: String,
    /// Whether equal ratios are equal distances.
    pub log: bool,
}

/// The range of an axis with its ticks, as distances along it: logarithms to the base of 10 where it is logarithmic.
#[derive(Clone, Debug, PartialEq)]
pub struct Scale {
    log: bool,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Ticks with a label.
    pub ticks: Vec<f64>,
    /// Ticks without.
    pub between: Vec<f64>,
}

impl Axis {
    /// A linear axis.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: false }
    }

    /// A logarithmic axis.
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: true }
    }

    /// The scale that holds all `values`, with some room around them; values that have no place on it are left out.
    pub fn scale(&self, values: impl Iterator<Item = f64>) -> Scale {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for at in values.filter_map(|value| self.place(value)) {
            low = low.min(at);
            high = high.max(at);
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        // a single value gets a range around it
        let room = if high > low { 0.04 * (high - low) } else { (0.1 * high.abs()).max(0.1) };
        Scale::new(self.log, low - room, high + room)
    }

    /// Where a value stands along the axis.
    pub fn place(&self, value: f64) -> Option<f64> {
        let at = if self.log { (value > 0.0).then(|| value.log10())? } else { value };
        at.is_finite().then_some(at)
    }
}

impl Scale {
    fn new(log: bool, low: f64, high: f64) -> Self {
        let (ticks, between) = if log { log_ticks(low, high) } else { linear_ticks(low, high) };
        Self { log, low, high, ticks, between }
    }

    /// Whether a place along the axis is within its range.
    pub fn holds(&self, at: f64) -> bool {
        (self.low..=self.high).contains(&at)
    }

    /// What is written beside a tick.
    pub fn label(&self, at: f64) -> String {
        if !self.log {
            return number(if at.abs() < 1e-9 * (self.high - self.low) { 0.0 } else { at });
        }
        let is_decade = |at: f64| (at - at.round()).abs() < 1e-9;
        // powers of ten only beside powers of ten
        if self.ticks.iter().all(|tick| is_decade(*tick)) {
            power_of_ten(at.round() as i32)
        } else {
            number(10f64.powf(at))
        }
    }
}

/// Whole powers of ten where there are at least two, else also 2 and 5 times those.
fn log_ticks(low: f64, high: f64) -> (Vec<f64>, Vec<f64>) {
    let (first, last) = (low.floor() as i32, high.ceil() as i32);
    let inside = |at: &f64| (low..=high).contains(at);
    let digits = |digits: &'static [f64]| {
        (first..=last).flat_map(move |power| digits.iter().map(move |digit| f64::from(power) + digit.log10()))
    };
    let decades: Vec<f64> = digits(&[1.0]).filter(inside).collect();
    const MOST: usize = 9;
    if decades.len() > MOST {
        let every = decades.len().div_ceil(MOST) as i32;
        let ticks = decades.iter().copied().filter(|at| (*at as i32).rem_euclid(every) == 0).collect();
        return (ticks, decades);
    }
    let between: Vec<f64> = digits(&[2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]).filter(inside).collect();
    if decades.len() >= 2 {
        return (decades, between);
    }
    let ticks: Vec<f64> = digits(&[1.0, 2.0, 5.0]).filter(inside).collect();
    if ticks.len() >= 2 {
        return (ticks, between);
    }
    // less than a factor of 2: as on a linear axis
    let (ticks, _) = linear_ticks(10f64.powf(low), 10f64.powf(high));
    (ticks.into_iter().filter(|value| *value > 0.0).map(f64::log10).filter(inside).collect(), Vec::new())
}

/// Multiples of 1, 2 or 5 times a power of ten, about six of them.
fn linear_ticks(low: f64, high: f64) -> (Vec<f64>, Vec<f64>) {
    let raw = (high - low) / 6.0;
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|digit| digit * power).find(|step| *step >= raw);
    let step = step.unwrap_or(raw);
    let all = |step: f64| {
        let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
        (first..=last).map(|number| number as f64 * step).collect::<Vec<f64>>()
    };
    (all(step), all(step / 2.0))
}

/// A number in few digits.
pub fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        return "0".into();
    }
    if !(1e-3..1e5).contains(&size) {
        let exponent = size.log10().floor();
        let digits = number(value / 10f64.powf(exponent));
        return format!("{digits}·{}", power_of_ten(exponent as i32));
    }
    // four significant digits without zeros behind them
    let decimals = (3.0 - size.log10().floor()).clamp(0.0, 8.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn power_of_ten(exponent: i32) -> String {
    match exponent {
        0 => "1".into(),
        1 => "10".into(),
        exponent => {
            const SUPERSCRIPT: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
            let digits = exponent.unsigned_abs().to_string();
            let raised = digits.bytes().map(|digit| SUPERSCRIPT[usize::from(digit - b'0')]);
            let sign = if exponent < 0 { "⁻" } else { "" };
            format!("10{sign}{}", raised.collect::<String>())
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn labels(scale: &Scale) -> Vec<String> {
        scale.ticks.iter().map(|at| scale.label(*at)).collect()
    }

    #[test]
    fn ticks_are_round_numbers() {
        let log = Axis::log("A").scale([0.003, 12.0].into_iter());
        assert_eq!(labels(&log), ["10⁻²", "10⁻¹", "1", "10"]);
        let narrow = Axis::log("A").scale([0.12, 0.9].into_iter());
        assert_eq!(labels(&narrow), ["0.2", "0.5"]);
        assert_eq!(labels(&Axis::log("A").scale([0.03, 0.7].into_iter())), ["0.05", "0.1", "0.2", "0.5"]);
        let closer = Axis::log("A").scale([1.31, 1.39].into_iter());
        assert!(labels(&closer).len() >= 2, "{:?}", labels(&closer));
        let wide = Axis::log("A").scale([1e-30, 1.0].into_iter());
        assert!((4..=9).contains(&wide.ticks.len()), "{:?}", labels(&wide));
        let linear = Axis::linear("T").scale([-20.0, -3.0].into_iter());
        assert_eq!(labels(&linear), ["-20", "-15", "-10", "-5"]);
        let around = Axis::linear("x").scale([-0.3, 0.3].into_iter());
        assert!(labels(&around).contains(&"0".to_owned()), "{:?}", labels(&around));
        assert_eq!((number(123_456.0), number(2e-7)), ("1.235·10⁵".into(), "2·10⁻⁷".into()));
    }

    proptest! {
        #[test]
        fn every_scale_holds_its_values_and_has_ticks(values in prop::collection::vec(1e-12..1e12_f64, 1..5), log: bool) {
            let axis = Axis { label: String::new(), log };
            let scale = axis.scale(values.iter().copied());
            prop_assert!(values.iter().all(|value| scale.holds(axis.place(*value).unwrap())));
            prop_assert!((2..=12).contains(&scale.ticks.len()), "{:?}", scale);
            prop_assert!(scale.ticks.iter().all(|at| scale.holds(*at)));
        }
    }
}
