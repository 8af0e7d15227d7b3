//! `rangehound`: reads the command line and turns the one result into an exit code.

use std::process::ExitCode;

use clap::FromArgMatches;
use clap::error::ErrorKind;
use rangehound::cli::complete;
use rangehound::cli::{self, Cli, Command, RunArgs, one_line};
use rangehound::failure::{self, Failure};
use rangehound::run::experiment::DEFAULT_SCENARIO;
use rangehound::terminal;

fn main() -> ExitCode {
    terminal::start_log();
    let given = cli::command().try_get_matches().and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match given {
        Ok(cli) => cli,
        Err(error) if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => {
            return failure::print(error.render().ansi())
                .map_or_else(|failure| failure.report(), |()| ExitCode::SUCCESS);
        }
        Err(error) => return Failure::input(one_line(&error)).report(),
    };
    exit_code(dispatch(cli.command.unwrap_or_else(|| Command::Run(RunArgs::default()))))
}

fn exit_code(outcome: Result<(), Failure>) -> ExitCode {
    outcome.map_or_else(|failure| failure.report(), |()| ExitCode::SUCCESS)
}

fn dispatch(command: Command) -> Result<(), Failure> {
    match command {
        Command::Run(args) => args.carry_out(),
        Command::Track(args) => args.carry_out(),
        Command::Sim(args) => args.carry_out(),
        Command::Fusion(args) => args.carry_out(),
        Command::Robot(args) => args.carry_out(),
        Command::Gateway(args) => args.carry_out(),
        Command::Keys(args) => args.carry_out(),
        Command::Watch(args) => args.carry_out(),
        Command::Record(args) => args.carry_out(),
        Command::Replay(args) => args.carry_out(),
        Command::Live(args) => args.carry_out(),
        Command::Resume(args) => args.carry_out(),
        Command::Status(args) => args.carry_out(),
        Command::Kill(args) => args.kill(),
        Command::Restart(args) => args.restart(),
        Command::Stop(args) => args.stop(),
        Command::Chaos(args) => args.carry_out(),
        Command::Explore(args) => args.carry_out(),
        Command::Plan(args) => args.carry_out(),
        Command::Compare(args) => args.carry_out(),
        Command::Calibrate(args) => args.carry_out(),
        Command::Latency(args) => args.carry_out(),
        Command::LatencyNode(args) => args.carry_out(),
        Command::Completions(args) => complete::completions(&args),
        Command::Names(args) => complete::names(&args),
        Command::Man(args) => complete::man(&args),
        Command::Scenario => failure::print(DEFAULT_SCENARIO),
    }
}
