"""What a desk keeps on disk for its user: keys, port, who acts, what was typed; and its lock."""

import contextlib
import hashlib
import json
import secrets
import threading
from pathlib import Path
from typing import IO, Any

from pydantic import BaseModel, Field, ValidationError

from acquisition.record import whole_file
from processing.errors import ConfigurationError
from rig.control import state_folder

try:
    import fcntl
except ImportError:  # pragma: no cover
    # no file locks on this system; two desks of a configuration are then not prevented
    fcntl = None  # type: ignore[assignment]

_MOST_TYPED = 20_000
_LAST_USED = 12
_WRITE_S = 0.5
_ALARMS = "alarms.json"


class _Stored(BaseModel, extra="ignore"):
    key: str = Field(default_factory=lambda: secrets.token_urlsafe(24))
    watch_key: str = Field(default_factory=lambda: secrets.token_urlsafe(24))
    port: int = 0
    acting: str = ""


class Kept:
    """Of one configuration. Where its folder cannot be written it is in memory, as long as the desk lives."""

    def __init__(self, source: Path) -> None:
        source = source.resolve()
        digest = hashlib.sha256(str(source).encode()).hexdigest()[:12]
        self._folder = state_folder() / "desks" / f"{source.stem}-{digest}"
        self._source = source
        self._lock: IO[str] | None = None
        self._of_output: IO[str] | None = None
        self._writing = threading.Lock()
        self._in_memory: dict[str, bytes] = {}
        self._typed: dict[str, dict[str, str]] = {}
        self._changed: set[str] = set()
        self._ended = threading.Event()
        self._stored = _Stored()

    def hold(self, output: Path) -> None:
        """Be the only desk of this configuration, and of the folder where its sessions are.

        Raises ConfigurationError where another one is: two would both act on one session.
        """
        where = output.resolve()
        digest = hashlib.sha256(str(where).encode()).hexdigest()[:12]
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            # nobody else reads what is in it
            self._folder.chmod(0o700)
            held = (self._folder / "lock").open("a+", encoding="utf-8")
            of_output = (self._folder.parent / f"sessions-{digest}.lock").open("a+", encoding="utf-8")
        except OSError:
            return
        if (other := _locked(held)) is not None:
            of_output.close()
            raise ConfigurationError(
                f"{self._source}: it already has an open desk: use {other or 'that'}, or end it first"
            )
        if (other := _locked(of_output)) is not None:
            held.close()
            raise ConfigurationError(
                f"session.output = {where}: the desk of another configuration has its sessions there: use "
                f"{other or 'that'}, or end it, or state another folder"
            )
        self._lock, self._of_output = held, of_output
        with contextlib.suppress(ValidationError):
            self._stored = _Stored.model_validate_json(self._read("desk.json") or b"{}")
        self._put()
        threading.Thread(target=self._write_typed, name="what is typed", daemon=True).start()

    def opened_at(self, address: str, port: int) -> None:
        """Tell the next desk where this one is, and take its port again the next time."""
        self._stored.port = port
        self._put()
        for held in (self._lock, self._of_output):
            if held is not None:
                held.truncate(0)
                held.write(address)
                held.flush()

    def close(self) -> None:
        """Let another desk in."""
        self._ended.set()
        self.write_typed()
        for held in (self._lock, self._of_output):
            if held is not None:
                held.truncate(0)
                held.close()
        self._lock = self._of_output = None

    @property
    def key(self) -> str:
        """The key of the address under which one may act."""
        return self._stored.key

    @property
    def watch_key(self) -> str:
        """That of the address under which one may watch only."""
        return self._stored.watch_key

    @property
    def port(self) -> int:
        """The port of the last desk; 0 if there was none."""
        return self._stored.port

    @property
    def acting(self) -> str:
        """The tab that acted last."""
        return self._stored.acting

    def note_acting(self, tab: str) -> None:
        """This tab acts now."""
        if tab != self._stored.acting:
            self._stored.acting = tab
            self._put()

    @property
    def alarms(self) -> bytes:
        """The list of alarms of the last desk, as `keep_alarms` was given it; empty if there was none."""
        return self._read(_ALARMS)

    def keep_alarms(self, listed: bytes) -> None:
        """Keep the list of alarms."""
        with self._writing:
            self._write(_ALARMS, listed)

    # -- what operators type -----------------------------------------------------

    def typed(self, operator: str) -> dict[str, str]:
        """What this operator has typed into fields, by the key of the field."""
        with self._writing:
            return dict(self._typed_of(operator))

    def type(self, operator: str, key: str, value: str) -> None:
        """Keep what was typed into a field; on the disk within a second."""
        with self._writing:
            self._typed_of(operator)[key] = value[:_MOST_TYPED]
            self._changed.add(operator)

    def write_typed(self) -> None:
        """Write what was typed since the last time."""
        with self._writing:
            for operator in tuple(self._changed):
                whole = {**self._of(operator), "typed": self._typed_of(operator)}
                self._write(_name(operator), json.dumps(whole).encode())
                self._changed.discard(operator)

    def has_written(self, operator: str) -> bool:
        """Whether all that this operator has typed is on the disk."""
        with self._writing:
            return operator not in self._changed

    def presets(self, operator: str) -> dict[str, dict[str, str]]:
        """The sets of values that this operator has used to start sessions, by a name, the last one first."""
        found = self._of(operator).get("presets")
        return found if isinstance(found, dict) else {}

    def use(self, operator: str, name: str, values: dict[str, str]) -> None:
        """Keep a set of values that was used."""
        with self._writing:
            whole = self._of(operator)
            others = {key: one for key, one in self.presets(operator).items() if key != name}
            presets = dict([(name, values), *others.items()][:_LAST_USED])
            self._write(_name(operator), json.dumps({**whole, "presets": presets}).encode())

    def _write_typed(self) -> None:
        while not self._ended.wait(_WRITE_S):
            self.write_typed()

    def _typed_of(self, operator: str) -> dict[str, str]:
        if operator not in self._typed:
            found = self._of(operator).get("typed")
            pairs = found.items() if isinstance(found, dict) else ()
            self._typed[operator] = {str(key): str(value) for key, value in pairs}
        return self._typed[operator]

    def _of(self, operator: str) -> dict[str, Any]:
        try:
            found = json.loads(self._read(_name(operator)) or b"{}")
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    def _put(self) -> None:
        self._write("desk.json", self._stored.model_dump_json(indent=1).encode())

    def _read(self, name: str) -> bytes:
        if self._lock is None:
            return self._in_memory.get(name, b"")
        try:
            return (self._folder / name).read_bytes()
        except OSError:
            return self._in_memory.get(name, b"")

    def _write(self, name: str, data: bytes) -> None:
        self._in_memory[name] = data
        if self._lock is None:
            return
        path = self._folder / name
        with contextlib.suppress(OSError):
            whole_file.replace(path, data)


def _locked(held: IO[str]) -> str | None:
    """Lock the file; what stands in it, and closes it, where another program has. None, too, where the disk
    knows no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        held.seek(0)
        said = held.read().strip()
        held.close()
        return said
    except OSError:
        return None
    return None


def _name(operator: str) -> str:
    return f"of-{hashlib.sha256(operator.encode()).hexdigest()[:16]}.json"
