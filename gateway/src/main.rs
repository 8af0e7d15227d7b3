//! The program `rangehound-gateway`: a gateway, a robot that connects to one, and their keys. `rangehound` starts it for its
//! commands of the same names.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand, ValueEnum as _};
use rangehound_gateway::gateway::{self, GatewayError};
use rangehound_gateway::keys::command::KeysArgs;
use rangehound_gateway::reference::{Exchange, ReferenceError, Transport};
use rangehound_gateway::robot::{self, RobotError, Target};
use rangehound_node::rendezvous::{Rendezvous, RendezvousError, Role};
use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

/// Robots of rangehound on other hosts than the run
#[derive(Debug, Parser)]
#[command(name = "rangehound-gateway", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Let robots on other hosts take part in a run of this host
    Gateway(GatewayArgs),
    /// Run one robot of a run on another host: no shared memory is needed here
    Robot(RobotArgs),
    /// Make keys and certificates for the hosts of a team
    Keys(KeysArgs),
    /// Be a robot or the centre of a reference run of `rangehound latency --hosts`
    #[command(hide = true)]
    LatencyNode(LatencyNodeArgs),
    /// List the transports of `latency-node` that this program was built with
    #[command(hide = true)]
    LatencyTransports,
}

#[derive(Debug, Args)]
struct GatewayArgs {
    /// Name of the run; waits until the run exists
    #[arg(long, default_value = rangehound_shared::scenario::defaults::NAME)]
    name: RunName,
    /// Address to listen on. Every address except the loopback (127.0.0.1 or ::1) requires --keys
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: SocketAddr,
    /// Folder with the keys of this host, from `rangehound keys`
    #[arg(long, value_name = "DIR")]
    keys: Option<PathBuf>,
    /// End when this process ends
    #[arg(long, value_name = "PID", hide = true)]
    end_with: Option<u32>,
    /// Only check that it could listen, with these keys
    #[arg(long, hide = true)]
    check: bool,
}

#[derive(Debug, Args)]
struct RobotArgs {
    /// Number of the robot in the team, from 0
    #[arg(long, value_name = "N")]
    id: usize,
    /// Address of the run's gateway
    #[arg(long, value_name = "HOST:PORT")]
    connect: String,
    /// Folder with the keys of this host, from `rangehound keys`
    #[arg(long, value_name = "DIR")]
    keys: Option<PathBuf>,
    /// Name of the run [default: whichever the gateway serves]
    #[arg(long)]
    name: Option<RunName>,
    /// Allow the run's host to end this process
    #[arg(long)]
    allow_remote_control: bool,
}

#[derive(Debug, Args)]
struct LatencyNodeArgs {
    /// Transport of the frames
    #[arg(long, value_enum)]
    transport: Transport,
    /// The centre's address
    #[arg(long, value_name = "ADDRESS:PORT")]
    address: SocketAddr,
    /// Folder with the keys of this host
    #[arg(long, value_name = "DIR")]
    keys: PathBuf,
    /// Number of ticks
    #[arg(long, value_name = "N")]
    ticks: u64,
    /// Time between two ticks, ns; 0 if each follows the answer before
    #[arg(long, value_name = "NS")]
    dt_ns: u64,
    /// Be this robot
    #[arg(long, value_name = "N", conflicts_with = "robots", required_unless_present = "robots")]
    robot: Option<usize>,
    /// Be the centre of this many robots
    #[arg(long, value_name = "N")]
    robots: Option<usize>,
}

/// Why the program fails: 2 for input that it refuses, 1 for all else.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error("{0}")]
    Input(String),
    #[error("{0}")]
    Running(String),
}

/// Writes a line to standard error. A line that cannot be written is dropped: `eprintln!` would panic.
fn complain(line: impl std::fmt::Display) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "rangehound: {line}");
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if !error.use_stderr() => error.exit(),
        Err(error) => {
            // After an empty line clap adds advice and usage.
            let text = error.to_string();
            let lines: Vec<&str> = text.lines().take_while(|line| !line.is_empty()).map(str::trim).collect();
            complain(format_args!("{}: see --help", lines.join(" ").trim_start_matches("error: ")));
            return ExitCode::from(2);
        }
    };
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("rangehound=info,error"))
        .format(|out, record| {
            use std::io::Write as _;
            writeln!(out, "rangehound: {}", record.args())
        })
        .init();
    let ended = match cli.command {
        Command::Gateway(args) => args.carry_out(),
        Command::Robot(args) => args.carry_out(),
        Command::Keys(args) => args.carry_out().map_err(|error| Failure::Input(error.to_string())),
        Command::LatencyNode(args) => args.carry_out().map_err(|error| Failure::Running(error.to_string())),
        Command::LatencyTransports => {
            let transports = Transport::value_variants().iter().filter_map(Transport::to_possible_value);
            transports.for_each(|transport| println!("{}", transport.get_name()));
            Ok(())
        }
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            complain(&failure);
            ExitCode::from(if matches!(failure, Failure::Input(_)) { 2 } else { 1 })
        }
    }
}

impl GatewayArgs {
    fn carry_out(&self) -> Result<(), Failure> {
        let system = |error: &dyn std::fmt::Display| Failure::Running(error.to_string());
        if self.check {
            let checked = gateway::check(self.listen, self.keys.as_ref());
            return checked.map(|address| println!("{address}")).map_err(|error| Failure::Input(error.to_string()));
        }
        let termination = Termination::listen().map_err(|error| system(&error))?;
        end_with(self.end_with)?;
        Role::Gateway.name_process();
        let waiting = || complain(format_args!("waiting for run {}", self.name));
        let rendezvous = match Rendezvous::join(&self.name, &termination, waiting) {
            Err(RendezvousError::Terminated) => return Ok(()),
            joined => joined.map_err(|error| match error {
                RendezvousError::NotOurs(_)
                | RendezvousError::NoFolder(_)
                | RendezvousError::OtherBuild { .. }
                | RendezvousError::Unusable { .. }
                | RendezvousError::Short(_) => Failure::Input(error.to_string()),
                error => system(&error),
            })?,
        };
        let listening = |address: SocketAddr| {
            complain(format_args!("the gateway of run {} listens on {address}", self.name));
        };
        let ended = gateway::run(&rendezvous, self.listen, self.keys.as_ref(), &termination, listening);
        ended.map_err(|error| match error {
            GatewayError::Open(_)
            | GatewayError::Keys(_)
            | GatewayError::Rendezvous(RendezvousError::RoleTaken { .. })
            | GatewayError::NotGateway(_)
            | GatewayError::Address { .. } => Failure::Input(error.to_string()),
            error => Failure::Running(error.to_string()),
        })
    }
}

impl RobotArgs {
    fn carry_out(&self) -> Result<(), Failure> {
        let has_port = self.connect.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok());
        if !has_port {
            return Err(Failure::Input(format!(
                "--connect is {:?}: expected HOST:PORT, such as station:7400",
                self.connect
            )));
        }
        let termination = Termination::listen().map_err(|error| Failure::Running(error.to_string()))?;
        Role::Robot(self.id).name_process();
        let target = Target {
            gateway: self.connect.clone(),
            keys: self.keys.clone(),
            run: self.name.as_ref().map(ToString::to_string),
            allows_control: self.allow_remote_control,
        };
        robot::run(&target, self.id, &termination).map_err(|error| match error {
            RobotError::Refused(_) | RobotError::Keys(_) => Failure::Input(error.to_string()),
            error => Failure::Running(error.to_string()),
        })
    }
}

impl LatencyNodeArgs {
    fn carry_out(&self) -> Result<(), ReferenceError> {
        let Self { transport, address, ticks, dt_ns, .. } = *self;
        let exchange = Exchange { transport, address, keys: &self.keys, ticks, dt_ns };
        match (self.robot, self.robots) {
            (Some(robot), _) => exchange.be_robot(robot),
            (None, robots) => exchange.run_centre(robots.unwrap_or(0)),
        }
    }
}

/// Asks the kernel to end this process when its parent ends, if the parent is given.
fn end_with(parent: Option<u32>) -> Result<(), Failure> {
    let Some(pid) = parent else { return Ok(()) };
    set_parent_process_death_signal(Some(Signal::TERM)).map_err(|error| Failure::Running(error.to_string()))?;
    // The parent may have died before the line above.
    if getppid().map(Pid::as_raw_pid) != i32::try_from(pid).ok() {
        return Err(Failure::Running("the process that started this one (--end-with) has ended".to_owned()));
    }
    Ok(())
}
