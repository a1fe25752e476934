//! When a running computation saves its state: so often that a kill costs at most ten seconds of computing, and else so
//! rarely that it takes little of the time.
//!
//! What a kill costs is what was computed since the last state that is *stored*: the time between two states, and the time
//! that the second takes to be saved and stored. Where a state takes more than a fifth of a second, or a computation
//! offers one less than once a second, both cannot be had: then the first holds, and the record of the job says what it
//! took.

use std::time::Duration;

/// A kill costs no more computing than this.
const MOST_LOST: Duration = Duration::from_secs(10);

/// Of that, kept for a state that takes longer than the one before.
const RESERVE: Duration = Duration::from_secs(1);

/// The first state of an attempt, of which nobody knows yet what it takes, is saved at the earliest after this time and
/// not much later, ...
const FIRST: Duration = Duration::from_secs(7);

/// ... one after another at the earliest after this one, ...
const EARLIEST: Duration = Duration::from_secs(5);

/// ... and so late that saving and storing take this share of the time. It leaves room to the 3 % that are promised.
const SHARE: f64 = 0.02;

/// The states of one attempt. Every instant is the time since its begin, so that no clock is read here.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spacing {
    offered: Duration,
    saved: Duration,
    saving: Duration,
    storing: Duration,
    on_its_way: bool,
}

impl Spacing {
    /// Whether a state that is offered `now` shall be saved; only one of several that are offered at once is.
    pub fn is_due(&mut self, now: Duration) -> bool {
        let until_next_offer = now.saturating_sub(self.offered);
        self.offered = now;
        // a second state before the first is stored would only be another thing to store
        if self.on_its_way {
            return false;
        }
        let cost = self.saving + self.storing;
        let latest = MOST_LOST.saturating_sub(RESERVE + cost);
        let (earliest, latest) =
            if self.saved.is_zero() { (FIRST, FIRST + RESERVE) } else { (EARLIEST.max(cost.div_f64(SHARE)), latest) };
        let rest = earliest.min(latest);
        let since = now.saturating_sub(self.saved);
        // where offers are rare, the next one may come too late
        self.on_its_way = since >= rest || since + until_next_offer > latest;
        self.on_its_way
    }

    /// Notes a state as it was when saving it began at `now`; that took `saving`.
    pub fn saved(&mut self, now: Duration, saving: Duration) {
        self.saved = now;
        self.saving = saving;
        self.on_its_way = true;
    }

    /// Notes that the newest state is stored; that took `storing`.
    pub fn stored(&mut self, storing: Duration) {
        self.storing = storing;
        self.on_its_way = false;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// What an hour of computing loses at most to a kill, s, and the share of its time that goes to states at the worst
    /// instant to end, where a state is offered every `offer` s and takes `saving` and `storing` s.
    fn hour(offer: f64, saving: f64, storing: f64) -> (f64, f64) {
        let seconds = Duration::from_secs_f64;
        let mut spacing = Spacing::default();
        let (mut now, mut taken, mut kept, mut states) = (0.0, 0.0, 0.0, 0.0);
        let (mut most_lost, mut most_share) = (0.0_f64, 0.0_f64);
        let mut arrives: Option<f64> = None;
        while now < 3600.0 {
            now += offer;
            if let Some(at) = arrives.filter(|at| *at <= now) {
                // killed just before the state was stored
                most_lost = most_lost.max(at - kept);
                kept = taken;
                spacing.stored(seconds(storing));
                arrives = None;
            }
            if spacing.is_due(seconds(now)) {
                taken = now;
                now += saving;
                spacing.saved(seconds(taken), seconds(saving));
                arrives = Some(now + storing);
                states += 1.0;
                most_share = most_share.max(states * (saving + storing) / (now + storing));
            }
        }
        (most_lost.max(now - kept), most_share)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        #[test]
        fn a_kill_costs_ten_seconds_and_states_three_per_cent(
            offer in 0.01..1.0, cost in 0.0..0.2, part in 0.0..1.0,
        ) {
            let (lost, share) = hour(offer, cost * part, cost * (1.0 - part));
            prop_assert!(lost <= 10.0, "{lost} s are lost");
            prop_assert!(share < 0.03, "{share} of the time");
        }

        #[test]
        fn large_states_and_rare_offers_keep_what_a_kill_costs(offer in 0.01..4.0, cost in 0.2..2.0, part in 0.0..1.0) {
            let (lost, _) = hour(offer, cost * part, cost * (1.0 - part));
            prop_assert!(lost <= 10.0, "{lost} s are lost");
        }
    }

    #[test]
    fn small_states_are_saved_every_five_seconds() {
        let mut spacing = Spacing::default();
        let mut saved = Vec::new();
        for tenth in 0..200 {
            let now = Duration::from_millis(tenth * 100);
            if spacing.is_due(now) {
                spacing.saved(now, Duration::ZERO);
                spacing.stored(Duration::from_millis(1));
                saved.push(now.as_secs_f64());
            }
        }
        assert_eq!(saved, [7.0, 12.0, 17.0]);
    }
}
