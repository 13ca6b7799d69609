"""Files of about 1 MB that claim to hold gigabytes, by what they lie about."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import zstandard

from acquisition.record.chunk_builder import MESSAGE_HEAD
from acquisition.record.contents import read_contents
from acquisition.record.topics import WINDOW
from tests.acquisition.record.samples import write_sample

_CHUNK_HEAD = struct.Struct("<BQQQQII4sQ")
_FILE_BYTES = 1_000_000
_LARGEST = 64 * 1024 * 1024


def make_bomb(path: Path, kind: str) -> None:
    """Write a record without an ending whose last chunks are lies of one `kind` of `BOMBS`."""
    path.unlink(missing_ok=True)
    write_sample(path, 64)
    with path.open("rb") as file:
        contents = read_contents(file)
    chunks = BOMBS[kind](next(n for n, channel in contents.channels.items() if channel.topic == "/window"))
    path.write_bytes(path.read_bytes()[: contents.data_end] + chunks)


def _chunk(data: bytes, size: int, crc: int) -> bytes:
    head = _CHUNK_HEAD.pack(6, _CHUNK_HEAD.size - 9 + len(data), 1, 2, size, crc, 4, b"zstd", len(data))
    return head + data


def _honest(data: bytes) -> bytes:
    return _chunk(zstandard.ZstdCompressor().compress(data), len(data), zlib.crc32(data))


def _many(chunk: bytes) -> bytes:
    return chunk * (_FILE_BYTES // len(chunk))


def _zero_frame(size: int) -> bytes:
    """A zstd frame of so many zeros, a multiple of 128 KiB: 4 bytes for every block."""
    block = 128 * 1024
    head = struct.pack("<IBBQ", 0xFD2FB528, 3 << 6, 7 << 3, size)
    repeated = (1 << 1 | block << 3).to_bytes(3, "little") + b"\0"
    last = (1 | 1 << 1 | block << 3).to_bytes(3, "little") + b"\0"
    return head + repeated * (size // block - 1) + last


def _six_gigabytes(channel: int) -> bytes:
    return _chunk(_zero_frame(6 * 2**30), 6 * 2**30, 0)


def _false_head(channel: int) -> bytes:
    """The head says one kilobyte, the frame 2 GiB."""
    return _chunk(_zero_frame(2**31), 1024, 0)


def _zeros(channel: int) -> bytes:
    return _many(_chunk(_zero_frame(_LARGEST), _LARGEST, zlib.crc32(bytes(_LARGEST))))


def _message(channel: int, content: bytes) -> bytes:
    return MESSAGE_HEAD.pack(5, MESSAGE_HEAD.size - 9 + len(content), channel, 0, 1, 1) + content


def _empty_messages(channel: int) -> bytes:
    return _many(_honest(_message(channel, b"") * (_LARGEST // MESSAGE_HEAD.size)))


def _small_chunks(channel: int) -> bytes:
    return _many(_honest(_message(channel, b"") * 64))


def _large_messages(channel: int) -> bytes:
    return _many(_honest(_message(channel, bytes(_LARGEST - 64))))


def _large_windows(channel: int) -> bytes:
    fields = dict.fromkeys(WINDOW.names, 0) | {
        "width_px": 2**20,
        "height_px": 2**20,
        "bytes_per_pixel": 1,
        "model_inverse_x": 1,
        "pixels": b"",
    }
    return _honest(_message(channel, WINDOW.encode(*fields.values())))


BOMBS: dict[str, Callable[[int], bytes]] = {
    "six gigabytes": _six_gigabytes,
    "false head": _false_head,
    "zeros": _zeros,
    "empty messages": _empty_messages,
    "small chunks": _small_chunks,
    "large messages": _large_messages,
    "large windows": _large_windows,
}
