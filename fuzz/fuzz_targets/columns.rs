#![no_main]

use rangehound_fuzz::{check, columns};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(columns, bytes)));
