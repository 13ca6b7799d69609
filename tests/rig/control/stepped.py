"""The controller's firmware and the lasers without waiting: a stepped clock, lines within this process.

The host's code is what runs with real ports; its clock is this one. What needs real time, a real terminal or
the real interpreter is tested with `wires` and `instruments`.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import pytest

from rig.control import device_thread, laser_service, protocol, sensors, serial_port, service
from rig.control.device_thread import DeviceThread
from rig.control.firmware.core import Firmware
from rig.control.lasers import ldc500, obis, serial_laser
from rig.control.protocol import checksum
from rig.control.serial_port import LineReader, PortLost
from rig.control.simulated import SimulatedBoard
from tests.rig.control import instruments
from tests.rig.control.instruments import Instrument

TURN_MS = 5
"""How long one turn of the board's loop takes."""


class Clock:
    """Stands in for the module `time`; it goes on only while somebody waits."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000_000

    def monotonic(self) -> float:
        return self.now_ns * 1e-9

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)


class SteppedBoard(SimulatedBoard):
    """Pins whose outputs are remembered with their times, and a loop that turns while it is waited for."""

    serial, laser_max_w, brake_max_ms = "TEST0001", 0.001, 300

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.port = "stepped"
        self.closed = True
        self.sensor_works = self.relay_works = self.connected = True
        self._reset_wanted = False
        self.said: list[tuple[int, str, list[float]]] = []
        self.to_host: Callable[[bytes], bytes] = bytes  # type: ignore[assignment]
        self.to_board: Callable[[bytes], bytes] = bytes  # type: ignore[assignment]
        self._heard, self._sent = b"", b""
        self.pressed = False
        self.light: bool | None = None
        self._latch = (0, "NONE")
        self._lit = False
        for name in ("pulse", "magnet", "starter", "clamp", "brake"):
            setattr(self, f"set_{name}", partial(self._say, name))
        self._boot()
        self.sent()  # its greeting

    def _boot(self) -> None:
        self._heard = b""
        self._say("boot", 1)
        self.firmware = Firmware(self)  # type: ignore[no-untyped-call]

    def press(self, keys: bytes) -> None:
        """As the keys of the real interpreter's bridge."""
        match keys:
            case b"o" | b"c":
                self.closed = keys == b"c"
            case b"x":
                self.sensor_works = False
            case b"p":
                self.relay_works = self._lit = False
            case b"k" | b"K":
                self.pressed = keys == b"k"
            case b"l" | b"d":
                self.light = keys == b"l"
            case b"r":
                self._reset_wanted = True

    def wait_for(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Turns until it holds."""
        end_ns = self.clock.now_ns + round(timeout_s * 1e9)
        while not condition():
            assert self.clock.now_ns < end_ns, f"not within {timeout_s} s; outputs {self.outputs()}"
            self.turn(TURN_MS / 1000)

    def events(self) -> list[tuple[int, str, list[float]]]:
        """Every change of an output: (board's ms, output, values)."""
        return self.said

    def outputs(self) -> dict[str, list[float]]:
        """Latest state of each output."""
        return {name: values for _, name, values in self.said}

    def count(self, name: str, first_value: float) -> int:
        """How often an output went to this value."""
        return sum(said == name and values[0] == first_value for _, said, values in self.said)

    def turn(self, duration_s: float = 0.0) -> None:
        """Its loop for so long, and at least once."""
        end_ns = self.clock.now_ns + round(duration_s * 1e9)
        while True:
            self.firmware.step()
            if self._reset_wanted:
                self._reset_wanted = False
                self._boot()
            if self.clock.now_ns >= end_ns:
                return
            self.clock.now_ns += TURN_MS * 1_000_000

    # -- what the firmware uses ------------------------------------------------

    def _say(self, name: str, *values: float) -> None:
        self.said.append((self.ticks_ms(), name, [float(value) for value in values]))

    def read(self) -> bytes:
        data, self._heard = self._heard, b""
        return data

    def write(self, data: bytes) -> None:
        if self.connected:
            self._sent += self.to_host(data)

    def set_laser(self, on: bool, power_w: float) -> None:
        self._lit = on and self.relay_works
        self._say("laser", on, power_w)

    def laser_enabled(self) -> bool:
        return self._lit

    def interlock_closed(self) -> bool:
        return self.closed

    def button_pressed(self) -> bool:
        return self.pressed

    def light_seen(self) -> bool | None:
        return self.light

    def environment(self) -> tuple[float, float, float]:
        if not self.sensor_works:
            raise OSError("no sensor")
        return 20.125, 45.5, 101325.0

    def ticks_ms(self) -> int:
        return self.clock.now_ns // 1_000_000

    # -- the host's end of the cable -------------------------------------------

    def open_line(self) -> "SteppedLine":
        if not self.connected:
            raise PortLost("stepped: no such port")
        return SteppedLine(self)

    def hear(self, data: bytes) -> None:
        if self.connected:
            self._heard += self.to_board(data)

    def sent(self) -> bytes:
        data, self._sent = self._sent, b""
        return data

    @property
    def wire(self) -> "SteppedBoard":
        """The cable, which can spoil and lose."""
        return self

    def inject(self, data: bytes) -> None:
        """Noise on the line towards the host."""
        self._sent += data

    def unplug(self) -> None:
        """The USB device goes, the board lives on."""
        self.connected = False

    def sleep(self, duration_s: float) -> None:
        self.clock.sleep(duration_s)

    @contextmanager
    def terminal(self) -> Iterator["SteppedTerminal"]:
        """What a person types at."""
        yield SteppedTerminal(self)


class SpoiledLine:
    """What the cable does to answers from now on: bytes that are passed on, and answers seen before."""

    def __init__(self, board: SteppedBoard) -> None:
        self._board, self._seen = board, b""
        self._due: list[tuple[float, bytes]] = []
        self._delay_s = 0.0
        self._usual = board.sent
        board.to_host = self._record

    def _record(self, data: bytes) -> bytes:
        self._seen += data
        return data

    def mute(self) -> None:
        self._board.to_host = lambda _: b""

    def half_lines(self) -> None:
        self._board.to_host = lambda data: data[: len(data) // 2]

    def old_replies(self) -> None:
        old = self._seen[-400:]
        self._board.to_host = lambda _: old

    def nan(self) -> None:
        self._change_status(3, "nan")

    def wrong_values(self) -> None:
        self._change_status(1, "7")

    def _change_status(self, place: int, value: str) -> None:
        def changed(data: bytes) -> bytes:
            body, star, _ = data.decode().partition("*")
            fields = body.split(",")
            if len(fields) < 14 or not star:
                return data
            fields[place] = value
            text = ",".join(fields).encode()
            return text + b"*%04X\n" % checksum(text)

        self._board.to_host = changed

    def late(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._board.sent = self._sent_late  # type: ignore[method-assign]

    def mend(self) -> None:
        """Answers pass as they do, and what was still to come has come."""
        self._board.to_host = self._record
        self._delay_s = 0.0

    def very_late(self) -> None:
        """Later than the last repetition of a command."""
        self.late(0.7)

    def _sent_late(self) -> bytes:
        now_s = self._board.clock.monotonic()
        if data := self._usual():
            self._due.append((now_s + self._delay_s, data))
        arrived = [data for at_s, data in self._due if at_s <= now_s]
        self._due = [one for one in self._due if one[0] > now_s]
        return b"".join(arrived)


class SteppedLine:
    """A `Line` to a board; waiting lets the board turn."""

    name = "stepped"

    def __init__(self, board: SteppedBoard) -> None:
        self._board = board

    def write(self, data: bytes) -> None:
        self._check()
        self._board.hear(data)

    def read(self, timeout_s: float) -> bytes:
        self._check()
        board = self._board
        board.turn()
        end_ns = board.clock.now_ns + math.ceil(timeout_s * 1e9)
        while not (data := board.sent()) and board.clock.now_ns < end_ns:
            board.turn(TURN_MS / 1000)
        return data

    def discard_input(self) -> None:
        self._board.sent()

    def close(self) -> None:
        pass

    def _check(self) -> None:
        if not self._board.connected:
            raise PortLost("stepped: the serial port is no longer available; check the cable")


class SteppedTerminal:
    """Lines written and read, as with `serial.Serial`."""

    def __init__(self, board: SteppedBoard) -> None:
        self._reader = LineReader(board.open_line())
        self._board = board

    def write(self, data: bytes) -> None:
        self._board.hear(data)

    def readline(self) -> bytes:
        line = self._reader.read_line(self._board.clock.monotonic() + 10)
        return b"" if line is None else line + b"\n"


class InstrumentLine:
    """A `Line` to an instrument, which answers at once or not at all."""

    def __init__(self, instrument: Instrument, clock: Clock) -> None:
        self.name = "stepped"
        self.closed = False
        self._instrument = instrument
        self._clock = clock
        self._waiting = b""

    def write(self, data: bytes) -> None:
        assert not self.closed
        self._waiting += self._instrument.hear(data)

    def read(self, timeout_s: float) -> bytes:
        assert not self.closed
        data, self._waiting = self._waiting, b""
        if not data:
            self._clock.sleep(max(timeout_s, 1e-3))
        return data

    def discard_input(self) -> None:
        self._waiting = b""

    def close(self) -> None:
        self.closed = True


def stepped_clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of all that the host does with lines."""
    clock = Clock()
    of_the_host = (
        sensors,
        laser_service,
        protocol,
        serial_port,
        service,
        device_thread,
        serial_laser,
        obis,
        ldc500,
    )
    for module in (*of_the_host, instruments):
        monkeypatch.setattr(module, "time", clock)
    return clock


def turn(device: DeviceThread) -> float:
    """One turn of a service and the jobs that wait, as its thread does them; seconds to the next one."""
    pause_s = device._poll()
    while not device._jobs.empty():
        device._run_next_job(0.0)
    return pause_s
