"""What a rig may not forget: that its light was darkened for a cause which nobody has acknowledged yet."""

import os
import re
import threading
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO, Self

from pydantic import BaseModel, ValidationError

from acquisition import atomic_write
from processing.errors import DeviceError
from rig.control.lasers import LaserSettings
from rig.control.presses import Presses
from rig.control.settings import ControllerSettings

try:
    import fcntl
except ImportError:  # pragma: no cover
    # no file locks on this system; the serial ports themselves are opened by one program at a time
    fcntl = None  # type: ignore[assignment]

_LOGS_KEPT = 200
_SCHEMA = 1


class TripCause(StrEnum):
    """Why the light was taken away until a person acknowledges it."""

    INTERLOCK = "INTERLOCK"
    OUTPUT = "OUTPUT"
    WATCHDOG = "WATCHDOG"
    POWER = "POWER"
    PERSON = "PERSON"
    """Somebody has pressed LIGHT OFF; no board has this cause."""


@dataclass(frozen=True, slots=True)
class LatchedTrip:
    """A trip that waits for its acknowledgement; `lit`: the laser was, or should have been, lit."""

    number: int
    cause: TripCause
    why: str
    lit: bool

    @property
    def text(self) -> str:
        """`trip 5 (INTERLOCK): the interlock of the laser opened`."""
        return f"trip {self.number} ({self.cause}): {self.why}"


class _LatchEntry(BaseModel, frozen=True, extra="forbid"):
    cause: TripCause
    why: str
    lit: bool


class _LogEnd(BaseModel, frozen=True, extra="forbid"):
    """The last line of an audit log."""

    lines: int
    digest: str


class _SafetyFile(BaseModel, frozen=True, extra="forbid"):
    """The file: the last number given, what is latched, whether a program had lit and has not confirmed dark.

    `press` is the mark of the last press of LIGHT OFF that was taken over.
    """

    schema_number: int = _SCHEMA
    number: int = 0
    latched: _LatchEntry | None = None
    lit: bool = False
    press: str = ""
    logs: dict[str, _LogEnd] = {}


def rig_state_path(laser: LaserSettings, controller: ControllerSettings) -> Path | None:
    """The file of the rig whose light comes from these devices; None where nothing real is lit.

    A simulated rig lives in one process, and so does its state. A port of USB is known by the device's serial
    number, under whatever name the system gives it.
    """
    if laser.kind == "none" or (laser.kind == "controller" and controller.kind != "serial"):
        return None
    port = controller.port if laser.kind == "controller" else laser.port
    if port.startswith("/"):
        port = str(Path(port).resolve())
    name = re.sub(r"[^A-Za-z0-9]+", "-", f"{laser.kind} {_device_at(port) or port}")
    return state_folder() / f"{name}.json"


def state_folder() -> Path:
    """Where this user's rigs keep what must outlive a program."""
    stated = os.environ.get("XDG_STATE_HOME") or os.environ.get("LOCALAPPDATA")
    place = Path(stated) if stated else Path.home() / ".local" / "state"
    return place / "optical-pendulum-rig"


_UNKNOWN = "so the latched trip is unknown"


def _unknown(why: str) -> _SafetyFile:
    return _SafetyFile(number=1, latched=_LatchEntry(cause=TripCause.POWER, why=why, lit=True))


def _device_at(port: str) -> str:
    # imported here: looking for ports is no part of reading a latch
    from serial.tools import list_ports

    for found in list_ports.comports():
        if found.device == port and found.serial_number:
            return f"{found.vid:04x} {found.pid:04x} {found.serial_number}"
    return ""


class SafetyState:
    """The latch of a rig, in its file (None: in memory); a context manager that holds it for one program.

    `trip` may be read, and `latch` called, from any thread. A file that cannot be read, or is not there,
    counts as latched: nobody can tell a new rig from one whose state was deleted. `presses` is the file
    beside it (None without one), `problem` why the state could not be written when it last should have been.
    """

    def __init__(self, path: Path | None = None, who: str = "") -> None:
        self.path = path
        self._who = who
        self._stored = _SafetyFile()
        self._changing, self._taking = threading.Lock(), threading.Lock()
        self._held: IO[bytes] | None = None
        self.presses = None if path is None else Presses(path.with_suffix(".off"))
        self._new_press = self._mark = ""
        self.problem = ""

    def __enter__(self) -> Self:
        if self.path is not None:
            self._hold(self.path)
        return self

    def __exit__(self, *_error: object) -> None:
        if self._held is not None:
            self._held.close()
            self._held = None

    def held_for(self, folder: Path) -> None:
        """Tell other programs in which folder the holder can be asked."""
        if self._held is not None:
            self._held.write(f"\n{folder.absolute()}".encode())
            self._held.flush()

    @property
    def folder_of_holder(self) -> Path | None:
        """The folder of the program that holds it, or held it last."""
        if self.path is None:
            return None
        try:
            _, _, folder = self.path.with_suffix(".lock").read_text("utf-8").partition("\n")
        except (OSError, ValueError):
            return None
        return Path(folder) if folder else None

    def read(self) -> None:
        """Read the file; also without holding it, to show it. One that is not there is latched."""
        if self.path is None:
            return
        try:
            stored = _SafetyFile.model_validate_json(self.path.read_bytes())
        except FileNotFoundError:
            was_there = self._is_noted(self.path.with_suffix(".lock"))
            new = f"nothing is known of its light: it is new here, or its state was deleted ({self.path})"
            self._stored = _unknown(f"{self.path} is gone, {_UNKNOWN}" if was_there else new)
        except (OSError, ValidationError):
            self._stored = _unknown(f"{self.path} cannot be read, {_UNKNOWN}")
        else:
            of_another = f"{self.path} is of schema {stored.schema_number}, and schema {_SCHEMA} is read"
            self._stored = stored if stored.schema_number == _SCHEMA else _unknown(of_another)
        self._look_for_press()

    def _look_for_press(self) -> None:
        """Note a press that was not taken over yet; an unreadable file is one that is not known."""
        if self.presses is None:
            return
        try:
            press = self.presses.newest()
        except DeviceError as error:
            # nothing to compare with: it counts as pressed for as long as it is so
            self._mark, self._new_press = f"unknown: {error}", str(error)
            return
        self._mark = press.mark
        self._new_press = "" if press.mark == self._stored.press else press.why

    def take_press(self, lit: bool) -> LatchedTrip | None:
        """Latch a press of LIGHT OFF that was not taken over yet; None without one.

        What is latched already stays as it is. Raises DeviceError, as `latch` does, where it holds but cannot
        be written.
        """
        with self._taking:
            self._look_for_press()
            why, mark, stored = self._new_press, self._mark, self._stored
            if not why or (stored.latched is not None and stored.press == mark):
                self._new_press = ""
                return None
            latched = stored.latched or _LatchEntry(cause=TripCause.PERSON, why=why, lit=lit)
            number = stored.number + (stored.latched is None)
            try:
                self._put(press=mark, number=number, latched=latched)
            finally:
                self._new_press = ""
            return self.trip

    @staticmethod
    def _is_noted(lock: Path) -> bool:
        """Whether a program has held the rig, which writes the state before it notes itself."""
        try:
            return lock.stat().st_size > 0
        except OSError:
            return False

    @property
    def trip(self) -> LatchedTrip | None:
        """What is latched."""
        stored = self._stored
        if stored.latched is None:
            if not (why := self._new_press):
                return None
            return LatchedTrip(stored.number + 1, TripCause.PERSON, why, stored.lit)
        return LatchedTrip(stored.number, stored.latched.cause, stored.latched.why, stored.latched.lit)

    def latch(self, cause: TripCause, why: str, lit: bool) -> LatchedTrip:
        """Latch a cause; the number grows, also where another one is latched already.

        It holds from now on even where the file cannot be written, of which DeviceError tells. Then it is
        left as a press for the next program, which needs no room on the disk, and `keep` tries again.
        """
        latched = _LatchEntry(cause=cause, why=why, lit=lit)
        number = self._stored.number + 1
        try:
            self._put(number=number, latched=latched)
        except DeviceError:
            if self.presses is not None:
                with suppress(OSError):
                    self.presses.touch()
            raise
        return LatchedTrip(number, cause, why, lit)

    def acknowledge(self, number: int) -> None:
        """Clear the trip of this number; raises DeviceError for another one, or where it cannot be kept."""
        trip = self.trip
        if trip is None or trip.number != number:
            latched = "nothing is latched" if trip is None else f"latched is {trip.text}"
            raise DeviceError(f"trip {number} cannot be acknowledged: {latched}")
        self._put(proven=True, number=number, latched=None, press=self._mark)
        self._new_press = ""

    @property
    def left_lit(self) -> bool:
        """Whether a program that lit was ended, or is, without having darkened."""
        return self._stored.lit

    def lit(self, lit: bool) -> None:
        """Note that light is on, or is off again for certain; raises DeviceError if that cannot be noted.

        That it is on is written each time: where nothing can be, a trip would be forgotten. A program that is
        killed, or whose last trip could not be written, leaves it noted.
        """
        if lit or lit != self._stored.lit:
            self._put(proven=True, lit=lit)

    def keep(self) -> None:
        """Write again what could not be written, or was deleted meanwhile. Raises nothing."""
        if self.path is not None and (self.problem or not self.path.exists()):
            with suppress(DeviceError):
                self._put()

    def note_log(self, log: Path, lines: int, digest: str) -> None:
        """Remember the end of an audit log, so that lines missing there are seen."""
        logs = {name: end for name, end in self._stored.logs.items() if name != str(log)}
        kept = dict([*logs.items(), (str(log), _LogEnd(lines=lines, digest=digest))][-_LOGS_KEPT:])
        self._put(logs=kept)

    def end_of_log(self, log: Path) -> tuple[int, str] | None:
        """Number of lines and digest of the last one, as noted; None if nothing was."""
        end = self._stored.logs.get(str(log))
        return None if end is None else (end.lines, end.digest)

    def _put(self, *, proven: bool = False, **changed: object) -> None:
        """Change and write it; what must be `proven` holds only once it is written."""
        with self._changing:
            stored = self._stored.model_copy(update=changed)
            if not proven:
                self._stored = stored
            if self.path is not None:
                try:
                    # somebody may have tidied up
                    self.path.parent.mkdir(parents=True, exist_ok=True)
                    atomic_write.replace(self.path, stored.model_dump_json(indent=1).encode())
                except OSError as error:
                    why = error.strerror or error
                    self.problem = f"{self.path}: the rig's state cannot be written: {why}"
                    raise DeviceError(self.problem) from None
            self._stored, self.problem = stored, ""

    def _hold(self, path: Path) -> None:
        if fcntl is None:
            self.read()
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # never through a symbolic link, which could name any file
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
            held = os.fdopen(os.open(path.with_suffix(".lock"), flags, 0o666), "r+b")
        except OSError as error:
            raise DeviceError(f"{path}: the rig's state cannot be held: {error.strerror or error}") from None
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            by = held.read(200).decode(errors="replace").partition("\n")[0] or "another program"
            held.close()
            raise DeviceError(f"the rig's devices are in use by {by}: end it first") from None
        except OSError as error:
            held.close()
            raise DeviceError(
                f"{path.with_suffix('.lock')}: cannot be locked: {error.strerror or error}; another program "
                "could light the laser: let XDG_STATE_HOME name a folder on a local disk"
            ) from None
        self.read()
        with suppress(DeviceError):
            # from now on a file that is missing was there
            self._put()
        held.truncate(0)
        held.write(f"process {os.getpid()}{self._who and f' ({self._who})'}".encode())
        held.flush()
        self._held = held
