"""The test camera: a USB3 Vision camera at the level of the bytes at its endpoints.

Written from the standard's layouts, without the driver's constants, so that an error in the driver
is not repeated here. It has no thread: frames fall due by the clock and are made when the host asks.
"""

import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tests.acquisition.cameras.usb3vision import description as layout
from tests.acquisition.cameras.usb3vision.descriptors import (
    PACKET,
    STREAM_IN,
)
from tests.acquisition.cameras.usb3vision.packing import DEPTHS, pack
from tests.acquisition.cameras.usb3vision.registers import EIRM, SBRM, SIRM, XML, Registers


class UnpluggedError(Exception):
    """The device is no longer there."""


class StalledError(Exception):
    """The endpoint is halted."""


class OverrunError(Exception):
    """A packet was longer than what the host's buffer had left."""


@dataclass
class Faults:
    """What shall go wrong; every hook gets what would be sent and returns what is sent instead."""

    replies: Callable[[int, bytes], list[bytes]] = field(default=lambda command, reply: [reply])
    units: Callable[[str, int, bytes], list[bytes]] = field(default=lambda kind, block, data: [data])
    refuse: Callable[[int, int], int] = field(default=lambda command, address: 0)
    reply_delay_s: Callable[[int], float] = field(default=lambda command: 0.0)
    unplug_after_stream_bytes: int | None = None
    announced_extra: int = 0
    """Bytes by which the payload that is announced is larger than what is sent."""
    ends_payload_short: bool = True
    """Whether a payload that is shorter than announced, of whole packets, ends its transfer."""
    states_packet_sizes: bool = True
    """Whether the sizes of leader and trailer are stated; some cameras say 0."""
    reads_words_only: bool = False
    """Whether reads of other than multiples of 4 bytes are refused."""
    block_ids: Callable[[int], int] = field(default=lambda block: block)


class VisionDevice(Registers):
    """One camera.

    Parameters
    ----------
    serial
        Its serial number.
    packing
        The description is stored ``"zip"`` or ``"plain"``; ``prefix`` precedes it.
    clock
        Seconds; frames fall due by it.
    frames_inside
        The camera's own memory: older frames are lost when the host is slow.
    clock_step_ns
        Resolution of its clock.
    """

    def __init__(
        self,
        serial: str = "U3V-0001",
        *,
        packing: str = "zip",
        xml: str | None = None,
        prefix: bytes = b"",
        max_packet: int = 1024,
        clock: Callable[[], float] = time.monotonic,
        first_block: int = 0,
        frame_rate_hz: float = 100.0,
        frames_inside: int = 8,
        clock_step_ns: int = 8,
    ) -> None:
        self.serial = serial
        self.faults = Faults()
        self.changed = threading.Condition()
        self.unplugged = False
        self.configuration = 0
        self.owner: object | None = None
        self.commands = 0
        self._clock = clock
        self._t0 = clock()
        self._clock_step_ns = clock_step_ns
        self._first_block = first_block
        self._frames_inside = frames_inside
        self._replies: deque[tuple[float, bytes]] = deque()
        self._units: deque[tuple[memoryview, bool]] = deque()
        self._events: deque[bytes] = deque()
        self._halted: set[int] = set()
        self._streamed = 0
        self._running_since: float | None = None
        self._next_frame = 0
        self._edges = 0
        self.frames_lost_inside = 0
        self._sawtooth: dict[tuple[int, int], np.ndarray] = {}
        text = (xml if xml is not None else layout.description()).encode()
        super().__init__(serial, prefix + text, packing, max_packet, frame_rate_hz, clock_step_ns)
        self._update()

    # ---- registers

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the frames."""
        return self.number(layout.HEIGHT), self.number(layout.WIDTH)

    @property
    def pixel_format(self) -> int:
        """The format's number."""
        return self.number(layout.PIXEL_FORMAT)

    @property
    def frame_bytes(self) -> int:
        """Bytes of one image."""
        height, width = self.shape
        return -(-height * width * ((self.pixel_format >> 16) & 0xFF) // 8)

    @property
    def frame_rate_hz(self) -> float:
        """Frames a second: as set, or as many as the exposure leaves."""
        if self.peek(layout.FRAME_RATE_ENABLE)[3] & 1:
            return float(struct.unpack("<d", self.peek(layout.FRAME_RATE, 8))[0])
        exposure_s = struct.unpack(">I", self.peek(layout.EXPOSURE_TICKS))[0] * 1e-7
        return min(1000.0, 1.0 / max(exposure_s, 1e-5))

    def clock_ns(self, at_s: float | None = None) -> int:
        """The camera's clock now or at a time: in ns whatever its resolution, in which it steps."""
        passed_s = (self._clock() if at_s is None else at_s) - self._t0
        steps = int(passed_s * 1e9) // self._clock_step_ns
        return (steps + 1000) * self._clock_step_ns

    def _update(self) -> None:
        self.poke(layout.PAYLOAD_SIZE, struct.pack("<I", self.frame_bytes))
        faults = self.faults
        sizes = (52, 32) if faults.states_packet_sizes else (0, 0)
        self.poke(SIRM + 8, struct.pack("<QII", self.frame_bytes + faults.announced_extra, *sizes))

    def _written(self, address: int) -> int:
        """Act on a register that has just been written; a status other than 0 refuses."""
        if address == 0x1F8:
            self.poke(0x1F0, struct.pack("<Q", self.clock_ns()))
        elif address == layout.START:
            if not self.number(SIRM + 4) & 1:
                return 0x8007
            self.poke(layout.LOCKED, struct.pack("<I", 1))
            self._running_since, self._next_frame, self._edges = self._clock(), 0, 0
        elif address in (layout.STOP, SIRM + 4):
            if address == layout.STOP or not self.number(SIRM + 4) & 1:
                self._running_since = None
                self._units.clear()
                self.poke(layout.LOCKED, struct.pack("<I", 0))
        elif layout.BASE <= address < layout.END:
            self._update()
        return 0

    # ---- control endpoint

    def control_out(self, packet: bytes) -> None:
        """A command from the host; its reply is queued."""
        with self.changed:
            self._alive()
            self.commands += 1
            magic, _flags, command, length, identity = struct.unpack_from("<IHHHH", packet)
            status, payload = 0, b""
            if magic != 0x43563355 or length != len(packet) - 12:
                status = 0x800E
            elif command == 0x0800:
                address, _, count = struct.unpack_from("<QHH", packet, 12)
                status, payload = self._read(address, count)
            elif command == 0x0802:
                (address,) = struct.unpack_from("<Q", packet, 12)
                status = self._write(address, packet[20:])
                payload = struct.pack("<HH", 0, length - 8)
            else:
                status = 0x8001
            if status:
                payload = b""
            reply = struct.pack("<IHHHH", 0x43563355, status, command + 1, len(payload), identity) + payload
            due = self._clock() + self.faults.reply_delay_s(command)
            self._replies.extend((due, part) for part in self.faults.replies(command, reply))
            self.changed.notify_all()

    def _read(self, address: int, count: int) -> tuple[int, bytes]:
        refused = self.faults.refuse(0x0800, address)
        if self.faults.reads_words_only and count % 4:
            refused = 0x8002
        found = self.find(address, count)
        if refused or found is None:
            return refused or 0x8003, b""
        if address in (layout.START, layout.STOP):
            return 0x8006, b""
        if count + 12 > self.number(SBRM + 0x18):
            return 0x8002, b""
        return 0, bytes(found[0][found[1] : found[1] + count])

    def _write(self, address: int, data: bytes) -> int:
        refused = self.faults.refuse(0x0802, address)
        found = self.find(address, len(data))
        if refused or found is None:
            return refused or 0x8003
        if address == layout.PAYLOAD_SIZE or address >= XML:
            return 0x8004
        found[0][found[1] : found[1] + len(data)] = data
        return self._written(address)

    def control_in(self, room: int, timeout_s: float) -> bytes:
        """The next reply; TimeoutError when there is none in time."""
        deadline = time.monotonic() + timeout_s
        with self.changed:
            while True:
                self._alive()
                now = self._clock()
                if self._replies and self._replies[0][0] <= now:
                    return self._replies.popleft()[1][:room]
                left = deadline - time.monotonic()
                if left <= 0:
                    raise TimeoutError
                until_due = self._replies[0][0] - now if self._replies else left
                self.changed.wait(max(min(left, until_due), 1e-4))

    # ---- stream endpoint

    def stream_in(self, target: memoryview, timeout_s: float) -> int:
        """Fill the host's buffer as a bulk transfer would: until it is full or a packet is short."""
        deadline = time.monotonic() + timeout_s
        filled = 0
        with self.changed:
            while filled < len(target):
                self._alive()
                if STREAM_IN in self._halted:
                    raise StalledError
                if not self._units and not self._make_frame():
                    left = deadline - time.monotonic()
                    if left <= 0:
                        if filled:
                            return filled
                        raise TimeoutError
                    self.changed.wait(min(left, self._wait_s()))
                    continue
                unit, ends_short = self._units[0]
                space = len(target) - filled
                if len(unit) > space and space % PACKET:
                    self._units.popleft()
                    raise OverrunError
                count = min(len(unit), space)
                target[filled : filled + count] = unit[:count]
                filled += count
                self._count(count)
                if count < len(unit):
                    self._units[0] = (unit[count:], ends_short)
                    break
                self._units.popleft()
                if ends_short:
                    break
        return filled

    def give_back(self, data: bytes, ended_short: bool) -> None:
        """The host has let go of its buffer before it was filled: on a real bus nothing was sent."""
        with self.changed:
            self._units.appendleft((memoryview(data), ended_short))

    def _count(self, count: int) -> None:
        self._streamed += count
        limit = self.faults.unplug_after_stream_bytes
        if limit is not None and self._streamed >= limit:
            self.unplug()
            raise UnpluggedError

    def edge(self, line: int) -> None:
        """A rising edge on one of its lines: a frame, if the camera waits for one there."""
        with self.changed:
            if self.number(layout.TRIGGER_SOURCE) == line and not self.number(layout.TRIGGER_ACTIVATION):
                self._edges += 1
            self.changed.notify_all()

    def _wait_s(self) -> float:
        if self._running_since is None:
            return 0.2
        due = self._running_since + (self._next_frame + 1) / self.frame_rate_hz
        return max(due - self._clock(), 1e-4)

    def _make_frame(self) -> bool:
        """Queue the next frame's units where one is due."""
        if self._running_since is None:
            return False
        due = int((self._clock() - self._running_since) * self.frame_rate_hz)
        if self.peek(layout.TRIGGER_MODE, 1) != b"\0":
            due = self._edges
        if due <= self._next_frame:
            return False
        if due - self._next_frame > self._frames_inside:
            self.frames_lost_inside += due - self._frames_inside - self._next_frame
            self._next_frame = due - self._frames_inside
        taken_s = self._running_since + self._next_frame / self.frame_rate_hz
        number = self._next_frame + self._first_block
        block = self.faults.block_ids(number)
        self._next_frame += 1
        height, width = self.shape
        image = self.image_bytes(number)
        sizes = struct.unpack("<6I", self.peek(SIRM + 0x18, 24))
        leader = struct.pack(
            "<IHHQHHQIIIIIHH", 0x4C563355, 0, 52, block, 0, 1, self.clock_ns(taken_s),
            self.pixel_format, width, height, self.number(layout.OFFSET_X), self.number(layout.OFFSET_Y),
            0, 0,
        )  # fmt: skip
        room = sizes[1] * sizes[2] + sizes[3] + sizes[4]
        status = 0 if room >= len(image) else 0xA005
        sent = min(room, len(image))
        trailer = struct.pack("<IHHQHHQI", 0x54563355, 0, 32, block, status, 0, sent, height)
        self._queue("leader", block, leader, sizes[0])
        at = 0
        for planned in [sizes[1]] * sizes[2] + [sizes[3], sizes[4]]:
            if at < sent and planned:
                piece = image[at : at + planned]
                self._queue("payload", block, piece, planned)
                at += len(piece)
        self._queue("trailer", block, trailer, sizes[5])
        return bool(self._units)

    def _queue(self, kind: str, block: int, data: bytes, planned: int) -> None:
        for part in self.faults.units(kind, block, data):
            # A short or empty packet ends a transfer that the host has planned longer.
            is_short = self.faults.ends_payload_short and len(part) < planned
            self._units.append((memoryview(part), not part or len(part) % PACKET != 0 or is_short))

    def image_bytes(self, block: int) -> bytes:
        """The image of a block as it goes over the bus."""
        return pack(self.pixels(block), self.pixel_format)

    def pixels(self, block: int) -> np.ndarray:
        """The image of a block as numbers: a sawtooth that begins elsewhere in every frame."""
        height, width = self.shape
        period = {8: 251, 10: 1021, 12: 4093, 14: 16381, 16: 65521}[DEPTHS[self.pixel_format]]
        key = (height * width, period)
        if key not in self._sawtooth:
            self._sawtooth = {key: np.arange(height * width + period) % period}
            if period < 256:
                self._sawtooth[key] = self._sawtooth[key].astype(np.uint8)
        start = 7 * block % period
        return self._sawtooth[key][start : start + height * width].reshape(height, width)

    def block_of(self, image: np.ndarray) -> int | None:
        """The block whose image of 8 bits this is, among the first 251; None if it is none of them."""
        block = int(image[0, 0]) * pow(7, -1, 251) % 251
        return block if np.array_equal(image, self.pixels(block)) else None

    # ---- events, and the rest of a device's life

    def event_in(self, timeout_s: float) -> bytes:
        """An event packet where events are on."""
        with self.changed:
            self._alive()
            if not self.number(EIRM) & 1:
                raise TimeoutError
            return struct.pack("<IHHHHHHQ", 0x45563355, 0x4000, 0x0C00, 12, 1, 0, 0x9001, self.clock_ns())

    def clear_halt(self, endpoint: int) -> None:
        """The host's request to continue after a stall."""
        with self.changed:
            self._alive()
            self._halted.discard(endpoint)
            if endpoint == STREAM_IN:
                self._units.clear()

    def halt(self, endpoint: int) -> None:
        """Stall an endpoint: the host has asked for it, or something went wrong inside."""
        with self.changed:
            self._alive()
            self._halted.add(endpoint)
            self.changed.notify_all()

    def unplug(self) -> None:
        """Take the device from the bus."""
        with self.changed:
            self.unplugged = True
            self.changed.notify_all()

    def reset(self) -> None:
        """Begin with block 0 and the clock anew while frames are sent, and stay on the bus."""
        with self.changed:
            self._t0 = self._running_since = self._clock()
            self._next_frame = 0
            self.changed.notify_all()

    def plug(self) -> None:
        """Put the device on the bus again, in its state after power-up."""
        with self.changed:
            self.unplugged = False
            self.configuration = 0
            self.owner = None
            self.faults.unplug_after_stream_bytes = None
            self._replies.clear()
            self._units.clear()
            self._halted.clear()
            self._running_since = None
            self._streamed = 0
            self.poke(SIRM + 4, bytes(4))
            self.poke(layout.LOCKED, bytes(4))

    def _alive(self) -> None:
        if self.unplugged:
            raise UnpluggedError
