#![no_main]

use rangehound_fuzz::{bags, check, made};

libfuzzer_sys::fuzz_target!(
    init: made::write_to_corpus("bags", made::bags()),
    |bytes: &[u8]| drop(check(bags, bytes))
);
