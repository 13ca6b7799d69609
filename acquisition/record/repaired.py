"""Repaired copies of a record, `NAME-recovered.mcap` beside it, and which holds the most of the run."""

import re
from collections.abc import Iterable
from pathlib import Path

from acquisition.record.digest import sha256_of
from acquisition.record.proof import RECOVERY, is_sound
from acquisition.record.reader import RecordReader
from acquisition.record.recover import Recovery, recover
from acquisition.record.whole_file import take_away_leftovers
from processing.errors import RecordError

_REPAIRED = re.compile(r"(.+)-recovered(?:-(\d+))?")


def copies_of(record: Path) -> list[Path]:
    """What lies beside a record under the names of repaired copies of it, in the order of their numbers."""
    found = []
    for path in record.parent.glob(f"{record.stem}-recovered*{record.suffix}"):
        parts = _REPAIRED.fullmatch(path.stem)
        if parts is not None and parts[1] == record.stem:
            found.append((int(parts[2] or 1), path))
    return [path for _, path in sorted(found)]


def originals(records: Iterable[Path]) -> dict[Path, list[Path]]:
    """Records of one folder, each with its repaired copies; a copy without its original is an original."""
    by_name = {path: list[Path]() for path in sorted(records)}
    for path in list(by_name):
        parts = _REPAIRED.fullmatch(path.stem)
        original = None if parts is None else path.with_name(f"{parts[1]}{path.suffix}")
        if original in by_name:
            by_name[original].append(path)
            del by_name[path]
    return by_name


def fullest(record: Path, copies: Iterable[Path]) -> Path:
    """Of a record and its repaired copies the one with the most frames that can be read.

    A copy must prove itself and say that it was recovered; of two that hold as many frames, the copy.
    """
    best, most = record, -1
    for path in (record, *copies):
        frames = _frames(path, is_copy=path != record)
        if frames > most or (frames == most and best == record):
            best, most = path, frames
    return best


def repaired(record: Path) -> tuple[Path, Recovery | None]:
    """A whole copy of a record beside it: one that was made of it as it is now, else a new one.

    A copy that is no longer what it was, or is of an earlier state of the record, stays, and the new one has
    the next free name. Raises RecordError where none can be made.
    """
    take_away_leftovers(record.parent)
    copies = copies_of(record)
    if copies:
        source = sha256_of(record)
        for path in reversed(copies):
            if _is_made_of(path, source):
                return path, None
    taken = {path.name for path in copies}
    number = 1
    while (target := _name(record, number)).name in taken or target.exists():
        number += 1
    return target, recover(record, target)


def _name(record: Path, number: int) -> Path:
    return record.with_name(f"{record.stem}-recovered{f'-{number}' if number > 1 else ''}{record.suffix}")


def _is_made_of(path: Path, source_sha256: str) -> bool:
    try:
        with RecordReader(path) as reader:
            said = reader.metadata.get(next(reversed(reader.metadata), ""), {})
            return said.get("source_sha256") == source_sha256 and is_sound(reader.file, reader.contents)
    except RecordError:
        return False


def _frames(path: Path, *, is_copy: bool) -> int:
    """Frames whose spots can be read; -1 of what is no record, or no proved copy."""
    try:
        with RecordReader(path) as reader:
            recovered = any(name.startswith(RECOVERY) for name in reader.metadata)
            if is_copy and not (recovered and is_sound(reader.file, reader.contents)):
                return -1
            return sum(len(block) for block in reader.spot_blocks(fields=("sequence",)))
    except RecordError:
        return -1
