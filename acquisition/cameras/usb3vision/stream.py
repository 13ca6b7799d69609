"""Assembly of frames from USB transfers, with checks and counts of lost frames.

A USB3 Vision camera sends each frame as a sequence of bulk transfers: a leader (block number, timestamp,
format), the payload in one or more transfers, and a trailer (status, number of valid bytes). Reads are
queued in this order, several frames ahead. Every transfer is checked against what is expected at its
position. If they disagree, the synchronisation is lost, for example because the bus dropped a transfer, and
the stream is searched for the next leader.
"""

import logging
import time
from collections import deque
from contextlib import suppress
from enum import Enum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import CameraLost, Frame
from acquisition.cameras.pixel_formats import ExpectedFrames
from acquisition.cameras.usb3vision.link import StreamHalted, UsbLink
from acquisition.cameras.usb3vision.packets import (
    TRAILER_START,
    Leader,
    TransferPlan,
    announced_type,
    parse_leader,
    parse_trailer,
)
from acquisition.cameras.usb3vision.transfers import Transfers
from acquisition.frames.losses import BlockNumbers, LossCause
from processing.errors import DeviceError, RigError

logger = logging.getLogger(__name__)

_MAX_HALTED_S: Final = 0.3
"""Bus errors for longer than this without a frame in between mean that the connection is lost."""
COUNTERS: Final = (1 << 16, 1 << 32)
"""Sizes of block counters that are shorter than the standard's 64 bits."""
_FRAMES_TO_LEARN: Final = 2
"""Consecutive frames with other parts than planned, after which these parts are expected."""
_LOSSES_TO_UNLEARN: Final = 6
"""Consecutive lost frames after which the planned parts are expected again."""
_MAX_MISMATCHES: Final = 10
"""This many consecutive frames of a wrong size or format are a wrong setting, not an error of the bus."""


class _Part(Enum):
    LEADER = 0
    PAYLOAD = 1
    TRAILER = 2
    SEARCH = 3
    """A read that searches for the next leader."""
    EMPTY = 4
    """The empty packet after a payload of whole packets."""


class _Payload:
    """The bytes of one frame that have arrived so far; `byte_count` is their number."""

    def __init__(self) -> None:
        self._pieces: list[NDArray[np.uint8]] = []
        self.byte_count = 0

    def __len__(self) -> int:
        return len(self._pieces)

    def append(self, piece: NDArray[np.uint8]) -> None:
        """Add the next piece."""
        self._pieces.append(piece)
        self.byte_count += piece.size

    def as_array(self) -> NDArray[np.uint8]:
        """The payload as one array: without a copy if its pieces are contiguous in one buffer."""
        first = self._pieces[0]
        if len(self._pieces) == 1:
            return first
        base = first.base
        share_buffer = isinstance(base, np.ndarray) and all(piece.base is base for piece in self._pieces)
        if share_buffer and isinstance(base, np.ndarray) and base.size >= self.byte_count:
            ends = np.cumsum([piece.size for piece in self._pieces])
            starts = [piece.ctypes.data - base.ctypes.data for piece in self._pieces]
            if starts[0] == 0 and starts[1:] == list(ends[:-1]):
                return base[: self.byte_count]
        return np.concatenate(self._pieces)


class UsbFrameStream:
    """The frames of one run, which `step` assembles; `numbers` numbers them and counts those that are lost.

    From construction on, reads for `Transfers.frames_ahead` frames are queued; data beyond them wait in the
    camera's memory until the next call, and are lost if it is full.

    A frame is delivered only if its leader, all of its bytes and its trailer have arrived and agree with
    each other and with the expected format. All others are counted: ``error_status`` if the camera says so
    in the trailer, ``incomplete`` if a part of the frame arrived, ``wrong_id`` if a block came again or too
    late, ``dropped_by_bus`` if block numbers are missing after an error of the bus, ``dropped_by_camera``
    if they are missing without one.
    """

    def __init__(
        self,
        transfers: Transfers,
        plan: TransferPlan,
        expected: ExpectedFrames,
        link: UsbLink,
        numbers: BlockNumbers,
    ) -> None:
        self._transfers = transfers
        self._plan = plan
        self._expected = expected
        self._link = link
        self._planned_parts: tuple[tuple[_Part, int], ...] = (
            (_Part.LEADER, plan.leader),
            *((_Part.PAYLOAD, size) for size in plan.payload),
            (_Part.TRAILER, plan.trailer),
        )
        self._parts = self._planned_parts
        self._ring: deque[tuple[_Part, int, NDArray[np.uint8]]] = deque()
        self._next_part = 0
        self._buffer = np.empty(0, np.uint8)  # buffer of the frame for which reads are being queued
        self._leader: Leader | None = None
        self._payload = _Payload()
        self._deviations, self._deviated = 0, False
        self._mismatches = 0
        self._halted_since_s: float | None = None
        self._numbers = numbers
        self._disturbed = False
        with suppress(RigError):  # an error occurs again in the first step, which handles it
            self._fill()

    def step(self, timeout_s: float) -> Frame | None:
        """Take the next transfer; returns the frame that it completes, or None."""
        try:
            self._fill()
            part, size, buffer = self._ring[0]
            transfer = self._transfers.wait(timeout_s)
        except TimeoutError:
            return None
        except StreamHalted as halt:
            self._after_halt(halt)
            return None
        self._ring.popleft()
        data = buffer[: transfer.byte_count]
        if not data.size and self._leader is not None and part in (_Part.TRAILER, _Part.EMPTY):
            self._take_empty(part)
        elif part is _Part.PAYLOAD and self._leader is not None:
            return self._take_payload(data, size, transfer.host_time_ns)
        elif part in (_Part.TRAILER, _Part.EMPTY) and self._leader is not None:
            frame = self._take_trailer(data, transfer.host_time_ns)
            if part is _Part.EMPTY:  # this camera sends empty packets, but not at this size
                self._parts = self._planned_parts
                self._disturbed = True
                self._resume_at(0)
            return frame
        else:
            self._take_leader(data, in_sequence=part is _Part.LEADER)
        return None

    def _fill(self) -> None:
        if self._next_part < 0:
            if not self._ring:
                # Synchronisation is lost. Every transfer of the camera ends with a short packet, so that
                # reads into one large buffer return whole transfers until a leader arrives.
                size = max(self._plan.leader, self._plan.payload_size, 1 << 16)
                self._submit(_Part.SEARCH, size, np.empty(size, np.uint8))
            return
        while len(self._ring) < self._transfers.frames_ahead * len(self._parts):
            if self._ring and not self._transfers.has_room:
                return  # the system has no memory for a further read until the oldest has ended
            part, size = self._parts[self._next_part]
            if part is _Part.PAYLOAD:
                # one buffer for all payload transfers of a frame, so that the image needs no copy
                if self._next_part == 1 or not self._buffer.size:
                    self._buffer = np.empty(sum(self._plan.payload), np.uint8)
                start = sum(size for _, size in self._parts[1 : self._next_part])
                buffer = self._buffer[start : start + size]
            else:
                buffer = np.empty(size, np.uint8)
            self._submit(part, size, buffer)
            self._next_part = (self._next_part + 1) % len(self._parts)

    def _submit(self, part: _Part, size: int, buffer: NDArray[np.uint8]) -> None:
        self._transfers.submit(buffer)
        self._ring.append((part, size, buffer))

    def _resume_at(self, next_part: int) -> None:
        """Cancel all reads and queue new ones, starting with this part; -1 searches for the next leader."""
        if self._ring and self._transfers.under_way:
            # Later reads may already have received bytes, which are lost by cancelling them, so that the next
            # part is unknown: search for a leader.
            next_part = -1
        if next_part <= 0 and self._numbers.lost_parts >= _LOSSES_TO_UNLEARN:
            self._parts = self._planned_parts  # the learned deviation does not hold (any more)
        self._transfers.cancel()
        self._ring.clear()
        self._buffer = np.empty(0, np.uint8)
        self._next_part = next_part

    def _after_halt(self, halt: StreamHalted) -> None:
        logger.info("%s", halt)
        now_s = time.monotonic()
        if self._halted_since_s is None:
            self._halted_since_s = now_s
        elif now_s - self._halted_since_s > _MAX_HALTED_S:
            raise CameraLost(f"{halt}, again and again; unplug it and plug it in again")
        self._lose_frame()
        self._disturbed = True
        self._resume_at(-1)
        self._link.clear_halt(self._link.stream_in)
        time.sleep(0.01)

    def _lose_frame(self) -> None:
        if self._leader is not None:
            self._numbers.lost_parts += 1
        self._leader = None

    def _deviates(self) -> bool:
        """Note a frame that was not sent as planned; True from the second consecutive one on."""
        self._deviations += not self._deviated
        self._deviated = True
        return self._deviations >= _FRAMES_TO_LEARN

    # ---- parts of a frame

    def _take_empty(self, part: _Part) -> None:
        """Take an empty packet: some cameras end a payload of whole packets with one."""
        if part is _Part.EMPTY:
            return
        *leading, trailer = self._parts
        if self._deviates():
            self._parts = (*leading, (_Part.EMPTY, trailer[1]), trailer)
        self._disturbed = True
        self._resume_at(len(self._parts) - 1)
        if self._next_part < 0:
            self._lose_frame()

    def _take_leader(self, data: NDArray[np.uint8], *, in_sequence: bool) -> None:
        self._lose_frame()
        leader = parse_leader(data[:256].tobytes()) if data.size <= self._plan.leader else None
        self._payload = _Payload()
        if leader is None:
            self._refuse_other_payload(data[:256].tobytes())
            self._disturbed = True
            if in_sequence:
                self._numbers.lost_parts += 1
            # A trailer is followed by a leader; after any other data the next part is unknown.
            self._resume_at(0 if data[:4].tobytes() == TRAILER_START else -1)
            return
        self._leader = leader
        self._deviated = False
        if not in_sequence:
            self._resume_at(1)
            if self._next_part != 1:
                self._lose_frame()
                self._disturbed = True

    def _refuse_other_payload(self, leader: bytes) -> None:
        kind = announced_type(leader)
        if kind is None:
            return
        self._mismatches += 1
        if self._mismatches >= _MAX_MISMATCHES:
            raise DeviceError(
                f"{self._link.name}: sends payload of type 0x{kind:04X}, no image; switch chunks and "
                "compression off (--set camera.features.ChunkModeActive=0)"
            )

    def _take_payload(self, data: NDArray[np.uint8], planned_bytes: int, host_time_ns: int) -> Frame | None:
        # Where a camera announced more than it sends, its trailer is in place of payload or right behind it.
        image_end = max(self._expected.image_bytes() - self._payload.byte_count, 0)
        limit = image_end + self._plan.trailer
        if data.size < planned_bytes and self._leader is not None and image_end < data.size <= limit:
            trailer = parse_trailer(data[image_end : image_end + 256].tobytes())
            if trailer is not None and trailer.block == self._leader.block:
                payload = self._parts[1 : 1 + len(self._payload) + bool(image_end)]
                trailer_part = () if image_end else ((_Part.TRAILER, self._plan.trailer),)
                if image_end:
                    self._payload.append(data[:image_end])
                sent_parts = (self._parts[0], *payload, *trailer_part)
                is_new = sent_parts != self._parts
                is_learned = is_new and self._deviates()
                frame = self._take_trailer(data[image_end:], host_time_ns)
                if is_new:
                    self._parts = sent_parts if is_learned else self._parts
                    self._disturbed = True
                    self._resume_at(0)
                return frame
        # A short transfer may be a trailer (the camera ended the frame early) or a leader (the rest of the
        # frame was lost) in place of payload.
        if data.size < planned_bytes and data.size <= max(self._plan.leader, self._plan.trailer):
            head = data[:256].tobytes()
            trailer = parse_trailer(head)
            is_short = self._payload.byte_count + data.size < self._expected.image_bytes()
            if is_short and trailer is not None and self._leader and trailer.block == self._leader.block:
                self._lose_frame()
                self._disturbed = True
                self._resume_at(0)
                return None
            if is_short and parse_leader(head) is not None:
                self._take_leader(data, in_sequence=False)
                return None
        self._payload.append(data)
        return None

    def _take_trailer(self, data: NDArray[np.uint8], host_time_ns: int) -> Frame | None:
        leader = self._leader
        assert leader is not None
        trailer = parse_trailer(data[:256].tobytes()) if data.size <= self._plan.trailer else None
        if trailer is None:
            self._disturbed = True
            if parse_leader(data[:256].tobytes()) is not None:
                self._take_leader(data, in_sequence=False)
            else:
                self._lose_frame()
                self._resume_at(-1)
            return None
        expected = self._expected
        image_bytes = expected.image_bytes(leader.x_padding)
        is_complete = (
            trailer.status == 0
            and trailer.valid_bytes >= image_bytes
            and self._payload.byte_count >= image_bytes
        )
        if trailer.block != leader.block or not is_complete or not self._fits(leader):
            self._numbers.faulty += trailer.block == leader.block and trailer.status != 0
            self._lose_frame()
            return None
        self._mismatches = 0
        self._leader = None
        lost: LossCause = "dropped_by_bus" if self._disturbed else "dropped_by_camera"
        number = self._numbers.number(leader.block, lost, leader.timestamp)
        if number is None:
            return None
        self._disturbed = False
        self._halted_since_s = None
        self._deviations, self._deviated = self._deviations * self._deviated, False
        image = expected.image(self._payload.as_array(), leader.x_padding)
        return Frame(image, number, leader.timestamp if expected.has_clock else -1, host_time_ns)

    def _fits(self, leader: Leader) -> bool:
        """Whether a frame has the expected size and format; raises DeviceError where many have not."""
        expected = self._expected
        size = (leader.width_px, leader.height_px, leader.pixel_format)
        if expected.can_strip_padding(leader.x_padding) and size == (
            expected.width_px,
            expected.height_px,
            expected.format.code,
        ):
            return True
        self._mismatches += 1
        if self._mismatches >= _MAX_MISMATCHES:
            sent = f"{leader.width_px} x {leader.height_px}, format 0x{leader.pixel_format:08X}"
            stated = f"{expected.width_px} x {expected.height_px} in {expected.format.name}"
            raise DeviceError(
                f"{self._link.name}: sends frames of {sent}, padding {leader.x_padding}; "
                f"its features say {stated}. Stop it and set size and format again"
            )
        return False
