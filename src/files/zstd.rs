//! Chunks that other tools, such as `mcap` and `ros2 bag`, have compressed with zstd. Our own chunks use lz4.

use std::io::Read;

use mcap::sans_io::decompressor::{DecompressResult, Decompressor};
use mcap::{McapError, McapResult};
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

/// Largest accepted window: the standard asks every decoder to accept this much. It bounds the memory that a damaged or
/// hostile file can use.
const WINDOW_MAX: u64 = 8 << 20;

/// Longest frame header, bytes.
const FRAME_HEADER_MAX: usize = 18;

/// A block's header, its longest body, and a frame's checksum, bytes.
const BLOCK_HEADER: usize = 3;
const BLOCK_MAX: usize = 128 << 10;
const CHECKSUM: usize = 4;

/// Bit of the frame descriptor, the byte after the magic number: a checksum follows the last block.
const HAS_CHECKSUM: u8 = 1 << 2;
const DESCRIPTOR: usize = 4;

/// Decompresses one block at a time, so that a few compressed bytes cannot expand to many at once.
pub(crate) struct ZstdDecoder {
    frame: FrameDecoder,
    is_in_frame: bool,
    has_checksum: bool,
    /// Remaining bytes of a skippable frame.
    to_skip: usize,
}

impl ZstdDecoder {
    pub(crate) fn new() -> Self {
        let mut frame = FrameDecoder::new();
        frame.set_max_window_size(WINDOW_MAX);
        Self { frame, is_in_frame: false, has_checksum: false, to_skip: 0 }
    }

    /// Reads a frame's header; returns the number of bytes used, and whether there may be more.
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
            // The header may be cut at the end of the bytes read so far.
            Err(FrameDecoderError::ReadFrameHeaderError(error))
                if input.len() < FRAME_HEADER_MAX && !matches!(error, ReadFrameHeaderError::BadMagicNumber(_)) =>
            {
                return Ok(None);
            }
            Err(error) => return Err(damaged(error)),
        }
        Ok(Some(input.len() - rest.len()))
    }

    /// Decodes the next block if it is complete; returns the number of bytes used.
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

    /// Ends a frame once all of its data have been returned.
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
