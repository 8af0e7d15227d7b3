//! Links the program at a fixed address.
//!
//! Each robot is a process of its own. With code at the same address in all of them, a processor that changes from one to the
//! next keeps what it has learnt of their branches: see docs/latency.md, "What each step bought". Stack, heap, shared memory
//! and libraries stay where the kernel puts them at random.

use std::env;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let of_target = |what: &str| env::var(format!("CARGO_CFG_TARGET_{what}")).unwrap_or_default();
    if of_target("OS") == "linux" && of_target("ENV") == "gnu" {
        println!("cargo:rustc-link-arg-bins=-no-pie");
    }
}
