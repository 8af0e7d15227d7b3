//! The folder of a bag: an MCAP file, and `metadata.yaml`, which rosbag2 reads first.

use std::fmt::Write as _;
use std::path::Path;

use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;

use super::write::{BagWriter, Contents, QOS};
use crate::failure::Failure;
use crate::files::atomic_file::{self, AtomicFile};
use crate::files::layout::{BAG_FILE, BAG_METADATA, Kind};
use crate::files::out_folder::{self, Claim};
use crate::results::frame::Frame;
use crate::results::run_mcap::write::Written;

/// Version of the metadata: that of ROS 2 Jazzy and Kilted.
const VERSION: u32 = 9;

/// A bag in the making. Its file gets its name, and the folder its metadata, when it is finished.
pub struct BagFolder {
    claim: Claim,
    writer: BagWriter<AtomicFile>,
    scenario: String,
}

impl BagFolder {
    /// Begins a bag of a run in a new or empty folder, or in one of an earlier bag, whose files it replaces.
    ///
    /// # Errors
    /// [`Failure`] if the folder cannot be used.
    pub fn begin(folder: &Path, description: &RunDescription, bytes_max: u64) -> Result<Self, Failure> {
        let log = logs::estimates_path(&description.out_dir);
        let named = |refusal: out_folder::Refusal| Failure::input(refusal.to_string().replace("(--out)", "(--ros2)"));
        let claim = out_folder::claim(folder, Kind::Bag, &[&log]).map_err(named)?;
        claim.clear().map_err(named)?;
        let out = AtomicFile::create(&folder.join(BAG_FILE))?;
        let writer = BagWriter::begin(out, &description.scenario, bytes_max)?;
        Ok(Self { claim, writer, scenario: description.scenario.name.clone() })
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn write(&mut self, frame: &Frame) -> anyhow::Result<Written> {
        Ok(self.writer.write(frame)?)
    }

    /// Completes the file, and writes the metadata.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn finish(self) -> anyhow::Result<()> {
        let Self { claim, writer, scenario } = self;
        let (file, contents) = writer.finish()?;
        file.finish()?;
        atomic_file::write(&claim.path().join(BAG_METADATA), metadata(&contents, &scenario))
    }

    /// Removes the bag, which holds no tick.
    pub fn discard(self) {
        let Self { claim, writer, .. } = self;
        drop(writer);
        out_folder::remove(claim.path());
    }
}

/// The text of `metadata.yaml`.
fn metadata(contents: &Contents, scenario: &str) -> String {
    let [first_ns, last_ns] = contents.span_ns.unwrap_or_default();
    let (duration_ns, count) = (last_ns.saturating_sub(first_ns), contents.count());
    let mut topics = String::new();
    for (topic, channel) in &contents.topics {
        let interface = topic.interface();
        let qos = QOS.lines().fold(String::new(), |text, line| text + "          " + line + "\n");
        // A write to a string cannot fail.
        let _ = write!(
            topics,
            "    - topic_metadata:
        name: {}
        type: {}
        serialization_format: cdr
        offered_qos_profiles:
{qos}        type_description_hash: {}
      message_count: {}
",
            topic.name(),
            interface.name,
            interface.hash,
            channel.count
        );
    }
    // JSON's texts are texts of YAML.
    let scenario = serde_json::Value::from(scenario);
    let offset_ns = contents.offset_ns;
    format!(
        "rosbag2_bagfile_information:
  version: {VERSION}
  storage_identifier: mcap
  duration:
    nanoseconds: {duration_ns}
  starting_time:
    nanoseconds_since_epoch: {first_ns}
  message_count: {count}
  topics_with_message_count:
{topics}  compression_format: \"\"
  compression_mode: \"\"
  relative_file_paths:
    - {BAG_FILE}
  files:
    - path: {BAG_FILE}
      starting_time:
        nanoseconds_since_epoch: {first_ns}
      duration:
        nanoseconds: {duration_ns}
      message_count: {count}
  custom_data:
    scenario: {scenario}
    stamp_minus_run_time_ns: \"{offset_ns}\"
  ros_distro: rangehound
"
    )
}
