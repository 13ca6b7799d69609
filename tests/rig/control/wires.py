"""The firmware on a MicroPython interpreter behind a pseudo-terminal, with a line that can fail."""

import contextlib
import os
import pty
import select
import socket
import subprocess
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from rig.control.serial_port import PortLost
from rig.control.simulated import _SimulatedLine
from tests.rig.known_rig import known

HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parents[2] / "rig" / "control" / "firmware"


class FirmwareBoard:
    """The firmware's own files, run by node's MicroPython, at one end of a pseudo-terminal.

    With ``through_wire`` its bytes pass a `Wire`, which can lose, spoil, delay and cut. `states` is where the
    states of rigs are kept, if not where this process keeps them.
    """

    def __init__(
        self, package: Path, folder: Path, through_wire: bool = False, states: Path | None = None
    ) -> None:
        self._log_file = folder / "outputs.log"
        self._log_file.touch()
        master, slave = pty.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        known(self.port, states)
        # Held open, so that the terminal survives a host that opens and closes it.
        self._slave = slave
        self._wire: Wire | None = None
        if through_wire:
            ours, theirs = socket.socketpair()
            serial_fd = theirs.detach()
            self._wire = Wire(master, ours)
        else:
            serial_fd = master
        os.set_blocking(serial_fd, False)
        control_out, self._control = os.pipe()
        os.set_blocking(control_out, False)
        self._errors = (folder / "node.err").open("wb")
        self._process = subprocess.Popen(
            [
                "node",
                str(HERE / "micropython" / "bridge.mjs"),
                str(package),
                str(FIRMWARE),
                str(HERE / "micropython" / "board.py"),
                str(serial_fd),
                str(control_out),
                str(self._log_file),
            ],
            pass_fds=(serial_fd, control_out),
            stdin=subprocess.DEVNULL,
            stdout=self._errors,
            stderr=self._errors,
        )
        os.close(serial_fd)
        os.close(control_out)
        self.wait_for(lambda: "turning" in self.outputs(), 20.0)
        # Take in the board's greeting, so that it does not arrive in the middle of a test.
        greeting = b""
        while not greeting.endswith(b"\n"):
            greeting += os.read(slave, 64)

    @property
    def wire(self) -> "Wire":
        """The wire of a board that was made with one."""
        assert self._wire is not None
        return self._wire

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)

    def terminal(self) -> serial.Serial:
        """What a person types at."""
        return serial.Serial(self.port, timeout=10.0)

    def press(self, keys: bytes) -> None:
        """Do something to the board: see bridge.mjs for the keys."""
        os.write(self._control, keys)

    def events(self) -> list[tuple[int, str, list[float]]]:
        """Every change of an output: (board's ms, output, values)."""
        rows = []
        for line in self._log_file.read_text().splitlines():
            ms, name, *values = line.split()
            rows.append((int(ms), name, [float(value) for value in values]))
        return rows

    def outputs(self) -> dict[str, list[float]]:
        """Latest state of each output."""
        return {name: values for _, name, values in self.events()}

    @property
    def is_safe(self) -> bool:
        """Whether laser, magnet and starter are off."""
        return not any(self.outputs()[name][0] for name in ("laser", "magnet", "starter"))

    def count(self, name: str, first_value: float) -> int:
        """How often an output went to this value."""
        return sum(row[1] == name and row[2][0] == first_value for row in self.events())

    def wait_for(self, condition: Callable[[], bool], timeout_s: float, every_s: float = 0.005) -> float:
        """Seconds until the condition, looked at so often, held; AssertionError when it did not."""
        start_s = time.monotonic()
        while time.monotonic() - start_s < timeout_s:
            if condition():
                return time.monotonic() - start_s
            if self._process.poll() is not None:
                raise AssertionError(f"the interpreter ended: {Path(self._errors.name).read_text()}")
            time.sleep(every_s)
        raise AssertionError(f"not within {timeout_s} s; outputs {self.outputs()}")

    def close(self) -> None:
        """End the interpreter, then let go of the terminal."""
        self._process.kill()
        self._process.wait()
        self._errors.close()
        os.close(self._control)
        if self._wire is not None:
            self._wire.close()
        if self._slave >= 0:
            os.close(self._slave)


def pull_cable(monkeypatch: pytest.MonkeyPatch, pulled: Callable[[], bool]) -> None:
    """The simulated controller's cable is out while `pulled` says so."""
    usual = _SimulatedLine._check

    def check(line: _SimulatedLine) -> None:
        if pulled():
            raise PortLost("simulated controller: the serial port is no longer available; check the cable")
        usual(line)

    monkeypatch.setattr(_SimulatedLine, "_check", check)


class Wire:
    """Carries bytes between the terminal and the board and can be told to do it badly."""

    def __init__(self, master: int, board: socket.socket) -> None:
        self._master = master
        self._board = board
        self.to_board: Callable[[bytes], bytes] = _unchanged
        self.to_host: Callable[[bytes], bytes] = _unchanged
        self.connected = True
        self._wake_out, self._wake_in = os.pipe()
        self._running = True
        self._thread = threading.Thread(target=self._carry, name="wire", daemon=True)
        self._thread.start()

    def inject(self, data: bytes) -> None:
        """Noise on the line towards the host."""
        os.write(self._master, data)

    def unplug(self) -> None:
        """The USB device goes: the terminal hangs up, the board lives on."""
        self._stop()
        if self._master >= 0:
            os.close(self._master)
            self._master = -1

    def close(self) -> None:
        """End the carrier."""
        self.unplug()
        self._board.close()
        for fd in (self._wake_out, self._wake_in):
            with contextlib.suppress(OSError):
                os.close(fd)

    def _stop(self) -> None:
        if self._running:
            self._running = False
            os.write(self._wake_in, b"x")
            self._thread.join()

    def _carry(self) -> None:
        board = self._board.fileno()
        while self._running:
            ready, _, _ = select.select([self._master, board, self._wake_out], [], [])
            try:
                if self._master in ready:
                    data = os.read(self._master, 4096)
                    if self.connected and (data := self.to_board(data)):
                        os.write(board, data)
                if board in ready:
                    data = os.read(board, 4096)
                    if not data:
                        return
                    if self.connected and (data := self.to_host(data)):
                        os.write(self._master, data)
            except OSError:
                return


def _unchanged(data: bytes) -> bytes:
    return data
