//! Topics and wake-ups over iceoryx2.
//!
//! Each topic is one publish-subscribe service for the whole run, never one for each robot:
//!
//! | topic | from -> to | payload |
//! |---|---|---|
//! | `world` | sim -> robots | an entry for each robot |
//! | `range` | robots -> fusion | one range |
//! | `heading` | fusion -> robots | a command for each robot |
//! | `drive` | robots -> sim | one robot's motion |
//! | `estimate` | fusion -> observers | the estimate |
//! | `truth` | sim -> observers | the target's true state |
//!
//! Data travels on topics; a wake-up only says "look". Each process waits on one listener, for a
//! limited time, and drains all of its topics at each wake-up, because wake-ups coalesce. Observers
//! are never woken: they look when they like.

mod senders;

use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

use iceoryx2::config::Config;
use iceoryx2::node::NodeView;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::event;
use rustix::process::Pid;

use crate::ROBOTS_MAX;
use crate::clock::monotonic_ns;
use crate::message::{Command, Drive, Estimate, Header, Range, Truth, WorldEntry};
use crate::rendezvous::{Rendezvous, Role, RoleHold};
use senders::{Senders, Standing};

/// Room for every robot, the other nodes, observers, and the dead of the past until they are cleaned.
const PORTS_MAX: usize = ROBOTS_MAX + 32;

/// Most messages that are taken at once: who sends faster than they can be refused must not keep the
/// others from being heard.
const DRAIN_MAX: usize = 16 * PORTS_MAX;

/// Samples that wait for a subscriber; the newest displace the oldest. Two ticks and their repeats.
const BUFFER: usize = 4;

/// Longest sleep of a node: how soon it sees that the run has ended if nobody calls.
pub const IDLE: Duration = Duration::from_millis(100);

/// Shortest sleep: less is rounded down to no time at all, which the kernel takes for no limit.
const SLEEP_MIN: Duration = Duration::from_micros(1);

/// A payload with the topic it travels on.
pub trait Topic: Copy + std::fmt::Debug + ZeroCopySend + 'static {
    /// Name of the service.
    const NAME: &'static str;
    /// True if every robot publishes, false if one node does.
    const FROM_ROBOTS: bool;

    /// The role that an entry speaks for.
    fn sender(&self) -> Role;
}

macro_rules! topics {
    ($($payload:ty => $name:literal, from_robots: $from_robots:literal, $entry:pat => $sender:expr;)*) => {
        $(impl Topic for $payload {
            const NAME: &'static str = $name;
            const FROM_ROBOTS: bool = $from_robots;

            fn sender(&self) -> Role {
                let $entry = self;
                $sender
            }
        })*
    };
}

topics! {
    WorldEntry => "world", from_robots: false, _ => Role::Sim;
    Range => "range", from_robots: true, range => Role::Robot(range.robot as usize);
    Command => "heading", from_robots: false, _ => Role::Fusion;
    Drive => "drive", from_robots: true, drive => Role::Robot(drive.robot as usize);
    Estimate => "estimate", from_robots: false, _ => Role::Fusion;
    Truth => "truth", from_robots: false, _ => Role::Sim;
}

/// Who can be woken: one event service each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sleeper {
    /// The simulator.
    Sim,
    /// The fusion centre.
    Fusion,
    /// All robots.
    Robots,
}

impl Sleeper {
    fn service(self) -> &'static str {
        match self {
            Self::Sim => "wake-sim",
            Self::Fusion => "wake-fusion",
            Self::Robots => "wake-robots",
        }
    }
}

/// Why somebody is woken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Call {
    /// There is data on a topic.
    Data,
    /// A node has just started and needs the present tick.
    Hello,
    /// The run has ended.
    Finished,
}

impl Call {
    const ALL: [Self; 3] = [Self::Data, Self::Hello, Self::Finished];

    fn event_id(self) -> EventId {
        EventId::new(self as usize)
    }
}

/// What a wait returned: the calls that came, none if time ran out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Calls([bool; Call::ALL.len()]);

impl Calls {
    /// True if this call was among them.
    #[must_use]
    pub fn has(self, call: Call) -> bool {
        self.0[call as usize]
    }
}

/// Why the bus cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{what}: iceoryx2 says {reason}")]
pub struct BusError {
    what: String,
    reason: String,
}

impl BusError {
    fn new(what: impl Into<String>, reason: impl std::fmt::Debug) -> Self {
        Self { what: what.into(), reason: format!("{reason:?}") }
    }
}

/// One process's place on the bus of its run.
#[derive(Debug)]
pub struct Bus {
    node: Node<ipc::Service>,
    run_id: u64,
    incarnation: Rc<Cell<u64>>,
    senders: Rc<Senders>,
}

impl Bus {
    /// Connects the process that holds a role.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn of_role(run: &Rendezvous, role: Role, hold: &RoleHold) -> Result<Self, BusError> {
        let bus = Self::connect(run, &role.to_string())?;
        bus.speak_as(hold.incarnation);
        Ok(bus)
    }

    /// Connects a process, under the name of its role or another. Must be the process's first use of
    /// iceoryx2, whose global configuration it sets: iceoryx2 falls back to that one when it cleans up
    /// after half-started nodes.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn connect(run: &Rendezvous, name: &str) -> Result<Self, BusError> {
        set_log_level_from_env_or(LogLevel::Fatal);
        let config_path = run.iceoryx2_config_path().display().to_string();
        let config_error = |reason: &dyn std::fmt::Debug| BusError::new(&config_path, format!("{reason:?}"));
        let file = FilePath::new(config_path.as_bytes()).map_err(|error| config_error(&error))?;
        let global = Config::setup_global_config_from_file(&file).map_err(|error| config_error(&error))?;
        let mut config = global.clone();
        // Cleaning up after the dead costs 10-55 ms each: never on a control path.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        let node_error = |reason: &dyn std::fmt::Debug| BusError::new(format!("node {name}"), format!("{reason:?}"));
        let node_name = NodeName::new(name).map_err(|error| node_error(&error))?;
        let node = NodeBuilder::new()
            .name(&node_name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|error| node_error(&error))?;
        let senders = Rc::new(Senders::new(run.roster().clone()));
        Ok(Self { node, run_id: run.description().run_id, incarnation: Rc::new(Cell::new(0)), senders })
    }

    /// From now on everything this process sends carries this incarnation of its role.
    pub fn speak_as(&self, incarnation: u64) {
        self.incarnation.set(incarnation);
    }

    /// Removes what killed nodes of this run left behind, so that their places become free, and returns how many
    /// it could not. Takes tens of milliseconds for each: for a supervisor, never for a node on the control path.
    pub fn clean_up_after_the_dead(&self) -> u64 {
        let clean = || self.node.blocking_cleanup_dead_nodes(Duration::from_secs(1)).failed_cleanups;
        if clean() == 0 {
            return 0;
        }
        // A node killed as it came to or left a service may have a tag of it that iceoryx2 stumbles over each time.
        let folder = self.node.config().global.node_dir().to_string();
        let _ = Node::<ipc::Service>::list(self.node.config(), |node| {
            if let NodeState::Dead(dead) = node {
                let tags = remove_tags(&std::path::Path::new(&folder).join(dead.id().value().to_string()));
                log::debug!("node {}: {tags} tags in the way of its cleaning removed", dead.id().value());
            }
            CallbackProgression::Continue
        });
        clean()
    }

    fn service<T: Topic>(
        &self,
    ) -> Result<iceoryx2::service::port_factory::publish_subscribe::PortFactory<ipc::Service, [T], Header>, BusError>
    {
        let name = ServiceName::new(T::NAME).map_err(|error| BusError::new(T::NAME, error))?;
        self.node
            .service_builder(&name)
            .publish_subscribe::<[T]>()
            .user_header::<Header>()
            .max_publishers(if T::FROM_ROBOTS { PORTS_MAX } else { 32 })
            .max_subscribers(if T::FROM_ROBOTS { 32 } else { PORTS_MAX })
            .max_nodes(PORTS_MAX)
            .subscriber_max_buffer_size(BUFFER)
            .subscriber_max_borrowed_samples(2)
            .history_size(1)
            .enable_safe_overflow(true)
            .open_or_create()
            .map_err(|error| BusError::new(format!("topic {}", T::NAME), error))
    }

    /// A publisher of messages of up to `len_max` entries.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn publisher<T: Topic>(&self, len_max: usize) -> Result<Publisher<T>, BusError> {
        let port = self
            .service::<T>()?
            .publisher_builder()
            .initial_max_slice_len(len_max)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|error| BusError::new(format!("publisher of {}", T::NAME), error))?;
        Ok(Publisher { port, run_id: self.run_id, incarnation: Rc::clone(&self.incarnation) })
    }

    /// A subscriber, which finds the newest earlier message waiting once its publisher sends again.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn subscriber<T: Topic>(&self) -> Result<Subscriber<T>, BusError> {
        let port = self
            .service::<T>()?
            .subscriber_builder()
            .buffer_size(BUFFER)
            .history_request(1)
            .create()
            .map_err(|error| BusError::new(format!("subscriber of {}", T::NAME), error))?;
        Ok(Subscriber { port, run_id: self.run_id, senders: Rc::clone(&self.senders), impostors: Cell::new(0) })
    }

    fn event(&self, sleeper: Sleeper) -> Result<event::PortFactory<ipc::Service>, BusError> {
        let name = ServiceName::new(sleeper.service()).map_err(|error| BusError::new(sleeper.service(), error))?;
        self.node
            .service_builder(&name)
            .event()
            .max_notifiers(PORTS_MAX)
            .max_listeners(PORTS_MAX)
            .max_nodes(PORTS_MAX)
            .event_id_max_value(Call::ALL.len() - 1)
            .open_or_create()
            .map_err(|error| BusError::new(sleeper.service(), error))
    }

    /// The bed of one sleeper: what this process waits on.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn sleep_as(&self, sleeper: Sleeper) -> Result<Bed, BusError> {
        let port = self
            .event(sleeper)?
            .listener_builder()
            .create()
            .map_err(|error| BusError::new(sleeper.service(), error))?;
        Ok(Bed { port })
    }

    /// A bell that wakes a sleeper.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn bell_of(&self, sleeper: Sleeper) -> Result<Bell, BusError> {
        let port = self
            .event(sleeper)?
            .notifier_builder()
            .create()
            .map_err(|error| BusError::new(sleeper.service(), error))?;
        Ok(Bell { port })
    }
}

/// Removes the tags of services and ports in a dead node's folder; how many there were.
fn remove_tags(folder: &std::path::Path) -> usize {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_tag = |path: &std::path::PathBuf| {
        path.extension().is_some_and(|extension| extension == "service_tag" || extension == "port_tag")
    };
    files.filter(is_tag).filter(|path| std::fs::remove_file(path).is_ok()).count()
}

/// Sends messages on one topic.
#[derive(Debug)]
pub struct Publisher<T: Topic> {
    port: iceoryx2::port::publisher::Publisher<ipc::Service, [T], Header>,
    run_id: u64,
    incarnation: Rc<Cell<u64>>,
}

impl<T: Topic> Publisher<T> {
    /// Sends one message and returns its stamp, taken just before. A full or dead subscriber loses the oldest
    /// message; the sender never waits.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 has no memory for it: nothing a repeat would mend.
    pub fn send(&self, tick: u64, valid_at_s: f64, entries: &[T]) -> Result<u64, BusError> {
        let failed =
            |reason: &dyn std::fmt::Debug| BusError::new(format!("send on {}", T::NAME), format!("{reason:?}"));
        let sent_ns = monotonic_ns();
        let sample = self.port.loan_slice_uninit(entries.len()).map_err(|error| failed(&error))?;
        let mut sample = sample.write_from_slice(entries);
        *sample.user_header_mut() =
            Header { run_id: self.run_id, incarnation: self.incarnation.get(), tick, valid_at_s, sent_ns };
        sample.send().map_err(|error| failed(&error))?;
        Ok(sent_ns)
    }
}

/// Receives messages of one topic.
#[derive(Debug)]
pub struct Subscriber<T: Topic> {
    port: iceoryx2::port::subscriber::Subscriber<ipc::Service, [T], Header>,
    run_id: u64,
    senders: Rc<Senders>,
    impostors: Cell<u64>,
}

impl<T: Topic> Subscriber<T> {
    /// Hands the waiting messages of this run to `take`, in order of each sender: those whose entries all
    /// speak for the role that the sender's process holds.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 cannot reach a publisher.
    pub fn drain(&self, mut take: impl FnMut(&Header, &[T])) -> Result<(), BusError> {
        for _ in 0..DRAIN_MAX {
            let Some(sample) = self.port.receive().map_err(|error| BusError::new(T::NAME, error))? else { break };
            if sample.user_header().run_id != self.run_id {
                continue;
            }
            let node = sample.header().node_id();
            let pid = || Pid::from_raw(node.pid::<ipc::Service>().ok()?.value());
            let standing = |entry: &T| self.senders.standing(entry.sender(), node.value(), pid);
            match sample.payload().iter().map(standing).find(|standing| *standing != Standing::Holder) {
                None => take(sample.user_header(), sample.payload()),
                Some(Standing::Impostor) => self.impostors.set(self.impostors.get() + 1),
                Some(_) => {}
            }
        }
        Ok(())
    }

    /// Connects to publishers that have come since, and takes nothing: the newest messages wait.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 cannot reach a publisher.
    pub fn keep_up(&self) -> Result<(), BusError> {
        self.port.update_connections().map_err(|error| BusError::new(T::NAME, error))
    }

    /// Messages since the last call that came from processes without the role they spoke for.
    pub fn take_impostors(&self) -> u64 {
        self.impostors.take()
    }
}

/// Where a process sleeps until it is called.
#[derive(Debug)]
pub struct Bed {
    port: Listener<ipc::Service>,
}

impl Bed {
    /// Sleeps until called, until time runs out, or until a signal comes.
    pub fn sleep(&self, at_most: Duration) -> Calls {
        let mut calls = Calls::default();
        // Once, let whoever is about to call do so: on a busy core that saves a sleep and a wake-up.
        std::thread::yield_now();
        // An error is a signal or a socket's hiccup: the loop looks at everything anyway.
        let _ = self.port.timed_wait(
            |activation| {
                if let Some(called) = calls.0.get_mut(activation.id.as_value()) {
                    *called = true;
                }
            },
            at_most.max(SLEEP_MIN),
        );
        calls
    }
}

/// Wakes a sleeper.
#[derive(Debug)]
pub struct Bell {
    port: Notifier<ipc::Service>,
}

impl Bell {
    /// Calls the sleeper. A sleeper that is dead or too busy to be called sees the data at its next
    /// look, so a failure is nothing to act on.
    pub fn ring(&self, call: Call) {
        if let Err(error) = self.port.notify_with_custom_event_id(call.event_id()) {
            log::debug!("a bell was not heard: {error:?}");
        }
    }
}
