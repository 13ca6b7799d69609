"""`rig archive tag` and `note`: what people say of runs. It follows from no record."""

import contextlib
import datetime
import getpass
import json
import platform
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pydantic import AwareDatetime, BaseModel, ValidationError

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError

_FOLDER = "remarks"


class _Remark(BaseModel, frozen=True):
    """One command: tags added to and removed from runs (by the SHA-256 of their records), or a note."""

    utc: AwareDatetime
    user: str = ""
    computer: str = ""
    runs: tuple[str, ...]
    add: tuple[str, ...] = ()
    remove: tuple[str, ...] = ()
    note: str = ""


class RunRemarks(NamedTuple):
    """All that was said of runs: for each in `runs` its tags, in order, and its notes, oldest first."""

    runs: list[str]
    tags: list[list[str]]
    notes: list[list[str]]


def write_remark(
    archive: Path, runs: Sequence[str], *, add: str = "", remove: str = "", note: str = ""
) -> None:
    """Write a remark as a file of its own.

    Raises ConfigurationError if it says nothing, or no run is named.
    """
    add, remove, note = add.strip(), remove.strip(), note.strip()
    if not (add or remove or note):
        raise ConfigurationError("an empty text says nothing of a run; name a tag or write a note")
    if not runs:
        raise ConfigurationError("no run is meant: name one, or state a condition that one meets")
    now = datetime.datetime.now(datetime.UTC)
    remark = _Remark(
        utc=now,
        user=user_name(),
        computer=platform.node(),
        runs=tuple(runs),
        add=(add,) if add else (),
        remove=(remove,) if remove else (),
        note=note,
    )
    path = archive / _FOLDER / f"{now:%Y%m%dT%H%M%S.%f}-{secrets.token_hex(4)}.json"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        whole_file.write_new(path, json.dumps(remark.model_dump(mode="json"), indent=1).encode())
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None


def read_remarks(archive: Path) -> RunRemarks:
    """What was said, in the order of its time. Raises RecordError for a file that cannot be understood."""
    tags: dict[str, set[str]] = {}
    notes: dict[str, list[str]] = {}
    remarks = [_read(path) for path in (archive / _FOLDER).glob("[!.]*.json")]
    for remark in sorted(remarks, key=lambda remark: remark.utc):
        for run in remark.runs:
            tags[run] = (tags.get(run, set()) | set(remark.add)) - set(remark.remove)
            said = notes.setdefault(run, [])
            if remark.note:
                said.append(f"{remark.utc:%Y-%m-%d} {remark.user}: {remark.note}")
    return RunRemarks(list(tags), [sorted(found) for found in tags.values()], [notes[run] for run in tags])


def _read(path: Path) -> _Remark:
    try:
        return _Remark.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise RecordError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None


def user_name() -> str:
    """Who runs the program; empty where the system does not say."""
    with contextlib.suppress(OSError, KeyError, ImportError):
        return getpass.getuser()
    return ""
