"""Reserved disk space, which is released when the disk is full, so that a record can still be finished."""

import os
import random
import tempfile
from pathlib import Path

_BLOCK_BYTES = 1024 * 1024


class Reserve:
    """A nameless temporary file beside the record: a kill frees it, nothing is left behind.

    Filled with random bytes, which no file system compresses away. Raises OSError where the room
    does not exist.
    """

    def __init__(self, folder: Path, size: int) -> None:
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 lives as long as the record
        self._random = random.Random(0)
        self.size = 0
        try:
            self.hold(size)
        except OSError:
            self.release()
            raise

    def hold(self, size: int) -> None:
        """Make it at least so large."""
        while not self._file.closed and self.size < size:
            written = self._file.write(self._random.randbytes(min(_BLOCK_BYTES, size - self.size)))
            self.size += written or 0
            os.fsync(self._file.fileno())

    def release(self) -> bool:
        """Give the room back; False where that was done before."""
        if self._file.closed:
            return False
        try:
            self._file.truncate(0)
        finally:
            self._file.close()
        self.size = 0
        return True
