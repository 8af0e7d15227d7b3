//! Every dependency is free to use: `deny.toml`'s list, checked without further tools.

use std::process::Command;

use serde_json::Value;

#[test]
fn every_dependency_has_an_allowed_licence() {
    let root = env!("CARGO_MANIFEST_DIR");
    let deny: toml::Table = toml::from_str(&std::fs::read_to_string(format!("{root}/deny.toml")).unwrap()).unwrap();
    let allowed: Vec<&str> =
        deny["licenses"]["allow"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    let exceptions = deny["licenses"]["exceptions"].as_array().unwrap();
    let is_exception = |package: &Value, licence: &str| {
        let of_package = exceptions.iter().filter(|exception| exception["crate"].as_str() == package.as_str());
        of_package
            .flat_map(|exception| exception["allow"].as_array().unwrap())
            .any(|name| name.as_str() == Some(licence))
    };

    // Reads the resolved dependencies; builds nothing.
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version=1", "--locked", "--all-features"])
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(root)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    assert!(packages.len() > 50, "the list of dependencies is not complete");
    for package in packages {
        let (name, licence) = (&package["name"], package["license"].as_str().unwrap_or(""));
        let expression = spdx::Expression::parse_mode(licence, spdx::ParseMode::LAX)
            .unwrap_or_else(|error| panic!("{name}: licence {licence:?}: {error}"));
        assert!(
            expression.evaluate(|requirement| {
                let licence = requirement.to_string();
                allowed.contains(&licence.as_str()) || is_exception(name, &licence)
            }),
            "{name}: {licence} is not among the allowed licences of deny.toml"
        );
    }
}
