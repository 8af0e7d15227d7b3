#![no_main]

use rangehound_fuzz::{check, recordings};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(recordings, bytes)));
