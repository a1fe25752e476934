//! What an interrupted run of several splits keeps: the splits that are done.

use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::Samples;
use crate::{forecast::model::TrainingOptions, progress::Progress};

/// The splits that are done, and what they were done on.
#[derive(Serialize, Deserialize)]
struct Saved<T> {
    fingerprint: u64,
    splits: Vec<Option<T>>,
}

/// Collects splits as they are done, and offers them to be saved.
pub(crate) struct Done<T> {
    fingerprint: u64,
    splits: Mutex<Vec<Option<T>>>,
}

impl<T: Clone + Serialize + DeserializeOwned> Done<T> {
    /// What an earlier attempt at the same run saved, or nothing.
    pub(crate) fn resume(samples: &Samples, options: &TrainingOptions, splits: usize, progress: &dyn Progress) -> Self {
        let fingerprint = fingerprint(samples, options, splits);
        let saved = progress.resumed().and_then(|bytes| postcard::from_bytes::<Saved<T>>(bytes).ok());
        // days may have been edited since: what was computed from others is of no use
        let saved = saved.filter(|saved| saved.fingerprint == fingerprint && saved.splits.len() == splits);
        let splits = saved.map_or_else(|| (0..splits).map(|_| None).collect(), |saved| saved.splits);
        Self { fingerprint, splits: Mutex::new(splits) }
    }

    /// The split of that number, where it is done.
    pub(crate) fn get(&self, split: usize) -> Option<T> {
        self.splits.lock().unwrap_or_else(PoisonError::into_inner).get(split).cloned().flatten()
    }

    /// Notes that a split is done.
    pub(crate) fn set(&self, split: usize, done: &T, progress: &dyn Progress) {
        if let Some(place) = self.splits.lock().unwrap_or_else(PoisonError::into_inner).get_mut(split) {
            *place = Some(done.clone());
        }
        progress.checkpoint(&|| self.save());
    }

    fn save(&self) -> Vec<u8> {
        let splits = self.splits.lock().unwrap_or_else(PoisonError::into_inner).clone();
        // numbers and lists always have this form; without it the next attempt begins at the beginning
        postcard::to_stdvec(&Saved { fingerprint: self.fingerprint, splits }).unwrap_or_default()
    }
}

/// FNV-1a (64 bits) over everything that the splits depend on.
fn fingerprint(samples: &Samples, options: &TrainingOptions, splits: usize) -> u64 {
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    hash.bytes(format!("{options:?} {splits} {:?} {:?}", samples.date, samples.yesterday).as_bytes());
    for row in 0..samples.features.rows() {
        hash.bytes(&[u8::from(samples.event[row])]);
        for value in samples.features.row(row).iter().chain(samples.variables.row(row)) {
            hash.bytes(&value.to_bits().to_le_bytes());
        }
    }
    hash.0
}

struct Fnv(u64);

impl Fnv {
    fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use crate::{
        forecast::{
            day::{DayRecord, Label},
            features::FeatureSetId,
            model::{FeatureChoice, TrainingError, TrainingOptions, train},
            svm::{Grid, KernelFamily},
            synthetic::{REPORTED, synthetic_station},
            verification::ThresholdRule,
        },
        progress::{Progress, Unobserved},
    };
    use std::sync::Mutex;

    /// Saves at every chance and cancels after a number of splits; `resumed` is what the attempt before saved.
    struct Interrupted {
        saved: Mutex<Option<Vec<u8>>>,
        saves_left: Mutex<usize>,
        stop: AtomicBool,
        resumed: Option<Vec<u8>>,
    }

    impl Progress for Interrupted {
        fn report(&self, _: f64, _: &str) {}

        fn cancelled(&self) -> bool {
            self.stop.load(Ordering::Relaxed)
        }

        fn checkpoint(&self, state: &dyn Fn() -> Vec<u8>) {
            let mut left = self.saves_left.lock().unwrap();
            if *left == 0 {
                return;
            }
            *left -= 1;
            *self.saved.lock().unwrap() = Some(state());
            if *left == 0 {
                self.stop.store(true, Ordering::Relaxed);
            }
        }

        fn resumed(&self) -> Option<&[u8]> {
            self.resumed.as_deref()
        }
    }

    fn interrupted(saves: usize, resumed: Option<Vec<u8>>) -> Interrupted {
        Interrupted { saved: Mutex::default(), saves_left: Mutex::new(saves), stop: AtomicBool::new(false), resumed }
    }

    fn options() -> TrainingOptions {
        TrainingOptions {
            label: Label::Observed,
            lead: 0,
            feature_set: FeatureSetId::Raw30,
            features: FeatureChoice::All,
            kernel: KernelFamily::Gaussian,
            reported: REPORTED.to_vec(),
            seed: 1,
            grid: Grid { c: vec![1.0], gamma: vec![0.01] },
            threshold: ThresholdRule::Peirce,
        }
    }

    #[test]
    fn an_interrupted_evaluation_goes_on_with_the_same_bits() {
        let days: Vec<DayRecord> = synthetic_station(3, 2000, 4);
        let whole = train(&days, &options(), &Unobserved).unwrap();
        let first = interrupted(2, None);
        assert_eq!(train(&days, &options(), &first).unwrap_err(), TrainingError::Cancelled);
        let saved = first.saved.lock().unwrap().clone();
        assert!(saved.is_some());
        let second = interrupted(usize::MAX, saved.clone());
        assert_eq!(train(&days, &options(), &second).unwrap(), whole);
        let all = 4 + 1;
        assert!(usize::MAX - *second.saves_left.lock().unwrap() < all, "the saved splits were computed again");

        // another input: what was saved is not used
        let other = synthetic_station(4, 2000, 4);
        let third = interrupted(usize::MAX, saved);
        assert_eq!(train(&other, &options(), &third).unwrap(), train(&other, &options(), &Unobserved).unwrap());
    }
}
