//! The film of a run: which frames are kept, and how they go to the store while it computes.

use std::sync::{
    Mutex, MutexGuard, PoisonError,
    atomic::{AtomicU64, Ordering},
};

use firn_science::{
    progress::Progress,
    runout::{GRAVITY_M_S2, observables::FRAMES_PER_S, plan::Plan},
};
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use super::{FRAMES, science};
use crate::{
    formats::film,
    jobs::{artifacts::digest, link::Artifact, processes::Failure},
};

/// The most bytes that all frames of a run may take, about.
const FILM_BYTES: f64 = 512e6;
/// Bytes of a packed frame a particle, about.
const FRAME_BYTES_A_PARTICLE: f64 = 3.5;
/// Physical time that a run takes at most, in units of the time scale of its fall, sqrt(H0 / g), about.
const USUAL_DURATION: f64 = 10.0;
/// The frame rates that are chosen from, a second: all divide that of the series.
const FRAME_RATES: [u32; 6] = [24, 12, 8, 4, 2, 1];

/// What is saved of a run: its own state, and what it has given of the film.
#[derive(Serialize, Deserialize)]
pub(super) struct Saved {
    #[serde(with = "serde_bytes")]
    run: Vec<u8>,
    pub(super) film: Film,
}

/// Keeps some of the frames of a run, also over its interruptions, and counts its work.
pub(super) struct Camera<'a> {
    progress: &'a dyn Progress,
    /// One frame of so many is kept, and the last.
    every: usize,
    film: Mutex<Film>,
    piece_bytes: usize,
    /// The state of the run that an earlier attempt saved.
    resumed: Option<Vec<u8>>,
    /// Work of this attempt: the bits of an `f64`.
    work: AtomicU64,
}

/// The film of a run so far. Its frames go away in pieces, so that neither the memory nor a saved state holds them.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(super) struct Film {
    /// Time since release, s, and length of every frame.
    table: Vec<(f64, u64)>,
    /// Digests of the pieces that were handed over.
    pub(super) pieces: Vec<String>,
    /// The frames since then, one after the other.
    #[serde(with = "serde_bytes")]
    pub(super) rest: Vec<u8>,
    /// The newest frame, where it is not one of those that are kept.
    newest: Option<(f64, ByteBuf)>,
}

impl Film {
    fn push(&mut self, time_s: f64, frame: &[u8]) {
        self.table.push((time_s, frame.len() as u64));
        self.rest.extend_from_slice(frame);
    }

    /// Hands the frames since the last piece over; false where nobody takes them.
    fn hand_over(&mut self, progress: &dyn Progress) -> bool {
        let name = digest(&self.rest);
        match progress.keep(std::mem::take(&mut self.rest)) {
            Ok(()) => self.pieces.push(name),
            Err(piece) => self.rest = piece,
        }
        self.rest.is_empty()
    }
}

impl<'a> Camera<'a> {
    pub(super) fn new(plan: &Plan, progress: &'a dyn Progress, piece_bytes: usize) -> Self {
        // what an earlier version saved is of no use, but no reason to fail either
        let saved = progress.resumed().and_then(|bytes| rmp_serde::from_slice::<Saved>(bytes).ok());
        let (resumed, film) = saved.map_or((None, Film::default()), |saved| (Some(saved.run), saved.film));
        Self {
            progress,
            every: FRAMES_PER_S as usize / frames_per_s(plan) as usize,
            film: Mutex::new(film),
            piece_bytes,
            resumed,
            work: AtomicU64::new(0),
        }
    }

    fn film(&self) -> MutexGuard<'_, Film> {
        self.film.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn take(&self, number: usize, frame: Vec<u8>) {
        let time_s = number as f64 / FRAMES_PER_S;
        let mut film = self.film();
        if number == 0 {
            // a run that began anew although there was a saved state
            *film = Film::default();
        }
        if !number.is_multiple_of(self.every) {
            film.newest = Some((time_s, ByteBuf::from(frame)));
            return;
        }
        film.newest = None;
        film.push(time_s, &frame);
        if film.rest.len() >= self.piece_bytes {
            // where nobody takes it, the film is held here
            film.hand_over(self.progress);
        }
    }

    /// Particle-steps of this attempt.
    pub(super) fn work_done(&self) -> f64 {
        f64::from_bits(self.work.load(Ordering::Relaxed))
    }

    pub(super) fn into_film(self) -> Result<Artifact, Failure> {
        let mut film = self.film.into_inner().unwrap_or_else(PoisonError::into_inner);
        if let Some((time_s, frame)) = film.newest.take() {
            film.push(time_s, &frame);
        }
        let mut bytes = film::head(&film.table);
        if film.pieces.is_empty() {
            bytes.append(&mut film.rest);
        } else if !film.rest.is_empty() && !film.hand_over(self.progress) {
            return Err(science("the last frames were not taken"));
        }
        let (name, media_type) = (FRAMES.into(), "application/octet-stream".into());
        Ok(Artifact { name, media_type, bytes, pieces: film.pieces })
    }
}

impl Progress for Camera<'_> {
    fn report(&self, fraction: f64, phase: &str) {
        self.progress.report(fraction, phase);
    }

    fn cancelled(&self) -> bool {
        self.progress.cancelled()
    }

    fn rate(&self, per_second: f64, unit: &str) {
        self.progress.rate(per_second, unit);
    }

    fn work(&self, done: f64, unit: &str) {
        self.work.store(done.to_bits(), Ordering::Relaxed);
        self.progress.work(done, unit);
    }

    fn checkpoint(&self, state: &dyn Fn() -> Vec<u8>) {
        self.progress.checkpoint(&|| {
            let saved = Saved { run: state(), film: self.film().clone() };
            // bytes and numbers always have this form; without it the next attempt begins at the beginning
            rmp_serde::to_vec(&saved).unwrap_or_default()
        });
    }

    fn keep(&self, piece: Vec<u8>) -> Result<(), Vec<u8>> {
        self.progress.keep(piece)
    }

    fn resumed(&self) -> Option<&[u8]> {
        self.resumed.as_deref()
    }
}

/// Frames kept a second: as many as the film has room for, by the usual duration of a run.
pub(super) fn frames_per_s(plan: &Plan) -> u32 {
    let duration_s = (USUAL_DURATION * (plan.drop_height_m / GRAVITY_M_S2).sqrt()).min(plan.end_time_s);
    let room = FILM_BYTES / (plan.particles() as f64 * FRAME_BYTES_A_PARTICLE * duration_s);
    FRAME_RATES.into_iter().find(|&rate| f64::from(rate) <= room).unwrap_or(1)
}
