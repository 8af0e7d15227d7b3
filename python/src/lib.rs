//! The Python package's native half: arrays in, the project's own steps, arrays out. Nothing is computed here.
//!
//! | module | what |
//! |---|---|
//! | `scenario` | a checked scenario |
//! | `plan` | one step of a planner |
//! | `situation` | what a planner sees, and planners that are Python functions |
//! | `callables` | sensors, target models, localisers and drives that are Python functions |
//! | `filter` | the fusion centre's filter, tick by tick |
//! | `run` | runs as arrays: simulated, tracked or loaded |
//! | `live` | observers of live runs, and nodes with functions |
//! | `messages` | the messages of live runs, encoded as in `run.mcap` |
//! | `radio` | radios on serial ports |
//! | `ros` | the messages of a run for ROS |
//! | `studies` | `compare` and `calibrate` |
//! | `arrays`, `errors` | conversions; exceptions |

mod arrays;
mod callables;
mod errors;
mod filter;
mod live;
mod messages;
mod plan;
mod radio;
mod ros;
mod run;
mod scenario;
mod situation;
mod studies;

use pyo3::prelude::*;

/// The package's native half.
#[pymodule]
mod _native {
    use super::*;

    #[pymodule_export]
    use super::errors::{InputError, RunError};
    #[pymodule_export]
    use super::filter::Filter;
    #[pymodule_export]
    use super::live::{Observer, run_fusion, run_robot};
    #[pymodule_export]
    use super::messages::{MessageStream, channels};
    #[pymodule_export]
    use super::plan::{Plan, plan};
    #[pymodule_export]
    use super::ros::{ros_markers, ros_robot, ros_status, ros_target, ros_twist};
    #[pymodule_export]
    use super::run::{load, simulate};
    #[pymodule_export]
    use super::scenario::Scenario;
    #[pymodule_export]
    use super::situation::Situation;
    #[pymodule_export]
    use super::studies::{calibrate, calibrated, compare};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
