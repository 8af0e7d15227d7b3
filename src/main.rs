//! `rangehound`: reads the command line and turns the one result into an exit code.

use std::process::ExitCode;

use clap::FromArgMatches;
use clap::error::ErrorKind;
use rangehound::cli::complete;
use rangehound::cli::{self, Cli, Command, RunArgs, one_line};
use rangehound::failure::{self, Failure};
use rangehound::live;
use rangehound::plan;
use rangehound::run::experiment::DEFAULT_SCENARIO;
use rangehound::run::node;
use rangehound::run::recorder;
use rangehound::run::remote;
use rangehound::run::status;
use rangehound::run::supervisor;
use rangehound::run::watch;
use rangehound::study::calibrate;
use rangehound::study::chaos;
use rangehound::study::compare;
use rangehound::study::explore;
use rangehound::study::latency;
use rangehound::study::replay;
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
        Command::Run(args) => supervisor::run(&args),
        Command::Track(args) => supervisor::track(&args),
        Command::Sim(args) => node::sim(&args),
        Command::Fusion(args) => node::fusion(&args),
        Command::Robot(args) => node::robot(&args),
        Command::Watch(args) => watch::watch(&args),
        Command::Record(args) => recorder::record(&args),
        Command::Replay(args) => replay::replay(&args),
        Command::Live(args) => live::live(&args),
        Command::Resume(args) => supervisor::resume(&args),
        Command::Status(args) => status::status(&args),
        Command::Kill(args) => remote::kill(&args),
        Command::Restart(args) => remote::restart(&args),
        Command::Stop(args) => remote::stop(&args),
        Command::Chaos(args) => chaos::chaos(&args),
        Command::Explore(args) => explore::explore(&args),
        Command::Plan(args) => plan::plan(&args),
        Command::Compare(args) => compare::compare(&args),
        Command::Calibrate(args) => calibrate::calibrate(&args),
        Command::Latency(args) => latency::latency(&args),
        Command::LatencyNode(args) => latency::reference::latency_node(&args),
        Command::Completions(args) => complete::completions(&args),
        Command::Names(args) => complete::names(&args),
        Command::Man(args) => complete::man(&args),
        Command::Scenario => failure::print(DEFAULT_SCENARIO),
    }
}
