#![no_main]

use rangehound_fuzz::{check, radio_logs};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(radio_logs, bytes)));
