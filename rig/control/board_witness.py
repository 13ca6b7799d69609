"""Samples of the accelerometer on the controller's board: the witness of the ground by the controller's line.

The board keeps them until it is asked, and is asked between heartbeats, so that they wait for everything else
on the line. They carry its ticks, which go on in this computer's time from session to session.
"""

import math
import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

from processing.errors import DeviceError
from processing.ticks import nanoseconds, seconds
from rig.control.link import ReplyTimeout
from rig.control.settings import WitnessSettings
from rig.control.witness import WitnessBuffer, WitnessSample

BLOCK = 6
"""Samples of a full reply."""
_BLOCKS = 2
"""Most replies between two heartbeats, three times what comes meanwhile."""
_PAUSE_S = 1.0
"""After a reply that failed, the line is left to the heartbeats for so long."""
_TICKS = 1 << 30
"""MicroPython's clock of ms begins anew there."""
_AXES = 3
_EVENTS_KEPT = 64


@dataclass(frozen=True, slots=True)
class BoardSensor:
    """What the board reads; of counts only their changes matter, so that `per_g` is for people."""

    name: str
    rate_hz: float
    per_g: int

    @property
    def step_ms(self) -> float:
        """Between two samples, as stated by the sensor."""
        return 1000.0 / self.rate_hz


@dataclass(frozen=True, slots=True)
class BoardSamples:
    """A reply: samples that follow one another, the board's ticks of the last one and of the reply itself.

    `alive` is whether the sensor answers the board, `dropped` how many samples of this session the board had
    no room for, `waiting` how many it still keeps, `first` the number of the first one.
    """

    alive: bool
    dropped: int
    waiting: int
    first: int
    last_ms: int
    now_ms: int
    values: tuple[tuple[int, ...], ...]


def sensor_of(reply: str) -> BoardSensor:
    """The reply to WITNess:STARt; raises DeviceError for another one."""
    name, *numbers = reply.split(",")
    try:
        rate, per_g = numbers
        sensor = BoardSensor(name, float(rate), int(per_g))
        if not sensor.rate_hz > 0:
            raise ValueError(rate)
    except ValueError:
        raise DeviceError(
            f"the controller answered {reply!r}, which is not a sensor, its rate and scale"
        ) from None
    return sensor


def samples_of(reply: str) -> BoardSamples:
    """The reply to WITNess:DATA?; raises DeviceError for another one."""
    try:
        *head, text = reply.split(",")
        alive, dropped, waiting, first, last_ms, now_ms = map(int, head)
        raw = bytes.fromhex(text)
        if len(raw) % (3 * _AXES):
            raise ValueError(text)
    except ValueError:
        raise DeviceError(f"the controller answered {reply!r}, which are not accelerometer samples") from None
    # 20 bits in the upper part of three bytes
    words = [int.from_bytes(raw[k : k + 3], signed=True) >> 4 for k in range(0, len(raw), 3)]
    values = tuple(tuple(words[k : k + _AXES]) for k in range(0, len(words), _AXES))
    return BoardSamples(alive == 1, dropped, waiting, first, last_ms, now_ms, values)


class AsksForWitness(Protocol):
    """A controller that has one; `rig.control.Controller`."""

    def start_witness(self) -> BoardSensor:
        """Begin with it."""
        ...

    def witness_samples(self) -> BoardSamples:
        """The oldest that wait."""
        ...


class BoardWitness(WitnessBuffer):
    """Takes the samples off the board in the controller's thread and keeps them until they are taken.

    Samples between two replies that follow one another are spaced evenly between the ticks of the replies'
    last ones, because the sensor's clock is not the board's.
    """

    def __init__(self, settings: WitnessSettings) -> None:
        super().__init__(settings)
        self._axes = len(settings.components)
        self._events: deque[str] = deque(maxlen=_EVENTS_KEPT)
        self._sensor: BoardSensor | None = None
        self._not_before_s = 0.0
        self._next = 0
        self._before_ms = 0.0
        self._base_ms = 0.0
        self._tick_ms = 0
        self._dropped = 0
        self._alive: bool | None = None
        self._refusal = ""

    @property
    def refusal(self) -> str:
        """Why the board gives no samples in this session, as it said; empty while it does."""
        return self._refusal

    @property
    def alive(self) -> bool | None:
        """Whether the board hears its accelerometer; None before it said so."""
        return self._alive

    def take_events(self) -> tuple[str, ...]:
        """What happened to it since the last call; only one thread may call it."""
        return tuple(self._events.popleft() for _ in range(len(self._events)))

    def begin(self) -> None:
        """The controller's session has begun: samples are asked for from the next `pull` on."""
        self._sensor, self._refusal = None, ""
        self._not_before_s = 0.0
        self._next = -1
        self._dropped = 0
        # ticks of another session may be of a board that was reset meanwhile
        self._base_ms, self._tick_ms = 0.0, -1

    def pull(self, controller: AsksForWitness) -> None:
        """Take what waits on the board, as far as the heartbeats leave time for; after a failure, later.

        Raises DeviceError for a failure. A board that refuses its accelerometer is not asked again in this
        session: the laser and everything else on it go on.
        """
        if time.monotonic() < self._not_before_s:
            return
        try:
            if self._sensor is None:
                self._sensor = controller.start_witness()
                # it has not looked at its sensor yet
                return
            for _ in range(_BLOCKS):
                block = controller.witness_samples()
                self._take(block, self._sensor, time.monotonic_ns())
                if not block.waiting:
                    break
        except DeviceError as error:
            refused = self._sensor is None and not isinstance(error, ReplyTimeout)
            self._refusal = str(error) if refused else ""
            self._not_before_s = math.inf if refused else time.monotonic() + _PAUSE_S
            raise

    def _take(self, block: BoardSamples, sensor: BoardSensor, received_ns: int) -> None:
        if block.alive != self._alive:
            said = f"{sensor.name} on the controller's board answers" if block.alive else _silent(sensor)
            # of one that answers from the start nobody needs to be told
            if self._alive is not None or not block.alive:
                self._events.append(said)
            self._alive = block.alive
        if block.dropped > self._dropped:
            lost = block.dropped - self._dropped
            self._events.append(f"{lost} samples of the witness had no room on the controller's board")
            self._dropped = block.dropped
        now_ms = self._on_line(block.now_ms, received_ns)
        if not block.values:
            return
        last_ms = now_ms - (block.now_ms - block.last_ms) % _TICKS
        count = len(block.values)
        step_ms = (last_ms - self._before_ms) / count if block.first == self._next else sensor.step_ms
        if not 0.5 * sensor.step_ms < step_ms < 2 * sensor.step_ms:
            step_ms = sensor.step_ms
        for later, value in enumerate(block.values, 1 - count):
            own_ms = last_ms + later * step_ms
            host_ns = received_ns - nanoseconds(1e-3 * (now_ms - own_ms))
            self._keep(WitnessSample(host_ns, 1e-3 * own_ms, tuple(map(float, value[: self._axes]))))
        self._next, self._before_ms = block.first + count, last_ms

    def _on_line(self, now_ms: int, received_ns: int) -> float:
        """The board's ticks without their wraps, from this computer's time at the session's first reply."""
        if self._tick_ms < 0:
            self._base_ms = 1e3 * seconds(received_ns)
        else:
            self._base_ms += (now_ms - self._tick_ms) % _TICKS
        self._tick_ms = now_ms
        return self._base_ms


def _silent(sensor: BoardSensor) -> str:
    return f"{sensor.name} on the controller's board does not answer: check its supply and wires"
