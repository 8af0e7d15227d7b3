#![no_main]

use rangehound_fuzz::{check, made, run_descriptions};

libfuzzer_sys::fuzz_target!(
    init: made::write_to_corpus("run_descriptions", made::run_descriptions()),
    |bytes: &[u8]| drop(check(run_descriptions, bytes))
);
