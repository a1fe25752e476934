//! The two forecasts that need no weather: every model has to beat them.

/// Days before and after a day of season whose training days make its climatology.
pub const CLIMATOLOGY_HALF_WIDTH: usize = 10;

/// Base rate by day of season: the share of avalanche days within [`CLIMATOLOGY_HALF_WIDTH`] days of that day of season.
#[derive(Clone, Debug, PartialEq)]
pub struct Climatology {
    /// Training days with a day of season below the index.
    days_before: Vec<u32>,
    /// Avalanche days among them.
    events_before: Vec<u32>,
}

/// Days of the longest season.
const SEASON: usize = 366;

impl Climatology {
    /// Fits training days: `day` is each one's [`day_of_season`](super::day::day_of_season), `event` its label.
    #[must_use]
    pub fn fit(day: &[i16], event: &[bool]) -> Self {
        let (mut days_before, mut events_before) = (vec![0; SEASON + 1], vec![0; SEASON + 1]);
        for (&day, &event) in day.iter().zip(event) {
            let slot = position(day) + 1;
            days_before[slot] += 1;
            events_before[slot] += u32::from(event);
        }
        for slot in 1..=SEASON {
            days_before[slot] += days_before[slot - 1];
            events_before[slot] += events_before[slot - 1];
        }
        Self { days_before, events_before }
    }

    /// Probability on a day of season: the base rate of the whole season where no training day is near, 0 without any.
    #[must_use]
    pub fn probability(&self, day_of_season: i16) -> f64 {
        let day = position(day_of_season);
        let from = day.saturating_sub(CLIMATOLOGY_HALF_WIDTH);
        let to = (day + CLIMATOLOGY_HALF_WIDTH + 1).min(SEASON);
        self.rate(from, to).or_else(|| self.rate(0, SEASON)).unwrap_or(0.0)
    }

    /// Share of avalanche days among the training days from day `from` of a season to before `to`.
    fn rate(&self, from: usize, to: usize) -> Option<f64> {
        let between = |before: &[u32]| before.get(to)?.checked_sub(*before.get(from)?);
        let (days, events) = (between(&self.days_before)?, between(&self.events_before)?);
        (days > 0).then(|| f64::from(events) / f64::from(days))
    }
}

/// Position of a day of season; one that no season has counts as the nearest.
fn position(day_of_season: i16) -> usize {
    usize::try_from(day_of_season).unwrap_or(0).min(SEASON - 1)
}

/// Persistence as a probability: how often an avalanche day follows one, and how often it follows a quiet day.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Persistence {
    /// Share of avalanche days among training days that follow an avalanche day.
    pub after_event: f64,
    /// Share of avalanche days among training days that follow a day without.
    pub after_quiet: f64,
    /// Share of avalanche days among all training days: the probability after a day that is unknown.
    pub base_rate: f64,
}

impl Persistence {
    /// Fits training days: `yesterday` is the label of the calendar day before, `None` where unknown.
    ///
    /// A rate without a training day is the base rate; without any training day all are 0.
    #[must_use]
    pub fn fit(yesterday: &[Option<bool>], event: &[bool]) -> Self {
        let share = |keep: &dyn Fn(Option<bool>) -> bool| {
            let kept = || yesterday.iter().zip(event).filter(|&(&y, _)| keep(y));
            let days = kept().count();
            (days > 0).then(|| kept().filter(|&(_, &event)| event).count() as f64 / days as f64)
        };
        let base_rate = share(&|_| true).unwrap_or(0.0);
        Self {
            after_event: share(&|y| y == Some(true)).unwrap_or(base_rate),
            after_quiet: share(&|y| y == Some(false)).unwrap_or(base_rate),
            base_rate,
        }
    }

    /// Probability of an avalanche day, given the label of the day before.
    #[must_use]
    pub const fn probability(&self, yesterday: Option<bool>) -> f64 {
        match yesterday {
            Some(true) => self.after_event,
            Some(false) => self.after_quiet,
            None => self.base_rate,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn climatology_is_the_rate_of_the_days_around() {
        // 100: event, 110: quiet, 111: event, 200: quiet
        let climatology = Climatology::fit(&[100, 110, 111, 200], &[true, false, true, false]);
        assert_eq!(climatology.probability(89), 0.5, "no day within ten: the rate of the season");
        assert_eq!(climatology.probability(90), 1.0);
        assert_eq!(climatology.probability(100), 0.5);
        assert_eq!(climatology.probability(105), 2.0 / 3.0);
        assert_eq!(climatology.probability(111), 0.5);
        assert_eq!(climatology.probability(195), 0.0);
    }

    #[test]
    fn climatology_ends_with_the_season() {
        let climatology = Climatology::fit(&[0, 365, 180], &[true, false, true]);
        assert_eq!(climatology.probability(3), 1.0);
        assert_eq!(climatology.probability(360), 0.0);
        assert_eq!(climatology.probability(400), climatology.probability(365));
        assert_eq!(climatology.probability(-5), climatology.probability(0));
        assert_eq!(Climatology::fit(&[], &[]).probability(10), 0.0);
    }

    #[test]
    fn persistence_is_the_rate_after_each_kind_of_day() {
        let yesterday = [Some(true), Some(true), Some(true), Some(false), Some(false), None];
        let fit = Persistence::fit(&yesterday, &[true, true, false, true, false, false]);
        assert_eq!(fit.probability(Some(true)), 2.0 / 3.0);
        assert_eq!(fit.probability(Some(false)), 0.5);
        assert_eq!(fit.probability(None), 0.5);
        // where the training days say nothing of an event yesterday, the base rate does
        let quiet = Persistence::fit(&[Some(false), None], &[false, true]);
        assert_eq!(quiet.probability(Some(true)), 0.5);
        assert_eq!(Persistence::fit(&[], &[]).probability(Some(true)), 0.0);
    }
}
