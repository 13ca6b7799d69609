"""`rig archive add`: what folders hold now, as facts; each state of a session is a file of its own."""

import hashlib
import os
import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.record.whole_file import take_away_leftovers
from processing.errors import ConfigurationError, RecordError
from rig.archive.blind import sealed
from rig.archive.enclosing import enclosed_row, withheld
from rig.archive.facts import Fact
from rig.archive.shelf import MANY
from rig.archive.store import Archive, duckdb_module
from rig.presentation import say

_WRITTEN_EVERY_S = 2.0
"""So much of what was read is lost to a kill at most."""


def add_sessions(archive: Path, sources: Sequence[Path], *, read: bool = False) -> str:
    """Add what every session below the folders holds now; returns a line that counts them.

    A session whose files are as they were by name, size and time is not read, unless `read`. What is seen
    last is what is listed, also where it was seen before and something else in between. Flaws of records are
    said on stderr and listed as their `state`. A file .eln is unpacked into the folder of its name beside it.

    Raises ConfigurationError for a folder without sessions, and without DuckDB; RecordError, when all others
    are added, where a session's files cannot be read: it stays as it was.
    """
    # `list` needs none of it
    from rig.archive.eln import is_eln, unpacked

    duckdb_module()
    sources = [unpacked(source) if is_eln(source) and source.is_file() else source for source in sources]
    for source in sources:
        if not any(True for _ in session_folders(source, archive)):
            raise ConfigurationError(
                f"{source.resolve()}: holds no session (no record, no results.json) in any folder"
            )
    adding = _Adding(Archive(archive), read, platform.node())
    try:
        for source in {source.resolve(): source for source in sources}.values():
            for folder in session_folders(source, archive):
                adding.look(folder)
    finally:
        adding.write()
    adding.affirm()
    adding.store.merge()
    told = adding.told()
    if adding.unread:
        raise RecordError(
            f"{len(adding.unread)} sessions cannot be read and stay as they were, the first is "
            f"{adding.unread[0]}; {told}"
        )
    return told


@dataclass
class _Place:
    """What the archive says that a folder holds: the state, how its files are known again, its runs."""

    version: str
    sha256: str
    files: str
    runs: tuple[str, ...]


@dataclass
class _Adding:
    """One `add`: what the archive knew of this computer's folders, what was seen of them, in order."""

    store: Archive
    read: bool
    computer: str
    places: dict[str, _Place] = field(default_factory=dict)
    listed: dict[str, tuple[str, str]] = field(default_factory=dict)
    seen: list[str] = field(default_factory=list)
    waiting: list[Fact] = field(default_factory=list)
    unread: list[Path] = field(default_factory=list)
    added: int = 0
    runs: int = 0
    known: int = 0

    def __post_init__(self) -> None:
        self.store.begin()
        self._seal = sealed(self.store.folder)
        self._there = self.store.sessions.names()
        self._added_runs: set[str] = set()
        self._written_s = time.monotonic()
        self._written = self._merged = 0
        try:
            connection = self.store.connection(mending=True, within=True)
        except ConfigurationError:
            return
        question = (
            "select folder, any_value(version), any_value(file_sha256), coalesce(any_value(files), ''), "
            "list(sha256) from latest where computer = ? group by folder"
        )
        for folder, version, sha256, files, runs in connection.execute(question, [self.computer]).fetchall():
            self.places[folder] = _Place(version, sha256, files, tuple(runs))
        found = connection.execute("select sha256, computer, folder from open_runs").fetchall()
        self.listed = {sha256: (computer, folder) for sha256, computer, folder in found}
        known = {
            version for (version,) in connection.execute("select distinct version from versions").fetchall()
        }
        strays = [name for name in self.store.sessions.older() if name not in known]
        if strays:
            # an earlier version of the program has gone on adding: it is seen now
            self.store.log.write(self.store.sessions.facts_of_older(strays))
            self.__post_init__()

    def look(self, folder: Path) -> None:
        """See what a folder holds."""
        # reading results takes seconds to import, which `list` must not wait for
        from rig.archive.session_rows import session_rows

        files, name = files_of(folder), str(folder)
        before = self.places.get(name)
        if not self.read and before is not None and before.files == files and before.version in self._there:
            self.known += 1
            self.seen.append(name)
            return
        try:
            found = session_rows(folder)
        except RecordError as error:
            say(f"{error}; {folder} stays as it was in the archive")
            self.unread.append(folder)
            return
        for flaw in found.flaws:
            say(flaw)
        if not found.rows:
            return
        self.seen.append(name)
        rows = found.rows
        if self._seal is not None and self._seal.public_key:
            hides = [*self._seal.scales, *withheld(self._seal)]
            rows = [enclosed_row(row, self._seal.public_key, hides) for row in rows]
        version, sha256 = self.store.sessions.write(found.session, rows)
        self._there.add(version)
        inside = not any(Path(row["record"]).is_absolute() for row in found.rows)
        place = _Place(version, sha256, files if inside else "", tuple(row["sha256"] for row in found.rows))
        if before is not None and before.version == version:
            self.known += 1
            if before.files != place.files:
                self._say(name, place)
        else:
            self.added, self.runs = self.added + 1, self.runs + len(place.runs)
            self._added_runs.update(place.runs)
            self._say(name, place)
        late = time.monotonic() - self._written_s > _WRITTEN_EVERY_S
        if len(self.waiting) >= MANY or (late and self.waiting):
            self.write()
            if self._written - self._merged >= MANY:
                self._merged = self._written
                self.store.merge_many()

    def affirm(self) -> None:
        """Say again what is as it was where a run would be listed from elsewhere than it was seen last."""
        last = {run: name for name in self.seen for run in self.places[name].runs}
        for name in dict.fromkeys(self.seen):
            here = (self.computer, name)
            runs = self.places[name].runs
            if any(last[run] == name and self.listed.get(run) != here for run in runs):
                self._say(name, self.places[name])
        self.write()

    def write(self) -> None:
        """Write what was seen into the log."""
        self._written_s = time.monotonic()
        if self.waiting:
            self._written += len(self.waiting)
            self.store.log.write(self.waiting)
            self.waiting = []

    def told(self) -> str:
        """A line that counts."""
        again = self.runs - len(self._added_runs)
        twice = f", {again} of them in more than one session and listed once" if again else ""
        sessions = f"{self.added} session{'' if self.added == 1 else 's'} added"
        return (
            f"{sessions} ({self.runs} run{'' if self.runs == 1 else 's'}{twice}), {self.known} known already"
        )

    def _say(self, folder: str, place: _Place) -> None:
        from rig.archive.session_rows import now_utc

        here = (self.computer, folder)
        before = self.places.get(folder)
        for run in before.runs if before is not None else ():
            if self.listed.get(run) == here:
                del self.listed[run]
        self.listed |= dict.fromkeys(place.runs, here)
        self.places[folder] = place
        seen = now_utc().isoformat()
        self.waiting.append(Fact(self.computer, folder, place.version, place.sha256, place.files, seen))


def files_of(folder: Path) -> str:
    """Hash of names, sizes and times of a session's files, as far as `add` reads them."""
    found, has_hidden = [], False
    for entry in os.scandir(folder):
        has_hidden |= entry.name.startswith(".")
        if entry.name.endswith((".mcap", ".json")) and entry.is_file():
            status = entry.stat()
            found.append(f"{entry.name}\0{status.st_size}\0{status.st_mtime_ns}")
    if has_hidden:
        # what a killed `recover` left
        take_away_leftovers(folder)
    return hashlib.sha256("\n".join(sorted(found)).encode()).hexdigest()


def session_folders(source: Path, archive: Path) -> Iterator[Path]:
    """Folders with records or results in and below one, in order; never those of the archive itself."""
    own = archive.resolve()
    for name, folders, files in os.walk(source.resolve()):
        folder = Path(name)
        folders[:] = sorted(inner for inner in folders if folder / inner != own)
        if any(
            file.endswith(".mcap") or (file.startswith("results") and file.endswith(".json"))
            for file in files
        ):
            yield folder
