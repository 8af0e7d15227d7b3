//! Data shared between processes changes only with the protocol number.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::path::{Path, PathBuf};

use xxhash_rust::xxh3::xxh3_64;

use rangehound_node::bus::{GROUP, Topic};
use rangehound_node::rendezvous::RunDescription;
use rangehound_robot::remote::wire::{Downlink, Driven, Echo, Heading, Measured, Uplink, World};
use rangehound_shared::message::{Command, Drive, Estimate, Header, Range, Truth, WorldEntry};
use rangehound_shared::protocol::PROTOCOL;
use rangehound_shared::recording::{ReadOptions, Recording};
use rangehound_shared::scenario::{PLANNERS, Scenario, ScenarioFile};

/// Every protocol so far with the digest of its data layout. Add a line for a new protocol; never change an old one.
const HISTORY: [(u32, u64); 9] = [
    (1, 0x8a98_a0c7_e0b3_ca0d),
    (2, 0xf26b_d96f_19ad_d4f6),
    (3, 0x1db7_11f4_60fd_fd13),
    (4, 0xc0ea_c5a0_6031_6e7e),
    (5, 0x7a0e_4cf4_61c2_071c),
    (6, 0x65ae_7aff_f591_598d),
    (7, 0x2195_e843_691a_5f26),
    (8, 0x2d2b_c56f_f932_6c87),
    (9, 0xeca9_6cf1_12b2_78c8),
];

/// The same for the description of a recorded run.
const RECORDED: (u32, u64) = (9, 0x094c_d944_0582_54f0);

/// The versioned type names that iceoryx2 compares; reading them through iceoryx2 would take `unsafe`.
fn type_names() -> String {
    let sources = [
        include_str!("../../shared/src/measurement.rs"),
        include_str!("../../shared/src/message.rs"),
        include_str!("../src/wait_groups.rs"),
    ];
    let lines = sources.into_iter().flat_map(str::lines).filter(|line| line.starts_with("#["));
    let names = lines.filter_map(|line| line.split_once("type_name(")?.1.split_once(')'));
    names.map(|(name, _)| format!("#[type_name({name})]")).collect()
}

/// Size and fields in order; `0` is an integer and `0.0` a float.
fn layout<T: Default + std::fmt::Debug>() -> String {
    format!("{} {} {:?}\n", size_of::<T>(), align_of::<T>(), T::default())
}

fn topic<T: Topic + Default>() -> String {
    format!("{} {}", T::NAME, layout::<T>())
}

/// The fields of the frames between hosts.
fn frames() -> String {
    let down = Downlink { world: Some(World::default()), heading: Some(Heading::default()), ..Downlink::default() };
    let driven = Driven { heading_after_ns: Some(0), ..Driven::default() };
    let (echo, measured) = (Some(Echo::default()), vec![Measured::default()]);
    let up = Uplink { echo, measured, driven: Some(driven), ..Uplink::default() };
    // Their names, and their bytes after the version.
    format!("{down:?} {:?}\n{up:?} {:?}\n", &down.to_bytes()[1..], &up.to_bytes()[1..])
}

/// The fields of a description, without the values of numbers.
fn description() -> String {
    let scenario = |text: &str| {
        let text = format!("{text}\n[robots]\ncount = 1\n[filter]\ngate_sigma = 3.0\n");
        Scenario::from_file(&ScenarioFile::parse(&text, "test").unwrap(), "test").unwrap()
    };
    let built_in = RunDescription { run_id: 7, scenario: scenario(""), out_dir: PathBuf::from("out") };
    let rows = "[[1.0, 0.0], [0.0, 1.0]]";
    let custom = format!("[target]\nmodel = \"custom\"\nphi = {rows}\nqd = {rows}\nstart = [0.0, 0.0]");
    let planners = PLANNERS.map(|name| scenario(&format!("[planner]\nname = {name:?}")).planner);
    let mut text = serde_json::to_string(&(built_in, scenario(&custom).motion, planners)).unwrap() + "\n";
    text.retain(|c| !c.is_ascii_digit() && !".-".contains(c));
    text
}

#[test]
fn a_recorded_runs_description_changes_only_with_the_protocol() {
    let text = "[recording]\nranges = \"r.csv\"\ntarget_height_m = 1.0\n[filter]\ngate_sigma = 3.0\n";
    let csv = "time_s,sensor_id,sensor_x_m,sensor_y_m,sensor_z_m,range_m,other\n1,a,0,0,2,3,x\n1,a,0,0,2,z,x\n2,a,0,0,2,3,x\n";
    let read = Recording::parse(csv.as_bytes(), Path::new("r.csv"), &ReadOptions::default()).unwrap();
    let file = ScenarioFile::parse(text, "test").unwrap();
    let scenario = Scenario::from_file_with(&file, "test", |_| Ok(read)).unwrap();
    let description = RunDescription { run_id: 7, scenario, out_dir: PathBuf::from("out") };
    let mut text = serde_json::to_string(&description).unwrap();
    text.retain(|c| !c.is_ascii_digit() && !".-".contains(c));
    let digest = xxh3_64(text.as_bytes());
    assert_eq!(RECORDED, (PROTOCOL, digest), "as below, here {digest:#018x}\n{text}");
}

#[test]
fn messages_change_only_with_the_protocol() {
    let text = [
        type_names(),
        layout::<Header>(),
        topic::<WorldEntry>(),
        topic::<Range>(),
        topic::<Command>(),
        topic::<Drive>(),
        topic::<Estimate>(),
        topic::<Truth>(),
        format!("{GROUP} robots on one service\n"),
        frames(),
        description(),
    ]
    .concat();
    let digest = xxh3_64(text.as_bytes());
    assert_eq!(
        HISTORY.last(),
        Some(&(PROTOCOL, digest)),
        "a message, a frame or the run's description has changed: give the changed messages a new version in their type names, \
         increase PROTOCOL by one, and add the line ({}, {digest:#018x}) to HISTORY\n{text}",
        PROTOCOL + 1
    );
    assert!(HISTORY.is_sorted_by(|before, after| before.0 < after.0 && before.1 != after.1));
}
