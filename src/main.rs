//! `rangehound`: reads the command line and turns the one result into an exit code.

use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;
use rangehound::cli::{Cli, Command, RunArgs, one_line};
use rangehound::experiment::DEFAULT_SCENARIO;
use rangehound::failure::{self, Failure};
use rangehound::{chaos, compare, latency, live, node, plan, remote, supervisor, watch};

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).format_target(false).init();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => {
            return failure::print(error).map_or_else(|failure| failure.report(), |()| ExitCode::SUCCESS);
        }
        Err(error) => return Failure::input(one_line(&error)).report(),
    };
    match dispatch(cli.command.unwrap_or_else(|| Command::Run(RunArgs::default()))) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

fn dispatch(command: Command) -> Result<(), Failure> {
    match command {
        Command::Run(args) => supervisor::run(&args),
        Command::Track(args) => supervisor::track(&args),
        Command::Sim(args) => node::sim(&args),
        Command::Fusion(args) => node::fusion(&args),
        Command::Robot(args) => node::robot(&args),
        Command::Watch(args) => watch::watch(&args),
        Command::Live(args) => live::live(&args),
        Command::Resume(args) => supervisor::resume(&args),
        Command::Status(args) => remote::status(&args),
        Command::Kill(args) => remote::kill(&args),
        Command::Restart(args) => remote::restart(&args),
        Command::Stop(args) => remote::stop(&args),
        Command::Chaos(args) => chaos::chaos(&args),
        Command::Plan(args) => plan::plan(&args),
        Command::Compare(args) => compare::compare(&args),
        Command::Latency(args) => latency::latency(&args),
        Command::LatencyNode(args) => latency::reference::latency_node(&args),
        Command::Scenario => failure::print(DEFAULT_SCENARIO),
    }
}
