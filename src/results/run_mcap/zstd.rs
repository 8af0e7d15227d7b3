//! Chunks that other tools have compressed with zstd, such as `mcap` and `ros2 bag`. Our own are of lz4.

use std::io::Read;

use mcap::sans_io::decompressor::{DecompressResult, Decompressor};
use mcap::{McapError, McapResult};
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

/// Largest window that is taken: what the format's standard asks every decoder to take, and a bound for the memory that a
/// damaged or hostile file can have.
const WINDOW_MAX: u64 = 8 << 20;

/// Longest header of a frame, bytes.
const FRAME_HEADER_MAX: usize = 18;

/// A block's header, its longest body, and a frame's checksum, bytes.
const BLOCK_HEADER: usize = 3;
const BLOCK_MAX: usize = 128 << 10;
const CHECKSUM: usize = 4;

/// Bit of a frame's descriptor, the byte after its magic number: a checksum follows its last block.
const HAS_CHECKSUM: u8 = 1 << 2;
const DESCRIPTOR: usize = 4;

/// Decompresses a block at a time, so that few compressed bytes cannot become many at once.
pub(super) struct ZstdDecoder {
    frame: FrameDecoder,
    is_in_frame: bool,
    has_checksum: bool,
    /// Bytes left of a frame that is no data.
    to_skip: usize,
}

impl ZstdDecoder {
    pub(super) fn new() -> Self {
        let mut frame = FrameDecoder::new();
        frame.set_max_window_size(WINDOW_MAX);
        Self { frame, is_in_frame: false, has_checksum: false, to_skip: 0 }
    }

    /// Takes what stands between two frames' blocks; how many bytes, and whether there may be more.
    fn begin_frame(&mut self, input: &[u8]) -> McapResult<Option<usize>> {
        if self.to_skip > 0 {
            let skipped = self.to_skip.min(input.len());
            self.to_skip -= skipped;
            return Ok((skipped > 0).then_some(skipped));
        }
        let mut rest = input;
        match self.frame.reset(&mut rest) {
            Ok(()) => {
                self.is_in_frame = true;
                self.has_checksum = input.get(DESCRIPTOR).is_some_and(|descriptor| descriptor & HAS_CHECKSUM != 0);
            }
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                self.to_skip = length as usize;
            }
            // It may be cut where the bytes that have been read end.
            Err(FrameDecoderError::ReadFrameHeaderError(error))
                if input.len() < FRAME_HEADER_MAX && !matches!(error, ReadFrameHeaderError::BadMagicNumber(_)) =>
            {
                return Ok(None);
            }
            Err(error) => return Err(damaged(error)),
        }
        Ok(Some(input.len() - rest.len()))
    }

    /// Decodes the next block, if it is whole; how many bytes it took.
    fn decode_block(&mut self, input: &[u8]) -> McapResult<Option<usize>> {
        let Some(header) = input.first_chunk::<BLOCK_HEADER>() else { return Ok(None) };
        let header = u32::from_le_bytes([header[0], header[1], header[2], 0]);
        let (is_last, kind, size) = (header & 1 != 0, header >> 1 & 3, (header >> 3) as usize);
        if size > BLOCK_MAX {
            return Err(damaged("a block is too long"));
        }
        let is_repeated_byte = kind == 1;
        let body = if is_repeated_byte { 1 } else { size };
        let len = BLOCK_HEADER + body + if is_last && self.has_checksum { CHECKSUM } else { 0 };
        let Some(mut block) = input.get(..len) else { return Ok(None) };
        self.frame.decode_blocks(&mut block, BlockDecodingStrategy::UptoBlocks(1)).map_err(damaged)?;
        Ok(Some(len))
    }

    /// Ends a frame of which all has been handed out.
    fn end_frame(&mut self) -> McapResult<()> {
        self.is_in_frame = false;
        let expected = self.frame.get_checksum_from_data();
        if expected.is_some() && expected != self.frame.get_calculated_checksum() {
            return Err(damaged("its checksum is not that of its data"));
        }
        Ok(())
    }
}

impl Decompressor for ZstdDecoder {
    fn next_read_size(&self) -> usize {
        0
    }

    fn decompress(&mut self, src: &[u8], dst: &mut [u8]) -> McapResult<DecompressResult> {
        let mut consumed = 0;
        loop {
            let mut wrote = 0;
            if self.is_in_frame {
                wrote = self.frame.read(dst).map_err(damaged)?;
                if self.frame.is_finished() && self.frame.can_collect() == 0 {
                    self.end_frame()?;
                }
            }
            let input = &src[consumed..];
            if wrote > 0 || input.is_empty() {
                return Ok(DecompressResult { consumed, wrote });
            }
            let taken = if self.is_in_frame { self.decode_block(input)? } else { self.begin_frame(input)? };
            let Some(taken) = taken else { return Ok(DecompressResult { consumed, wrote }) };
            consumed += taken;
        }
    }

    fn reset(&mut self) -> McapResult<()> {
        (self.is_in_frame, self.to_skip) = (false, 0);
        Ok(())
    }

    fn name(&self) -> &'static str {
        "zstd"
    }
}

fn damaged(reason: impl std::fmt::Display) -> McapError {
    McapError::DecompressionError(format!("zstd: {reason}"))
}
