#![no_main]

use rangehound_fuzz::{check, names};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(names, bytes)));
