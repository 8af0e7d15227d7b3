#![no_main]

use rangehound_fuzz::{check, made, run_files};

libfuzzer_sys::fuzz_target!(
    init: made::write_to_corpus("run_files", made::run_files()),
    |bytes: &[u8]| drop(check(run_files, bytes))
);
