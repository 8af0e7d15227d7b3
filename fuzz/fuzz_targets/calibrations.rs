#![no_main]

use rangehound_fuzz::{check, calibrations};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(calibrations, bytes)));
