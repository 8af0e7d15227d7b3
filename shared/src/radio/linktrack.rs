//! Frames of a LinkTrack, `NodeFrame3`, little-endian.
//!
//! | bytes | content |
//! |---|---|
//! | 0..2 | `55 05` |
//! | 2..4 | length of the complete frame |
//! | 4, 5 | role and id of the sending radio |
//! | 6..10, 10..14 | its own time, the system's time |
//! | 14..18 | reserved |
//! | 18..20 | supply voltage, mV |
//! | 20 | number of nodes |
//! | 7 each | role, id, range (int24, mm), first-path and total signal strength, dBm / -2 |
//! | last | sum of all bytes before, modulo 256 |

use super::{RadioRange, Refusal, add};

const START: [u8; 2] = [0x55, 0x05];
const HEADER_LEN: usize = 21;
const NODE_LEN: usize = 7;

/// Most nodes of a frame: the count is a byte.
const FRAME_LEN_MAX: usize = HEADER_LEN + 255 * NODE_LEN + 1;

/// The fields of a frame besides its ranges.
#[derive(Debug, Clone, Copy)]
pub(super) struct Head {
    pub(super) id: u8,
    pub(super) local_time: u32,
}

/// Finds frames in a stream; buffers one frame.
#[derive(Debug, Default)]
pub(super) struct Frames {
    bytes: Vec<u8>,
}

impl Frames {
    /// Takes the next bytes, and passes on each frame that they complete.
    ///
    /// After a wrong checksum the search for a start continues one byte later: the next frame may start within the
    /// bytes of the false one. Bytes between frames are skipped.
    pub(super) fn push(
        &mut self,
        mut bytes: &[u8],
        ranges: &mut Vec<RadioRange>,
        mut take: impl FnMut(Result<Head, Refusal>, &mut Vec<RadioRange>),
    ) {
        while !bytes.is_empty() {
            let count = bytes.len().min(FRAME_LEN_MAX);
            self.bytes.extend_from_slice(&bytes[..count]);
            bytes = &bytes[count..];
            let mut at = 0;
            loop {
                at += start(&self.bytes[at..]);
                let rest = &self.bytes[at..];
                let len = match frame_len(rest) {
                    Ok(Some(len)) if rest.len() >= len => len,
                    Ok(_) => break,
                    Err(refusal) => {
                        take(Err(refusal), ranges);
                        at += 1;
                        continue;
                    }
                };
                ranges.clear();
                match read(&rest[..len], ranges) {
                    // The checksum is right, so it is a frame even if its contents are invalid.
                    Err(Refusal::Checksum) => {
                        take(Err(Refusal::Checksum), ranges);
                        at += 1;
                    }
                    read => {
                        take(read, ranges);
                        at += len;
                    }
                }
            }
            self.bytes.drain(..at);
        }
    }

    pub(super) fn has_rest(&self) -> bool {
        !self.bytes.is_empty()
    }
}

/// Finds the next possible start of a frame.
fn start(bytes: &[u8]) -> usize {
    let found = bytes.windows(2).position(|pair| pair == START);
    let is_half = bytes.last() == Some(&START[0]);
    found.unwrap_or(bytes.len() - usize::from(is_half))
}

/// The length of the frame that starts here, if known.
fn frame_len(bytes: &[u8]) -> Result<Option<usize>, Refusal> {
    if bytes.len() < 4 {
        return Ok(None);
    }
    let len = usize::from(u16::from_le_bytes([bytes[2], bytes[3]]));
    let is_possible =
        (HEADER_LEN + 1..=FRAME_LEN_MAX).contains(&len) && (len - HEADER_LEN - 1).is_multiple_of(NODE_LEN);
    let Some(count) = bytes.get(HEADER_LEN - 1) else {
        return if is_possible { Ok(None) } else { Err(Refusal::Malformed) };
    };
    if len == HEADER_LEN + usize::from(*count) * NODE_LEN + 1 { Ok(Some(len)) } else { Err(Refusal::Malformed) }
}

/// Reads a frame of the stated length.
fn read(frame: &[u8], ranges: &mut Vec<RadioRange>) -> Result<Head, Refusal> {
    let (sum, summed) = frame.split_last().ok_or(Refusal::Malformed)?;
    if summed.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte)) != *sum {
        return Err(Refusal::Checksum);
    }
    for node in summed[HEADER_LEN..].chunks_exact(NODE_LEN) {
        // The highest of the three bytes has the sign.
        let range_mm = i32::from_le_bytes([0, node[2], node[3], node[4]]) >> 8;
        let range = RadioRange {
            anchor: node[1].to_string(),
            anchor_position_m: None,
            range_m: f64::from(range_mm) / 1000.0,
            rssi_dbm: Some(f64::from(node[6]) / -2.0),
        };
        add(ranges, range)?;
    }
    let local_time = u32::from_le_bytes([summed[6], summed[7], summed[8], summed[9]]);
    Ok(Head { id: summed[5], local_time })
}

/// A frame as the radio sends it, for tests of its readers.
#[cfg(test)]
pub(super) fn frame(id: u8, local_time: u32, nodes: &[(u8, i32)]) -> Vec<u8> {
    let mut frame = START.to_vec();
    frame.extend(u16::try_from(HEADER_LEN + nodes.len() * NODE_LEN + 1).unwrap().to_le_bytes());
    frame.extend([2, id]);
    frame.extend(local_time.to_le_bytes());
    frame.extend(7_000_u32.to_le_bytes());
    frame.extend([0; 4]);
    frame.extend(4_950_u16.to_le_bytes());
    frame.push(u8::try_from(nodes.len()).unwrap());
    for (node, range_mm) in nodes {
        frame.extend([1, *node]);
        frame.extend(&range_mm.to_le_bytes()[..3]);
        frame.extend([161, 158]);
    }
    frame.push(frame.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)));
    frame
}

#[cfg(test)]
mod tests {
    use super::*;

    type Read = (Vec<(u8, u32, Vec<(String, f64)>)>, Vec<Refusal>);

    fn read_all(chunks: &[&[u8]]) -> Read {
        let (mut frames, mut taken, mut refused, mut ranges) = (Frames::default(), Vec::new(), Vec::new(), Vec::new());
        for chunk in chunks {
            frames.push(chunk, &mut ranges, |head, ranges| match head {
                Ok(head) => {
                    let ranges = ranges.iter().map(|range| (range.anchor.clone(), range.range_m)).collect();
                    taken.push((head.id, head.local_time, ranges));
                }
                Err(refusal) => refused.push(refusal),
            });
            assert!(frames.bytes.capacity() <= 8 * FRAME_LEN_MAX);
        }
        (taken, refused)
    }

    #[test]
    fn a_frame_is_read_exactly() {
        // Built by hand: tag 5 hears anchor 3 at 4.321 m (0x0010E1) and 4 at -0.001 m.
        let mut bytes = vec![
            0x55, 0x05, 36, 0, 2, 5, 0x10, 0x27, 0, 0, 0x11, 0x27, 0, 0, 0, 0, 0, 0, 0x56, 0x13, 2, 1, 3, 0xE1, 0x10,
            0x00, 161, 158, 1, 4, 0xFF, 0xFF, 0xFF, 170, 165,
        ];
        bytes.push(bytes.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)));
        let expected = (5, 10_000, vec![("3".to_owned(), 4.321), ("4".to_owned(), -0.001)]);
        assert_eq!(read_all(&[&bytes]), (vec![expected.clone()], vec![]));
        assert_eq!(read_all(&bytes.chunks(1).collect::<Vec<_>>()), (vec![expected], vec![]));
    }

    #[test]
    fn after_garbage_the_next_frame_is_found() {
        let (one, two) = (frame(5, 1, &[(3, 1000)]), frame(5, 2, &[(3, 2000), (4, 8_388_607)]));
        let garbage = [b"\x55\x05\x55\x55\x05noise".as_slice(), &one[..20], &two, b"\x55", &one].concat();
        for size in [1, 7, garbage.len()] {
            let (taken, refused) = read_all(&garbage.chunks(size).collect::<Vec<_>>());
            assert_eq!(taken.iter().map(|frame| frame.1).collect::<Vec<_>>(), [2, 1], "{size}");
            assert_eq!(taken[0].2[1].1, 8388.607);
            assert!(!refused.is_empty());
        }
    }

    #[test]
    fn one_wrong_byte_is_refused() {
        let whole = frame(5, 1, &[(3, 1000), (4, 2000)]);
        for at in 0..whole.len() {
            for bit in 0..8 {
                let mut damaged = whole.clone();
                damaged[at] ^= 1 << bit;
                assert_eq!(read_all(&[&damaged]).0, [], "byte {at} bit {bit}");
            }
        }
        assert_eq!(read_all(&[&frame(5, 1, &[(3, 1000), (3, 2000)])]).1, [Refusal::AnchorTwice]);
    }
}
