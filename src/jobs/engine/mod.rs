//! What carries tickets from the desk to the workers. A ticket is a wake-up and nothing more: it may be lost, doubled or
//! late, and the row of the job decides what is true.

pub mod local;
pub mod nats;

use std::{pin::Pin, time::Duration};

use serde::{Deserialize, Serialize};
use uuid::Uuid;

/// What the methods of [`Engine`] and [`Lease`] return: both are used as trait objects.
pub type Boxed<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// Says that a job waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ticket {
    /// Which.
    pub job: Uuid,
    /// How urgent it is, 0 to 9.
    pub priority: u8,
    /// The attempt that came before, so that a repeated ticket can be told from a new one.
    pub attempt: u32,
}

/// The engine does not answer.
#[derive(Debug, thiserror::Error)]
#[error("the job engine: {0}")]
pub struct EngineError(pub String);

/// Carries tickets.
pub trait Engine: Send + Sync {
    /// Takes tickets; of two tickets for the same job and attempt one is enough.
    fn publish<'a>(&'a self, tickets: &'a [Ticket]) -> Boxed<'a, Result<(), EngineError>>;

    /// Waits for the most urgent ticket, the oldest among equals. Called only when there is a free slot: nothing is
    /// fetched ahead.
    fn next(&self) -> Boxed<'_, Result<Box<dyn Lease>, EngineError>>;

    /// Whether workers may live on when this process or its machine does not.
    fn workers_survive(&self) -> bool;

    /// How many tickets it holds, waiting or with a worker: fewer than there are jobs means that some were lost.
    fn held(&self) -> Boxed<'_, Result<u64, EngineError>>;

    /// Whether the engine answers.
    fn check(&self) -> Boxed<'_, Result<(), EngineError>>;
}

/// A ticket that one worker holds.
pub trait Lease: Send + Sync {
    /// The ticket.
    fn ticket(&self) -> Ticket;

    /// Says that the worker is alive.
    fn extend(&self) -> Boxed<'_, Result<(), EngineError>>;

    /// The ticket has served.
    fn done(self: Box<Self>) -> Boxed<'static, ()>;

    /// Another worker shall have the ticket after `delay`.
    fn put_back(self: Box<Self>, delay: Duration) -> Boxed<'static, ()>;
}
