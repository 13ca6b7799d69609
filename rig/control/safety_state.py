"""Safety state of a rig, which outlives programs: trips that await their acknowledgement."""

import os
import re
import threading
from concurrent import futures
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO, Self

from pydantic import BaseModel, ValidationError

from acquisition import atomic_write
from processing.errors import DeviceError
from rig.control.device_thread import run_in_thread
from rig.control.lasers import LaserSettings
from rig.control.presses import Presses
from rig.control.settings import ControllerSettings

try:
    import fcntl
except ImportError:  # pragma: no cover
    # no file locks on this system; the serial ports themselves are opened by one program at a time
    fcntl = None  # type: ignore[assignment]

_SCHEMA = 1
_MAX_TRIP_WRITE_S = 0.2
"""Longest wait of a trip for the disk: the program that latches it also switches the light off."""
_MAX_EXIT_WAIT_S = 5.0
"""Longest wait, at the end of a program, for a write under way."""


class TripCause(StrEnum):
    """Causes for which the light is off until a person acknowledges the trip."""

    INTERLOCK = "INTERLOCK"
    OUTPUT = "OUTPUT"
    WATCHDOG = "WATCHDOG"
    POWER = "POWER"
    PERSON = "PERSON"
    """A person pressed LIGHT OFF; no board reports this cause."""


@dataclass(frozen=True, slots=True)
class LatchedTrip:
    """A trip that waits for its acknowledgement."""

    number: int
    cause: TripCause
    why: str
    lit: bool
    """Whether the laser was, or should have been, lit."""

    @property
    def text(self) -> str:
        """The trip in words, such as `trip 5 (INTERLOCK): the interlock of the laser opened`."""
        return f"trip {self.number} ({self.cause}): {self.why}"


class _LatchEntry(BaseModel, frozen=True, extra="forbid"):
    """A latched trip in the file."""

    cause: TripCause
    why: str
    lit: bool


class _SafetyFile(BaseModel, frozen=True, extra="forbid"):
    """Content of the file."""

    schema_number: int = _SCHEMA
    number: int = 0
    """Number of the last trip."""
    latched: _LatchEntry | None = None
    lit: bool = False
    """True from the moment when a program lights until it has confirmed that the light is off."""
    press: str = ""
    """Time and hash of the last press of LIGHT OFF that became a trip."""


def rig_state_path(laser: LaserSettings, controller: ControllerSettings) -> Path | None:
    """The state file of the rig with these devices; None if they have no real light.

    The state of a simulated rig stays in its process. A USB port is identified by the device's serial number,
    whatever name the system gives it.
    """
    if laser.kind == "none" or (laser.kind == "controller" and controller.kind != "serial"):
        return None
    port = controller.port if laser.kind == "controller" else laser.port
    if port.startswith("/"):
        port = str(Path(port).resolve())
    name = re.sub(r"[^A-Za-z0-9]+", "-", f"{laser.kind} {_device_at(port) or port}")
    return state_folder() / f"{name}.json"


def state_folder() -> Path:
    """Folder of this user's state files, which outlive programs."""
    parent = os.environ.get("XDG_STATE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(parent) if parent else Path.home() / ".local" / "state") / "optical-pendulum-rig"


_UNKNOWN = "so the latched trip is unknown"


def _unknown_state(why: str) -> _SafetyFile:
    """A state that counts as latched, because its file cannot be read."""
    return _SafetyFile(number=1, latched=_LatchEntry(cause=TripCause.POWER, why=why, lit=True))


def _device_at(port: str) -> str:
    """USB numbers and serial number of the device at a port; empty where it has none."""
    # imported here, because most callers read a latch without looking for ports
    from serial.tools import list_ports

    for info in list_ports.comports():
        if info.device == port and info.serial_number:
            return f"{info.vid:04x} {info.pid:04x} {info.serial_number}"
    return ""


class SafetyState:
    """The latch of a rig, in its file (None: in memory); a context manager that holds the rig.

    `trip` may be read, and `latch` called, from any thread; neither waits for a disk that hangs. A file that
    cannot be read or is missing counts as latched, because a new rig cannot be told from one whose state was
    deleted.
    """

    def __init__(self, path: Path | None = None, holder_text: str = "") -> None:
        self.path = path
        self._holder_text = holder_text
        self._state = _SafetyFile()
        self._state_lock, self._file_lock, self._press_lock = (threading.Lock() for _ in range(3))
        self._pending_writes: set[futures.Future[None]] = set()
        self._lock_file: IO[bytes] | None = None
        self.presses = None if path is None else Presses(path.with_suffix(".off"))
        """Presses of LIGHT OFF, in a second file; None without a file."""
        self._new_press = self._mark = ""
        self.problem = ""
        """The reason why the last write of the state failed; else empty."""

    def __enter__(self) -> Self:
        if self.path is not None:
            self._lock(self.path)
        return self

    def __exit__(self, *_error: object) -> None:
        if self._lock_file is not None:
            # the next program must find a trip whose writing is under way
            futures.wait(tuple(self._pending_writes), _MAX_EXIT_WAIT_S)
            self._lock_file.close()
            self._lock_file = None

    def note_folder(self, folder: Path) -> None:
        """Note for other programs the folder in which this holder of the rig takes orders."""
        if self._lock_file is not None:
            self._lock_file.write(f"\n{folder.absolute()}".encode())
            self._lock_file.flush()

    @property
    def holder_folder(self) -> Path | None:
        """The folder of the program that holds the rig, or held it last."""
        if self.path is None:
            return None
        try:
            _, _, folder = self.path.with_suffix(".lock").read_text("utf-8").partition("\n")
        except (OSError, ValueError):
            return None
        return Path(folder) if folder else None

    def read(self) -> None:
        """Read the file, which needs no hold of the rig; a missing file counts as latched."""
        if self.path is None:
            return
        try:
            state = _SafetyFile.model_validate_json(self.path.read_bytes())
        except FileNotFoundError:
            # a program that has held the rig wrote the state before it noted itself in the lock
            was_held = False
            with suppress(OSError):
                was_held = self.path.with_suffix(".lock").stat().st_size > 0
            new = f"nothing is known of its light: it is new here, or its state was deleted ({self.path})"
            self._state = _unknown_state(f"{self.path} is gone, {_UNKNOWN}" if was_held else new)
        except (OSError, ValidationError):
            self._state = _unknown_state(f"{self.path} cannot be read, {_UNKNOWN}")
        else:
            text = f"{self.path} is of schema {state.schema_number}, and schema {_SCHEMA} is read"
            self._state = state if state.schema_number == _SCHEMA else _unknown_state(text)
        self._look_for_press()

    def _look_for_press(self) -> None:
        """Note a press that is no trip yet; an unreadable file counts as such a press."""
        if self.presses is None:
            return
        try:
            press = self.presses.newest()
        except DeviceError as error:
            # without a mark to compare, LIGHT OFF counts as pressed as long as the file is unreadable
            self._mark, self._new_press = f"unknown: {error}", str(error)
            return
        self._mark = press.mark
        self._new_press = "" if press.mark == self._state.press else press.why

    def take_press(self, lit: bool) -> LatchedTrip | None:
        """Latch a press of LIGHT OFF that is no trip yet; None without one.

        A trip that is latched already stays as it is. Raises DeviceError, as `latch` does, where the latch
        holds but cannot be written.
        """
        with self._press_lock:
            self._look_for_press()
            # a trip that comes meanwhile waits for this, so that neither replaces the other
            with self._state_lock:
                why, mark, state = self._new_press, self._mark, self._state
                self._new_press = ""
                if not why or (state.latched is not None and state.press == mark):
                    return None
                latched = state.latched or _LatchEntry(cause=TripCause.PERSON, why=why, lit=lit)
                number = state.number + (state.latched is None)
                changes = {"press": mark, "number": number, "latched": latched}
                self._state = state.model_copy(update=changes)
            self._write_in_time()
            return self.trip

    @property
    def trip(self) -> LatchedTrip | None:
        """The latched trip, or that of a press that is not latched yet; None without either."""
        state = self._state
        if state.latched is None:
            if not (why := self._new_press):
                return None
            return LatchedTrip(state.number + 1, TripCause.PERSON, why, state.lit)
        return LatchedTrip(state.number, state.latched.cause, state.latched.why, state.latched.lit)

    def latch(self, cause: TripCause, why: str, lit: bool) -> LatchedTrip:
        """Latch a cause; the number grows, also if another trip is latched already.

        A press of LIGHT OFF that was latched before stays in the text of the trip. The latch holds from now
        on. Raises DeviceError if the file cannot be written, or within 0.2 s is not; the writing then goes
        on. For a trip that cannot be written a press is noted, which needs no space on the disk, and
        `retry_write` tries again.
        """
        with self._state_lock:
            earlier, number = self._state.latched, self._state.number + 1
            if earlier is not None and earlier.cause is TripCause.PERSON:
                why = f"{why}; {earlier.why}"
            latched = _LatchEntry(cause=cause, why=why, lit=lit)
            self._state = self._state.model_copy(update={"number": number, "latched": latched})
        self._write_in_time()
        return LatchedTrip(number, cause, why, lit)

    def acknowledge(self, number: int) -> None:
        """Clear the trip of this number; DeviceError for another number, or if that cannot be written.

        A trip that comes while this waits for the disk stays latched, which raises DeviceError, too.
        """
        with self._file_lock:
            with self._state_lock:
                trip, mark, state = self.trip, self._mark, self._state
            if trip is None or trip.number != number:
                latched = "nothing is latched" if trip is None else f"latched is {trip.text}"
                raise DeviceError(f"trip {number} cannot be acknowledged: {latched}")
            changes = {"number": number, "latched": None, "press": mark}
            self._write(state.model_copy(update=changes))
            with self._state_lock:
                newest = self.trip
                if newest == trip:
                    self._state = self._state.model_copy(update=changes)
                    if self._mark == mark:
                        self._new_press = ""
                    return
        change = "it was acknowledged" if newest is None else f"a trip came: {newest.text}"
        raise DeviceError(f"trip {number} cannot be acknowledged: meanwhile {change}")

    @property
    def left_lit(self) -> bool:
        """Whether a program has lit the laser and has not confirmed since that the light is off."""
        return self._state.lit

    def note_light(self, is_on: bool) -> None:
        """Note that the light is on, or certainly off again; raises DeviceError if that cannot be written.

        X        must stay dark. "On" remains in the file of a program that was killed.
        """
        if is_on or is_on != self._state.lit:
            with self._file_lock:
                self._write(self._state.model_copy(update={"lit": is_on}))
                self._change(lit=is_on)

    def retry_write(self) -> None:
        """Write the state again if that failed before, or if the file was deleted. Raises nothing."""
        if self.path is not None and (self.problem or not self.path.exists()):
            with suppress(DeviceError):
                self._write_state()

    def _change(self, **changes: object) -> None:
        """Change the state in memory, where it holds from now on."""
        with self._state_lock:
            self._state = self._state.model_copy(update=changes)

    def _write_state(self) -> None:
        """Write the state as it is in memory; DeviceError where that fails."""
        with self._file_lock:
            self._write(self._state)

    def _write_in_time(self) -> None:
        """Write the state, in a thread; DeviceError where that fails, or has not ended after 0.2 s."""
        if self.path is None:
            return

        def write() -> None:
            try:
                self._write_state()
            except DeviceError:
                if self.presses is not None:
                    with suppress(OSError):
                        self.presses.touch()
                raise

        future = run_in_thread(write)
        self._pending_writes.add(future)
        future.add_done_callback(self._pending_writes.discard)
        try:
            future.result(_MAX_TRIP_WRITE_S)
        except TimeoutError:
            self.problem = f"{self.path}: the rig's state is not written yet: the disk hangs"
            raise DeviceError(self.problem) from None

    def _write(self, state: _SafetyFile) -> None:
        if self.path is not None:
            try:
                # the folder may have been removed meanwhile
                self.path.parent.mkdir(parents=True, exist_ok=True)
                atomic_write.replace(self.path, state.model_dump_json(indent=1).encode())
            except OSError as error:
                self.problem = f"{self.path}: the rig's state cannot be written: {error.strerror or error}"
                raise DeviceError(self.problem) from None
        self.problem = ""

    def _lock(self, path: Path) -> None:
        if fcntl is None:
            self.read()
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # never through a symbolic link, which could name any file
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
            lock_file = os.fdopen(os.open(path.with_suffix(".lock"), flags, 0o666), "r+b")
        except OSError as error:
            raise DeviceError(f"{path}: the rig's state cannot be held: {error.strerror or error}") from None
        try:
            fcntl.flock(lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = lock_file.read(200).decode(errors="replace").partition("\n")[0] or "another program"
            lock_file.close()
            raise DeviceError(f"the rig's devices are in use by {holder}: end it first") from None
        except OSError as error:
            lock_file.close()
            raise DeviceError(
                f"{path.with_suffix('.lock')}: cannot be locked: {error.strerror or error}; another program "
                "could light the laser: let XDG_STATE_HOME name a folder on a local disk"
            ) from None
        self.read()
        with suppress(DeviceError):
            # the file is written before the lock, so that a missing file later means a deleted one
            self._write_state()
        lock_file.truncate(0)
        lock_file.write(f"process {os.getpid()}{self._holder_text and f' ({self._holder_text})'}".encode())
        lock_file.flush()
        self._lock_file = lock_file
