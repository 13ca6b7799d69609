"""The log of an archive: which computer saw which folder hold which state, numbered, never changed.

A file holds facts of one `rig archive add`. The files of a computer are numbered without gaps, each states
the hash of the one before, and its turn is larger than that of every fact that its writer knew. The present
state of a folder is its last fact, by turn, then by the computer's name. Clocks decide nothing.
"""

import datetime
import json
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from acquisition.record import whole_file
from processing.errors import RecordError
from rig.archive.proved import read_file, sha256_hex, with_line, without_line
from rig.archive.remarks import user_name

FOLDER = "facts"
_SUFFIX = ".facts"
_NAME = re.compile(r"(.+)-(\d{8})\.facts")
_SCHEMA = 1


class Fact(NamedTuple):
    """A computer saw a folder hold the state that a file of `sessions/` describes.

    `files` says by which names, sizes and times it is known again; empty where nothing does. `seen_utc` is
    what the computer's clock said.
    """

    computer: str
    folder: str
    version: str
    sha256: str
    files: str
    seen_utc: str


class Entry(NamedTuple):
    """A file of the log."""

    name: str
    turn: int
    facts: Sequence[Fact]
    sha256: str
    before: str


class FactLog:
    """The log of one archive, as far as this process knows it."""

    def __init__(self, archive: Path) -> None:
        self.folder = archive / FOLDER
        self._read: dict[str, Entry] = {}

    def names(self) -> set[str]:
        """Names of all files. Raises RecordError where one is missing among them."""
        try:
            names = {path.name for path in self.folder.iterdir() if _NAME.fullmatch(path.name)}
        except FileNotFoundError:
            return set()
        except OSError as error:
            raise RecordError(f"{self.folder}: cannot be read: {error.strerror or error}") from None
        for computer, last in newest_numbers(names).items():
            for number in range(1, last):
                if (missing := file_name(computer, number)) not in names:
                    raise RecordError(
                        f"{self.folder / missing}: is missing; restore it from a copy of the archive"
                    )
        return names

    def entry(self, name: str) -> Entry:
        """One file. Raises RecordError where it is not as it was written."""
        if name not in self._read:
            self._read[name] = _parsed(self.folder / name)
        return self._read[name]

    def entries(self, names: Iterable[str]) -> list[Entry]:
        """Files in the order in which their facts hold."""
        return sorted((self.entry(name) for name in names), key=lambda entry: (entry.turn, entry.name))

    def write(self, facts: Sequence[Fact], *, above: int = 0) -> str:
        """Add a file with facts, after all that are there and after the turn `above`; returns its name."""
        computer = _as_file_name(platform.node())
        while True:
            names = self.names()
            number = newest_numbers(names).get(computer, 0) + 1
            before = self.entry(file_name(computer, number - 1)).sha256 if number > 1 else ""
            turn = 1 + max([above, *(self.entry(name).turn for name in self._latest(names))])
            name = file_name(computer, number)
            head = {
                "schema": _SCHEMA,
                "name": name,
                "turn": turn,
                "before": before,
                "utc": datetime.datetime.now(datetime.UTC).isoformat(),
                "user": user_name(),
            }
            lines = [json.dumps(head), *(json.dumps(list(fact)) for fact in facts)]
            data = with_line("\n".join(lines).encode())
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                whole_file.write_new(self.folder / name, data)
            except FileExistsError:
                # somebody else was faster: what he saw comes before
                continue
            except OSError as error:
                raise RecordError(f"{self.folder}: cannot be written: {error.strerror or error}") from None
            return name

    def _latest(self, names: set[str]) -> list[str]:
        """Of each computer its last file, whose turn is its largest."""
        return [file_name(computer, number) for computer, number in newest_numbers(names).items()]


def newest_numbers(names: Iterable[str]) -> dict[str, int]:
    """The largest number of each computer among names of files."""
    found: dict[str, int] = {}
    for name in names:
        parts = _NAME.fullmatch(name)
        if parts is not None:
            found[parts[1]] = max(found.get(parts[1], 0), int(parts[2]))
    return found


def covered(names: Iterable[str], numbers: Mapping[str, int]) -> set[str]:
    """Names of files whose numbers do not exceed those of their computers."""
    return {
        name
        for name in names
        if (parts := _NAME.fullmatch(name)) is not None and int(parts[2]) <= numbers.get(parts[1], 0)
    }


def file_name(computer: str, number: int) -> str:
    """Name of a computer's file of the log."""
    return f"{computer}-{number:08d}{_SUFFIX}"


def _as_file_name(computer: str) -> str:
    plain = re.sub(r"[^\w.-]", "_", computer, flags=re.ASCII).lstrip(".") or "computer"
    return plain if plain == computer else f"{plain}-{sha256_hex(computer.encode())[:8]}"


def _parsed(path: Path) -> Entry:
    data = read_file(path)
    lines = without_line(path, data).decode().split("\n")
    try:
        head = json.loads(lines[0])
        if head["schema"] > _SCHEMA:
            raise RecordError(f"{path}: was written by a newer version; update optical-pendulum-rig")
        if head["name"] != path.name:
            raise RecordError(f"{path}: is {head['name']} under another name; take it from a backup")
        facts = [Fact(*json.loads(line)) for line in lines[1:]]
        return Entry(path.name, head["turn"], facts, sha256_hex(data), head["before"])
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise RecordError(f"{path}: cannot be understood ({error!r}); take it from a backup") from None
