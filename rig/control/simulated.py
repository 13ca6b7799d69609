"""A simulated controller, which runs the board's firmware in this process.

The host's side is the same as for real hardware, including checksums and watchdog. Only the
board's pins are replaced by the inputs of the simulated rig, which switch its laser or release its pendulum.
"""

import operator
import threading
import time
from collections.abc import Callable

from acquisition.simulation.inputs import RigInputs
from rig.control.controller import Controller
from rig.control.firmware.core import Firmware
from rig.control.serial_port import PortLost, SerialLine
from rig.control.settings import ControllerSettings

_LOOP_INTERVAL_S = 0.005


def simulated_controller(
    settings: ControllerSettings,
    laser_max_w: float,
    inputs: RigInputs | None = None,
    laser: Callable[[float], None] | None = None,
    interlock_closed: Callable[[], bool] = lambda: True,
) -> Controller:
    """A `Controller` whose board is simulated in this process, as `SimulatedBoard`."""
    board = SimulatedBoard(inputs, laser, interlock_closed)
    return Controller(settings, laser_max_w, board.open_line)


class SimulatedBoard:
    """The simulated board, whose thread runs the firmware's loop while a line is open or a session lasts.

    The watchdog therefore acts as on the real board when the heartbeats stop. The board's pins move the rig
    of `inputs`; with None they are not connected. `laser`, if given, is called instead of that rig's laser,
    from the board's thread and with the optical power in W (0.0 when off); it must return immediately.
    """

    fault = ""
    serial = "SIMULATED"
    clamp_closed = False
    latches_at_start = False
    laser_max_w = 0.005
    starter_max_ms = 5000
    brake_max_ms = 60000
    ticks_diff, ticks_add = staticmethod(operator.sub), staticmethod(operator.add)
    """Difference and sum of readings of the clock, which does not overflow."""

    def __init__(
        self,
        inputs: RigInputs | None,
        laser: Callable[[float], None] | None = None,
        interlock_closed: Callable[[], bool] = lambda: True,
    ) -> None:
        self.changed = threading.Condition()
        self.to_board = bytearray()
        self.to_host = bytearray()
        self.open_lines = 0
        inputs = inputs or RigInputs()
        self.set_pulse, self.set_magnet, self.set_starter = inputs.pulse, inputs.magnet, inputs.starter
        self.set_clamp, self.set_brake = inputs.clamp, inputs.brake
        self._laser = laser or inputs.laser
        self._interlock_closed = interlock_closed
        self._thread: threading.Thread | None = None
        self._enabled = False
        self._latch = (0, "NONE")
        self._firmware = Firmware(self)  # type: ignore[no-untyped-call]

    def open_line(self) -> SerialLine:
        """Connect the cable."""
        with self.changed:
            self.open_lines += 1
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="simulated-board", daemon=True)
                self._thread.start()
        return _SimulatedLine(self)

    def _run(self) -> None:
        while True:
            with self.changed:
                if not self.to_board:
                    self.changed.wait(_LOOP_INTERVAL_S)
            self._firmware.step()
            with self.changed:
                if not self.open_lines and not self._firmware.token:
                    self._thread = None
                    return

    # -- interface to the firmware --------------------------------------------

    def read(self) -> bytes:
        """Bytes from the host since the last call."""
        with self.changed:
            data = bytes(self.to_board)
            self.to_board.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send to the host, if the line is open."""
        with self.changed:
            if self.open_lines:
                self.to_host += data
                self.changed.notify_all()

    def set_laser(self, on: bool, power_w: float) -> None:
        """Switch the laser, with this power."""
        self._enabled = on
        self._laser(power_w if on else 0.0)

    def laser_enabled(self) -> bool:
        """Whether the laser's relay is closed."""
        return self._enabled

    def interlock_closed(self) -> bool:
        """State of the interlock loop."""
        return self._interlock_closed()

    def interlock_opened(self) -> bool:
        """Whether the loop opened for less than a turn, which is not simulated."""
        return False

    def button_pressed(self) -> bool:
        """State of the board's button, which is never pressed."""
        return False

    def light_seen(self) -> bool | None:
        """None: there is no photodiode."""
        return None

    def stored_latch(self) -> tuple[int, str]:
        """Number and cause of the last trip, as a reset finds them."""
        return self._latch

    def store_latch(self, number: int, cause: str) -> None:
        """Store number and cause of the last trip, which survive a reset."""
        self._latch = (number, cause)

    def environment(self) -> tuple[float, float, float]:
        """Temperature in °C, relative humidity in %, pressure in Pa."""
        return 20.0, 45.0, 101325.0

    def ticks_ms(self) -> int:
        """The board's clock in ms."""
        return time.monotonic_ns() // 1_000_000


class _SimulatedLine:
    """The host's end of the cable."""

    name = "simulated controller"

    def __init__(self, board: SimulatedBoard) -> None:
        self._board = board
        self._closed = False

    def write(self, data: bytes) -> None:
        self._check()
        board = self._board
        with board.changed:
            board.to_board += data
            board.changed.notify_all()

    def read(self, timeout_s: float) -> bytes:
        board = self._board
        with board.changed:
            board.changed.wait_for(lambda: board.to_host or self._closed, max(timeout_s, 0.0))
            self._check()
            data = bytes(board.to_host)
            board.to_host.clear()
        return data

    def discard_input(self) -> None:
        with self._board.changed:
            self._board.to_host.clear()

    def close(self) -> None:
        with self._board.changed:
            if not self._closed:
                self._closed = True
                self._board.open_lines -= 1

    def _check(self) -> None:
        if self._closed:
            raise PortLost("simulated controller: the serial port is no longer available; check the cable")
