#![no_main]

use rangehound_fuzz::{check, made, node_states};

libfuzzer_sys::fuzz_target!(
    init: made::write_to_corpus("node_states", made::node_states()),
    |bytes: &[u8]| drop(check(node_states, bytes))
);
