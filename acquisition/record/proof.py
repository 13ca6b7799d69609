"""What of a record is proved by a checksum, and what is not."""

import zlib
from typing import IO

from acquisition.record.contents import Contents

_BLOCK_BYTES = 256 * 1024


def data_crc_matches(file: IO[bytes], contents: Contents) -> bool:
    """Whether the data section is as it was written; True where no checksum of it exists."""
    if not contents.whole or contents.data_crc == 0:
        return True
    crc, rest = 0, contents.data_end
    file.seek(0)
    while rest > 0:
        block = file.read(min(_BLOCK_BYTES, rest))
        if not block:
            return False
        crc = zlib.crc32(block, crc)
        rest -= len(block)
    return crc == contents.data_crc


def unproved_parts(file: IO[bytes], contents: Contents) -> tuple[str, ...]:
    """Metadata and descriptions that are believed unread: without a checksum of their own, in a file that
    was cut or has changed.
    """
    proved = contents.whole and contents.data_crc != 0 and data_crc_matches(file, contents)
    return () if proved else tuple(contents.unproved)


def is_sound(file: IO[bytes], contents: Contents) -> bool:
    """Whether every byte is proved to be as it was written, by the sums of index and data section."""
    whole = contents.whole and contents.indexed and contents.data_crc != 0
    return whole and not contents.damage and data_crc_matches(file, contents)
