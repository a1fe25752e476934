//! NATS JetStream as the engine: tickets in a work queue on disk, one subject a priority, a lease a ticket.
//!
//! The queue may lose, double or delay a ticket: the row of the job decides, and the caretaker issues lost ones again.

use std::time::Duration;

use async_nats::{
    Client,
    jetstream::{
        self, AckKind, Context, Message,
        consumer::{AckPolicy, PullConsumer, pull},
        context::PublishAckFuture,
        message::PublishMessage,
        stream::{self, DiscardPolicy, RetentionPolicy, StorageType},
    },
};
use futures_util::StreamExt;
use tokio::sync::RwLock;

use super::{Boxed, Engine, EngineError, Lease, Ticket};
use crate::domain::job::Priority;

/// Name of the stream of tickets.
const STREAM: &str = "FIRN_TICKETS";

/// Tickets go to `firn.tickets.<priority>`.
const SUBJECT: &str = "firn.tickets";

/// A word on this subject tells idle workers to look: a queue a priority cannot be waited for in one request.
const WAKE: &str = "firn.wake";

/// How long an idle worker sleeps at most where a wake-up was lost.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// A ticket that is published again within this time is one ticket.
const DUPLICATE_WINDOW: Duration = Duration::from_secs(10);

/// How long the server may take to answer.
const ANSWER: Duration = Duration::from_secs(5);

/// Deliveries of one ticket: without a limit, as a ticket that is in the stream and is not delivered any more would count
/// as held for ever, and hide that another is lost. The desk ends a poison job by its attempts.
const MOST_DELIVERIES: i64 = -1;

/// Tickets over NATS JetStream.
pub struct Nats {
    client: Client,
    context: Context,
    // of whoever makes the queues; whoever only takes from them has none, so that all keep to the same
    lease: Option<Duration>,
    // most urgent first; made again where the server lost them
    queues: RwLock<Vec<PullConsumer>>,
}

fn most_urgent_first() -> impl Iterator<Item = u8> {
    (0..=Priority::MAX).rev()
}

fn queue_name(priority: u8) -> String {
    format!("priority-{priority}")
}

fn failed(error: impl std::fmt::Display) -> EngineError {
    EngineError(error.to_string())
}

impl Nats {
    /// Connects as the desk does: makes the stream and its consumers, or gives those that are there this lease.
    ///
    /// # Errors
    /// [`EngineError`] where the NATS server does not answer or refuses.
    pub async fn connect(url: &str, lease: Duration) -> Result<Self, EngineError> {
        let engine = Self::open(url, Some(lease)).await?;
        engine.prepare().await?;
        Ok(engine)
    }

    /// Connects as a worker does: takes from what the desk has made, and waits where that is not there yet.
    ///
    /// # Errors
    /// [`EngineError`] where the NATS server does not answer or refuses.
    pub async fn connect_to_work(url: &str) -> Result<Self, EngineError> {
        Self::open(url, None).await
    }

    async fn open(url: &str, lease: Option<Duration>) -> Result<Self, EngineError> {
        let client = async_nats::ConnectOptions::new()
            .name("firn")
            .connection_timeout(ANSWER)
            .request_timeout(Some(ANSWER))
            .connect(url)
            .await
            .map_err(failed)?;
        let mut context = jetstream::new(client.clone());
        context.set_timeout(ANSWER);
        Ok(Self { client, context, lease, queues: RwLock::default() })
    }

    /// The connection, for whoever else speaks over it.
    #[must_use]
    pub fn client(&self) -> Client {
        self.client.clone()
    }

    fn connected(&self) -> Result<(), EngineError> {
        match self.client.connection_state() {
            async_nats::connection::State::Connected => Ok(()),
            state => Err(EngineError(format!("the connection to NATS is {state:?}"))),
        }
    }

    /// Sends what was said but is still on its way out.
    pub async fn flush(&self) {
        if tokio::time::timeout(ANSWER, self.client.flush()).await.is_err() {
            tracing::warn!("the connection to NATS could not be flushed");
        }
    }

    async fn prepare(&self) -> Result<(), EngineError> {
        let queues = match self.lease {
            Some(lease) => self.make(lease).await?,
            None => self.find().await?,
        };
        *self.queues.write().await = queues;
        Ok(())
    }

    async fn make(&self, lease: Duration) -> Result<Vec<PullConsumer>, EngineError> {
        let config = stream::Config {
            name: STREAM.into(),
            subjects: vec![format!("{SUBJECT}.*")],
            retention: RetentionPolicy::WorkQueue,
            storage: StorageType::File,
            discard: DiscardPolicy::New,
            duplicate_window: DUPLICATE_WINDOW,
            ..stream::Config::default()
        };
        let stream = self.context.get_or_create_stream(config).await.map_err(failed)?;
        let mut queues = Vec::new();
        for priority in most_urgent_first() {
            let config = pull::Config {
                durable_name: Some(queue_name(priority)),
                filter_subject: format!("{SUBJECT}.{priority}"),
                ack_policy: AckPolicy::Explicit,
                ack_wait: lease,
                max_deliver: MOST_DELIVERIES,
                max_ack_pending: 100_000,
                ..pull::Config::default()
            };
            // one that is there gets this lease
            queues.push(stream.create_consumer(config).await.map_err(failed)?);
        }
        Ok(queues)
    }

    async fn find(&self) -> Result<Vec<PullConsumer>, EngineError> {
        let stream = self.context.get_stream(STREAM).await.map_err(failed)?;
        let mut queues = Vec::new();
        for priority in most_urgent_first() {
            queues.push(stream.get_consumer(&queue_name(priority)).await.map_err(failed)?);
        }
        Ok(queues)
    }

    /// One ticket, if any waits, the most urgent first.
    async fn take(&self) -> Result<Option<Message>, EngineError> {
        let queues = self.queues.read().await;
        if queues.is_empty() {
            return Err(EngineError("the server has not made its queues there yet".into()));
        }
        for queue in queues.iter() {
            let answer = async {
                let mut batch = queue.fetch().max_messages(1).messages().await.map_err(failed)?;
                batch.next().await.transpose().map_err(failed)
            };
            // a server that goes down in between never answers, and the library would wait for ever
            if let Some(message) = tokio::time::timeout(ANSWER, answer).await.map_err(failed)?? {
                return Ok(Some(message));
            }
        }
        Ok(None)
    }

    async fn issue(&self, ticket: &Ticket) -> Result<PublishAckFuture, EngineError> {
        let body = serde_json::to_vec(ticket).map_err(failed)?;
        let publish =
            PublishMessage::build().payload(body.into()).message_id(format!("{}.{}", ticket.job, ticket.attempt));
        self.context.send_publish(format!("{SUBJECT}.{}", ticket.priority), publish).await.map_err(failed)
    }

    async fn publish_all(&self, tickets: &[Ticket]) -> Result<(), EngineError> {
        let mut waiting = Vec::with_capacity(tickets.len());
        for ticket in tickets {
            waiting.push(self.issue(ticket).await?);
        }
        for answer in waiting {
            answer.await.map_err(failed)?;
        }
        self.client.publish(WAKE, "".into()).await.map_err(failed)
    }

    async fn wait(&self) -> Result<Box<dyn Lease>, EngineError> {
        let mut wake = self.client.subscribe(WAKE).await.map_err(failed)?;
        loop {
            if let Some(message) = self.take().await? {
                match serde_json::from_slice(&message.payload) {
                    Ok(ticket) => return Ok(Box::new(NatsLease { ticket, message })),
                    Err(error) => {
                        tracing::error!(%error, "a ticket that nobody can read was thrown away");
                        message.ack_with(AckKind::Term).await.map_err(failed)?;
                    }
                }
            } else {
                // whether it was woken or not, it looks again
                let _ = tokio::time::timeout(LOOK_EVERY, wake.next()).await;
            }
        }
    }
}

impl Engine for Nats {
    fn publish<'a>(&'a self, tickets: &'a [Ticket]) -> Boxed<'a, Result<(), EngineError>> {
        Box::pin(async move {
            // nobody who submits a job shall wait for a server that is away: the caretaker issues the ticket later
            self.connected()?;
            if self.publish_all(tickets).await.is_err() {
                // the server may have lost its store: make the queue anew and try once more
                self.prepare().await?;
                self.publish_all(tickets).await?;
            }
            Ok(())
        })
    }

    fn next(&self) -> Boxed<'_, Result<Box<dyn Lease>, EngineError>> {
        Box::pin(async {
            match self.wait().await {
                Ok(lease) => Ok(lease),
                Err(error) => {
                    self.prepare().await?;
                    Err(error)
                }
            }
        })
    }

    fn workers_survive(&self) -> bool {
        true
    }

    fn held(&self) -> Boxed<'_, Result<u64, EngineError>> {
        Box::pin(async {
            self.connected()?;
            match self.context.get_stream(STREAM).await {
                Ok(stream) => Ok(stream.cached_info().state.messages),
                Err(_) => {
                    // a server that lost its store has no stream: with a new one, no ticket is there
                    self.prepare().await?;
                    Ok(0)
                }
            }
        })
    }

    fn check(&self) -> Boxed<'_, Result<(), EngineError>> {
        Box::pin(std::future::ready(self.connected()))
    }
}

struct NatsLease {
    ticket: Ticket,
    message: Message,
}

impl NatsLease {
    /// An acknowledgement that is lost costs a second delivery, which the desk turns away.
    async fn say(&self, kind: AckKind) {
        if let Err(error) = self.message.ack_with(kind).await {
            tracing::warn!(job = %self.ticket.job, %error, "a ticket could not be acknowledged");
        }
    }
}

impl Lease for NatsLease {
    fn ticket(&self) -> Ticket {
        self.ticket
    }

    fn extend(&self) -> Boxed<'_, Result<(), EngineError>> {
        Box::pin(async { self.message.ack_with(AckKind::Progress).await.map_err(failed) })
    }

    fn done(self: Box<Self>) -> Boxed<'static, ()> {
        Box::pin(async move { self.say(AckKind::Ack).await })
    }

    fn put_back(self: Box<Self>, delay: Duration) -> Boxed<'static, ()> {
        Box::pin(async move { self.say(AckKind::Nak(Some(delay).filter(|delay| !delay.is_zero()))).await })
    }
}
