//! The program `rangehound-gateway`: robots on other hosts. It is a program of its own because of its network libraries.

use std::ffi::OsString;
use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use rangehound_node::gateway_note::{GatewayNote, RemoteRobotNote};
use rangehound_node::rendezvous::{Rendezvous, Role};

use crate::failure::Failure;

/// Its name.
const PROGRAM: &str = "rangehound-gateway";

/// Where it is: beside this program, or in `PATH`.
///
/// # Errors
/// [`Failure`] if it is not installed.
pub fn program() -> Result<PathBuf, Failure> {
    let beside = std::env::current_exe().ok().and_then(|own| Some(own.parent()?.join(PROGRAM)));
    let path = std::env::var_os("PATH").unwrap_or_default();
    let in_path = std::env::split_paths(&path).map(|folder| folder.join(PROGRAM));
    beside.into_iter().chain(in_path).find(|program| program.is_file()).ok_or_else(|| {
        Failure::input(format!(
            "robots on other hosts need the program {PROGRAM}, which is neither beside this one nor in PATH: \
             `cargo build --release -p {PROGRAM}` makes it"
        ))
    })
}

/// Checks that a gateway could listen here with these keys. Returns the address, with a free port if none was given: the
/// gateway keeps it when it is started again.
///
/// # Errors
/// [`Failure`] with the gateway's own reason.
pub fn check(listen: SocketAddr, keys: Option<&Path>) -> Result<SocketAddr, Failure> {
    let mut command = Command::new(program()?);
    command.args(["gateway", "--check", "--listen", &listen.to_string()]);
    if let Some(keys) = keys {
        command.arg("--keys").arg(keys);
    }
    let output = command.output().map_err(|error| Failure::Running(error.into()))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).trim().parse().unwrap_or(listen));
    }
    let text = String::from_utf8_lossy(&output.stderr);
    Err(Failure::input(text.trim().trim_start_matches("rangehound: ").to_owned()))
}

/// Advice about a program that cannot be started.
const INSTALL: &str = "install the rangehound-gateway of this version";

/// The transports that the program can measure for `latency`: the names of the transports that it was built with.
///
/// # Errors
/// [`Failure`] if it is not installed or does not answer.
pub fn latency_transports() -> Result<Vec<String>, Failure> {
    let program = program()?;
    let output = Command::new(&program).arg("latency-transports").output();
    match output {
        Ok(output) if output.status.success() => {
            Ok(String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect())
        }
        Ok(output) => {
            let (program, status) = (program.display(), output.status);
            Err(anyhow::anyhow!("{program} cannot list what it measures: {status}: {INSTALL}").into())
        }
        Err(error) => Err(anyhow::anyhow!("cannot start {}: {error}: {INSTALL}", program.display()).into()),
    }
}

/// Becomes that program, with these arguments.
///
/// # Errors
/// [`Failure`] if it is not installed or cannot be started.
pub fn hand_over(args: impl IntoIterator<Item = OsString>) -> Result<(), Failure> {
    let program = program()?;
    let error = Command::new(&program).arg0("rangehound").args(args).exec();
    Err(Failure::Running(anyhow::anyhow!("cannot start {}: {error}: {INSTALL}", program.display())))
}

/// The link of a robot that takes part in a run from another host.
#[must_use]
pub fn remote_robot(run: &Rendezvous, role: Role) -> Option<RemoteRobotNote> {
    let robot = role.robot()?;
    let note = GatewayNote::read(run)?;
    let is_through_gateway = run.roster().holder(role).is_some_and(|pid| pid.as_raw_pid().cast_unsigned() == note.pid);
    note.robots.into_iter().find(|remote| remote.robot == robot && is_through_gateway)
}
