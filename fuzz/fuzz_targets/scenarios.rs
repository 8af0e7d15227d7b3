#![no_main]

use rangehound_fuzz::{check, scenarios};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(scenarios, bytes)));
