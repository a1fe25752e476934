//! A whole run: from a plan to a summary, with frames on the way.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::frames::{FrameError, encode};
use super::observables::{Ending, FRAMES_PER_S, Observations, Observer, Summary};
use super::plan::Plan;
use super::{Advance, GRAVITY_M_S2, RunoutError, Simulation};
use crate::progress::Progress;

/// The unit of the work that a run reports.
pub const WORK_UNIT: &str = "particle-steps";

/// Particle-steps from one offer to save the state to the next, at most: a fraction of a second.
const BETWEEN_OFFERS: f64 = 1e7;
/// Typical duration of a run in units of the time scale of its fall, `sqrt(H0 / g)`; only progress is told by it.
const TYPICAL_DURATION: f64 = 8.0;

/// What came of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The run in a few numbers.
    pub summary: Summary,
    /// All that was observed.
    pub observations: Observations,
}

/// Why nothing came of it.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RunError {
    /// The dynamics could not be started, or broke; says at which step, with the state there.
    #[error(transparent)]
    Dynamics(#[from] RunoutError),
    /// A frame could not be stored.
    #[error("frame {frame}: {error}")]
    Frame {
        /// Its number, from 0.
        frame: usize,
        /// Why.
        error: FrameError,
    },
    /// The caller no longer wants the result.
    #[error("cancelled")]
    Cancelled,
}

/// The state of a run between two steps.
struct Run<'a> {
    plan: &'a Plan,
    simulation: Simulation,
    observer: Observer,
    /// Particle-steps that an earlier attempt did.
    done_before: f64,
}

/// What is saved of a run.
#[derive(Serialize, Deserialize)]
struct Saved {
    simulation: Vec<u8>,
    seen: Observations,
}

/// Simulates a plan until the flow rests, leaves the terrain, or the plan's time is over.
///
/// Each frame, 24 a second and the release among them, goes to `keep` with its number, in the layout of [`super::frames`];
/// nothing is kept of it here, because the frames of a large run are larger than its particles. A run that is taken up
/// from a saved state gives the frames since then, with the bits that they would have had.
///
/// # Errors
/// [`RunError::Cancelled`] once [`Progress::cancelled`] says so; a run that broke, with its state.
pub fn run(plan: &Plan, progress: &dyn Progress, keep: &mut dyn FnMut(usize, Vec<u8>)) -> Result<Outcome, RunError> {
    let mut run = Run::begin(plan, progress)?;
    if run.observer.frames() == 0 {
        run.take_frame(keep)?;
    }
    let ending = loop {
        if run.observer.is_at_rest() {
            break Ending::AtRest;
        }
        let time_s = run.observer.frames() as f64 / FRAMES_PER_S;
        // a time of whole frames includes its last one
        if time_s > plan.end_time_s + 1e-9 {
            break Ending::EndTime;
        }
        match run.advance(time_s, progress)? {
            Advance::Reached => run.take_frame(keep)?,
            Advance::LeftDomain => break Ending::LeftDomain,
            Advance::Cancelled => return Err(RunError::Cancelled),
        }
    };
    let (steps, particles) = (run.simulation.steps(), run.simulation.particles() as u64);
    let summary = run.observer.summary(ending, steps, particles).ok_or(RunError::Cancelled)?;
    Ok(Outcome { summary, observations: run.observer.into_seen() })
}

impl<'a> Run<'a> {
    /// The release, or where an earlier attempt was saved.
    fn begin(plan: &'a Plan, progress: &dyn Progress) -> Result<Self, RunError> {
        let saved = progress.resumed().and_then(|bytes| postcard::from_bytes::<Saved>(bytes).ok());
        // a state that is damaged or of another version is of no use, but no reason to give up either
        let resumed = saved.and_then(|saved| {
            let simulation = Simulation::resume(&plan.setup, &saved.simulation).ok()?;
            Some((simulation, saved.seen))
        });
        let (simulation, seen) = match resumed {
            Some(resumed) => resumed,
            None => (Simulation::new(&plan.setup)?, Observations::default()),
        };
        let observer = Observer::new(plan.scene(simulation.mass_kg()), seen);
        let done_before = particle_steps(&simulation);
        Ok(Self { plan, simulation, observer, done_before })
    }

    fn take_frame(&mut self, keep: &mut dyn FnMut(usize, Vec<u8>)) -> Result<(), RunError> {
        let snapshot = self.simulation.snapshot();
        let frame = self.observer.frames();
        keep(frame, encode(&snapshot).map_err(|error| RunError::Frame { frame, error })?);
        self.observer.observe(&snapshot, &self.simulation.energies());
        Ok(())
    }

    /// Advances to a time, offering to save the state on the way.
    fn advance(&mut self, time_s: f64, progress: &dyn Progress) -> Result<Advance, RunError> {
        let slice_s = self.plan.setup.time_step_s * (BETWEEN_OFFERS / self.simulation.particles() as f64).max(1.0);
        loop {
            let until = time_s.min(self.simulation.time_s() + slice_s);
            let reached = self.simulation.step_until(until, progress)?;
            self.report(progress);
            if reached != Advance::Reached {
                return Ok(reached);
            }
            progress.checkpoint(&|| self.save());
            if until >= time_s {
                return Ok(Advance::Reached);
            }
        }
    }

    fn report(&self, progress: &dyn Progress) {
        let time_s = self.simulation.time_s();
        let typical = (TYPICAL_DURATION * (self.plan.drop_height_m / GRAVITY_M_S2).sqrt()).min(self.plan.end_time_s);
        progress.report(fraction(time_s / typical), &format!("{time_s:.1} s after release"));
        progress.work(particle_steps(&self.simulation) - self.done_before, WORK_UNIT);
    }

    fn save(&self) -> Vec<u8> {
        let simulation = self.simulation.checkpoint(&self.plan.setup);
        // numbers and lists always have this form; without it the next attempt begins at the beginning
        postcard::to_stdvec(&Saved { simulation, seen: self.observer.seen().clone() }).unwrap_or_default()
    }
}

/// Particle-steps since release.
fn particle_steps(simulation: &Simulation) -> f64 {
    simulation.steps() as f64 * simulation.particles() as f64
}

/// Share of the work, from the share of a typical duration: the same up to 0.8, and then ever slower towards 1.
fn fraction(share: f64) -> f64 {
    if share <= 0.8 { share } else { 1.0 - 0.2 * (-(share - 0.8) / 0.2).exp() }
}
