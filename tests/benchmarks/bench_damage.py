"""What is lost of a damaged record: changed bits, cuts, both."""

import contextlib
import logging
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.record import pixels_path
from acquisition.record.check import check_record
from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from tests.acquisition.record.samples import BLOCK, write_sample

FRAMES = 640


def damages(count: int) -> dict[str, Any]:
    """What is lost of a record by so many changed bits, cuts, and both."""
    # every damaged place would be logged
    logging.disable(logging.WARNING)
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_sample(folder / "whole.mcap", FRAMES)
        rng = np.random.default_rng(7)
        for what, file in (("numbers", folder / "whole.mcap"), ("pixels", folder / "whole.pixels.mcap")):
            results[what] = _of_file(folder, file.read_bytes(), what, count // 2, rng)
    return results


def _of_file(folder: Path, whole: bytes, what: str, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """One of the record's files damaged, the other whole."""
    path = folder / "run.mcap"
    for name in ("whole.mcap", "whole.pixels.mcap"):
        (folder / name.replace("whole", "run")).write_bytes((folder / name).read_bytes())
    damaged = path if what == "numbers" else pixels_path(path)
    places, cuts = rng.integers(0, len(whole), count), rng.integers(3000, len(whole), count)
    results: dict[str, Any] = {"bytes": len(whole)}
    for kind, flips, lengths in (
        ("flipped", places, [len(whole)] * count),
        ("cut", [-1] * count, cuts),
        ("flipped and without footer", places % (len(whole) - 40), [len(whole) - 40] * count),
        ("flipped and cut", places % cuts, cuts),
    ):
        results[kind] = _lost(path, damaged, whole, flips, lengths)
    return results


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` takes a twentieth of the places."""
    return damages(50 if quick else 1000)


def _lost(path: Path, damaged: Path, whole: bytes, flips: Any, lengths: Any) -> dict[str, Any]:
    """Most frames that one file lost beyond what its cut took, and how many flips `check` did not find."""
    most = missed = wrong = 0
    damaged.write_bytes(whole)
    chunks = _frames_by_chunk(path, damaged)
    expected: dict[int, tuple[set[int], set[int]]] = {}
    for place, length in zip(flips, lengths, strict=True):
        length = int(length)
        if length not in expected:
            damaged.write_bytes(whole[:length])
            expected[length] = _frames(path)
        if place < 0:
            # everything in chunks that end before the cut is there
            complete = sum(count for end, count in chunks if end <= length)
            place_in = int(damaged != path)
            most = max(most, complete - len(expected[length][place_in]))
            continue
        changed = bytearray(whole[:length])
        changed[int(place)] ^= 1 << int(place) % 8
        damaged.write_bytes(changed)
        spots, windows = _frames(path)
        before_spots, before_windows = expected[length]
        wrong += not (spots <= before_spots and windows <= before_windows)
        most = max(most, len(before_spots - spots) + len(before_windows - windows))
        with contextlib.suppress(RecordError):
            missed += not any(finding.severity == "error" for finding in check_record(path))
    return {
        "frames of a chunk": BLOCK,
        "most frames lost": most,
        "not found by check": missed,
        "with frames that were never written": wrong,
    }


def _frames(path: Path) -> tuple[set[int], set[int]]:
    """Frame numbers of spots and windows; none of a file that is refused, as one cut within its head."""
    try:
        with RecordReader(path) as reader:
            return set(reader.spots()["sequence"].tolist()), {window.sequence for window in reader.windows()}
    except RecordError:
        return set(), set()


def _frames_by_chunk(path: Path, damaged: Path) -> list[tuple[int, int]]:
    """Of every chunk of one file its end, and how many spots or windows it holds."""
    with RecordReader(path) as reader:
        file = next(file for file in reader.files if file.path == damaged)
        return [
            (
                place.offset + place.length,
                sum(one.topic in ("/spot", "/window") for one in file.piece(place).messages()),
            )
            for place in file.chunks
        ]
