#![no_main]

use rangehound_fuzz::{check, anchors};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(anchors, bytes)));
