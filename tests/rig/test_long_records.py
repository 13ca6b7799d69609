"""What commands keep of a record for each of its frames, so that a day's record fits into memory."""

import tracemalloc
from collections.abc import Callable, Sized
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.check import check_record
from processing.fit import DecayFit
from rig.analysis import analyse_record
from rig.analysis.contact_fits import fit_decay
from tests.rig.long_record import make_long_record

SHORT, LONG = 6_000, 13_000


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("long")
    return (
        make_long_record(folder / "short.mcap", SHORT),
        make_long_record(folder / "long.mcap", LONG),
    )


def bytes_per_spot(command: Callable[[Path], object], records: tuple[Path, Path]) -> float:
    """By how much the most memory that python and numpy hold at a time grows with the record."""
    for record in records:
        command(record)  # what is loaded, compiled or remembered once stays
    peaks = []
    for record in records:
        tracemalloc.start()
        try:
            command(record)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    return (peaks[1] - peaks[0]) / (LONG - SHORT)


def remembered(call: Callable[..., Any]) -> Callable[..., Any]:
    """The same, made once for each number of half-cycles: fits, which watching their memory makes slow."""
    kept: dict[tuple[int, ...], Any] = {}

    def once(*words: Any, **more: Any) -> Any:
        key = tuple(len(word) if isinstance(word, Sized) else 0 for word in words)
        if key not in kept:
            kept[key] = call(*words, **more)
        return kept[key]

    return once


@pytest.mark.slow
def test_a_fit_keeps_the_coordinates_and_one_copy_of_one_of_them(
    records: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """24 bytes a frame; the rest is half-cycles and the chunks' index. The whole table would be 168."""
    monkeypatch.setattr(DecayFit, "of", remembered(DecayFit.of))
    monkeypatch.setattr("rig.analysis.half_cycle_fits.fit_decay", remembered(fit_decay))
    # both are long
    monkeypatch.setattr("rig.analysis.passing_deflections._MAX_FRAMES_IN_MEMORY", 0)
    assert bytes_per_spot(analyse_record, records) < 56


def test_a_check_keeps_one_byte_for_a_spot_and_one_for_a_window(records: tuple[Path, Path]) -> None:
    """And the chunks' index: 240 bytes for each of two chunks in 48 frames, twice."""
    assert bytes_per_spot(check_record, records) < 26
