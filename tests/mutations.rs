//! The faults of `tools/mutations.toml` still fit the sources: a change that moves a line moves its fault.

#[test]
fn each_fault_replaces_a_text_that_its_file_has_once() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |file: &str| std::fs::read_to_string(root.join(file)).unwrap();
    let faults: toml::Table = toml::from_str(&read("tools/mutations.toml")).unwrap();
    let faults = faults["mutation"].as_array().unwrap();
    let misfits = faults.iter().filter(|fault| {
        let [file, from, to] = ["file", "from", "to"].map(|key| fault[key].as_str().unwrap());
        read(file).matches(from).count() != 1 || from == to
    });
    let misfits: Vec<&str> = misfits.map(|fault| fault["what"].as_str().unwrap()).collect();
    assert!(misfits.is_empty(), "{misfits:?}");
    // Each member of the workspace is copied, without which the copy cannot be built.
    let workspace: toml::Table = toml::from_str(&read("Cargo.toml")).unwrap();
    let script = read("tools/mutations.py");
    let copied = script.lines().find(|line| line.starts_with("MEMBERS = ")).unwrap();
    for member in workspace["workspace"]["members"].as_array().unwrap() {
        assert!(copied.contains(&member.to_string()), "{member} is not copied");
    }
}
