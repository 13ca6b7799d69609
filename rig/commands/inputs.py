"""What commands are given to read: what is not there is refused before anything heavy is imported.

`there`, `recorded` and `with_results` are callbacks of parameters, for one path or several; they return what
they got, or raise ConfigurationError.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, TypeVar

import typer

from acquisition.record import records_in, records_of
from processing.errors import ConfigurationError

_Given = TypeVar("_Given", Path, list[Path], Path | None, list[Path] | None)
_KINDS = {"": "file or folder", ".mcap": "record", ".toml": "file", ".rrd": "Rerun file"}
_MOST_NAMED = 5


def there(given: _Given) -> _Given:
    """For files and folders that must be there; whether they are what is wanted, their readers say."""
    for path in _paths(given):
        try:
            path.stat()
        except (FileNotFoundError, NotADirectoryError):
            kind = _KINDS.get(path.suffix.lower(), "file")
            raise ConfigurationError(f"{path}: no such {kind}{_instead_of(path)}") from None
        except (OSError, ValueError):
            continue  # not to be seen, or no name at all: the reader's own words are better
    return given


_OF_RECORDS = {
    "balance": "rig view {} --layout balancing shows its balance",
    "run": "rig replay {0} processes it again, rig fit {0} fits it",
    "desk": "rig view {} shows it",
}


def configuration(ctx: typer.Context, given: _Given) -> _Given:
    """The same, for a configuration; a record, or its folder, is taken by other commands."""
    for path in _paths(there(given)):
        if path.suffix.lower() == ".mcap" or (path.is_dir() and any(path.glob("*.mcap"))):
            kind = "is a folder with records" if path.is_dir() else "is a record"
            instead = _OF_RECORDS.get(ctx.command.name or "", "rig record info {} says how it was made")
            if path.is_dir() and ctx.command.name == "run":
                instead = "rig run --resume {} continues its session"
            raise ConfigurationError(
                f"{path}: {kind}, and a configuration (TOML file) is wanted; {instead.format(path)}"
            )
    return given


def recorded(given: _Given) -> _Given:
    """The same, for records and folders that must hold one."""
    for path in _paths(there(given)):
        records_in(path)
    return given


def to_be_fitted(given: _Given) -> _Given:
    """The same, for what `rig fit` takes: records, a table, a film, folders of them."""
    for path in _paths(there(given)):
        if kind_of(path) == "records":
            records_in(path)
    return given


def kind_of(path: Path) -> Literal["records", "table", "film"]:
    """What a file or folder is to `rig fit`, by its name and, of an array, by its dimensions.

    A folder without records, images or films counts as one of records, of which none is there.
    """
    suffix = path.suffix.lower()
    if suffix in (".mcap", ".csv", ".txt", ".toml", ".json"):
        return "records" if suffix == ".mcap" else "table"
    if path.is_dir() and (records_of(path) or any(path.glob("results*.json"))):
        return "records"
    # the readers of films take a second
    from rig.intake import is_filmed

    if path.is_dir():
        return "film" if is_filmed(path) else "records"
    return "film" if is_filmed(path) else "table"


def recorded_or_fitted(given: _Given) -> _Given:
    """The same; a folder, or results.json, that rig fit made of a table or a film, is taken too."""
    for path in _paths(there(given)):
        if not is_of_table(path):
            records_in(path)
    return given


def is_of_table(path: Path) -> bool:
    """Whether it is what rig fit leaves of a table or a film, beside which there is no record."""
    folder = path if path.is_dir() else path.parent
    return (
        (path.is_dir() or path.suffix.lower() == ".json")
        and not any(folder.glob("*.mcap"))
        and any(folder.glob("results*.json"))
    )


def with_results(given: _Given) -> _Given:
    """The same, for folders of sessions, or of several, which must hold results, and for files."""
    for path in _paths(there(given)):
        # the folder of a list has those of its sessions
        if path.is_dir() and not (any(path.glob("results*.json")) or any(path.glob("*/results*.json"))):
            raise ConfigurationError(
                f"{path}: holds no results.json; rig run makes one, and rig fit from records"
            )
        if any(path.glob("results-*.json")):
            from rig.analysis import results_path
            from rig.presentation import say

            newest = results_path(path)
            say(f"{path}: {newest.name}, the newest of its results, is taken; name others to take them")
    return given


def one_record(path: Path) -> Path:
    """The record itself, or the only one of a folder; raises ConfigurationError for none or several."""
    records = records_in(path)
    if len(records) > 1:
        names = ", ".join(record.name for record in records)
        raise ConfigurationError(f"{path}: holds {len(records)} records; name one of them: {names}")
    return records[0]


def _paths(given: Path | list[Path] | None) -> Sequence[Path]:
    return given if isinstance(given, list) else [] if given is None else [given]


def _instead_of(path: Path) -> str:
    """What the folder of a missing file has of its kind, and how such a file is made."""
    how = {
        "": "; put a name with spaces in quotes",
        ".toml": "; rig init writes a configuration",
    }.get(path.suffix.lower(), "")
    if path.suffix.lower() == ".toml":
        from rig.settings import shipped_names

        if path.stem in shipped_names():
            how = f"; rig init --example {path.stem} writes {path.name} here"
    if not path.parent.is_dir():
        return f"; there is no folder {path.parent}{how}"
    try:
        beside = [o for o in path.parent.iterdir() if o.suffix == path.suffix and o.name != "pyproject.toml"]
    except OSError:
        return how
    names = sorted(other.name for other in beside if path.suffix or other.is_dir())
    shown = ", ".join([*names[:_MOST_NAMED], *(["..."] if len(names) > _MOST_NAMED else [])])
    return (f"; {path.parent} has {shown}" if names else "") + how
