#![no_main]

use rangehound_fuzz::{check, made, tick_logs};

libfuzzer_sys::fuzz_target!(
    init: made::write_to_corpus("tick_logs", made::tick_logs()),
    |bytes: &[u8]| drop(check(tick_logs, bytes))
);
