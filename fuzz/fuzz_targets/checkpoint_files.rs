#![no_main]

use rangehound_fuzz::{check, made, checkpoint_files};

libfuzzer_sys::fuzz_target!(
    init: made::write_to_corpus("checkpoint_files", made::checkpoint_files()),
    |bytes: &[u8]| drop(check(checkpoint_files, bytes))
);
