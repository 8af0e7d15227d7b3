//! From a scenario file to an experiment: checked, with a name and a folder.

use std::path::{Path, PathBuf};

use rangehound_fusion::planner;
use rangehound_node::rendezvous::{Created, Rendezvous, RendezvousError, RunDescription, living_runs};
use rangehound_shared::recording::{ReadSummary, Recording};
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Scenario, ScenarioFile, Source};

use crate::failure::{self, Failure};
use crate::files::input::{self, COMMAND_LINE, in_utf8};
use crate::files::layout::RUNS;
use crate::files::out_folder::NUMBERS_END;
use crate::run::node::input_or_running;

/// The default scenario file, as `rangehound scenario` prints it.
pub const DEFAULT_SCENARIO: &str = include_str!("../../scenarios/paper.toml");

/// How a run gets its name when the user gives none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Naming {
    /// The scenario's name, numbered if that is taken, so that no earlier result is overwritten.
    Numbered,
    /// The scenario's name, by which nodes in other terminals join.
    Exact,
}

/// An experiment whose input has been checked completely.
#[derive(Debug)]
pub struct Experiment {
    /// Name of the run.
    pub name: RunName,
    /// The run's description, for its nodes.
    pub description: RunDescription,
    /// The scenario file that leads here again, overrides included: for the run folder, beside the recording's copy.
    pub scenario_file: ScenarioFile,
    /// Files that were read to make it. Nothing may be written over them.
    inputs: Vec<PathBuf>,
    /// The next names to try, if the user has chosen none.
    numbered: Option<Numbered>,
}

/// The parts of numbered names.
#[derive(Debug)]
struct Numbered {
    wanted: String,
    /// The folder made for this one name; `None` if the user has chosen one.
    folder: Option<Reserved>,
}

/// A folder that reserves its name against other processes. It is removed again if it stays empty.
#[derive(Debug)]
pub struct Reserved(PathBuf);

impl Drop for Reserved {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir(&self.0);
    }
}

impl Experiment {
    /// The experiment of a scenario file as it was given.
    ///
    /// # Errors
    /// [`Failure::Input`] for whatever the user must mend.
    pub fn from_given(
        given: Given,
        name: Option<&RunName>,
        naming: Naming,
        out: Option<&Path>,
    ) -> Result<Self, Failure> {
        Self::check(given, None, name, naming, out)
    }

    /// The experiment of a recording that has been read already; `flags` as in [`Given`]. `inputs` are files that were read
    /// beside it.
    ///
    /// # Errors
    /// [`Failure::Input`] for whatever the user must mend.
    pub fn from_recording(
        file: ScenarioFile,
        flags: Vec<Flag>,
        read: (Recording, ReadSummary),
        name: Option<&RunName>,
        out: Option<&Path>,
        inputs: impl IntoIterator<Item = PathBuf>,
    ) -> Result<Self, Failure> {
        let given = Given { file, file_name: COMMAND_LINE.to_owned(), folder: PathBuf::new(), path: None, flags };
        let mut experiment = Self::check(given, Some(read), name, Naming::Numbered, out)?;
        experiment.inputs.extend(inputs);
        Ok(experiment)
    }

    /// Files that were read to make it: scenario, recording, anchors, true track.
    #[must_use]
    pub fn inputs(&self) -> Vec<&Path> {
        self.inputs.iter().map(PathBuf::as_path).collect()
    }

    /// The description for nodes, which read the recording's copy: without the recording's data.
    #[must_use]
    pub fn description_for_nodes(&self) -> RunDescription {
        let mut description = self.description.clone();
        if let Source::Recorded(ranges) = &mut description.scenario.source {
            ranges.forget();
        }
        description
    }

    fn check(
        given: Given,
        read: Option<(Recording, ReadSummary)>,
        name: Option<&RunName>,
        naming: Naming,
        out: Option<&Path>,
    ) -> Result<Self, Failure> {
        let Given { mut file, file_name, folder, path, flags } = given;
        let scenario = match read {
            Some(read) => Scenario::from_file_with(&file, &file_name, |_| Ok(read)),
            None => input::scenario(&file, &file_name, &folder),
        };
        let scenario = scenario.map_err(|error| Failure::input(error.by_flag(&flags)))?;
        let mut inputs = Vec::from_iter(path);
        if let (Some(recording), Source::Recorded(ranges)) = (file.recording.take(), &scenario.source) {
            inputs.extend(recording.inputs(&folder));
            let measurements = match ranges.already_read().map(|read| (read.ranges(), read.bearings())) {
                Some((0, bearings)) => format!("{bearings} bearings"),
                Some((ranges, bearings)) if bearings > 0 => format!("{ranges} ranges and {bearings} bearings"),
                _ => format!("{} ranges", ranges.summary.rows),
            };
            let sensors = scenario.robots.len();
            failure::print_stderr(format!(
                "recording: {measurements} of {sensors} sensors; read as {}",
                ranges.summary.read_as
            ));
            for line in ranges.summary.lines() {
                failure::print_stderr(format!("recording: {line}"));
            }
            file.recording = Some(recording.of_copy());
        }
        planner::for_team(scenario.planner, scenario.robots.len(), scenario.seed)
            .map_err(|error| Failure::Input(failure::located(error, &file_name)))?;
        let folder = std::path::absolute(out.unwrap_or(Path::new(RUNS)));
        in_utf8("--out", &folder.map_err(|error| Failure::input(format!("--out: {error}")))?)?;
        let (name, numbered) = match (name, naming) {
            (Some(name), _) => (name.clone(), None),
            (None, Naming::Exact) => (name_of(&scenario)?, None),
            (None, Naming::Numbered) => {
                let wanted = scenario.name.clone();
                let (name, folder) = free_name(&wanted, out.is_some())?;
                (name, Some(Numbered { wanted, folder }))
            }
        };
        let out = out.map_or_else(|| Path::new(RUNS).join(name.to_string()), Path::to_owned);
        let out_dir = std::path::absolute(&out).map_err(|error| Failure::input(format!("--out: {error}")))?;
        let description = RunDescription::new(scenario, out_dir);
        Ok(Self { name, description, scenario_file: file, inputs, numbered })
    }

    /// Creates its run, which no node can join yet. If the user gave no name and another process has just taken this one, the next
    /// is tried.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn create(&mut self) -> Result<Created, Failure> {
        loop {
            let description = self.description_for_nodes();
            let Some(Numbered { wanted, folder }) = &mut self.numbered else {
                return Rendezvous::create_closed(&self.name, description).map_err(input_or_running);
            };
            match Rendezvous::create_closed_if_free(&self.name, description) {
                Err(RendezvousError::Taken { .. }) => {
                    let (name, reserved) = free_name(wanted, folder.is_none())?;
                    if let Some(reserved) = reserved {
                        self.description.out_dir = std::path::absolute(&reserved.0)?;
                        *folder = Some(reserved);
                    }
                    self.name = name;
                }
                created => return created.map_err(input_or_running),
            }
        }
    }
}

/// A scenario file as the user gave it, not yet checked.
#[derive(Debug, Clone)]
pub struct Given {
    /// The scenario.
    pub file: ScenarioFile,
    /// Its name in errors.
    pub file_name: String,
    /// The base of relative paths in it.
    pub folder: PathBuf,
    /// The file, if it was read from one.
    pub path: Option<PathBuf>,
    /// The keys whose values the command line gave: errors name the flag.
    pub flags: Vec<Flag>,
}

/// A key of the scenario, and the flag that gives its value.
pub type Flag = (&'static str, &'static str);

impl Given {
    /// The file that the user named, or the paper's experiment.
    ///
    /// # Errors
    /// [`Failure::Input`] if the file cannot be read.
    pub fn read(path: Option<&Path>) -> Result<Self, Failure> {
        Ok(match path {
            Some(path) => Self {
                file: input::scenario_file(path)?,
                file_name: path.display().to_string(),
                folder: path.parent().unwrap_or(Path::new("")).to_owned(),
                path: Some(path.to_owned()),
                flags: Vec::new(),
            },
            None => Self {
                file: ScenarioFile::parse(DEFAULT_SCENARIO, "scenarios/paper.toml").map_err(Failure::input)?,
                // The default is valid: only values from the command line can be wrong.
                file_name: COMMAND_LINE.to_owned(),
                folder: PathBuf::new(),
                path: None,
                flags: Vec::new(),
            },
        })
    }
}

/// The name of a run that is named as its scenario is.
pub(crate) fn name_of(scenario: &Scenario) -> Result<RunName, Failure> {
    let name = &scenario.name;
    name.parse().map_err(|error| Failure::input(format!("name is {name:?}: {error}")))
}

/// The scenario's name, or the first of name-2, name-3, ... that no living run has and (unless the folder
/// is given) no folder. The folder is made at once: of several processes only one succeeds.
pub(crate) fn free_name(wanted: &str, folder_given: bool) -> Result<(RunName, Option<Reserved>), Failure> {
    let living = living_runs();
    let short: String = wanted.chars().take(19).collect();
    let candidates = std::iter::once(wanted.to_owned()).chain((2..NUMBERS_END).map(|n| format!("{short}-{n}")));
    for name in candidates.filter_map(|name| name.parse::<RunName>().ok()).filter(|name| !living.contains(name)) {
        if folder_given {
            return Ok((name, None));
        }
        let folder = Path::new(RUNS).join(name.to_string());
        let made = std::fs::create_dir_all(RUNS).and_then(|()| std::fs::create_dir(&folder));
        match made {
            Ok(()) => return Ok((name, Some(Reserved(folder)))),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists && folder.symlink_metadata().is_ok() => {}
            Err(error) => {
                let folder = folder.display();
                return Err(Failure::input(format!(
                    "cannot make the folder {folder}: {error}: choose another with --out"
                )));
            }
        }
    }
    Err(Failure::input("all numbered names of this scenario are taken: choose one with --name"))
}
