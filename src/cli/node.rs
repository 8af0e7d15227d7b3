//! One node: `sim`, `fusion`, `robot`.

use clap::Args;
use rangehound_node::rendezvous::Role;
use rangehound_shared::run_name::RunName;

use super::ExperimentArgs;
use super::values::whole;
use crate::study::latency::reference::Reference;

/// `sim`.
#[derive(Debug, Args)]
pub struct SimArgs {
    /// The experiment, if this process founds the run
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// Who to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// `fusion`.
#[derive(Debug, Args)]
pub struct FusionArgs {
    /// Which run
    #[command(flatten)]
    pub node: NodeArgs,
    /// Stand by: follow the run, and lead as soon as nobody does or who leads hangs
    #[arg(long)]
    pub standby: bool,
}

/// `robot`.
#[derive(Debug, Args)]
pub struct RobotArgs {
    /// Which robot of the team, counted from 0
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub id: u64,
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
}

/// `latency-node`.
#[derive(Debug, Args)]
pub struct LatencyNodeArgs {
    /// How it talks
    #[arg(long)]
    pub reference: Reference,
    /// fusion, who is the centre, or robot-N
    #[arg(long)]
    pub role: Role,
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
}

/// What the nodes and who watches them have in common.
#[derive(Debug, Args)]
pub struct NodeArgs {
    /// Name of the run to join; waits for it to be founded
    #[arg(long, default_value = rangehound_shared::scenario::defaults::NAME)]
    pub name: RunName,
    /// Who to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// Set by `run` for the nodes that it starts, and by `latency` for what it measures.
#[derive(Debug, Default, Args)]
pub struct ParentArgs {
    /// End when this process, the parent, ends
    #[arg(long, value_name = "PID", hide = true)]
    pub end_with: Option<u32>,
}
