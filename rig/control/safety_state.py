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

from acquisition.record import whole_file
from processing.errors import DeviceError
from rig.control.lasers import LaserSettings
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


class _Latched(BaseModel, frozen=True, extra="forbid"):
    cause: TripCause
    why: str
    lit: bool


class _LogEnd(BaseModel, frozen=True, extra="forbid"):
    """The last line of an audit log."""

    lines: int
    digest: str


class _Stored(BaseModel, frozen=True, extra="forbid"):
    """The file: the last number given, what is latched, whether light was on that outlives a program."""

    schema_number: int = _SCHEMA
    number: int = 0
    latched: _Latched | None = None
    lit: bool = False
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


def _unknown(what: str) -> _Stored:
    why = f"{what}, so the latched trip is unknown"
    return _Stored(number=1, latched=_Latched(cause=TripCause.POWER, why=why, lit=True))


def _device_at(port: str) -> str:
    # imported here: looking for ports is no part of reading a latch
    from serial.tools import list_ports

    for found in list_ports.comports():
        if found.device == port and found.serial_number:
            return f"{found.vid:04x} {found.pid:04x} {found.serial_number}"
    return ""


class SafetyState:
    """The latch of a rig, in its file (None: in memory); a context manager that holds it for one program.

    `trip` may be read, and `latch` called, from any thread. A file that cannot be read, or was deleted,
    counts as latched.
    """

    def __init__(self, path: Path | None = None, who: str = "") -> None:
        self.path = path
        self._who = who
        self._stored = _Stored()
        self._changing = threading.Lock()
        self._held: IO[bytes] | None = None

    def __enter__(self) -> Self:
        if self.path is not None:
            self._hold(self.path)
        return self

    def __exit__(self, *_error: object) -> None:
        if self._held is not None:
            self._held.close()
            self._held = None

    def held_for(self, folder: Path) -> None:
        """Tell others in which folder whoever holds it can be asked."""
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
        """Read the file; also without holding it, to show it. One that was there, and is gone, is latched."""
        if self.path is None:
            return
        try:
            stored = _Stored.model_validate_json(self.path.read_bytes())
        except FileNotFoundError:
            was_there = self._is_noted(self.path.with_suffix(".lock"))
            self._stored = _unknown(f"{self.path} is gone") if was_there else _Stored()
        except (OSError, ValidationError):
            self._stored = _unknown(f"{self.path} cannot be read")
        else:
            of_another = f"{self.path} is of schema {stored.schema_number}, and schema {_SCHEMA} is read"
            self._stored = stored if stored.schema_number == _SCHEMA else _unknown(of_another)

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
            return None
        return LatchedTrip(stored.number, stored.latched.cause, stored.latched.why, stored.latched.lit)

    def latch(self, cause: TripCause, why: str, lit: bool) -> LatchedTrip:
        """Latch a cause; the number grows, also where another one is latched already.

        It holds from now on even where the file cannot be written, of which DeviceError tells.
        """
        latched = _Latched(cause=cause, why=why, lit=lit)
        number = self._stored.number + 1
        self._put(number=number, latched=latched)
        return LatchedTrip(number, cause, why, lit)

    def acknowledge(self, number: int) -> None:
        """Clear the trip of this number; raises DeviceError for another one, or where it cannot be kept."""
        trip = self.trip
        if trip is None or trip.number != number:
            latched = "nothing is latched" if trip is None else f"latched is {trip.text}"
            raise DeviceError(f"trip {number} cannot be acknowledged: {latched}")
        self._put(proven=True, latched=None)

    @property
    def left_lit(self) -> bool:
        """Whether a program that lit was ended, or is, without having darkened."""
        return self._stored.lit

    def lit(self, lit: bool) -> None:
        """Note that light is on which a killed program would leave on; raises DeviceError if it cannot be."""
        if lit != self._stored.lit:
            self._put(proven=True, lit=lit)

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
                    whole_file.replace(self.path, stored.model_dump_json(indent=1).encode())
                except OSError as error:
                    raise DeviceError(
                        f"{self.path}: the rig's state cannot be written: {error.strerror or error}"
                    ) from None
            self._stored = stored

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
