//! Topics and wake-ups over iceoryx2.
//!
//! Each topic is one publish-subscribe service for the whole run, not one per robot. If robots publish, every
//! sixteen of them has a service of its own: `range`, `range.1` and so on.
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
//! Data travels on topics; a wake-up ([`Notifier`]) carries no data. Each process waits in one [`Waiter`], for a
//! limited time, and drains the topics whose events came. After a time-out it drains all topics, because wake-ups
//! coalesce. Observers are never woken: they poll.

mod senders;

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::Duration;

use iceoryx2::config::Config;
use iceoryx2::node::NodeView;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::service::ipc::Service;
use rangehound_shared::message::{Command, Drive, Estimate, Header, Outgoing, Range, Truth, WorldEntry};
pub use rangehound_shared::protocol::wake::{Event, Events, WaitGroup};
use rustix::process::Pid;

use crate::block::BlockError;
use crate::rendezvous::{Rendezvous, Role, RoleLease, RunDescription};
use crate::system::clock::monotonic_ns;
use crate::system::resources;
use crate::wait_groups::WaitGroups;
pub use crate::wait_groups::{Notifier, Waiter};
use senders::{Senders, Standing};

/// Ports on each side of a topic beside the robots': the one node there, its standbys, observers, and dead nodes that are not
/// cleaned up yet. Each message costs a scan of all ports, used or not.
const PLACES: usize = 16;

/// Number of robots that publish on one service. To take a message, iceoryx2 looks at the publishers of its service one after the other.
pub const GROUP: usize = 16;

/// Publishers that are gone and whose last samples a subscriber can still take: each costs 4 kB of its memory. The next repeat
/// replaces any further lost samples.
const EXPIRED: usize = 4;

/// Samples queued for a subscriber; the newest displace the oldest. Two ticks and their repeats.
const BUFFER: usize = 4;

/// Longest sleep of a node: bounds how late it sees the end of the run without an event.
pub const IDLE: Duration = Duration::from_millis(100);

/// A payload and its topic.
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

/// Why the bus cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{what}: {reason}")]
pub struct BusError {
    what: String,
    reason: String,
}

impl BusError {
    fn new(what: impl Into<String>, reason: impl std::fmt::Debug) -> Self {
        let text = format!("iceoryx2 says {reason:?}");
        let reason = if ["Incompatible", "VersionMismatch"].iter().any(|word| text.contains(word)) {
            format!("made by another version of rangehound: use one version for all nodes of a run ({text})")
        } else {
            resources::run_out_of().map_or(text.clone(), |lack| format!("{lack} ({text})"))
        };
        Self { what: what.into(), reason }
    }
}

/// One process's place on the bus of its run.
#[derive(Debug)]
pub struct Bus {
    node: Node<Service>,
    run_id: u64,
    robots: usize,
    incarnation: Rc<Cell<u64>>,
    senders: Rc<Senders>,
    wait_groups: WaitGroups,
}

impl Bus {
    /// Connects the process that holds a role.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn of_role(run: &Rendezvous, role: Role, lease: &RoleLease) -> Result<Self, BusError> {
        let bus = Self::connect(run, &role.to_string())?;
        bus.take_role(run, role, lease)?;
        Ok(bus)
    }

    /// Takes a role: from now on this process sends in its name.
    ///
    /// # Errors
    /// [`BusError`] if the role's file cannot be written.
    pub fn take_role(&self, run: &Rendezvous, role: Role, lease: &RoleLease) -> Result<(), BusError> {
        self.mark_messages(lease.incarnation);
        let registered = run.roster().register_node(role, lease, self.node.id().value());
        registered.map_err(|error| BusError { what: format!("role {role}"), reason: error.to_string() })
    }

    /// Connects a process, under the name of its role or another, by its [`node`].
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn connect(run: &Rendezvous, name: &str) -> Result<Self, BusError> {
        let node = node(run, name)?;
        let senders = Rc::new(Senders::new(run.roster().clone(), run.description().scenario.robots.len()));
        let wait_groups = open_wait_groups(run)?;
        let RunDescription { run_id, scenario, .. } = run.description();
        Ok(Self {
            node,
            run_id: *run_id,
            robots: scenario.robots.len(),
            incarnation: Rc::new(Cell::new(0)),
            senders,
            wait_groups,
        })
    }

    /// Marks all further messages of this process with this incarnation of its role.
    pub fn mark_messages(&self, incarnation: u64) {
        self.incarnation.set(incarnation);
    }

    /// Removes what killed nodes of this run left behind, to free their ports. Returns how many nodes could not be cleaned
    /// up. Takes tens of milliseconds per node: for a supervisor, never for a node on the control path.
    pub fn clean_up_dead_nodes(&self) -> u64 {
        let clean = || self.node.blocking_cleanup_dead_nodes(Duration::from_secs(1)).failed_cleanups;
        if clean() == 0 {
            return 0;
        }
        // A node killed while it joined or left a service may have a stale tag, which fails its cleanup every time.
        let folder = self.node.config().global.node_dir().to_string();
        let _ = Node::<Service>::list(self.node.config(), |node| {
            if let NodeState::Dead(dead) = node {
                let tags = remove_tags(&std::path::Path::new(&folder).join(dead.id().value().to_string()));
                log::debug!("removed {tags} stale tags of the dead node {}", dead.id().value());
            }
            CallbackProgression::Continue
        });
        clean()
    }

    /// The service of a topic and, if robots publish on it, of one group of them.
    fn service<T: Topic>(
        &self,
        group: usize,
    ) -> Result<iceoryx2::service::port_factory::publish_subscribe::PortFactory<Service, [T], Header>, BusError> {
        let name = if group == 0 { T::NAME.to_owned() } else { format!("{}.{group}", T::NAME) };
        let name = ServiceName::new(&name).map_err(|error| BusError::new(T::NAME, error))?;
        let robots = if T::FROM_ROBOTS { GROUP.min(self.robots.saturating_sub(group * GROUP)) } else { self.robots };
        self.node
            .service_builder(&name)
            .publish_subscribe::<[T]>()
            .user_header::<Header>()
            .max_publishers(if T::FROM_ROBOTS { robots + PLACES } else { PLACES })
            .max_subscribers(if T::FROM_ROBOTS { PLACES } else { robots + PLACES })
            .max_nodes(robots + 2 * PLACES)
            .subscriber_max_buffer_size(BUFFER)
            .subscriber_max_borrowed_samples(BUFFER)
            .history_size(0)
            .enable_safe_overflow(true)
            .open_or_create()
            .map_err(|error| BusError::new(format!("topic {}", T::NAME), error))
    }

    /// A publisher of messages of up to `len_max` entries.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn publisher<T: Topic>(&self, len_max: usize) -> Result<Publisher<T>, BusError> {
        self.publisher_in(0, len_max)
    }

    /// A publisher of one robot's messages.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn publisher_of_robot<T: Topic>(&self, robot: usize) -> Result<Publisher<T>, BusError> {
        self.publisher_in(robot / GROUP, 1)
    }

    fn publisher_in<T: Topic>(&self, group: usize, len_max: usize) -> Result<Publisher<T>, BusError> {
        let port = self
            .service::<T>(group)?
            .publisher_builder()
            .initial_max_slice_len(len_max)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|error| BusError::new(format!("publisher of {}", T::NAME), error))?;
        Ok(Publisher { port, run_id: self.run_id, incarnation: Rc::clone(&self.incarnation) })
    }

    /// A subscriber to all further messages.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 refuses.
    pub fn subscriber<T: Topic>(&self) -> Result<Subscriber<T>, BusError> {
        let groups = if T::FROM_ROBOTS { self.robots.div_ceil(GROUP) } else { 1 };
        let port = |group| {
            let port = self.service::<T>(group)?.subscriber_builder().buffer_size(BUFFER).create();
            port.map_err(|error| BusError::new(format!("subscriber of {}", T::NAME), error))
        };
        Ok(Subscriber {
            ports: (0..groups).map(port).collect::<Result<_, _>>()?,
            run_id: self.run_id,
            senders: Rc::clone(&self.senders),
            impostors: Cell::new(0),
            held: RefCell::default(),
        })
    }

    /// The waiter of one wait group: this process waits on it.
    #[must_use]
    pub fn waiter_of(&self, group: WaitGroup) -> Waiter {
        Waiter::new(self.wait_groups.clone(), group, self.robots)
    }

    /// A notifier, which wakes a wait group.
    #[must_use]
    pub fn notifier_of(&self, group: WaitGroup) -> Notifier {
        Notifier::new(self.wait_groups.clone(), group)
    }
}

/// The waiter of one wait group of a run, for a process that only waits.
///
/// # Errors
/// [`BusError`] if the run's wait groups are gone.
pub fn waiter(run: &Rendezvous, group: WaitGroup) -> Result<Waiter, BusError> {
    Ok(Waiter::new(open_wait_groups(run)?, group, run.description().scenario.robots.len()))
}

fn open_wait_groups(run: &Rendezvous) -> Result<WaitGroups, BusError> {
    WaitGroups::open(run.shared_memory_prefix()).map_err(|error: BlockError| {
        let text = error.to_string();
        // The wait groups are created before any process can join.
        let is_gone = text.contains("DoesNotExist");
        let out_dir = run.description().out_dir.display();
        let gone = format!("removed during the run: stop the run, then continue it with `rangehound resume {out_dir}`");
        BusError {
            what: "the wait groups of the run".to_owned(),
            reason: if is_gone { format!("{gone} ({text})") } else { text },
        }
    })
}

/// A process's node in iceoryx2, set up for its run. Must be the process's first use of iceoryx2, whose global
/// configuration it sets: iceoryx2 falls back to that one when it cleans up after half-started nodes.
///
/// # Errors
/// [`BusError`] if iceoryx2 refuses.
pub fn node<S: iceoryx2::service::Service>(run: &Rendezvous, name: &str) -> Result<Node<S>, BusError> {
    set_log_level_from_env_or(LogLevel::Fatal);
    let config_path = run.iceoryx2_config_path().display().to_string();
    let config_error = |reason: &dyn std::fmt::Debug| BusError::new(&config_path, format!("{reason:?}"));
    let file = FilePath::new(config_path.as_bytes()).map_err(|error| config_error(&error))?;
    let global = Config::setup_global_config_from_file(&file).map_err(|error| config_error(&error))?;
    let mut config = global.clone();
    // Cleanup after dead nodes costs 10-55 ms each: never on a control path.
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    config.defaults.publish_subscribe.subscriber_expired_connection_buffer = EXPIRED;
    let node_error = |reason: &dyn std::fmt::Debug| BusError::new(format!("node {name}"), format!("{reason:?}"));
    let node_name = NodeName::new(name).map_err(|error| node_error(&error))?;
    let node = NodeBuilder::new()
        .name(&node_name)
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create()
        .map_err(|error| node_error(&error))?;
    // iceoryx2 creates its node counter with permissions for all users.
    run.close_to_others();
    Ok(node)
}

/// Removes the service and port tags in a dead node's folder; returns their number.
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
    port: iceoryx2::port::publisher::Publisher<Service, [T], Header>,
    run_id: u64,
    incarnation: Rc<Cell<u64>>,
}

impl<T: Topic> Publisher<T> {
    /// Sends one message and returns its time stamp, taken just before. If a subscriber's queue is full or its process is dead, the
    /// oldest message is lost; the sender never waits.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 has no memory for the message: a repeat would fail too.
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

impl<T: Topic> Publisher<T> {
    /// Sends a message of one entry: see [`Self::send`].
    ///
    /// # Errors
    /// See [`Self::send`].
    pub fn send_one(&self, message: &Outgoing<T>) -> Result<(), BusError> {
        self.send(message.tick, message.valid_at_s, std::slice::from_ref(&message.entry)).map(|_| ())
    }
}

/// Receives messages of one topic.
#[derive(Debug)]
pub struct Subscriber<T: Topic> {
    ports: Vec<iceoryx2::port::subscriber::Subscriber<Service, [T], Header>>,
    run_id: u64,
    senders: Rc<Senders>,
    impostors: Cell<u64>,
    /// Empty between two drains; kept to reuse its memory.
    held: RefCell<Vec<Sample<Service, [T], Header>>>,
}

impl<T: Topic> Subscriber<T> {
    /// Passes the queued messages of this run to `take`, in order for each sender. Messages with an entry for a role that the
    /// sender's process does not hold are dropped.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 cannot reach a publisher.
    pub fn drain(&self, mut take: impl FnMut(&Header, &[T])) -> Result<(), BusError> {
        // All samples are held until the end. A publisher that sends faster than this loop takes then reaches its borrow limit, and
        // the others get their turn: iceoryx2 takes from one publisher for as long as that has samples.
        let mut held = self.held.borrow_mut();
        held.clear();
        for port in &self.ports {
            loop {
                let sample = match port.receive() {
                    Ok(Some(sample)) => sample,
                    Ok(None) | Err(ReceiveError::ExceedsMaxBorrows) => break,
                    Err(error) => return Err(BusError::new(T::NAME, error)),
                };
                if sample.user_header().run_id == self.run_id {
                    match self.standing(&sample) {
                        Standing::Holder => take(sample.user_header(), sample.payload()),
                        Standing::Impostor => self.impostors.set(self.impostors.get() + 1),
                        Standing::Gone => {}
                    }
                }
                held.push(sample);
            }
        }
        held.clear();
        Ok(())
    }

    /// The sender's standing towards the role of its message: the first of its entries that is not [`Standing::Holder`].
    fn standing(&self, sample: &Sample<Service, [T], Header>) -> Standing {
        let node = sample.header().node_id();
        let pid = || Pid::from_raw(node.pid::<Service>().ok()?.value());
        let of_entry = |entry: &T| self.senders.standing(entry.sender(), node.value(), pid);
        // If one node publishes, all entries have the same sender role.
        let entries = if T::FROM_ROBOTS { usize::MAX } else { 1 };
        let mut standings = sample.payload().iter().take(entries).map(of_entry);
        standings.find(|standing| *standing != Standing::Holder).unwrap_or(Standing::Holder)
    }

    /// Connects to new publishers without taking anything: the newest messages stay queued.
    ///
    /// # Errors
    /// [`BusError`] if iceoryx2 cannot reach a publisher.
    pub fn keep_up(&self) -> Result<(), BusError> {
        self.ports
            .iter()
            .try_for_each(UpdateConnections::update_connections)
            .map_err(|error| BusError::new(T::NAME, error))
    }

    /// Messages since the last call whose sender did not hold their role.
    pub fn take_impostors(&self) -> u64 {
        self.impostors.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_of_another_version_is_reported() {
        let text = BusError::new("topic world", "IncompatibleTypes").to_string();
        assert!(text.starts_with("topic world: made by another version of rangehound: use one version"), "{text}");
    }
}
