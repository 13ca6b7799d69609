"""Reads a file of which the disk cannot give some parts, as on exFAT after a power cut.

One part that cannot be read would otherwise make the whole record unreadable.
"""

import errno
import io
import os
from pathlib import Path
from typing import Any

_BLOCK_BYTES = 4096
_FAULTS = {errno.EIO, getattr(errno, "EUCLEAN", errno.EIO), getattr(errno, "EBADMSG", errno.EIO)}


class _FaultyFile(io.FileIO):
    """A file whose unreadable blocks are read as zeros; `lost` are the bytes of each, by their place."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "r")
        self.lost: dict[int, int] = {}

    def readinto(self, buffer: Any, /) -> int | None:
        """Fill the buffer as far as the next unreadable block, or with zeros to the end of that block."""
        try:
            return super().readinto(buffer)
        except OSError as error:
            if error.errno not in _FAULTS:
                raise
        place, room = self.tell(), memoryview(buffer).cast("B")
        left = os.fstat(self.fileno()).st_size - place
        count = max(min(_BLOCK_BYTES - place % _BLOCK_BYTES, left, len(room)), 0)
        if count and len(room) > count:
            # what can be read of this block before the fault
            room = room[:count]
            try:
                return super().readinto(room)
            except OSError as error:
                if error.errno not in _FAULTS:
                    raise
        room[:count] = bytes(count)
        self.seek(count, os.SEEK_CUR)
        self.lost[place] = max(self.lost.get(place, 0), count)
        return count


class FaultTolerantFile(io.BufferedReader):
    """A file opened for reading; parts that its disk cannot give are zeros, and no error.

    Raises OSError if it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self._faulty = _FaultyFile(path)
        super().__init__(self._faulty)

    @property
    def unreadable_bytes(self) -> int:
        """How many bytes could not be read so far."""
        end = lost = 0
        for place, count in sorted(self._faulty.lost.items()):
            lost += max(place + count - max(place, end), 0)
            end = max(end, place + count)
        return lost
