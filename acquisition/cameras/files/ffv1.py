"""Checksums of FFV1 video (RFC 9043): a decoder that finds damage delivers a picture all the same.

A frame is divided into slices. Each ends with its size (3 bytes, big-endian), and where the encoder wrote
checksums, with a status byte and a CRC-32 that makes the remainder over the whole slice zero.
"""

import zlib
from pathlib import Path
from typing import Final

import cv2

_SIZE: Final = 3
_WITH_CHECKSUM: Final = 8
_LOOKED_AT: Final = 5
# the CRC of RFC 9043 takes the most significant bit first, zlib's the least
_REVERSED: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def slices_of(packet: bytes, footer: int) -> list[bytes] | None:
    """The slices of a frame whose slices end with `footer` bytes; None if the sizes do not add up."""
    found = []
    end = len(packet)
    while end > 0:
        if end < footer:
            return None
        at = end - footer
        begin = at - int.from_bytes(packet[at : at + _SIZE], "big")
        if begin < 0:
            return None
        found.append(packet[begin:end])
        end = begin
    return found


def is_whole(packet: bytes) -> bool:
    """Whether a frame with checksums is undamaged."""
    slices = slices_of(packet, _WITH_CHECKSUM)
    return bool(slices) and all(_remainder(part) == 0 for part in slices or ())


def _remainder(data: bytes) -> int:
    return zlib.crc32(data.translate(_REVERSED), 0xFFFFFFFF) ^ 0xFFFFFFFF


class Ffv1Checksums:
    """Checks the frames of a FFV1 file in order, from their bytes as stored.

    `present` is False if the encoder wrote no checksums, so that damage cannot be found.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._capture = self._opened()
        first = [packet for packet in (self._next() for _ in range(_LOOKED_AT)) if packet]
        # one of the first frames may itself be damaged
        self.present = any(slices_of(packet, _WITH_CHECKSUM) for packet in first)
        self.rewind()

    def rewind(self) -> None:
        """Begin with the first frame again."""
        self._capture.release()
        self._capture = self._opened()
        self._spoilt = False

    def next_is_whole(self) -> bool:
        """Check the next frame. One that follows a damaged frame up to the next key frame is not whole."""
        packet = self._next()
        if not self.present or packet is None:
            return True
        if not is_whole(packet):
            self._spoilt = True
        elif self._capture.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME):
            self._spoilt = False
        return not self._spoilt

    def close(self) -> None:
        """Close the file."""
        self._capture.release()

    def _opened(self) -> cv2.VideoCapture:
        return cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])

    def _next(self) -> bytes | None:
        good, packet = self._capture.read()
        return packet.tobytes() if good and packet is not None else None
