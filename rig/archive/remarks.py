"""`rig archive tag` and `note`: what people say of runs. It follows from no record."""

import contextlib
import datetime
import getpass
import json
import platform
import secrets
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError
from rig.archive.proved import changed, has_line, read_file, with_line, without_line

_FOLDER = "remarks"


@dataclass(frozen=True)
class _Remark:
    """One command: tags added to and removed from runs (by the SHA-256 of their records), or a note.

    `turn` is larger than that of every remark that its writer knew: remarks hold in this order, whatever the
    clocks say. Those of earlier versions have none, and go before all others by their time.
    """

    utc: datetime.datetime
    runs: tuple[str, ...]
    turn: int = 0
    user: str = ""
    computer: str = ""
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
        turn=1 + max((remark.turn for _, remark in _remarks(archive)), default=0),
        user=user_name(),
        computer=platform.node(),
        runs=tuple(runs),
        add=(add,) if add else (),
        remove=(remove,) if remove else (),
        note=note,
    )
    path = archive / _FOLDER / f"{now:%Y%m%dT%H%M%S.%f}-{secrets.token_hex(4)}.json"
    text = json.dumps({**asdict(remark), "utc": now.isoformat()}, indent=1)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        whole_file.take_away_leftovers(path.parent)
        whole_file.write_new(path, with_line(text.encode()))
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
        remark = _understood(json.loads(without_line(path, data) if has_line(data) else data))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordError(
            f"{path}: cannot be read: {error!r}; it was damaged, take it from a backup"
        ) from None
    if remark.turn and not has_line(data):
        raise changed(path)
    return remark


def _understood(tree: Any) -> _Remark:
    # pydantic takes longer to import than a list of 100,000 runs takes to be read
    utc = datetime.datetime.fromisoformat(tree["utc"])
    if utc.tzinfo is None:
        raise ValueError(f"{utc} states no time zone")
    return _Remark(
        utc,
        runs=tuple(map(_text, tree["runs"])),
        turn=int(tree.get("turn", 0)),
        user=_text(tree.get("user", "")),
        computer=_text(tree.get("computer", "")),
        add=tuple(map(_text, tree.get("add", ()))),
        remove=tuple(map(_text, tree.get("remove", ()))),
        note=_text(tree.get("note", "")),
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value


def user_name() -> str:
    """Who runs the program; empty where the system does not say."""
    with contextlib.suppress(OSError, KeyError, ImportError):
        return getpass.getuser()
    return ""
