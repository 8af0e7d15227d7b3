#![no_main]

use rangehound_fuzz::{check, words};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(words, bytes)));
