"""What commands keep of a record for each of its frames, so that a day's record fits into memory."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from acquisition.record.check import check_record
from rig.analysis import analyse_record
from tests.rig.long_record import make_long_record

SHORT, LONG = 6_000, 18_000


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("long")
    return (
        make_long_record(folder / "short.mcap", SHORT),
        make_long_record(folder / "long.mcap", LONG),
    )


def bytes_per_spot(command: Callable[[Path], object], records: tuple[Path, Path]) -> float:
    """By how much the most memory that python and numpy hold at a time grows with the record."""
    command(records[0])  # what is loaded or compiled once stays
    peaks = []
    for record in records:
        tracemalloc.start()
        try:
            command(record)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    return (peaks[1] - peaks[0]) / (LONG - SHORT)


@pytest.mark.slow
def test_a_fit_keeps_the_coordinates_and_one_copy_of_one_of_them(
    records: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """24 bytes a frame; the rest is half-cycles and the chunks' index. The whole table would be 168."""
    # both are long
    monkeypatch.setattr("rig.analysis.passing_deflections._MOST_IN_MEMORY", 0)
    assert bytes_per_spot(analyse_record, records) < 48


def test_a_check_keeps_one_byte_for_a_spot_and_one_for_a_window(records: tuple[Path, Path]) -> None:
    """And the chunks' index: 34 bytes for each of two chunks in 48 frames, twice."""
    assert bytes_per_spot(check_record, records) < 10
