//! Commands that the program `rangehound-gateway` carries out: `gateway`, `keys`.

use std::ffi::OsString;
use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;
use rangehound_shared::run_name::RunName;

use crate::failure::Failure;
use crate::run::gateway;

/// `gateway`.
#[derive(Debug, Args)]
pub struct GatewayArgs {
    /// Name of the run; waits until the run exists
    #[arg(long, default_value = rangehound_shared::scenario::defaults::NAME)]
    pub name: RunName,
    /// Address to listen on. Every address except the loopback (127.0.0.1 or ::1) requires --keys
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: SocketAddr,
    /// Folder with the keys of this host, from `rangehound keys`
    #[arg(long, value_name = "DIR")]
    pub keys: Option<PathBuf>,
}

/// `keys`.
#[derive(Debug, Args)]
pub struct KeysArgs {
    /// Folder for the keys. If it has an authority already, that one signs the new certificates
    #[arg(long, value_name = "DIR", default_value = "keys")]
    pub out: PathBuf,
    /// Host of the run, whose gateway the robots' hosts connect to
    #[arg(long, value_name = "NAME", required_unless_present = "hosts")]
    pub gateway: Option<String>,
    /// Host of robots, and the robots that it may speak for: alice=0,1 or bob=2-5; repeatable
    #[arg(long = "host", value_name = "NAME=ROBOTS")]
    pub hosts: Vec<String>,
    /// Days until the certificates expire [default: 365]
    #[arg(long, value_name = "N")]
    pub days: Option<String>,
}

impl GatewayArgs {
    /// Has the other program carry it out.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let mut args: Vec<OsString> = vec!["gateway".into()];
        args.extend(["--name".into(), self.name.to_string().into()]);
        args.extend(["--listen".into(), self.listen.to_string().into()]);
        args.extend(self.keys.iter().flat_map(|keys| ["--keys".into(), keys.into()]));
        gateway::hand_over(args)
    }
}

impl KeysArgs {
    /// Has the other program carry it out.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let mut args: Vec<OsString> = vec!["keys".into(), "--out".into(), self.out.clone().into()];
        args.extend(self.gateway.iter().map(|name| format!("--gateway={name}").into()));
        args.extend(self.hosts.iter().map(|host| format!("--host={host}").into()));
        args.extend(self.days.iter().map(|days| format!("--days={days}").into()));
        gateway::hand_over(args)
    }
}
