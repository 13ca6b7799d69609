"""The file `session.json`: which runs of a session were made, how each ended, which are missing."""

import datetime
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from enum import StrEnum
from pathlib import Path
from typing import IO, Any, Self

from pydantic import BaseModel

from acquisition import atomic_write
from acquisition.record import recovery_path
from acquisition.record.check import recover
from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError, RecordError, RigError, require_schema
from rig.terminal import say

try:
    import fcntl
except ImportError:  # pragma: no cover
    # no file locks on this system; two sessions in one folder are then not prevented
    fcntl = None  # type: ignore[assignment]

STATE_NAME = "session.json"
LOCK_NAME = ".session.lock"
_SCHEMA = 1


class RunState(StrEnum):
    """State of a run, or of one attempt at its start."""

    RECORDING = "recording"
    COMPLETE = "complete"
    STOPPED = "stopped"
    """Ended early by a person, or because the program had to end."""
    REJECTED = "rejected"
    """Its start was not accepted, or its conditions were not met."""
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    """The program was killed."""


class RunEntry(BaseModel, frozen=True, extra="forbid"):
    """One run or attempt."""

    number: int
    record: str
    """File name of its record."""
    state: RunState
    reason: str = ""
    """Why it ended."""
    begun_utc: str = ""
    ended_utc: str = ""
    """Empty while it is being recorded."""
    recovered: str = ""
    """File name of the recovered copy of a truncated record; empty without one."""


class SessionState(BaseModel, frozen=True, extra="forbid"):
    """The contents of `session.json`."""

    schema_version: int = _SCHEMA
    source: str
    runs_wanted: int
    configuration: dict[str, Any]
    """The complete configuration, so that the session can be resumed without other files."""
    entries: tuple[RunEntry, ...] = ()

    @property
    def complete(self) -> list[RunEntry]:
        return [entry for entry in self.entries if entry.state is RunState.COMPLETE]

    @property
    def next_number(self) -> int:
        return 1 + max((entry.number for entry in self.entries), default=0)


def read_session(folder: Path) -> SessionState:
    """The session in a folder, running or ended; raises ConfigurationError if there is none."""
    path = folder / STATE_NAME
    if folder.is_file():
        raise ConfigurationError(f"{folder}: is a file; name the folder of a session")
    try:
        tree = json.loads(path.read_bytes())
        if isinstance(tree, dict):
            require_schema(str(path), tree.get("schema_version"), _SCHEMA, ConfigurationError)
        return SessionState.model_validate(tree)
    except FileNotFoundError:
        raise ConfigurationError(
            f"{folder}: contains no session to resume ({STATE_NAME} is missing)"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None


def is_in_use(folder: Path) -> bool:
    """Whether a program has the session of a folder open: it measures, or fits what it has measured."""
    if fcntl is None:
        return False
    with suppress(OSError), (folder / LOCK_NAME).open("rb") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def withdraw_unrecorded(folder: Path, created: Sequence[Path] = ()) -> None:
    """Remove the files of a session that has ended without a record, which would block the next session.

    The folders `created` for it are removed, too, if they are empty. A session with a record stays.
    """
    with suppress(RigError), closing(SessionFile.opened(folder)) as file:
        records = [folder / entry.record for entry in file.state.entries]
        if any(record.exists() for record in records):
            return
        for name in (STATE_NAME, LOCK_NAME):
            (folder / name).unlink(missing_ok=True)
    with suppress(OSError):
        for path in created:
            path.rmdir()


class SessionFile:
    """`session.json` of one folder: locked while the session runs, replaced as a whole at each change."""

    def __init__(self, folder: Path, state: SessionState) -> None:
        self.folder = folder
        self.state = state
        self._lock: IO[bytes] | None = None

    @classmethod
    def create(cls, folder: Path, source: Path, runs: int, configuration: dict[str, Any]) -> Self:
        """Create the file of a new session; raises ConfigurationError if the folder holds one already."""
        if os.path.lexists(folder / STATE_NAME):
            raise ConfigurationError(
                f"{folder}: already holds a session; rig run --resume {folder} continues it, "
                "or name another folder"
            )
        file = cls(folder, SessionState(source=str(source), runs_wanted=runs, configuration=configuration))
        file._take_lock()
        file.save(file.state)
        return file

    @classmethod
    def opened(cls, folder: Path) -> Self:
        """Open the file of an earlier session; raises ConfigurationError if it is missing or still in use."""
        file = cls(folder, read_session(folder))
        file._take_lock()
        return file

    @property
    def complete_records(self) -> list[Path]:
        """Paths of the records of the complete runs."""
        return [self.folder / entry.record for entry in self.state.complete]

    def note(self, number: int, record: str, state: RunState, reason: str = "", recovered: str = "") -> None:
        """Save the state of a run."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        begun = next((entry.begun_utc for entry in self.state.entries if entry.record == record), now)
        # the time of day may have been set back meanwhile
        ended = "" if state == RunState.RECORDING else max(now, begun)
        entry = RunEntry(
            number=number,
            record=record,
            state=state,
            reason=reason,
            begun_utc=begun,
            ended_utc=ended,
            recovered=recovered,
        )
        self._replace(record, entry)

    def forget(self, record: str) -> None:
        """Remove the entry of a run that did not begin."""
        self._replace(record)

    def _replace(self, record: str, *new_entries: RunEntry) -> None:
        others = [entry for entry in self.state.entries if entry.record != record]
        self.save(self.state.model_copy(update={"entries": (*others, *new_entries)}))

    def reconfigure(self, source: Path, configuration: dict[str, Any]) -> str:
        """Give the missing runs another configuration; returns what it changes, in words.

        Complete runs have their own configuration in their records.
        """
        changed = "; ".join(_changes(self.state.configuration, configuration))
        self.save(self.state.model_copy(update={"source": str(source), "configuration": configuration}))
        return changed or "nothing else"

    def save(self, state: SessionState) -> None:
        """Replace the file atomically, so that a power failure leaves either the old or the new file."""
        path = self.folder / STATE_NAME
        try:
            atomic_write.replace(path, json.dumps(state.model_dump(mode="json"), indent=1).encode())
        except OSError as error:
            raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None
        self.state = state

    def close(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _take_lock(self) -> None:
        if fcntl is None:
            return
        path = self.folder / LOCK_NAME
        try:
            # not through a symbolic link, which could name any file
            lock = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+b")
        except OSError as error:
            raise ConfigurationError(f"{path}: cannot be opened: {error.strerror or error}") from None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise ConfigurationError(
                f"{self.folder}: its session is still running; stop it first, or name another folder"
            ) from None
        except OSError as error:
            lock.close()
            raise ConfigurationError(
                f"{path}: cannot be locked: {error.strerror or error}; another program could write the same "
                "session: name a folder on another disk"
            ) from None
        self._lock = lock


def _changes(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Each changed key of a configuration tree with its new and old value, in words."""
    for key in sorted(old.keys() | new.keys()):
        old_value, new_value = old.get(key), new.get(key)
        if isinstance(old_value, Mapping) and isinstance(new_value, Mapping):
            yield from _changes(old_value, new_value, f"{prefix}{key}.")
        elif old_value != new_value:
            yield f"{prefix}{key} = {json.dumps(new_value)} (was {json.dumps(old_value)})"


_STATE_OF_END: dict[str, RunState] = {
    EventKind.REJECTED: RunState.REJECTED,
    EventKind.ENDED_EARLY: RunState.STOPPED,
    EventKind.FAILED: RunState.FAILED,
}


def note_recorded_end(file: SessionFile, entry: RunEntry) -> str:
    """Save how a run, whose entry says that it is being recorded, has ended by its record.

    Returns the end in words; empty, and nothing is saved, if the run has no record or a truncated one.
    """
    record = file.folder / entry.record
    if not record.exists():
        return ""
    with suppress(RecordError), RecordReader(record) as reader:
        end = end_of(reader.events())
        if end is not None and not reader.truncated:
            state = _STATE_OF_END.get(end.kind, RunState.COMPLETE)
            file.note(entry.number, entry.record, state, end.text)
            condition = "whole" if state is RunState.COMPLETE else f"{state}, its run is made again"
            return f"{entry.record} is {condition}: {end.text}"
    return ""


def close_earlier_runs(file: SessionFile) -> None:
    """Save how the runs of a killed program have ended, and report truncated records."""
    for entry in file.state.entries:
        if entry.state is RunState.RECORDING:
            _close_interrupted(file, entry)
    for record in file.complete_records:
        if record.exists():
            # complete at the end of its run, but truncated since, e.g. by a failed copy
            with RecordReader(record) as reader:
                if reader.truncated:
                    say(reader.cut_notice)
    say(f"{file.folder}: {len(file.state.complete)} of {file.state.runs_wanted} runs are complete")


def _close_interrupted(file: SessionFile, entry: RunEntry) -> None:
    """Save how a run that was being recorded has ended; make a recovered copy of a truncated record."""
    record = file.folder / entry.record
    if end_text := note_recorded_end(file, entry):
        say(end_text)
        return
    recovered, reason = "", "the session was interrupted"
    if record.exists():
        try:
            copy = recovery_path(record)
            if not copy.exists():
                recover(record, copy)
            recovered = copy.name
            say(f"{entry.record} was cut short and stays as it is; {copy.name} is a whole copy")
        except RecordError as error:
            reason = f"{reason}; {error}"
    file.note(entry.number, entry.record, RunState.INTERRUPTED, reason, recovered)
