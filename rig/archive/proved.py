"""Files of an archive that prove themselves: they state the SHA-256 of what they hold.

Text ends with a line that states it, compressed text with a frame that other programs skip; a file whose name
holds the beginning of its hash needs neither.
"""

import hashlib
import json
import re
import struct
from pathlib import Path

from processing.errors import RecordError

NAMED_CHARACTERS = 32
"""Of a hash in a file's name: 128 bits."""
_NAMED = re.compile(rf".*-[0-9a-f]{{{NAMED_CHARACTERS}}}")
_LINE = re.compile(rb"\nsha256 ([0-9a-f]{64})\n\Z")
_FRAME = struct.Struct("<II32s")
_SKIPPED = 0x184D2A50
"""Magic of a frame of zstd that holds no data."""


def read_file(path: Path) -> bytes:
    """All of a file. Raises RecordError where any part cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None


def sha256_hex(data: bytes) -> str:
    """Hexadecimal SHA-256."""
    return hashlib.sha256(data).hexdigest()


def with_line(text: bytes) -> bytes:
    """Text with a last line that states its hash."""
    return text + f"\nsha256 {sha256_hex(text)}\n".encode()


def without_line(path: Path, data: bytes) -> bytes:
    """The text of which `with_line` made the content of a file. Raises RecordError if it is not the same."""
    found = _LINE.search(data)
    if found is None or sha256_hex(data[: found.start()]).encode() != found[1]:
        raise changed(path)
    return data[: found.start()]


def has_line(data: bytes) -> bool:
    """Whether content ends as `with_line` ends it; that of earlier versions does not."""
    return _LINE.search(data) is not None


def with_frame(packed: bytes) -> bytes:
    """What zstd has packed, with a frame that states its hash."""
    return packed + _FRAME.pack(_SKIPPED, 32, hashlib.sha256(packed).digest())


def without_frame(path: Path, data: bytes) -> bytes:
    """What `with_frame` was given; content of earlier versions, which has no such frame, as it is.

    Raises RecordError if it is not the same.
    """
    if not has_frame(data):
        return data
    packed, (_, _, digest) = data[: -_FRAME.size], _FRAME.unpack(data[-_FRAME.size :])
    if hashlib.sha256(packed).digest() != digest:
        raise changed(path)
    return packed


def has_frame(data: bytes) -> bool:
    """Whether content ends with such a frame."""
    return len(data) >= _FRAME.size and _FRAME.unpack(data[-_FRAME.size :])[:2] == (_SKIPPED, 32)


def check_name(path: Path, data: bytes) -> None:
    """Raise RecordError if the content is not that whose hash ends the file's name."""
    if not path.name.partition(".")[0].endswith(f"-{sha256_hex(data)[:NAMED_CHARACTERS]}"):
        raise changed(path)


def prove(path: Path, name: str, data: bytes) -> bool:
    """Prove a file of an archive by its name in it, as far as it proves itself; False where nothing does.

    Raises RecordError if it is not as it was written.
    """
    folder, _, file = name.rpartition("/")
    if file.endswith(".parquet"):
        if _NAMED.fullmatch(file.removesuffix(".parquet")) is None:
            return False
        check_name(path, data)
        return True
    if file.endswith(".zst"):
        without_frame(path, data)
        return has_frame(data)
    if folder == "" or file.endswith(".facts") or has_line(data):
        without_line(path, data)
        return True
    try:
        # of earlier versions: it is at least what it seems to be
        states_turn = bool(json.loads(data).get("turn"))
    except (ValueError, AttributeError):
        raise changed(path) from None
    if states_turn:
        raise changed(path)
    return False


def changed(path: Path) -> RecordError:
    """That a file is not as it was written."""
    return RecordError(
        f"{path}: its bytes have changed since it was written; rig archive check lists what can be repaired"
    )
