//! Fan-in and fan-out over iceoryx2 with its defaults: a topic and an event in each direction, and an event for each range.
//!
//! Services have room for exactly the robots of the run, because room costs time. All other settings are the defaults.

use std::time::{Duration, Instant};

use anyhow::{anyhow, bail};
use iceoryx2::node::Node;
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::event::PortFactory as Event;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as Topic;
use rangehound_node::bus;
use rangehound_node::rendezvous::Rendezvous;
use rangehound_node::system::signal::Termination;

use super::{Command, RANGE_TICK, ROBOT, Range, TICK, WAIT};

fn refused(what: &str, reason: impl std::fmt::Debug) -> anyhow::Error {
    anyhow!("{what} of the iceoryx2 reference failed: iceoryx2 says {reason:?}")
}

/// A process's node among `robots` and a centre.
struct Place {
    node: Node<ipc::Service>,
    robots: usize,
}

impl Place {
    fn of(run: &Rendezvous, name: &str) -> anyhow::Result<Self> {
        Ok(Self { node: bus::node(run, name)?, robots: run.description().scenario.robots.len() })
    }

    fn topic<T: std::fmt::Debug + ZeroCopySend>(
        &self,
        name: &str,
        publishers: usize,
        subscribers: usize,
    ) -> anyhow::Result<Topic<ipc::Service, T, ()>> {
        self.node
            .service_builder(&ServiceName::new(name)?)
            .publish_subscribe::<T>()
            .max_publishers(publishers)
            .max_subscribers(subscribers)
            .max_nodes(self.robots + 1)
            .open_or_create()
            .map_err(|error| refused(name, error))
    }

    fn ranges(&self) -> anyhow::Result<Topic<ipc::Service, Range, ()>> {
        self.topic("range", self.robots, 1)
    }

    fn commands(&self) -> anyhow::Result<Topic<ipc::Service, Command, ()>> {
        self.topic("command", 1, self.robots)
    }

    fn event(&self, name: &str, notifiers: usize, listeners: usize) -> anyhow::Result<Event<ipc::Service>> {
        self.node
            .service_builder(&ServiceName::new(name)?)
            .event()
            .max_notifiers(notifiers)
            .max_listeners(listeners)
            .max_nodes(self.robots + 1)
            // A listener checks all possible ids.
            .event_id_max_value(self.robots)
            .open_or_create()
            .map_err(|error| refused(name, error))
    }

    fn range_event(&self) -> anyhow::Result<Event<ipc::Service>> {
        self.event("range", self.robots, 1)
    }

    fn command_event(&self) -> anyhow::Result<Event<ipc::Service>> {
        self.event("command", 1, self.robots)
    }
}

/// Bounds every wait.
struct WaitLimit<'a> {
    termination: &'a Termination,
    limit: Duration,
    since: Option<Instant>,
}

impl<'a> WaitLimit<'a> {
    fn new(termination: &'a Termination, limit: Duration) -> Self {
        Self { termination, limit, since: None }
    }

    /// Call this after a wait without result.
    fn check(&mut self) -> anyhow::Result<()> {
        if self.termination.requested() {
            bail!("asked to end before the last tick");
        }
        if self.since.get_or_insert_with(Instant::now).elapsed() > self.limit {
            bail!("received nothing for {:?}", self.limit);
        }
        Ok(())
    }

    /// Call this when the awaited message has come.
    fn reset(&mut self) {
        self.since = None;
    }
}

/// Sleeps until notified.
fn wait(listener: &Listener<ipc::Service>, wait_limit: &mut WaitLimit<'_>) -> anyhow::Result<()> {
    match listener.timed_wait(|_| {}, WAIT) {
        Ok(0) | Err(ListenerWaitError::InterruptSignal) => wait_limit.check(),
        Ok(_) => Ok(()),
        Err(error) => Err(refused("wait", error)),
    }
}

pub(super) struct Centre<'a> {
    ranges: Subscriber<ipc::Service, Range, ()>,
    commands: Publisher<ipc::Service, Command, ()>,
    listener: Listener<ipc::Service>,
    notifier: Notifier<ipc::Service>,
    newest: Vec<Range>,
    wait_limit: WaitLimit<'a>,
    _place: Place,
}

impl<'a> Centre<'a> {
    pub(super) fn open(run: &Rendezvous, termination: &'a Termination, silence: Duration) -> anyhow::Result<Self> {
        let place = Place::of(run, "centre")?;
        let port = |error: &dyn std::fmt::Debug| refused("port", error);
        Ok(Self {
            ranges: place.ranges()?.subscriber_builder().create().map_err(|error| port(&error))?,
            commands: place.commands()?.publisher_builder().create().map_err(|error| port(&error))?,
            listener: place.range_event()?.listener_builder().create().map_err(|error| port(&error))?,
            notifier: place.command_event()?.notifier_builder().create().map_err(|error| port(&error))?,
            newest: vec![Range::default(); place.robots],
            wait_limit: WaitLimit::new(termination, silence),
            _place: place,
        })
    }
}

impl super::Centre for Centre<'_> {
    fn collect(&mut self, tick: u64) -> anyhow::Result<()> {
        let mut missing = self.newest.len();
        while missing > 0 {
            wait(&self.listener, &mut self.wait_limit)?;
            while let Some(sample) = self.ranges.receive().map_err(|error| refused("range", error))? {
                let range = *sample.payload();
                let newest = self.newest.get_mut(range[ROBOT] as usize);
                let newest = newest.filter(|newest| range[RANGE_TICK] == tick && newest[RANGE_TICK] < tick);
                *newest.ok_or_else(|| {
                    anyhow!("unexpected range {range:?}: expected one of tick {tick} from each robot")
                })? = range;
                missing -= 1;
            }
        }
        self.wait_limit.reset();
        Ok(())
    }

    fn answer(&mut self, command: &Command) -> anyhow::Result<()> {
        self.commands.send_copy(*command).map_err(|error| refused("command", error))?;
        self.notifier.notify().map_err(|error| refused("event", error))?;
        Ok(())
    }
}

pub(super) struct Robot<'a> {
    ranges: Publisher<ipc::Service, Range, ()>,
    commands: Subscriber<ipc::Service, Command, ()>,
    notifier: Notifier<ipc::Service>,
    listener: Listener<ipc::Service>,
    wait_limit: WaitLimit<'a>,
    _place: Place,
}

impl<'a> Robot<'a> {
    pub(super) fn open(
        run: &Rendezvous,
        id: usize,
        termination: &'a Termination,
        silence: Duration,
    ) -> anyhow::Result<Self> {
        let place = Place::of(run, &format!("robot-{id}"))?;
        let port = |error: &dyn std::fmt::Debug| refused("port", error);
        let notifier = place.range_event()?.notifier_builder().default_event_id(EventId::new(id)).create();
        Ok(Self {
            ranges: place.ranges()?.publisher_builder().create().map_err(|error| port(&error))?,
            commands: place.commands()?.subscriber_builder().create().map_err(|error| port(&error))?,
            notifier: notifier.map_err(|error| port(&error))?,
            listener: place.command_event()?.listener_builder().create().map_err(|error| port(&error))?,
            wait_limit: WaitLimit::new(termination, silence),
            _place: place,
        })
    }
}

impl super::Robot for Robot<'_> {
    fn publish(&mut self, range: &Range) -> anyhow::Result<()> {
        self.ranges.send_copy(*range).map_err(|error| refused("range", error))?;
        self.notifier.notify().map_err(|error| refused("event", error))?;
        Ok(())
    }

    fn command(&mut self, tick: u64) -> anyhow::Result<Command> {
        let mut newest = None;
        while newest.is_none() {
            wait(&self.listener, &mut self.wait_limit)?;
            while let Some(sample) = self.commands.receive().map_err(|error| refused("command", error))? {
                newest = Some(*sample.payload()).filter(|command| command[TICK] == tick);
            }
        }
        self.wait_limit.reset();
        newest.ok_or_else(|| anyhow!("no command came: expected that of tick {tick}"))
    }
}
