"""Decompression with a limit on the output and with salvage of broken input."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import zstandard

from sma_bench.border import Budget, OverBudget

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

# Small pieces keep the output small (a zstd block makes 128 KiB from 4 bytes) and lose little of
# what lies before an error.
_PIECE = 4096
_LARGEST_MESSAGE = 1 << 24
_CUT = "the zstd compression is broken or cut short"


def decompress_zstd(data: bytes, limit: int) -> tuple[bytes, bool]:
    """Decompress one frame, as far as it goes.

    Returns:
        The output, at most `limit` bytes and one block, and whether the frame was whole.
    """
    decompressor = zstandard.ZstdDecompressor()
    try:
        if 0 <= zstandard.frame_content_size(data) <= limit:
            return decompressor.decompress(data), True
    except (zstandard.ZstdError, MemoryError):
        pass
    stream = decompressor.decompressobj()
    return _piece_by_piece(stream, data, limit, (zstandard.ZstdError, MemoryError))


def decompress_lz4(data: bytes, limit: int) -> tuple[bytes, bool]:
    """Decompress one lz4 frame, as far as it goes; nothing where lz4 is not installed."""
    try:
        import lz4.frame
    except ImportError:
        return b"", False
    stream = lz4.frame.LZ4FrameDecompressor()
    return _piece_by_piece(stream, data, limit, (RuntimeError, MemoryError, EOFError))


def _piece_by_piece(
    stream: Any, data: bytes, limit: int, broken: tuple[type[Exception], ...]
) -> tuple[bytes, bool]:
    """What a stream makes of the data until it raises one of `broken`, and whether that is all."""
    output, size = [], 0
    try:
        for start in range(0, len(data), _PIECE):
            if size > limit or stream.eof:
                break
            output.append(stream.decompress(data[start : start + _PIECE]))
            size += len(output[-1])
    except broken:
        return b"".join(output), False
    return b"".join(output), stream.eof and size <= limit


def decompress_file(source: Path, target: Path, budget: Budget) -> str:
    """Decompress a zstd file as far as it goes, and the budget does; what ended that too early."""
    decompressor = zstandard.ZstdDecompressor()
    stream = decompressor.decompressobj()
    with source.open("rb") as compressed, target.open("wb") as output:
        try:
            while piece := compressed.read(_PIECE):
                while piece:
                    if stream.eof:
                        stream = decompressor.decompressobj()
                    plain = stream.decompress(piece)
                    budget.take(len(plain))
                    output.write(plain)
                    piece = stream.unused_data if stream.eof else b""
        except OverBudget as error:
            return str(error)
        except (zstandard.ZstdError, MemoryError):
            return _CUT
    return "" if stream.eof else _CUT


def decompress_messages(blobs: Sequence[bytes], budget: Budget) -> tuple[list[bytes], int]:
    """Messages of a bag with per-message compression.

    Returns:
        The messages, those that cannot be decompressed as empty bytes, and how many those are.

    Raises:
        OverBudget: they are larger, all together, than they may be.
    """
    decompressor = zstandard.ZstdDecompressor()
    messages, broken = [], 0
    for blob in blobs:
        try:
            size = zstandard.frame_content_size(blob)
            if size > _LARGEST_MESSAGE:
                raise zstandard.ZstdError("larger than any message")
            messages.append(decompressor.decompress(blob, max_output_size=_LARGEST_MESSAGE))
            budget.take(len(messages[-1]))
        except (zstandard.ZstdError, MemoryError):
            messages.append(b"")
            broken += 1
    return messages, broken
