#![no_main]

use rangehound_fuzz::{check, command_lines};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drop(check(command_lines, bytes)));
