#![no_main]

use rangehound_fuzz::{check, plan_lines};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(plan_lines, bytes)));
