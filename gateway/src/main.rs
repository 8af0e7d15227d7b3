//! The program `rangehound-gateway`.

fn main() {}
