"""Builds one chunk: its messages as bytes, and the index with their positions."""

import struct
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time, publish time."""
_LENGTH_BEFORE_DATA = MESSAGE_HEAD.size - 9
_INDEX_ENTRY = struct.Struct("<QQ")
MESSAGE_HEAD_DTYPE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<u8"),
        ("publish_time_ns", "<u8"),
    ]
)
"""The same as an array's row."""


class ChunkBuilder:
    """Collects the messages of a chunk until `McapFile.add_chunk` writes and clears it.

    `data` are the messages, `index` the positions by channel, `start_ns` and `end_ns` the range of log times.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Begin a new chunk."""
        self.data = bytearray()
        self.index: defaultdict[int, bytearray] = defaultdict(bytearray)
        self.start_ns = 0
        self.end_ns = 0

    @property
    def counts(self) -> dict[int, int]:
        """Number of messages by channel."""
        return {channel: len(entries) // _INDEX_ENTRY.size for channel, entries in self.index.items()}

    def add(self, channel: int, sequence: int, log_time_ns: int, *parts: bytes | memoryview) -> None:
        """Add one encoded message, given in consecutive parts."""
        self._extend_times(log_time_ns, log_time_ns)
        self.index[channel].extend(_INDEX_ENTRY.pack(log_time_ns, len(self.data)))
        self.data += MESSAGE_HEAD.pack(
            Opcode.MESSAGE,
            _LENGTH_BEFORE_DATA + sum(map(len, parts)),
            channel,
            sequence & 0xFFFFFFFF,
            log_time_ns,
            log_time_ns,
        )
        for part in parts:
            self.data += part

    def add_rows(
        self,
        channel: int,
        sequences: Sequence[int] | NDArray[np.int64],
        log_times_ns: NDArray[np.int64],
        rows: NDArray[Any],
    ) -> None:
        """Add many encoded messages of the same length, each a row of a packed structured array (n,)."""
        count = len(rows)
        if count == 0:
            return
        block = np.empty(count, dtype=[*MESSAGE_HEAD_DTYPE.descr, ("message", rows.dtype)])
        block["opcode"] = Opcode.MESSAGE
        block["length"] = _LENGTH_BEFORE_DATA + rows.dtype.itemsize
        block["channel"] = channel
        block["sequence"] = np.asarray(sequences, dtype=np.int64) & 0xFFFFFFFF
        block["log_time_ns"] = log_times_ns
        block["publish_time_ns"] = log_times_ns
        block["message"] = rows
        entries = np.empty((count, 2), dtype="<u8")
        entries[:, 0] = log_times_ns
        entries[:, 1] = len(self.data) + np.arange(count) * block.itemsize
        self._extend_times(int(log_times_ns.min()), int(log_times_ns.max()))
        self.index[channel].extend(entries.tobytes())
        self.data += block.tobytes()

    def _extend_times(self, first_ns: int, last_ns: int) -> None:
        self.start_ns = min(self.start_ns, first_ns) if self.data else first_ns
        self.end_ns = max(self.end_ns, last_ns) if self.data else last_ns
