"""GenCP (Generic Control Protocol): reading and writing of a camera's registers by commands and replies."""

import logging
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from processing.errors import DeviceError

logger = logging.getLogger(__name__)

_PREFIX: Final = 0x43563355  # "U3VC", little-endian
_HEADER: Final = struct.Struct("<IHHHH")  # prefix, flags or status, command, length, request id
_READ_COMMAND: Final = struct.Struct("<QHH")
_WRITE_ADDRESS: Final = struct.Struct("<Q")
_TWO_WORDS: Final = struct.Struct("<HH")

_REQUEST_ACK: Final = 0x4000
_READ: Final = 0x0800
_WRITE: Final = 0x0802
_PENDING_ACK: Final = 0x0805

_MIN_PACKET_BYTES: Final = 64
"""Packet size that every camera supports, used until the camera's own limits have been read."""
_MAX_WAIT_S: Final = 30.0
"""Longest wait for a camera that repeatedly requests more time."""
_POLL_S: Final = 0.1
"""Timeout of a single read of a reply, within which `abort` takes effect."""

_BUSY: Final = 0x8007
_STATUS_MEANINGS: Final = {
    0x8001: "command not implemented",
    0x8002: "invalid parameter",
    0x8003: "no register at this address",
    0x8004: "register is write-protected",
    0x8005: "bad alignment",
    0x8006: "access denied (another program may control the camera)",
    _BUSY: "camera is busy",
    0x800B: "message timed out inside the camera",
    0x800E: "invalid header",
    0x800F: "wrong configuration",
    0x8FFF: "unspecified error",
    0xA001: "resend not supported",
    0xA002: "stream endpoint is halted",
    0xA003: "payload size not aligned",
    0xA004: "stream registers inconsistent",
    0xA005: "data discarded",
}


class RegisterRefused(DeviceError):
    """The camera answered a register access with an error status."""


class NoAnswer(DeviceError):
    """The camera does not answer register accesses, or only with invalid replies, in spite of retries."""


class GenCpChannel:
    """Register access over one pair of endpoints; may be used by several threads.

    Parameters
    ----------
    send
        Called with a packet and a timeout in s; raises TimeoutError if it could not be sent.
    receive
        Called with the largest size and a timeout in s, returns one packet; raises TimeoutError.
    name
        Name of the camera in messages.
    timeout_s
        Timeout of one reply; a camera may extend it by a pending acknowledge.
    retries
        Number of repetitions of a command after a missing or damaged reply or the status "busy". Every
        attempt has a new id, so that a late reply to an earlier one is recognised and ignored.
    clock
        Monotonic time in s.
    """

    def __init__(
        self,
        send: Callable[[bytes, float], None],
        receive: Callable[[int, float], bytes],
        name: str,
        *,
        timeout_s: float,
        retries: int = 3,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._send = send
        self._receive = receive
        self._name = name
        self._timeout_s = timeout_s
        self._retries = retries
        self._clock = clock
        self._lock = threading.RLock()
        self._last_id = 0
        self._max_command = _MIN_PACKET_BYTES
        self._max_reply = _MIN_PACKET_BYTES
        self._deadline_s: float | None = None
        self._aborted = threading.Event()

    def set_limits(self, max_command: int, max_reply: int, response_time_s: float) -> None:
        """Use the camera's own packet sizes in bytes and its longest response time."""
        self._max_command = max(max_command, _MIN_PACKET_BYTES)
        self._max_reply = max(max_reply, _MIN_PACKET_BYTES)
        self._timeout_s = max(self._timeout_s, min(2.0 * response_time_s, _MAX_WAIT_S))

    @contextmanager
    def time_limit(self, limit_s: float) -> Iterator[None]:
        """Context whose accesses may together take at most this time, after which they raise `NoAnswer`."""
        deadline_s = self._clock() + limit_s
        if not self._lock.acquire(timeout=limit_s):
            raise NoAnswer(f"{self._name}: still busy with another command after {limit_s:.1f} s")
        try:
            self._deadline_s = deadline_s
            yield
        finally:
            self._deadline_s = None
            self._lock.release()

    def abort(self) -> None:
        """Make another thread's present command, and all later commands, fail immediately."""
        self._aborted.set()

    def read(self, address: int, length: int) -> bytes:
        """`length` bytes from `address`, in as many commands as the camera's packets need."""
        largest = (self._max_reply - _HEADER.size) & ~3
        data = bytearray()
        while len(data) < length:
            size = min(length - len(data), largest)
            data += self._read_piece(address + len(data), size)
        return bytes(data)

    def write(self, address: int, data: bytes) -> None:
        """Write `data` at `address`, in as many commands as the camera's packets need."""
        largest = (self._max_command - _HEADER.size - _WRITE_ADDRESS.size) & ~3
        for start in range(0, len(data), largest):
            piece = data[start : start + largest]
            action = f"writing {len(piece)} bytes at 0x{address + start:X}"
            reply = self._transact(_WRITE, _WRITE_ADDRESS.pack(address + start) + piece, action, None)
            # the written length is optional in GenCP; 0 means that it is omitted
            if len(reply) >= _TWO_WORDS.size:
                written = _TWO_WORDS.unpack_from(reply)[1]
                if written not in (0, len(piece)):
                    raise NoAnswer(
                        f"{self._name}: {action}: the camera reports that it has written {written}"
                    )

    def _read_piece(self, address: int, size: int) -> bytes:
        """Read by one command; where a camera reads only whole words of 4 bytes, the size is rounded up."""
        try:
            return self._read_once(address, size)
        except RegisterRefused:
            if size % 4 == 0:
                raise
        return self._read_once(address, size + 3 & ~3)[:size]

    def _read_once(self, address: int, size: int) -> bytes:
        action = f"reading {size} bytes at 0x{address:X}"
        return self._transact(_READ, _READ_COMMAND.pack(address, 0, size), action, size)

    def _transact(self, command: int, payload: bytes, action: str, reply_size: int | None) -> bytes:
        """Data of the reply to a command; `action` names the command in messages."""
        problem = "no reply"
        with self._lock:
            for _ in range(self._retries + 1):
                if self._limited_s(1.0) <= 0:
                    break
                self._last_id = self._last_id % 0xFFFF + 1  # 0 is reserved
                header = _HEADER.pack(_PREFIX, _REQUEST_ACK, command, len(payload), self._last_id)
                try:
                    self._send(header + payload, self._limited_s(self._timeout_s))
                    status, data = self._await(command + 1, self._last_id, reply_size)
                except TimeoutError as error:
                    problem = str(error) or "no reply"
                    continue
                if status == 0:
                    return data
                meaning = _STATUS_MEANINGS.get(status, "unknown status")
                problem = f"{meaning} (status 0x{status:04X})"
                if status != _BUSY:
                    raise RegisterRefused(f"{self._name}: {action}: {problem}")
                time.sleep(min(0.01, max(self._limited_s(0.01), 0.0)))
        raise NoAnswer(f"{self._name}: {action}: {problem}; unplug the camera and plug it in again")

    def _limited_s(self, timeout_s: float) -> float:
        """The timeout, as far as `time_limit` and `abort` allow it."""
        if self._aborted.is_set():
            return 0.0
        if self._deadline_s is None:
            return timeout_s
        return min(timeout_s, self._deadline_s - self._clock())

    def _await(self, command: int, request_id: int, reply_size: int | None) -> tuple[int, bytes]:
        """Status and data of the reply; other packets that arrive are logged and ignored."""
        start_s = self._clock()
        deadline_s = start_s + self._timeout_s
        problem = "no reply"
        while True:
            left_s = self._limited_s(min(deadline_s, start_s + _MAX_WAIT_S) - self._clock())
            if left_s <= 0:
                raise TimeoutError(problem)
            try:
                packet = self._receive(self._max_reply, min(left_s, _POLL_S))
            except TimeoutError:
                continue
            if len(packet) < _HEADER.size:
                problem = f"a reply of only {len(packet)} bytes"
                continue
            prefix, status, answered, length, answered_id = _HEADER.unpack_from(packet)
            if prefix != _PREFIX:
                problem = f"a reply that begins with 0x{prefix:08X}, not 0x{_PREFIX:08X}"
            elif answered_id != request_id:
                logger.debug("%s: reply %d is late, %d is awaited", self._name, answered_id, request_id)
                problem = f"a reply to command {answered_id}, not to {request_id}"
            elif length != len(packet) - _HEADER.size:
                problem = f"a reply of {len(packet) - _HEADER.size} bytes that claims {length}"
            elif answered == _PENDING_ACK:
                if length >= _TWO_WORDS.size:
                    deadline_s = self._clock() + _TWO_WORDS.unpack_from(packet, _HEADER.size)[1] / 1000
            elif answered != command:
                problem = f"a reply of kind 0x{answered:04X}, not 0x{command:04X}"
            elif status == 0 and reply_size is not None and length != reply_size:
                problem = f"{length} bytes where {reply_size} were asked for"
            else:
                return status, packet[_HEADER.size :]
