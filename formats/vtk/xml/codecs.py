"""Compression of the blocks of an array: zlib, lzma (as xz) and lz4."""

from __future__ import annotations

import importlib
import lzma
import zlib
from collections.abc import Callable
from typing import Any

from meshdeform_core.errors import FormatError

# Largest compression ratio, by the definition of zlib and lz4; lzma exceeds it for constants.
LARGEST_RATIO = {"none": 1, "zlib": 1032, "lz4": 255, "lzma": 10_000}

# VTK's own level.
_LEVEL = 5
# Memory limit of decompression; the largest preset needs 65 MiB.
_LZMA_MEMORY = 80 << 20
_SMALLEST_DICTIONARY = 4096


class DamagedBlock(Exception):
    """A compressed block contradicts its header; the message is the reason."""


def require_codec(compression: str, path: Any) -> None:
    """Refuse lz4 where its package is missing.

    Raises
    ------
    FormatError
        With the command that installs it.
    """
    if compression == "lz4":
        _lz4(path)


def _lz4(path: Any) -> Any:
    try:
        return importlib.import_module("lz4.block")
    except ImportError as error:
        raise FormatError(
            f"{path}: compression lz4 needs the package lz4, which is not installed; pip install lz4, or choose "
            "compression = zlib, lzma or none"
        ) from error


def packer(compression: str, path: Any) -> Callable[[bytes | memoryview], bytes]:
    """The function that compresses one block."""
    if compression == "zlib":
        return lambda block: zlib.compress(block, _LEVEL)
    if compression == "lzma":
        return _pack_lzma
    compress = _lz4(path).compress
    return lambda block: bytes(compress(block, store_size=False))


def _pack_lzma(block: bytes | memoryview) -> bytes:
    # A dictionary larger than the block costs time to clear for each block, and compresses no better.
    filters = [{"id": lzma.FILTER_LZMA2, "preset": _LEVEL, "dict_size": max(len(block), _SMALLEST_DICTIONARY)}]
    return lzma.compress(block, lzma.FORMAT_XZ, lzma.CHECK_CRC32, filters=filters)


def unpacker(compression: str, path: Any) -> Callable[[bytes, int], bytes]:
    """The function that decompresses one block to exactly the given number of bytes.

    It raises :class:`DamagedBlock` and never decompresses more than one byte beyond.
    """
    if compression == "lz4":
        return _lz4_unpacker(_lz4(path))
    unpack = _unpack_zlib if compression == "zlib" else _unpack_lzma

    def checked(packed: bytes, size: int) -> bytes:
        try:
            data, complete = unpack(packed, size + 1)
        except (zlib.error, lzma.LZMAError) as error:
            raise DamagedBlock(str(error)) from error
        if len(data) != size or not complete:
            found = f"more than {size}" if len(data) > size else f"{len(data)}"
            raise DamagedBlock(f"it decompresses to {found} bytes, expected {size}")
        return data

    return checked


def _unpack_zlib(packed: bytes, most: int) -> tuple[bytes, bool]:
    stream = zlib.decompressobj()
    return stream.decompress(packed, most), stream.eof


def _unpack_lzma(packed: bytes, most: int) -> tuple[bytes, bool]:
    stream = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_LZMA_MEMORY)
    return stream.decompress(packed, most), stream.eof


def _lz4_unpacker(block: Any) -> Callable[[bytes, int], bytes]:
    def checked(packed: bytes, size: int) -> bytes:
        try:
            data: bytes = block.decompress(packed, uncompressed_size=size)
        except (block.LZ4BlockError, ValueError) as error:
            raise DamagedBlock(str(error)) from error
        if len(data) != size:
            raise DamagedBlock(f"it decompresses to {len(data)} bytes, expected {size}")
        return data

    return checked
