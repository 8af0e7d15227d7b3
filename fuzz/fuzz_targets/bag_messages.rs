#![no_main]

use rangehound_fuzz::{check, bag_messages};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(bag_messages, bytes)));
