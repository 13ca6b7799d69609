"""A drive with a write cache that its power keeps alive, as an NBD server for QEMU.

What the guest writes is in the cache until the guest flushes it, or forces one write through (FUA). A cut
leaves what was flushed and any of the writes since, one of them torn between two sectors.
"""

import socket
import struct
import threading
from pathlib import Path
from typing import NamedTuple

import numpy as np

_HAVE_OPTION = b"IHAVEOPT"
_REPLY_OF_OPTION = 0x3E889045565A9
_REQUEST = struct.Struct(">IHHQQI")
_ANSWER = struct.Struct(">IIQ")
_GO, _ACK, _INFO, _UNSUPPORTED = 7, 1, 3, 2**31 + 1
_READ, _WRITE, _END, _FLUSH = 0, 1, 2, 3
_FORCED = 1
_FLAGS = 1 | 4 | 8  # has flags, takes flushes, takes forced writes
_INVALID = 22
_SECTOR_BYTES = 512


class Cut(NamedTuple):
    """What a drive holds after a power cut, and how many writes were in its cache, kept and lost."""

    image: bytes
    kept: int
    lost: int


class VolatileDrive:
    """Serves one guest at a Unix socket in a thread, until the guest has gone."""

    def __init__(self, place: Path, image: bytes) -> None:
        self._seen = bytearray(image)
        self._platter = bytearray(image)
        self._cached: list[tuple[int, bytes]] = []
        self._lock = threading.Lock()
        self.flushes = 0
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(str(place))
        self._server.listen(1)
        threading.Thread(target=self._serve, name="drive", daemon=True).start()

    def cut(self, rng: np.random.Generator) -> Cut:
        """What would be left if the power went now; the guest does not notice."""
        with self._lock:
            image, cached = bytearray(self._platter), list(self._cached)
        # of writes to the same place the later one stays
        kept = sorted(rng.permutation(len(cached))[: rng.integers(0, len(cached) + 1)].tolist())
        torn = kept[int(rng.integers(0, len(kept)))] if kept else -1
        for index in kept:
            offset, data = cached[index]
            if index == torn:
                data = data[: int(rng.integers(0, len(data) // _SECTOR_BYTES + 1)) * _SECTOR_BYTES]
            image[offset : offset + len(data)] = data
        return Cut(bytes(image), len(kept), len(cached) - len(kept))

    def close(self) -> None:
        """No guest any more."""
        self._server.close()

    def _serve(self) -> None:
        try:
            guest, _ = self._server.accept()
            with guest, guest.makefile("rb") as requests:
                guest.sendall(b"NBDMAGIC" + _HAVE_OPTION + struct.pack(">H", 3))
                requests.read(4)
                while requests.read(8) == _HAVE_OPTION:
                    option, length = struct.unpack(">II", requests.read(8))
                    requests.read(length)
                    if option != _GO:
                        guest.sendall(struct.pack(">QIII", _REPLY_OF_OPTION, option, _UNSUPPORTED, 0))
                        continue
                    about = struct.pack(">HQH", 0, len(self._seen), _FLAGS)
                    guest.sendall(struct.pack(">QIII", _REPLY_OF_OPTION, option, _INFO, len(about)) + about)
                    guest.sendall(struct.pack(">QIII", _REPLY_OF_OPTION, option, _ACK, 0))
                    break
                while head := requests.read(_REQUEST.size):
                    _, flags, kind, handle, offset, length = _REQUEST.unpack(head)
                    if kind == _END:
                        return
                    data = requests.read(length) if kind == _WRITE else b""
                    error, answer = self._answer(kind, flags, offset, length, data)
                    guest.sendall(_ANSWER.pack(0x67446698, error, handle) + answer)
        except (OSError, struct.error):
            return  # the guest was killed, or never came

    def _answer(self, kind: int, flags: int, offset: int, length: int, data: bytes) -> tuple[int, bytes]:
        with self._lock:
            if kind == _READ:
                return 0, bytes(self._seen[offset : offset + length])
            if kind == _WRITE:
                self._seen[offset : offset + length] = data
                if flags & _FORCED:
                    # an older write to the same place that is still in the cache must not come after it
                    self._cached = [each for each in self._cached if not _overlaps(each, offset, length)]
                    self._platter[offset : offset + length] = data
                else:
                    self._cached.append((offset, data))
                return 0, b""
            if kind == _FLUSH:
                self._platter[:] = self._seen
                self._cached.clear()
                self.flushes += 1
                return 0, b""
        return _INVALID, b""


def _overlaps(write: tuple[int, bytes], offset: int, length: int) -> bool:
    return write[0] < offset + length and offset < write[0] + len(write[1])
