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
from rig.archive.proved import changed, has_line, read_file, with_line, without_line

_FOLDER = "remarks"


class _Remark(BaseModel, frozen=True):
    """One command: tags added to and removed from runs (by the SHA-256 of their records), or a note.

    `turn` is larger than that of every remark that its writer knew: remarks hold in this order, whatever the
    clocks say. Those of earlier versions have none, and go before all others by their time.
    """

    utc: AwareDatetime
    turn: int = 0
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
        raise ConfigurationError("the text is empty; name a tag or write a note")
    if not runs:
        raise ConfigurationError("no run is meant: name one, or state a condition that one meets")
    now = datetime.datetime.now(datetime.UTC)
    remark = _Remark(
        utc=now,
        turn=1 + max((remark.turn for _, remark in _remarks(archive)), default=0),
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
        whole_file.take_away_leftovers(path.parent)
        whole_file.write_new(path, with_line(json.dumps(remark.model_dump(mode="json"), indent=1).encode()))
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None


def read_remarks(archive: Path) -> RunRemarks:
    """What was said, in order. Raises RecordError for a file that cannot be understood, or has changed."""
    tags: dict[str, set[str]] = {}
    notes: dict[str, list[str]] = {}
    for _, remark in sorted(_remarks(archive), key=lambda item: (item[1].turn, item[1].utc, item[0])):
        for run in remark.runs:
            tags[run] = (tags.get(run, set()) | set(remark.add)) - set(remark.remove)
            said = notes.setdefault(run, [])
            if remark.note:
                said.append(f"{remark.utc:%Y-%m-%d} {remark.user}: {remark.note}")
    return RunRemarks(list(tags), [sorted(found) for found in tags.values()], [notes[run] for run in tags])


def _remarks(archive: Path) -> list[tuple[str, _Remark]]:
    return [(path.name, _read(path)) for path in (archive / _FOLDER).glob("[!.]*.json")]


def _read(path: Path) -> _Remark:
    data = read_file(path)
    try:
        remark = _Remark.model_validate_json(without_line(path, data) if has_line(data) else data)
    except ValidationError as error:
        raise RecordError(
            f"{path}: cannot be read: {str(error).splitlines()[0]}; it was damaged, take it from a backup"
        ) from None
    if remark.turn and not has_line(data):
        raise changed(path)
    return remark


def user_name() -> str:
    """Who runs the program; empty where the system does not say."""
    with contextlib.suppress(OSError, KeyError, ImportError):
        return getpass.getuser()
    return ""
