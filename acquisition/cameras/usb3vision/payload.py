"""The payload of one frame, as it arrives in pieces."""

import numpy as np
from numpy.typing import NDArray


class Payload:
    """Bytes of one frame, `byte_count` of them so far."""

    def __init__(self) -> None:
        self._pieces: list[NDArray[np.uint8]] = []
        self.byte_count = 0

    def __len__(self) -> int:
        return len(self._pieces)

    def append(self, piece: NDArray[np.uint8]) -> None:
        """One more piece, in order."""
        self._pieces.append(piece)
        self.byte_count += piece.size

    def whole(self) -> NDArray[np.uint8]:
        """The payload as one array: without a copy if its pieces are contiguous in one buffer."""
        first = self._pieces[0]
        if len(self._pieces) == 1:
            return first
        base = first.base
        lie_together = isinstance(base, np.ndarray) and all(piece.base is base for piece in self._pieces)
        if lie_together and isinstance(base, np.ndarray) and base.size >= self.byte_count:
            ends = np.cumsum([piece.size for piece in self._pieces])
            starts = [piece.ctypes.data - base.ctypes.data for piece in self._pieces]
            if starts[0] == 0 and starts[1:] == list(ends[:-1]):
                return base[: self.byte_count]
        return np.concatenate(self._pieces)
