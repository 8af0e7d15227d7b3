#![no_main]

use rangehound_fuzz::{check, true_tracks};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(true_tracks, bytes)));
