//! The embedded engine: a queue in memory beside the table that is the truth.

use std::{
    cmp::Reverse,
    collections::{BinaryHeap, HashSet},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use tokio::sync::Notify;
use uuid::Uuid;

use super::{Boxed, Engine, EngineError, Lease, Ticket};

/// Tickets in memory; they are issued again from the table at every start.
#[derive(Clone, Default)]
pub struct Local(Arc<Inner>);

#[derive(Default)]
struct Inner {
    waiting: Mutex<Waiting>,
    arrived: Notify,
    leased: AtomicU64,
}

/// Most urgent first, then first come first served: ids are ordered in time.
#[derive(Default)]
struct Waiting {
    queue: BinaryHeap<(u8, Reverse<Uuid>, u32)>,
    known: HashSet<Uuid>,
}

impl Local {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.0.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, ticket: Ticket) {
        let mut waiting = self.waiting();
        if waiting.known.insert(ticket.job) {
            waiting.queue.push((ticket.priority, Reverse(ticket.job), ticket.attempt));
            self.0.arrived.notify_one();
        }
    }

    fn pop(&self) -> Option<Ticket> {
        let mut waiting = self.waiting();
        let (priority, Reverse(job), attempt) = waiting.queue.pop()?;
        waiting.known.remove(&job);
        if !waiting.queue.is_empty() {
            // one notice may have stood for several tickets: pass it on to the next idle slot
            self.0.arrived.notify_one();
        }
        Some(Ticket { job, priority, attempt })
    }
}

impl Engine for Local {
    fn publish<'a>(&'a self, tickets: &'a [Ticket]) -> Boxed<'a, Result<(), EngineError>> {
        for ticket in tickets {
            self.push(*ticket);
        }
        Box::pin(std::future::ready(Ok(())))
    }

    fn next(&self) -> Boxed<'_, Result<Box<dyn Lease>, EngineError>> {
        Box::pin(async {
            loop {
                if let Some(ticket) = self.pop() {
                    let lease: Box<dyn Lease> = Box::new(LocalLease::of(self.clone(), ticket));
                    return Ok(lease);
                }
                self.0.arrived.notified().await;
            }
        })
    }

    fn workers_survive(&self) -> bool {
        false
    }

    fn held(&self) -> Boxed<'_, Result<u64, EngineError>> {
        let held = self.waiting().known.len() as u64 + self.0.leased.load(Ordering::Relaxed);
        Box::pin(std::future::ready(Ok(held)))
    }

    fn check(&self) -> Boxed<'_, Result<(), EngineError>> {
        Box::pin(std::future::ready(Ok(())))
    }
}

struct LocalLease {
    engine: Local,
    ticket: Ticket,
}

impl LocalLease {
    fn of(engine: Local, ticket: Ticket) -> Self {
        engine.0.leased.fetch_add(1, Ordering::Relaxed);
        Self { engine, ticket }
    }
}

impl Drop for LocalLease {
    fn drop(&mut self) {
        self.engine.0.leased.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Lease for LocalLease {
    fn ticket(&self) -> Ticket {
        self.ticket
    }

    fn extend(&self) -> Boxed<'_, Result<(), EngineError>> {
        Box::pin(std::future::ready(Ok(())))
    }

    fn done(self: Box<Self>) -> Boxed<'static, ()> {
        Box::pin(std::future::ready(()))
    }

    fn put_back(self: Box<Self>, delay: Duration) -> Boxed<'static, ()> {
        Box::pin(async move {
            tokio::spawn(async move {
                tokio::time::sleep(delay).await;
                self.engine.push(self.ticket);
            });
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticket(priority: u8) -> Ticket {
        Ticket { job: Uuid::now_v7(), priority, attempt: 0 }
    }

    #[tokio::test]
    async fn urgent_tickets_come_first_and_equals_in_their_order() {
        let engine = Local::default();
        let tickets = [ticket(5), ticket(5), ticket(9), ticket(0)];
        engine.publish(&tickets).await.unwrap();
        let mut order = Vec::new();
        for _ in 0..4 {
            order.push(engine.next().await.unwrap().ticket());
        }
        assert_eq!(order, [tickets[2], tickets[0], tickets[1], tickets[3]]);
    }

    #[tokio::test]
    async fn a_repeated_ticket_is_one_ticket() {
        let engine = Local::default();
        let one = ticket(5);
        engine.publish(&[one, one]).await.unwrap();
        assert_eq!(engine.next().await.unwrap().ticket(), one);
        assert!(tokio::time::timeout(Duration::from_millis(20), engine.next()).await.is_err());
    }

    #[tokio::test]
    async fn every_idle_slot_hears_of_its_ticket() {
        let engine = Local::default();
        let slots: Vec<_> = (0..4)
            .map(|_| {
                let engine = engine.clone();
                tokio::spawn(async move { engine.next().await.unwrap().ticket() })
            })
            .collect();
        tokio::task::yield_now().await;
        engine.publish(&[ticket(1), ticket(2), ticket(3), ticket(4)]).await.unwrap();
        for slot in slots {
            tokio::time::timeout(Duration::from_secs(5), slot).await.unwrap().unwrap();
        }
    }
}
