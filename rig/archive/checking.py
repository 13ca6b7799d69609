"""`rig archive check`: every file of an archive proved, what facts name missed, records hashed again."""

import os
import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.record.digest import sha256_of
from processing.errors import ConfigurationError, RecordError
from rig.archive.adding import add_sessions
from rig.archive.facts import Fact, FactLog
from rig.archive.proved import prove, read_file, sha256_hex
from rig.archive.remote import is_remote, restored
from rig.archive.store import Archive, duckdb_module, reads_archive
from rig.presentation import say

_SAID_EVERY_S = 5.0
_DONE = ".checked"
"""File of the archive that names the records of an unfinished check, so that the next one goes on."""
_FOLDERS = ("", "facts", "sessions", "refits", "merged", "remarks", "blind", "quarantine")


@dataclass
class _Found:
    """What a check has found: files that are not as they were, by their name in the archive, and why."""

    flaws: dict[str, str] = field(default_factory=dict)
    proved: int = 0
    unproved: int = 0
    unknown: list[str] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)


@reads_archive
def check_archive(archive: Path, *, records: bool = False, repair: bool = False, url: str = "") -> int:
    """Prove every file of an archive, and with `records` that those on this computer are what it knows.

    `repair` removes what is damaged and follows from the rest, makes states again from their folders, and, of
    the archive that `url` names, of which `archive` is a copy, puts back on either side what is sound on the
    other. Prints what was found; returns the exit status: 1 where something is not as it was written and was
    not repaired.

    Raises ConfigurationError where there is no archive.
    """
    duckdb_module()
    if not archive.is_dir():
        raise ConfigurationError(f"{archive}: is not an archive; rig archive add makes one")
    found = _files(archive)
    if is_remote(url):
        for name, (line, mended) in restored(url, repair=repair).items():
            found.flaws.pop(name, None)
            if mended:
                found.lines.append(f"repaired: {line}")
            else:
                found.flaws[name] = line
    if repair and found.flaws:
        _repair(archive, found)
    for line in (*found.lines, *found.flaws.values()):
        print(line)
    failed = len(found.flaws)
    for name in found.unknown:
        print(f"{archive / name}: belongs to no archive")
    told = f"{found.proved} files verified, {failed} damaged or missing"
    if found.unproved:
        told += f", {found.unproved} of an earlier version, which nothing proves"
    if records and not failed:
        wrong, read = _records(archive)
        failed += len(wrong)
        for line in wrong:
            print(line)
        told += f"; {read} records read, {len(wrong)} not as the archive knows them"
    print(told)
    return 1 if failed else 0


def _files(archive: Path) -> _Found:
    found, stated = _Found(), dict[str, str]()
    facts = _facts(archive, found)
    for fact in facts:
        stated[f"sessions/{fact.version}.parquet"] = fact.sha256
    told_s, done = time.monotonic(), 0
    for name in _names(archive):
        path = archive / name
        done += 1
        if time.monotonic() - told_s > _SAID_EVERY_S:
            told_s = time.monotonic()
            say(f"{done} files read")
        if name in found.flaws:
            continue
        if name.rpartition("/")[0] not in _FOLDERS or (name.count("/") == 0 and name != "archive.json"):
            found.unknown.append(name)
            continue
        try:
            data = read_file(path)
            known = prove(path, name, data)
            if name in stated and sha256_hex(data) != stated[name]:
                raise RecordError(f"{path}: its bytes have changed since it was added")
        except RecordError as error:
            found.flaws[name] = str(error)
            continue
        found.proved += known or name in stated
        found.unproved += not known and name not in stated
    for name in sorted(stated.keys() - found.flaws.keys()):
        if not (archive / name).exists():
            found.flaws[name] = f"{archive / name}: is missing"
    return found


def _facts(archive: Path, found: _Found) -> list[Fact]:
    """All facts, whose files follow one another; of those that cannot be read it is said."""
    log, facts = FactLog(archive), list[Fact]()
    try:
        names = Archive(archive).names()
    except RecordError as error:
        found.flaws["facts"] = str(error)
        names = {path.name for path in log.folder.glob("*.facts")}
    hashes = dict.fromkeys(names, "")
    for name in sorted(names):
        try:
            entry = log.entry(name)
        except RecordError as error:
            found.flaws[f"facts/{name}"] = str(error)
            continue
        hashes[name] = entry.sha256
        facts += entry.facts
        computer, _, number = name.removesuffix(".facts").rpartition("-")
        before = f"{computer}-{int(number) - 1:08d}.facts"
        if hashes.get(before, "") not in ("", entry.before):
            found.flaws[f"facts/{name}"] = f"{log.folder / name}: does not follow from the present {before}"
    return facts


def _names(archive: Path) -> Iterator[str]:
    for folder, folders, files in os.walk(archive):
        folders.sort()
        for file in sorted(files):
            if not file.startswith("."):
                yield (Path(folder) / file).relative_to(archive).as_posix()


def _repair(archive: Path, found: _Found) -> None:
    """Remove what follows from the rest, and make states again from folders that are here."""
    states = {name for name in found.flaws if name.startswith("sessions/")}
    for name in list(found.flaws):
        if name.startswith("merged/"):
            (archive / name).unlink(missing_ok=True)
            found.lines.append(f"repaired: {found.flaws.pop(name)}; it is made again when needed")
        elif name.startswith("refits/"):
            (archive / name).unlink(missing_ok=True)
            found.lines.append(f"removed: {found.flaws.pop(name)}; rig archive refit makes it again")
    if any(name.startswith(("facts", "archive.json")) for name in found.flaws):
        return
    folders = sorted(
        {
            Path(fact.folder)
            for entry in FactLog(archive).entries(FactLog(archive).names())
            for fact in entry.facts
            if f"sessions/{fact.version}.parquet" in states and fact.computer == platform.node()
        }
    )
    here = [folder for folder in folders if folder.is_dir()]
    if here:
        say(add_sessions(archive, here, read=True))
    again = _files(archive).flaws
    for name in states - again.keys():
        found.lines.append(f"repaired: {found.flaws.pop(name)}; made again from its records")


def _records(archive: Path) -> tuple[list[str], int]:
    """Records of this computer that are not what the archive knows, and how many were read."""
    question = (
        "select distinct folder, record, sha256 from latest "
        "where computer = ? and state <> 'missing' order by all"
    )
    rows: Sequence[tuple[str, str, str]] = (
        Archive(archive).connection().execute(question, [platform.node()]).fetchall()
    )
    done_path = archive / _DONE
    done = set(done_path.read_text(encoding="utf-8").splitlines()) if done_path.exists() else set()
    wrong: list[str] = []
    told_s, read = time.monotonic(), 0
    with done_path.open("a", encoding="utf-8") as progress:
        for number, (folder, record, sha256) in enumerate(rows, 1):
            path = Path(folder) / record
            try:
                status = path.stat()
                mark = f"{sha256} {status.st_size} {status.st_mtime_ns}"
                if mark in done:
                    continue
                read += 1
                if sha256_of(path) != sha256:
                    wrong.append(f"{path}: is not the record that was added; rig archive add")
                    continue
            except (OSError, RecordError) as error:
                wrong.append(str(error) if isinstance(error, RecordError) else f"{path}: {error.strerror}")
                continue
            print(mark, file=progress, flush=True)
            if time.monotonic() - told_s > _SAID_EVERY_S:
                told_s = time.monotonic()
                say(f"{number} of {len(rows)} records")
    done_path.unlink()
    return wrong, read
