//! Recordings whose chunks another tool has compressed with zstd.

use rangehound::results::frame::Frame;
use rangehound::results::run_mcap::read::FrameReader;

use super::{replay, replayed};
use crate::command_line::hostile::targets::made::{chunk_of, frames, recorded, with_zstd};
use crate::support::Run;

#[test]
fn a_recording_that_another_tool_has_compressed_with_zstd_replays_to_the_bit() {
    let run = Run::new();
    run.lockstep("--record --in-process --ticks 2000").finish().succeeded();
    let bytes = with_zstd(&std::fs::read(run.path("out/run.mcap")).unwrap());
    assert!(bytes.windows(4).filter(|window| window == b"zstd").count() > 3);
    run.write("other.mcap", &bytes);
    assert_eq!(replayed(&run, "other.mcap")["ticks"], 2_000);
    assert_eq!(replayed(&run, "out/run.mcap")["ticks"], 2_000);

    run.write("cut.mcap", &bytes[..bytes.len() / 2]);
    let cut = replay(&run, "cut.mcap");
    assert_eq!((cut.code, cut.complaints().len()), (Some(2), 1), "{cut:#?}");
    assert!(cut.stderr.contains("cut short"), "{cut:#?}");
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 0x55;
    run.write("damaged.mcap", &damaged);
    let refused = replay(&run, "damaged.mcap");
    assert_eq!((refused.code, refused.complaints().len()), (Some(2), 1), "{refused:#?}");
    assert!(refused.stderr.contains("damaged.mcap") && !refused.stderr.contains("panicked"), "{refused:#?}");
}

#[test]
fn damaged_zstd_is_never_read_as_recorded() {
    let (description, all) = frames("paper.toml", 300);
    let complete = with_zstd(&recorded(&description, &all));
    let begin = complete.windows(4).position(|window| window == b"zstd").unwrap() + 12;
    let mut refused = 0;
    for n in 0..400 {
        let mut bytes = complete.clone();
        let at = begin + n * (complete.len() - begin - 60) / 400;
        bytes[at] ^= 1 << (n % 8);
        let Ok(mut reader) = FrameReader::open(&bytes[..]) else {
            refused += 1;
            continue;
        };
        let mut read = Vec::new();
        let end = loop {
            match reader.next_frame() {
                Ok(Some(frame)) => read.push(frame),
                Ok(None) => break None,
                Err(error) => break Some(error.to_string()),
            }
        };
        // A record with a damaged type may be skipped with its ticks; all frames that are read must equal the recorded
        // ones.
        let is_recorded = |frame: &Frame| {
            let recorded = all.iter().find(|recorded| recorded.tick == frame.tick);
            recorded.is_some_and(|recorded| format!("{recorded:?}") == format!("{frame:?}"))
        };
        assert!(read.iter().all(is_recorded), "{at}: {end:?}");
        refused += u32::from(end.is_some());
    }
    assert!(refused > 380, "{refused} of 400");
}

#[test]
fn a_huge_window_is_refused() {
    let (description, all) = frames("paper.toml", 3);
    let mut bytes = recorded(&description, &all);
    let complete = with_zstd(&bytes);
    let begin = complete.windows(4).position(|window| window == b"zstd").unwrap() - 41;
    bytes = complete[..begin].to_vec();
    // A window of a terabyte, and a block that repeats one byte.
    bytes.extend(chunk_of(1 << 20, 0, b"\x28\xb5\x2f\xfd\0\xf0\x03\0\x10x"));
    let mut reader = match FrameReader::open(&bytes[..]) {
        Ok(reader) => reader,
        Err(error) => panic!("{error}"),
    };
    let error = reader.next_frame().unwrap_err().to_string();
    assert!(error.contains("zstd") && error.contains("indow") && !error.contains('\n'), "{error}");
}
