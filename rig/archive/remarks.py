"""`rig archive tag` and `note`: what people say of runs. It follows from no record."""

import contextlib
import datetime
import getpass
import json
import platform
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError

if TYPE_CHECKING:
    from rig.archive.remark_file import Remark

_FOLDER = "remarks"


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
    # takes as long to import as `list` needs for its work
    from rig.archive.remark_file import Remark

    add, remove, note = add.strip(), remove.strip(), note.strip()
    if not (add or remove or note):
        raise ConfigurationError("an empty text says nothing of a run; name a tag or write a note")
    if not runs:
        raise ConfigurationError("no run is meant: name one, or state a condition that one meets")
    user = ""
    with contextlib.suppress(OSError, KeyError, ImportError):
        user = getpass.getuser()
    now = datetime.datetime.now(datetime.UTC)
    remark = Remark(
        utc=now,
        user=user,
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


def _read(path: Path) -> "Remark":
    from rig.archive.remark_file import read_remark

    return read_remark(path)
